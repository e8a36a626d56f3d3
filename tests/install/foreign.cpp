// A foreign project: one beat of a cell and of a loop through the installed headers and libraries.
#include <cstdio>
#include <wiggers/cellmodels/pacing.hpp>
#include <wiggers/cellmodels/population.hpp>
#include <wiggers/circulation/loop.hpp>
#ifdef WITH_HEART
#include <wiggers/heart/scene.hpp>
#endif

int main() {
  using namespace wiggers;
  const CellModel& model = find_model("ttp06-endo");
  PacedCell cell(model, model.parameter_values("default"), {800, model.default_stimulus}, CellIntegrator{});
  std::vector<double> state = model.default_state();
  double peak = -100;
  cell.beat(state, 1,
            [&](double, const double* y, double) { peak = std::max(peak, y[model.membrane_potential]); });
  // As the README has it.
  CellPopulation cells(model, 100, {.table_spacing_mV = 0.1, .threads = 2});
  cells.set_input("i_stim", -52);
  cells.step(0.02, 50);
  if (cells.state_of(99)[0] < -30) return 1;
  const LoopSolver solver(find_circulation_set("wiggers-healthy-0d").loop, {});
  CirculationValues values = solver.loop().initial;
  solver.beat(values);
#ifdef WITH_HEART
  if (Scene().dt_s != 1e-3) return 1;
#endif
  std::printf("peak %g mV, aorta %g mmHg\n", peak, values[p_AR_SYS]);
  return peak > 20 && values[p_AR_SYS] > 50 ? 0 : 1;
}
