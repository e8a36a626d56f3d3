// A foreign project: one beat of a cell, and a population as the README has it.
#include <algorithm>
#include <cstdio>
#include <wiggers/cellmodels/pacing/pacing.hpp>
#include <wiggers/cellmodels/population/population.hpp>

int main() {
  using namespace wiggers;
  const CellModel& model = find_model("ttp06-endo");
  PacedCell cell(model, model.parameter_values("default"), {800, model.default_stimulus}, CellIntegrator{});
  std::vector<double> state = model.default_state();
  double peak = -100;
  cell.beat(state, 1,
            [&](double, const double* y, double) { peak = std::max(peak, y[model.membrane_potential]); });
  CellPopulation cells(model, 100, {.table_spacing_mV = 0.1, .threads = 2});
  cells.set_input("i_stim", -52);
  cells.step(0.02, 50);
  std::printf("peak %g mV, of the population %g mV\n", peak, cells.state_of(99)[0]);
  return peak > 20 && cells.state_of(99)[0] > -30 ? 0 : 1;
}
