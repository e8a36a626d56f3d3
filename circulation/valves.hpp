// Valve laws: flow Q from the upstream pressure p1 to the downstream pressure p2. mmHg, mL, s.
//
//   diode        Q = (p1 - p2)/Rmin if p1 > p2, else (p1 - p2)/Rmax          (Regazzoni et al. 2022)
//   log-arctan   log10 R runs from Rmin to Rmax with 1/2 + arctan(100 pi (p2 - p1))/pi: smooth, fat tails
//   tanh         R runs from Rmin to Rmax with (1 + tanh(k (p2 - p1)))/2
//   ideal        Q = max(p1 - p2, 0)/Rmin: no leak
//
// The whole-heart paper (Fedele et al. 2023) prints the diode with its branches swapped: read literally the
// valve would block forward and pass backward flow. Rmin belongs to p1 > p2. Laws differ visibly in a limit
// cycle (up to 0.2 mL): never compare runs with different laws at integration accuracy.
//
// To add a law: a struct like those below and its entry in `ValveLaws`.
//   name           as files say it
//   has_kink       the resistance jumps where p1 = p2 (the flow is continuous there). Integrators stop at
//                  that instant; the struct has, in place of flow, resistance(valve, open): where the
//                  resistance of that side is, nullptr where nothing flows
//   has_steepness  the key tanh_steepness is read, and takes part in sensitivities
//   flow           for any kind of number: dp = p1 - p2; it and its derivative are finite at any drop
// Their numbers are those of ValveParametersOf, and tanh_steepness. tests/own_network.cmake follows this.
#pragma once

#include <array>
#include <string>
#include <string_view>
#include <tuple>
#include <type_traits>
#include <utility>
#include <wiggers/core/numbers.hpp>
#include <wiggers/core/quantity.hpp>

namespace wiggers {

template <class P>
struct ValveParametersOf {
  P Rmin = 0.0075;
  P Rmax = 75000;
};
using ValveParameters = ValveParametersOf<double>;
inline constexpr std::array valve_quantities = {
    Quantity{"Rmin", "mmHg s/mL", 0.0075, 2e-4, 5, "resistance of the open valve"},
    Quantity{"Rmax", "mmHg s/mL", 75000, 1e-3, 1e9, "resistance of the closed valve"},
};
static_assert(well_formed(valve_quantities));
// Copies values between fields of two kinds of number.
template <class From, class To>
void copy_values(const From& from, const To& to) {
  for (std::size_t k = 0; k < from.size(); ++k) *to[k] = value_of(*from[k]);
}
// The fields in the order of the quantities.
template <class Valve>
auto fields_of(Valve& v) requires requires {
  v.Rmin;
}
{ return std::array{&v.Rmin, &v.Rmax}; }
inline constexpr Quantity tanh_steepness_quantity = {
    "tanh_steepness", "1/mmHg", 20, 0.1, 1e4, "steepness k of the tanh valve law"};

struct DiodeValve {
  static constexpr std::string_view name = "diode";
  static constexpr bool has_kink = true, has_steepness = false;
  template <class P>
  static const P* resistance(const ValveParametersOf<P>& valve, bool open) {
    return open ? &valve.Rmin : &valve.Rmax;
  }
};

struct LogArctanValve {
  static constexpr std::string_view name = "log-arctan";
  static constexpr bool has_kink = false, has_steepness = false;
  template <class T, class P>
  static T flow(const ValveParametersOf<P>& valve, const P&, const T& dp) {
    constexpr double pi = 3.14159265358979323846;
    const T closed = 0.5 + atan(T(-100.0 * pi * dp)) * (1.0 / pi);
    const P low = log(valve.Rmin), high = log(valve.Rmax);
    return dp * exp(T(-(low + (high - low) * closed)));
  }
};

struct TanhValve {
  static constexpr std::string_view name = "tanh";
  static constexpr bool has_kink = false, has_steepness = true;
  template <class T, class P>
  static T flow(const ValveParametersOf<P>& valve, const P& steepness, const T& dp) {
    const T closed = 0.5 * (1.0 + tanh(T(-steepness * dp)));
    return dp / (valve.Rmin + (valve.Rmax - valve.Rmin) * closed);
  }
};

struct IdealValve {
  static constexpr std::string_view name = "ideal";
  static constexpr bool has_kink = true, has_steepness = false;
  template <class P>
  static const P* resistance(const ValveParametersOf<P>& valve, bool open) {
    return open ? &valve.Rmin : nullptr;
  }
};

using ValveLaws = std::tuple<DiodeValve, LogArctanValve, TanhValve, IdealValve>;

// --- what follows ---------------------------------------------------------------------------------------

enum class ValveLaw : int {};  // place in ValveLaws
inline constexpr int n_valve_laws = std::tuple_size_v<ValveLaws>;

namespace valve_laws {
template <class Law, std::size_t k = 0>
consteval int place() {
  if constexpr (std::is_same_v<Law, std::tuple_element_t<k, ValveLaws>>)
    return static_cast<int>(k);
  else
    return place<Law, k + 1>();
}
// f(Law{}) of the law at a place.
template <std::size_t k = 0, class F>
[[gnu::always_inline]] inline auto with(ValveLaw law, F f) {
  if constexpr (k + 1 < std::tuple_size_v<ValveLaws>)
    if (static_cast<std::size_t>(law) != k) return with<k + 1>(law, f);
  return f(std::tuple_element_t<k, ValveLaws>{});
}
}  // namespace valve_laws

template <class Law>
inline constexpr ValveLaw law_of = ValveLaw{valve_laws::place<Law>()};

inline constexpr auto valve_law_names = []<std::size_t... k>(std::index_sequence<k...>) {
  return std::array<std::string_view, sizeof...(k)>{std::tuple_element_t<k, ValveLaws>::name...};
}
(std::make_index_sequence<std::tuple_size_v<ValveLaws>>());

inline bool has_kink(ValveLaw law) {
  return valve_laws::with(law, []<class Law>(Law) { return Law::has_kink; });
}
inline bool has_steepness(ValveLaw law) {
  return valve_laws::with(law, []<class Law>(Law) { return Law::has_steepness; });
}

// The flow of a valve whose law has a kink, and which is known to be open or closed.
template <class T, class P>
T valve_flow_when(bool open, ValveLaw law, const ValveParametersOf<P>& valve, const T& dp) {
  const P* R = valve_laws::with(law, [&]<class Law>(Law) -> const P* {
    if constexpr (Law::has_kink) return Law::resistance(valve, open);
    return nullptr;
  });
  return R ? T(dp / *R) : T(0.0);
}

template <class T, class P>
T valve_flow(ValveLaw law, const ValveParametersOf<P>& valve, const std::type_identity_t<P>& steepness,
             const T& p1, const T& p2) {
  const T dp = p1 - p2;
  return valve_laws::with(law, [&]<class Law>(Law) {
    if constexpr (Law::has_kink) {
      const P* R = Law::resistance(valve, value_of(dp) > 0);
      return R ? T(dp / *R) : T(0.0);
    } else {
      return Law::flow(valve, steepness, dp);
    }
  });
}

}  // namespace wiggers
