#include <wiggers/core/errors.hpp>
#include <wiggers/heart/scene/accuracy.hpp>

namespace wiggers {

namespace {

template <class Presets>
const auto& find(const Presets& presets, std::string_view name) {
  std::vector<std::string> known;
  for (const auto& preset : presets) {
    if (preset.name == name) return preset;
    known.emplace_back(preset.name);
  }
  refuse_unknown("accuracy", name, known);
}

}  // namespace

const CellAccuracy& cell_accuracy(std::string_view name) {
  static const std::vector<CellAccuracy> presets = {
      {"draft", {"rosenbrock", 3e-4, 3e-6, 0}, "APD90 within 0.05 ms, V within 0.1 mV", 1e-3},
      {"standard",
       {"cvode", 1e-8, 1e-10, 0},
       "APD90 within 1e-4 ms, V within 1e-3 mV, Ca_i within 1e-5",
       1e-6},
      {"reference", {"cvode", 1e-11, 1e-13, 0}, "APD90 within 1e-6 ms, V within 1e-5 mV", 1e-7}};
  return find(presets, name);
}

const LoopAccuracy& loop_accuracy(std::string_view name) {
  static const std::vector<LoopAccuracy> presets = {
      {"draft", {"runge-kutta-4", 1e-9, 1e-9, 2e-3}, "pressures within 0.1 mmHg, volumes within 0.1 mL"},
      {"standard", {"cvode", 1e-9, 1e-9, 1e-3}, "pressures within 1e-4 mmHg, volumes within 1e-4 mL"},
      {"reference", {"cvode", 1e-12, 1e-12, 1e-3}, "pressures within 1e-6 mmHg, volumes within 1e-6 mL"}};
  return find(presets, name);
}

const HeartAccuracy& heart_accuracy(std::string_view name) {
  static const std::vector<HeartAccuracy> presets = {
      {"draft",
       {"solver.dt_s=2e-3", "solver.stretch_rate=implicit", "solver.regulation=frozen-midpoint",
        "solver.electrophysiology_integrator=rush-larsen-2", "solver.electrophysiology_substep_ms=0.2"},
       "indexes within 1 %, valve times within 3 ms"},
      {"standard",
       {"solver.dt_s=1e-3", "solver.stretch_rate=implicit", "solver.regulation=forward-euler",
        "solver.electrophysiology_integrator=rush-larsen-2", "solver.electrophysiology_substep_ms=0.1"},
       "indexes within 0.5 %, valve times within 1.1 ms"},
      {"reference",
       {"solver.dt_s=2.5e-4", "solver.stretch_rate=implicit", "solver.regulation=frozen-midpoint",
        "solver.electrophysiology_integrator=rush-larsen-2", "solver.electrophysiology_substep_ms=0.02"},
       "indexes within 0.2 %, valve times within 1 ms"},
      {"founding",
       {"solver.dt_s=1e-3", "solver.stretch_rate=lagged", "solver.regulation=forward-euler",
        "solver.electrophysiology_integrator=rush-larsen", "solver.electrophysiology_substep_ms=0.05"},
       "the whole-heart paper's scheme, for comparison: peak flow within 12 %, valve times within 15 ms"}};
  return find(presets, name);
}

}  // namespace wiggers
