// Cost of one beat of the reduced whole heart, of an elastance heart and of a loop, and of their ways to the
// cycle.
#include <benchmark/benchmark.h>
#include <sys/resource.h>

#include <wiggers/heart/accuracy.hpp>
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

// From the set's initial values to a distance of 1e-8, C_VEN_SYS = 60 (baseline75).
void loop_cycle(benchmark::State& state, const char* integrator) {
  LoopIntegrator settings;
  settings.name = integrator;
  const LoopSolver solver(find_circulation_set("baseline75").loop, settings);
  int beats = 0;
  for (auto _ : state) {
    CirculationValues values = solver.loop().initial;
    beats = solver.to_limit_cycle(values, loop_cycle_settings(1e-8)).beats;
  }
  state.counters["beats"] = beats;
}

// Cells and heart from the scene's start to the certified cycle.
void cold_start(benchmark::State& state, const char* scene) {
  for (auto _ : state) {
    HeartRun run(read_scene(std::string(WIGGERS_SCENES) + "/" + scene, {"run.distance=1e-5"}));
    run.prepare(Progress::Style::quiet);
    run.advance(Progress::Style::quiet, {});
  }
}

}  // namespace

// The presets of --accuracy, as overrides of the scene.
BENCHMARK_CAPTURE(heart_beat, whole_heart_draft, "whole_heart.toml", heart_accuracy("draft").overrides)
    ->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(heart_beat, whole_heart_standard, "whole_heart.toml", heart_accuracy("standard").overrides)
    ->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(heart_beat, whole_heart_founding, "whole_heart.toml", heart_accuracy("founding").overrides)
    ->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(heart_beat, elastance_heart_1ms, "elastance_healthy.toml", {})
    ->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(loop_beat, forward_euler_1ms, "forward-euler")->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(loop_beat, cvode_1e9, "cvode")->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(loop_cycle, runge_kutta_4_1ms, "runge-kutta-4")->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(loop_cycle, cvode_1e9, "cvode")->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(cold_start, whole_heart, "whole_heart.toml")->Unit(benchmark::kMillisecond);

BENCHMARK_MAIN();
