# The recipes of circulation/network.hpp and valves.hpp, followed: a copy of the circulation with a vessel, a
# shunt and a valve law of one's own, built and tested (models/own_network.cpp).
include(own_copy.cmake)
own_copy(circulation own_network)
# A vessel: its enumerator, its line, the outlet that now leads to it, quantities of its own, numbers in every set.
own_line(own_network/circulation/network.hpp "enum Vessel { AR_SYS," "enum Vessel { AR_SYS, CAP_SYS,")
own_line(own_network/circulation/network.hpp "node\\(VEN_SYS\\)}," "node(CAP_SYS)},
    VesselEntry{\"CAP_SYS\", SYS,
                {Quantity{\"R_CAP\", \"mmHg s/mL\", 0.05, 1e-4, 20, \"capillary resistance\"},
                 Quantity{\"C_CAP\", \"mL/mmHg\", 0.5, 0.02, 200, \"capillary compliance\"},
                 Quantity{\"L_CAP\", \"mmHg s^2/mL\", 1e-3, 1e-5, 0.1, \"capillary inertance\"}},
                {\"p_CAP_SYS\", \"mmHg\", 30, -60, 500, \"systemic capillary pressure\"},
                {\"Q_CAP_SYS\", \"mL/s\", 0, -5000, 5000, \"systemic capillary flow\"}, node(VEN_SYS)},")
own_line(own_network/circulation/loop_sets.cpp "(all\\({{[^}]*},)" "\\1 {0.05, 0.5, 1e-3},")
own_line(own_network/circulation/loop_sets.cpp "(start\\({[^}]*},[ \n]*{[^,]*,)([^}]*},[ \n]*{[^,]*,)" "\\1 30,\\2 0,")
# A shunt: its line.
own_line(own_network/circulation/network.hpp "(constexpr std::array shunts = {)"
         "\\1 Branch{\"AVF\", \"arteriovenous fistula\", node(AR_SYS), node(VEN_SYS)},")
# A valve law: its struct and its entry.
own_line(own_network/circulation/valves.hpp "using ValveLaws = std::tuple<" "struct BlendValve {
  static constexpr std::string_view name = \"blend\";
  static constexpr bool has_kink = false, has_steepness = false;
  template <class T, class P>
  static T flow(const ValveParametersOf<P>& valve, const P&, const T& dp) {
    const T open = 0.5 * (1.0 + tanh(T(10.0 * dp)));
    return dp * (1.0 / valve.Rmax + (1.0 / valve.Rmin - 1.0 / valve.Rmax) * open);
  }
};
using ValveLaws = std::tuple<BlendValve, ")

wiggers_test(own_network wiggers::core models/own_network.cpp ${own_network_sources})
target_include_directories(test_own_network BEFORE PRIVATE ${own_network_include})
