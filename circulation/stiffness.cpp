#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <wiggers/circulation/stiffness.hpp>
#include <wiggers/core/dual.hpp>

namespace wiggers {

namespace {

// Compliant nodes: four chambers, then the vessels.
enum Node { n_AR_SYS = n_chambers, n_VEN_SYS, n_AR_PUL, n_VEN_PUL, n_nodes };

struct Ends {
  int from, to;
};
constexpr std::array<Ends, n_valves> valve_ends = {{{LA, LV}, {LV, n_AR_SYS}, {RA, RV}, {RV, n_AR_PUL}}};

struct Inertance {
  const char* name;
  Ends ends;
  double R, L;
};
std::array<Inertance, 4> inertances(const CirculationParameters& c) {
  const CircuitParameters& s = c.circuits[SYS];
  const CircuitParameters& l = c.circuits[PUL];
  return {{{"SYS.AR", {n_AR_SYS, n_VEN_SYS}, s.R_AR, s.L_AR},
           {"SYS.VEN", {n_VEN_SYS, RA}, s.R_VEN, s.L_VEN},
           {"PUL.AR", {n_AR_PUL, n_VEN_PUL}, l.R_AR, l.L_AR},
           {"PUL.VEN", {n_VEN_PUL, LA}, l.R_VEN, l.L_VEN}}};
}

std::array<double, n_nodes> node_stiffness(const CirculationParameters& c, const ChamberElastances& E) {
  return {E[LA],
          E[LV],
          E[RA],
          E[RV],
          1 / c.circuits[SYS].C_AR,
          1 / c.circuits[SYS].C_VEN,
          1 / c.circuits[PUL].C_AR,
          1 / c.circuits[PUL].C_VEN};
}

}  // namespace

ValveConductances steepest_conductances(const CirculationParameters& c) {
  ValveConductances steepest{};
  for (int v = 0; v < n_valves; ++v) {
    if (has_kink(c.valve_law)) {
      steepest[v] = 1 / std::min(c.valves[v].Rmin, c.valves[v].Rmax);
      continue;
    }
    // Smooth laws are steepest near the switch, where the resistance falls while the drop grows.
    for (double drop = 1e-6; drop < 1e3; drop *= 1.25)
      for (double sign : {-1.0, 1.0}) {
        const auto dp = Dual<1>::variable(sign * drop, 0);
        const auto Q =
            valve_flow<Dual<1>, double>(c.valve_law, c.valves[v], c.tanh_steepness, dp, Dual<1>(0.0));
        steepest[v] = std::max(steepest[v], Q.derivative[0]);
      }
  }
  return steepest;
}

double fastest_rate(const CirculationParameters& c, const ChamberElastances& E, const ValveConductances& g) {
  const auto e = node_stiffness(c, E);
  std::array<double, n_nodes> symmetric{}, antisymmetric{};
  double fastest = 0, swing = 0;
  for (int v = 0; v < n_valves; ++v) {
    const auto [from, to] = valve_ends[v];
    const double across = std::sqrt(e[from] * e[to]);
    symmetric[from] += g[v] * (e[from] + across);
    symmetric[to] += g[v] * (e[to] + across);
  }
  for (const Inertance& i : inertances(c)) {
    const double from = std::sqrt(e[i.ends.from] / i.L), to = std::sqrt(e[i.ends.to] / i.L);
    antisymmetric[i.ends.from] += from;
    antisymmetric[i.ends.to] += to;
    swing = std::max(swing, from + to);
    fastest = std::max(fastest, i.R / i.L);
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
  for (int v = 0; v < n_valves; ++v)
    consider(g[v] * (e[valve_ends[v].from] + e[valve_ends[v].to]),
             fmt::format("valve {} (Rmin = {:.3g} mmHg s/mL)", valve_names[v], c.valves[v].Rmin));
  for (const Inertance& i : inertances(c))
    consider(std::max(i.R / i.L, std::sqrt((e[i.ends.from] + e[i.ends.to]) / i.L)),
             fmt::format("vessel {} (R = {:.3g} mmHg s/mL, L = {:.3g} mmHg s^2/mL)", i.name, i.R, i.L));
  return name;
}

}  // namespace wiggers
