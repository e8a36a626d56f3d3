// The closed loop as a network, written once: nodes that hold blood and branches that carry it.
//
//   lungs -> VEN_PUL -> LA -MV-> LV -AV-> AR_SYS -> VEN_SYS -> RA -TV-> RV -PV-> AR_PUL -> lungs
//
//   node     a chamber (its volume is a state, its pressure comes from its wall) or a vessel (its pressure is
//            a state: C dp/dt = inflow - outflow)
//   branch   a valve (valves.hpp), the outlet of a vessel (R and L in series: its flow is a state), or a
//            shunt (shunts.hpp), which is there only where it is named
//
// Rates, pressure drops, volumes, power, stiffness, scales, columns, files and derivatives all follow from
// the tables here, unrolled while compiling.
//
// To add
//   a shunt: its line in `shunts`.
//   a vessel: its enumerator in `Vessel` and its line in `vessels`, where the outlet of the vessel before it
//     now leads to it; quantities with names of its own, if its circuit has vessels of its kind; and its
//     numbers in every set of loop_sets.cpp, which asks for them. Every loop then has it.
// tests/own_network.cmake follows this.
#pragma once

#include <array>
#include <span>
#include <string_view>
#include <type_traits>
#include <utility>
#include <wiggers/core/enumerators.hpp>
#include <wiggers/core/quantity.hpp>

namespace wiggers {

enum Chamber { LA, LV, RA, RV };
enum Vessel { AR_SYS, VEN_SYS, AR_PUL, VEN_PUL };
enum ValveIndex { MV, AV, TV, PV };
enum CircuitIndex { SYS, PUL };

// The circulation's state: volumes of the chambers, pressures of the vessels, flows out of the vessels. The
// first state of node n stands at place n.
inline constexpr int n_chambers = 4;
constexpr int node(Chamber c) { return c; }
constexpr int node(Vessel v) { return n_chambers + v; }

inline constexpr std::array<std::string_view, 2> circuit_names = {"SYS", "PUL"};

namespace network {

struct ChamberEntry {
  std::string_view name;
  Quantity volume;
};
// Defaults of all states: the start of the set wiggers-healthy-0d.
inline constexpr std::array<ChamberEntry, n_chambers> chambers = {
    {{"LA", {"V_LA", "mL", 65, 0, 2000, "volume of the left atrium"}},
     {"LV", {"V_LV", "mL", 120, 0, 2000, "volume of the left ventricle"}},
     {"RA", {"V_RA", "mL", 65, 0, 2000, "volume of the right atrium"}},
     {"RV", {"V_RV", "mL", 145, 0, 2000, "volume of the right ventricle"}}}};

// Resistance, compliance, inertance. From an infant's circulation to a large adult's, ill or not; the same
// for the body and the lungs.
using VesselQuantities = std::array<Quantity, 3>;
inline constexpr VesselQuantities arterial_quantities = {
    Quantity{"R_AR", "mmHg s/mL", 0.48, 1e-4, 20, "arterial resistance"},
    Quantity{"C_AR", "mL/mmHg", 1.5, 0.02, 200, "arterial compliance"},
    Quantity{"L_AR", "mmHg s^2/mL", 5e-3, 1e-5, 0.1, "arterial inertance"}};
inline constexpr VesselQuantities venous_quantities = {
    Quantity{"R_VEN", "mmHg s/mL", 0.26, 1e-4, 20, "venous resistance"},
    Quantity{"C_VEN", "mL/mmHg", 60, 0.2, 600, "venous compliance"},
    Quantity{"L_VEN", "mmHg s^2/mL", 5e-4, 1e-5, 0.1, "venous inertance"}};

struct VesselEntry {
  std::string_view name;
  CircuitIndex circuit;         // the table of its numbers in files
  VesselQuantities quantities;  // R, C, L
  Quantity pressure, flow;      // states
  int outlet;                   // node
};
inline constexpr std::array vessels = {
    VesselEntry{"AR_SYS",
                SYS,
                arterial_quantities,
                {"p_AR_SYS", "mmHg", 80, -60, 500, "systemic arterial pressure"},
                {"Q_AR_SYS", "mL/s", 0, -5000, 5000, "systemic arterial flow"},
                node(VEN_SYS)},
    VesselEntry{"VEN_SYS",
                SYS,
                venous_quantities,
                {"p_VEN_SYS", "mmHg", 28, -60, 500, "systemic venous pressure"},
                {"Q_VEN_SYS", "mL/s", 0, -5000, 5000, "systemic venous flow, into the right atrium"},
                node(RA)},
    VesselEntry{"AR_PUL",
                PUL,
                arterial_quantities,
                {"p_AR_PUL", "mmHg", 18, -60, 500, "pulmonary arterial pressure"},
                {"Q_AR_PUL", "mL/s", 0, -5000, 5000, "pulmonary arterial flow"},
                node(VEN_PUL)},
    VesselEntry{"VEN_PUL",
                PUL,
                venous_quantities,
                {"p_VEN_PUL", "mmHg", 12, -60, 500, "pulmonary venous pressure"},
                {"Q_VEN_PUL", "mL/s", 0, -5000, 5000, "pulmonary venous flow, into the left atrium"},
                node(LA)}};

struct Branch {
  std::string_view name, meaning;
  int from, to;  // nodes
};
inline constexpr std::array valves = {
    Branch{"MV", "mitral valve", node(LA), node(LV)},
    Branch{"AV", "aortic valve", node(LV), node(AR_SYS)},
    Branch{"TV", "tricuspid valve", node(RA), node(RV)},
    Branch{"PV", "pulmonary valve", node(RV), node(AR_PUL)},
};
inline constexpr std::array shunts = {
    Branch{"ASD", "atrial septal defect", node(LA), node(RA)},
    Branch{"VSD", "ventricular septal defect", node(LV), node(RV)},
    Branch{"PDA", "patent arterial duct", node(AR_SYS), node(AR_PUL)},
};

}  // namespace network

// --- what follows ---------------------------------------------------------------------------------------

inline constexpr int n_vessels = static_cast<int>(network::vessels.size());
inline constexpr int n_valves = static_cast<int>(network::valves.size());
inline constexpr int n_shunts = static_cast<int>(network::shunts.size());
inline constexpr int n_nodes = n_chambers + n_vessels;
inline constexpr int n_circulation_states = n_nodes + n_vessels;
constexpr int volume_of(Chamber c) { return c; }
constexpr int pressure_of(Vessel v) { return n_chambers + v; }
constexpr int flow_of(Vessel v) { return n_nodes + v; }

namespace network {

template <auto& entries, class E>
consteval bool named_by() {
  return [&]<std::size_t... i>(std::index_sequence<i...>) {
    return ((enumerator_name<static_cast<E>(i)>() == entries[i].name) && ...);
  }
  (std::make_index_sequence<entries.size()>{});
}
static_assert(named_by<chambers, Chamber>() && named_by<vessels, Vessel>() && named_by<valves, ValveIndex>());

template <class Entry, std::size_t N>
consteval auto names_of(const std::array<Entry, N>& entries) {
  std::array<std::string_view, N> names;
  for (std::size_t k = 0; k < N; ++k) names[k] = entries[k].name;
  return names;
}

constexpr std::string_view node_name(int n) {
  return n < n_chambers ? chambers[n].name : vessels[n - n_chambers].name;
}

consteval auto states() {
  std::array<Quantity, n_circulation_states> list;
  for (int c = 0; c < n_chambers; ++c) list[static_cast<std::size_t>(c)] = chambers[c].volume;
  for (int v = 0; v < n_vessels; ++v) {
    list[static_cast<std::size_t>(n_chambers + v)] = vessels[v].pressure;
    list[static_cast<std::size_t>(n_nodes + v)] = vessels[v].flow;
  }
  return list;
}

constexpr bool at_valve(int n) {
  for (const Branch& valve : valves)
    if (valve.from == n || valve.to == n) return true;
  return false;
}

// Calls f with 0 to n - 1 as constants.
template <int n, class F>
[[gnu::always_inline]] constexpr void unrolled(F f) {
  [&]<int... i>(std::integer_sequence<int, i...>) { (f(std::integral_constant<int, i>{}), ...); }
  (std::make_integer_sequence<int, n>{});
}

// f(0) to f(n - 1), constants, as an array.
template <class T, int n, class F>
[[gnu::always_inline]] inline std::array<T, n> each(F f) {
  return [&]<int... i>(std::integer_sequence<int, i...>) {
    return std::array<T, n>{f(std::integral_constant<int, i>{})...};
  }
  (std::make_integer_sequence<int, n>{});
}

// The branches at a node, those that fill it first; valves have their own numbers, outlets n_valves on.
struct Junction {
  std::array<int, n_valves + n_vessels> branch{};
  int inflows = 0, all = 0;
};
consteval Junction junction(int at) {
  Junction j;
  const auto add = [&](int end, int branch) {
    if (end == at) j.branch[static_cast<std::size_t>(j.all++)] = branch;
  };
  for (int v = 0; v < n_vessels; ++v) add(vessels[v].outlet, n_valves + v);
  for (int v = 0; v < n_valves; ++v) add(valves[v].to, v);
  j.inflows = j.all;
  for (int v = 0; v < n_valves; ++v) add(valves[v].from, v);
  for (int v = 0; v < n_vessels; ++v) add(n_chambers + v, n_valves + v);
  return j;
}
// Names are keys in files and columns in tables.
consteval int named(std::string_view name) {
  int count = 0;
  for (const Branch& valve : valves) count += valve.name == name;
  for (const Branch& shunt : shunts) count += shunt.name == name;
  for (const VesselEntry& vessel : vessels) count += vessel.name == name;
  return count;
}
consteval bool share_a_key(const VesselEntry& a, const VesselEntry& b) {
  for (const Quantity& p : a.quantities)
    for (const Quantity& q : b.quantities)
      if (a.circuit == b.circuit && p.name == q.name) return true;
  return false;
}
consteval bool distinct() {
  for (const auto& list : {std::span<const Branch>(valves), std::span<const Branch>(shunts)})
    for (const Branch& branch : list)
      if (named(branch.name) != 1 || branch.from == branch.to) return false;
  for (std::size_t k = 0; k < vessels.size(); ++k) {
    if (named(vessels[k].name) != 1) return false;
    for (std::size_t i = 0; i < k; ++i)
      if (share_a_key(vessels[k], vessels[i])) return false;
  }
  return true;
}
static_assert(distinct(),
              "valves, vessels and shunts need names of their own, vessels of a circuit also "
              "quantities of their own names, and a branch two ends");
consteval bool closed() {
  for (int n = 0; n < n_nodes; ++n) {
    const Junction j = junction(n);
    if (j.inflows == 0 || j.inflows == j.all) return false;
  }
  return true;
}
static_assert(closed(), "every node of the circulation must be filled by a branch and emptied by one");

template <int branch, class T, class Y>
const auto& through(const std::array<T, n_valves>& Q, const Y* y) {
  if constexpr (branch < n_valves)
    return Q[branch];
  else
    return y[n_nodes + branch - n_valves];
}
template <int at, int first, class T, class Y>
[[gnu::always_inline]] inline decltype(auto) sum_of_flows(const std::array<T, n_valves>& Q, const Y* y) {
  constexpr Junction j = junction(at);
  const auto& flow = through<j.branch[first]>(Q, y);
  if constexpr (first == 0)
    return (flow);
  else if constexpr (first < j.inflows)
    return T(sum_of_flows<at, first - 1>(Q, y) + flow);
  else
    return T(sum_of_flows<at, first - 1>(Q, y) - flow);
}
}  // namespace network

inline constexpr Vessel reservoir = VEN_SYS;  // its pressure makes up for a given blood volume
inline constexpr auto chamber_names = network::names_of(network::chambers);
inline constexpr auto valve_names = network::names_of(network::valves);
inline constexpr auto shunt_names = network::names_of(network::shunts);
inline constexpr auto circulation_state_quantities = network::states();
static_assert(well_formed(circulation_state_quantities));

// States that code names.
inline constexpr int V_LA = volume_of(LA), V_LV = volume_of(LV), V_RA = volume_of(RA), V_RV = volume_of(RV);
inline constexpr int p_AR_SYS = pressure_of(AR_SYS), p_VEN_SYS = pressure_of(VEN_SYS),
                     p_AR_PUL = pressure_of(AR_PUL), p_VEN_PUL = pressure_of(VEN_PUL);
inline constexpr int Q_AR_SYS = flow_of(AR_SYS), Q_VEN_SYS = flow_of(VEN_SYS), Q_AR_PUL = flow_of(AR_PUL),
                     Q_VEN_PUL = flow_of(VEN_PUL);

// Pressure of a node: a chamber's from p, a vessel's from the state.
template <class T, class Y>
[[gnu::always_inline]] inline decltype(auto) node_pressure(int n, const T* p, const Y* y) {
  if constexpr (std::is_same_v<T, Y>)
    return n < n_chambers ? p[n] : y[n];
  else
    return n < n_chambers ? p[n] : T(y[n]);
}

// Inflow less outflow of a node, without shunts: Q through the valves, y the state.
template <int n, class T, class Y>
[[gnu::always_inline]] inline T net_flow(const std::array<T, n_valves>& Q, const Y* y) {
  return network::sum_of_flows<n, network::junction(n).all - 1>(Q, y);
}

}  // namespace wiggers
