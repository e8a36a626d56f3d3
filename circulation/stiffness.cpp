#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <wiggers/circulation/stiffness.hpp>
#include <wiggers/core/dual.hpp>
#include <wiggers/core/errors.hpp>

namespace wiggers {

namespace {

std::array<double, n_nodes> node_stiffness(const CirculationParameters& c, const ChamberElastances& E) {
  std::array<double, n_nodes> e{};
  for (int n = 0; n < n_chambers; ++n) e[n] = E[n];
  for (int v = 0; v < n_vessels; ++v) e[n_chambers + v] = 1 / c.vessels[v].C;
  return e;
}

// f(branch, conductance, description) for valves and shunts.
template <class F>
void for_each_conductance(const CirculationParameters& c, const ValveConductances& g, F f) {
  for (int v = 0; v < n_valves; ++v)
    f(network::valves[v], g[v], [&, v] {
      return fmt::format("valve {} (Rmin = {:.3g} mmHg s/mL)", network::valves[v].name, c.valves[v].Rmin);
    });
  for (int s = 0; s < n_shunts; ++s)
    if (c.shunts[s].present)
      f(network::shunts[s], 1 / c.shunts[s].R, [&, s] {
        return fmt::format("shunt {} (R = {:.3g} mmHg s/mL)", network::shunts[s].name, c.shunts[s].R);
      });
}

// f(node, rate, description): what each branch adds to the row of each of its ends.
template <class F>
void for_each_row_entry(const CirculationParameters& c, const std::array<double, n_nodes>& e,
                        const ValveConductances& g, F f) {
  for_each_conductance(c, g, [&](const network::Branch& branch, double conductance, const auto& description) {
    const double across = std::sqrt(e[branch.from] * e[branch.to]);
    for (int end : {branch.from, branch.to}) f(end, conductance * (e[end] + across), description);
  });
}

}  // namespace

ValveConductances steepest_conductances(const CirculationParameters& c) {
  ValveConductances steepest{};
  for (int v = 0; v < n_valves; ++v) {
    if (has_kink(c.valve_law)) {
      for (bool open : {true, false})
        steepest[v] = std::max(steepest[v], valve_flow_when(open, c.valve_law, c.valves[v], 1.0));
      continue;
    }
    // Smooth laws are steepest near the switch, where the resistance falls while the drop grows.
    for (double drop = 1e-6; drop < 1e3; drop *= 1.25)
      for (double sign : {-1.0, 1.0}) {
        const auto dp = Dual<1>::variable(sign * drop, 0);
        const auto Q =
            valve_flow<Dual<1>, double>(c.valve_law, c.valves[v], c.tanh_steepness, dp, Dual<1>(0.0));
        if (!std::isfinite(Q.derivative[0]))
          throw NumericalFailure(
              fmt::format("valve law {} has no derivative at a pressure drop of {:.3g} mmHg",
                          valve_law_names[static_cast<std::size_t>(c.valve_law)], sign * drop));
        steepest[v] = std::max(steepest[v], Q.derivative[0]);
      }
  }
  return steepest;
}

double fastest_rate(const CirculationParameters& c, const ChamberElastances& E, const ValveConductances& g) {
  const auto e = node_stiffness(c, E);
  std::array<double, n_nodes> symmetric{}, antisymmetric{};
  double fastest = 0, swing = 0;
  for_each_row_entry(c, e, g, [&](int node, double rate, const auto&) { symmetric[node] += rate; });
  for (int v = 0; v < n_vessels; ++v) {
    const VesselParameters& vessel = c.vessels[v];
    const double from = std::sqrt(e[n_chambers + v] / vessel.L);
    const double to = std::sqrt(e[network::vessels[v].outlet] / vessel.L);
    antisymmetric[n_chambers + v] += from;
    antisymmetric[network::vessels[v].outlet] += to;
    swing = std::max(swing, from + to);
    fastest = std::max(fastest, vessel.R / vessel.L);
  }
  for (double sum : symmetric) fastest = std::max(fastest, sum);
  for (double sum : antisymmetric) swing = std::max(swing, sum);
  return fastest + swing;
}

std::string stiffest_branch(const CirculationParameters& c, const ChamberElastances& E,
                            const ValveConductances& g) {
  const auto e = node_stiffness(c, E);
  double fastest = 0;
  std::string name;
  const auto consider = [&](double rate, std::string text) {
    if (rate > fastest) {
      fastest = rate;
      name = std::move(text);
    }
  };
  for_each_conductance(c, g, [&](const network::Branch& branch, double conductance, const auto& description) {
    consider(conductance * (e[branch.from] + e[branch.to]), description());
  });
  for (int v = 0; v < n_vessels; ++v) {
    const VesselParameters& vessel = c.vessels[v];
    consider(std::max(vessel.R / vessel.L,
                      std::sqrt((e[n_chambers + v] + e[network::vessels[v].outlet]) / vessel.L)),
             fmt::format("vessel {} (R = {:.3g} mmHg s/mL, L = {:.3g} mmHg s^2/mL)", network::vessels[v].name,
                         vessel.R, vessel.L));
  }
  return name;
}

FillingLimit largest_filling_step(const CirculationParameters& c) {
  const auto e = node_stiffness(c, {});  // chambers: none
  ValveConductances open;
  for (int v = 0; v < n_valves; ++v) open[v] = 1 / c.valves[v].Rmin;
  std::array<double, n_nodes> rate{}, largest{};
  std::array<std::string, n_nodes> by;
  for_each_row_entry(c, e, open, [&](int node, double adds, const auto& description) {
    rate[node] += adds;
    if (adds > largest[node]) {
      largest[node] = adds;
      by[node] = description();
    }
  });
  FillingLimit limit;
  for (int n = n_chambers; n < n_nodes; ++n)
    if (rate[n] > 0 && 2 / rate[n] < limit.step_s) limit = {2 / rate[n], by[n]};
  return limit;
}

}  // namespace wiggers
