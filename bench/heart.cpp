// Cost of one beat of the reduced whole heart, of an elastance heart, of a loop, and of one cell step.
#include <benchmark/benchmark.h>
#include <sys/resource.h>

#include <wiggers/cellmodels/crn.hpp>
#include <wiggers/cellmodels/ttp06.hpp>
#include <wiggers/core/fixed_step.hpp>
#include <wiggers/heart/run.hpp>

using namespace wiggers;

namespace {

// A scene brought to its cycle once, then beat after beat.
void heart_beat(benchmark::State& state, const char* scene, const std::vector<std::string>& changes) {
  HeartRun run(read_scene(std::string(WIGGERS_SCENES) + "/" + scene, changes));
  run.prepare(Progress::Style::quiet);
  run.advance(Progress::Style::quiet, {});
  Table trace = run.driver().trace();
  for (auto _ : state) benchmark::DoNotOptimize(run.driver().beat(&trace));
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  state.counters["peak_MB"] = static_cast<double>(usage.ru_maxrss) / 1024;
}

void loop_beat(benchmark::State& state, const char* integrator) {
  LoopIntegrator settings;
  settings.name = integrator;
  const LoopSolver solver(find_circulation_set("wiggers-healthy-0d").loop, settings);
  CirculationValues values = solver.loop().initial;
  for (auto _ : state) solver.beat(values);
}

template <class Model>
void cell_step(benchmark::State& state) {
  auto parameters = defaults_of(Model::parameters);
  const auto constants = Model::constants(parameters.data());
  auto y = defaults_of(Model::states);
  const double no_stimulus[1] = {0};
  RushLarsen1<Model, double> integrator;
  for (auto _ : state) {
    integrator.step(0.05, y.data(), no_stimulus, constants);
    benchmark::DoNotOptimize(y);
  }
}

}  // namespace

BENCHMARK_CAPTURE(heart_beat, whole_heart_1ms_50us, "whole_heart.toml", {})->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(heart_beat, whole_heart_rush_larsen_2, "whole_heart.toml",
                  {"solver.electrophysiology_integrator=rush-larsen-2"})
    ->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(heart_beat, whole_heart_implicit_rate, "whole_heart.toml", {"solver.stretch_rate=implicit"})
    ->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(heart_beat, elastance_heart_1ms, "elastance_healthy.toml", {})
    ->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(loop_beat, forward_euler_1ms, "forward-euler")->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(loop_beat, cvode_1e9, "cvode")->Unit(benchmark::kMillisecond);
BENCHMARK_TEMPLATE(cell_step, Crn);
BENCHMARK_TEMPLATE(cell_step, Ttp06<Ttp06Type::endo>);

BENCHMARK_MAIN();
