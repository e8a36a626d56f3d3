#include <fmt/format.h>

#include <algorithm>
#include <wiggers/circulation/circulation.hpp>
#include <wiggers/circulation/elastance.hpp>
#include <wiggers/core/errors.hpp>

namespace wiggers {

double dissipated_power(const CirculationParameters& c, const double* y, const double* p,
                        const std::array<double, n_valves>& Q) {
  double outlets = 0, gates = 0;
  for (int v = 0; v < n_vessels; ++v) {
    const double flow = y[n_nodes + v];
    outlets += c.vessels[v].R * flow * flow;
  }
  const auto drops = valve_drops(p, y);
  for (int v = 0; v < n_valves; ++v) gates += drops[v] * Q[v];
  for_each_shunt_flow(c, p, y, [&](int s, double flow) {
    gates +=
        (node_pressure(network::shunts[s].from, p, y) - node_pressure(network::shunts[s].to, p, y)) * flow;
  });
  return outlets + gates;
}

double largest_explicit_step(const CirculationParameters& c) {
  double step = 1e9;
  for (const VesselParameters& vessel : c.vessels)
    if (vessel.R > 0) step = std::min(step, 2 * vessel.L / vessel.R);
  return step;
}

void check_elastance(const ElastanceParameters& e, double period, const char* place) {
  if (e.TC + e.TR > period * (1 + 1e-12))
    throw InputError(
        fmt::format("{}: TC + TR = {} s is longer than the period, {} s: the chamber would start to contract "
                    "before it has "
                    "relaxed. Shorten TC or TR.",
                    place, e.TC + e.TR, period));
}

}  // namespace wiggers
