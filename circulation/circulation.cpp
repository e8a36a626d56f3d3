#include <fmt/format.h>

#include <algorithm>
#include <wiggers/circulation/circulation.hpp>
#include <wiggers/circulation/elastance.hpp>
#include <wiggers/core/errors.hpp>

namespace wiggers {

double dissipated_power(const CirculationParameters& c, const double* y, const double* p,
                        const std::array<double, n_valves>& Q) {
  const double branches =
      c.circuits[SYS].R_AR * y[Q_AR_SYS] * y[Q_AR_SYS] + c.circuits[SYS].R_VEN * y[Q_VEN_SYS] * y[Q_VEN_SYS] +
      c.circuits[PUL].R_AR * y[Q_AR_PUL] * y[Q_AR_PUL] + c.circuits[PUL].R_VEN * y[Q_VEN_PUL] * y[Q_VEN_PUL];
  const double valves = (p[LA] - p[LV]) * Q[MV] + (p[LV] - y[p_AR_SYS]) * Q[AV] + (p[RA] - p[RV]) * Q[TV] +
                        (p[RV] - y[p_AR_PUL]) * Q[PV];
  return branches + valves;
}

double largest_explicit_step(const CirculationParameters& c) {
  double step = 1e9;
  for (const CircuitParameters& circuit : c.circuits) {
    if (circuit.R_AR > 0) step = std::min(step, 2 * circuit.L_AR / circuit.R_AR);
    if (circuit.R_VEN > 0) step = std::min(step, 2 * circuit.L_VEN / circuit.R_VEN);
  }
  return step;
}

double largest_arterial_step(const CirculationParameters& c) {
  return 2 * std::min(c.valves[AV].Rmin * c.circuits[SYS].C_AR, c.valves[PV].Rmin * c.circuits[PUL].C_AR);
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
