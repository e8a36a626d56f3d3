// The closed RLC circulation: the parameters and equations of its network. mmHg, mL, s.
//
//   each circuit (SYS, PUL):   Q_in --+--[R_AR L_AR]--+--[R_VEN L_VEN]--> atrium
//                                     |               |
//                                    C_AR            C_VEN          (C first, then R and L in series)
//
//   dV/dt of a chamber = inflow - outflow;  C dp/dt = inflow - outflow of a vessel;
//   L dQ/dt = pressure before - pressure after - R Q.
// Sources: Regazzoni et al., J Comput Phys 457:111083, 2022; Fedele et al. 2023 (whole-heart paper).
// Invariant: total stressed volume = chamber volumes + sum of C p; constant without external flow.
#pragma once

#include <array>
#include <type_traits>
#include <wiggers/circulation/network.hpp>
#include <wiggers/circulation/shunts.hpp>
#include <wiggers/circulation/valves.hpp>
#include <wiggers/core/quantity.hpp>

namespace wiggers {

template <class P>
struct VesselParametersOf {
  P R = 0, C = 0, L = 0;
};
using VesselParameters = VesselParametersOf<double>;
template <class V>
auto fields_of(V& v) requires requires {
  v.C;
}
{ return std::array{&v.R, &v.C, &v.L}; }

// Parameters may be plain, or dual to carry sensitivities.
template <class P>
struct CirculationParametersOf {
  ValveLaw valve_law = law_of<DiodeValve>;
  P tanh_steepness = tanh_steepness_quantity.default_value;
  std::array<ValveParametersOf<P>, n_valves> valves;
  std::array<VesselParametersOf<P>, n_vessels> vessels;
  std::array<ShuntParametersOf<P>, n_shunts> shunts;
  bool has_shunts() const {
    for (const auto& shunt : shunts)
      if (shunt.present) return true;
    return false;
  }
};
using CirculationParameters = CirculationParametersOf<double>;

using CirculationValues = std::array<double, n_circulation_states>;

// Pressure drops over the valves, forward positive: p of the chambers, y the state.
template <class T, class Y>
std::array<T, n_valves> valve_drops(const T* p, const Y* y) {
  return network::each<T, n_valves>([&](auto v) -> T {
    return node_pressure(network::valves[v].from, p, y) - node_pressure(network::valves[v].to, p, y);
  });
}

template <class T, class P, class Y>
std::array<T, n_valves> valve_flows(const CirculationParametersOf<P>& c, const T* p, const Y* y) {
  return network::each<T, n_valves>([&](auto v) {
    return valve_flow<T, P>(c.valve_law, c.valves[v], c.tanh_steepness,
                            node_pressure(network::valves[v].from, p, y),
                            node_pressure(network::valves[v].to, p, y));
  });
}

// f(shunt, flow) for those that are present.
template <class T, class P, class Y, class F>
void for_each_shunt_flow(const CirculationParametersOf<P>& c, const T* p, const Y* y, F f) {
  for (int s = 0; s < n_shunts; ++s)
    if (c.shunts[s].present)
      f(s, shunt_flow<T, P>(c.shunts[s], node_pressure(network::shunts[s].from, p, y),
                            node_pressure(network::shunts[s].to, p, y)));
}

// Adds what shunts bring to the first `n` nodes. Apart, so that a loop without shunts does not carry it
// along.
template <class T, class P, class Y>
[[gnu::noinline]] void add_shunt_flows(const CirculationParametersOf<P>& c, const T* p, const Y* y, T* rates,
                                       int n) {
  for_each_shunt_flow(c, p, y, [&](int s, const T& flow) {
    const auto gains = [&](int end, const T& in) {
      if (end < n) rates[end] += end < n_chambers ? in : T(in / c.vessels[end - n_chambers].C);
    };
    gains(network::shunts[s].from, T(-flow));
    gains(network::shunts[s].to, flow);
  });
}

// What the chambers gain (mL/s), from Q through the valves and from shunts.
template <class T, class P, class Y>
std::array<T, n_chambers> chamber_inflows(const CirculationParametersOf<P>& c, const T* p, const Y* y,
                                          const std::array<T, n_valves>& Q) {
  std::array<T, n_chambers> net = network::each<T, n_chambers>([&](auto n) { return net_flow<n>(Q, y); });
  if (c.has_shunts()) add_shunt_flows(c, p, y, net.data(), n_chambers);
  return net;
}

// Time derivatives of the states for given chamber pressures and valve flows; of the loop without its shunts,
// and of the whole.
template <class T, class P>
[[gnu::always_inline]] inline void rates_without_shunts(const CirculationParametersOf<P>& c, const T* y,
                                                        const T* p, const std::array<T, n_valves>& Q, T* dy) {
  network::unrolled<n_nodes>([&](auto n) {
    if constexpr (n < n_chambers)
      dy[n] = net_flow<n>(Q, y);
    else
      dy[n] = net_flow<n>(Q, y) / c.vessels[n - n_chambers].C;
  });
  network::unrolled<n_vessels>([&](auto k) {
    constexpr Vessel v = static_cast<Vessel>(k());
    dy[flow_of(v)] = (y[pressure_of(v)] - node_pressure(network::vessels[v].outlet, p, y) -
                      c.vessels[v].R * y[flow_of(v)]) /
                     c.vessels[v].L;
  });
}
template <class T, class P>
void circulation_rates(const CirculationParametersOf<P>& c, const T* y, const T* p,
                       const std::array<T, n_valves>& Q, T* dy) {
  rates_without_shunts(c, y, p, Q, dy);
  if (c.has_shunts()) add_shunt_flows(c, p, y, dy, n_nodes);
}

// Total stressed blood volume (mL).
template <class T, class P>
T total_volume(const CirculationParametersOf<P>& c, const T* y) {
  T sum = y[0];
  for (int n = 1; n < n_chambers; ++n) sum = sum + y[n];
  for (int v = 0; v < n_vessels; ++v) sum = sum + c.vessels[v].C * y[n_chambers + v];
  return sum;
}

// Sets the reservoir's pressure so that the total volume has the given value.
template <class T, class P>
void hold_total_volume(const CirculationParametersOf<P>& c, T* y, const std::type_identity_t<T>& volume_mL) {
  T& pressure = y[pressure_of(reservoir)];
  pressure = pressure + (volume_mL - total_volume(c, y)) / c.vessels[reservoir].C;
}

// Power lost in resistors, valves and shunts (mmHg mL/s): what the chambers' work must equal over a periodic
// beat.
double dissipated_power(const CirculationParameters& c, const double* y, const double* p,
                        const std::array<double, n_valves>& Q);

// Explicit Euler of a vessel's outlet is stable for steps below 2 L/R; the smallest (s).
double largest_explicit_step(const CirculationParameters& c);

}  // namespace wiggers
