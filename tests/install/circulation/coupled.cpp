// A 3D code that solves the left ventricle itself and takes the rest of the circulation from wiggers.
#include <cmath>
#include <cstdio>
#include <wiggers/circulation/loop.hpp>

using namespace wiggers;

// Stands for the 3D code: the pressure (mmHg) in its ventricle at a volume (mL) and a time of the beat (s).
double pressure_of_3d_ventricle(double volume_mL, double t_s) {
  const ElastanceParameters e{2.75, 0.08, 0, 0.272, 0.136, 5};
  return elastance(e, t_s, 0.8) * (volume_mL - e.V0);
}

int main() {
  const Loop loop = find_circulation_set("wiggers-healthy-0d").loop;
  CirculationValues y = loop.initial;  // y[V_LV], y[p_AR_SYS] and ten more, by name
  const double dt_s = 1e-4;
  const long steps = std::lround(loop.period_s / dt_s);
  for (int beat = 0; beat < 10; ++beat)
    for (long step = 0; step < steps; ++step) {
      const double t_s = static_cast<double>(step) * dt_s;
      double p[n_chambers], rates[n_circulation_states];
      for (int chamber : {LA, RA, RV})
        p[chamber] = elastance(loop.elastance[chamber], t_s, loop.period_s) *
                     (y[chamber] - loop.elastance[chamber].V0);
      p[LV] = pressure_of_3d_ventricle(y[V_LV], t_s);
      const auto flows = valve_flows(loop.circulation, p, y.data());
      circulation_rates<double>(loop.circulation, y.data(), p, flows, rates);
      for (int k = 0; k < n_circulation_states; ++k) y[k] += dt_s * rates[k];
    }

  // The same ventricle is in the set: its own loop, solved to 1e-9, is where the coupled one must be, too.
  CirculationValues exact = loop.initial;
  for (int beat = 0; beat < 10; ++beat) LoopSolver(loop, {}).beat(exact);
  std::printf("LV %.2f mL, aorta %.2f mmHg; exactly %.2f mL, %.2f mmHg\n", y[V_LV], y[p_AR_SYS], exact[V_LV],
              exact[p_AR_SYS]);
  return std::abs(y[V_LV] - exact[V_LV]) < 0.1 && std::abs(y[p_AR_SYS] - exact[p_AR_SYS]) < 0.1 ? 0 : 1;
}
