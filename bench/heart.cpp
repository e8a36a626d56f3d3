// Cost of one beat of the reduced whole heart, of an elastance heart and of a loop, and of their ways to the
// cycle.
#include <benchmark/benchmark.h>
#include <sys/resource.h>

#include <wiggers/heart/run/run.hpp>
#include <wiggers/heart/scene/accuracy.hpp>
#include <wiggers/heart/study/heart_study.hpp>
#include <wiggers/heart/study/loop_study.hpp>

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

// All derivatives on the limit cycle, 75 indexes by 46 parameters; to be divided by loop_cycle of the same
// set.
void healthy_cycle(benchmark::State& state) {
  const LoopSolver solver(find_circulation_set("wiggers-healthy-0d").loop,
                          {"runge-kutta-4", 1e-9, 1e-9, 1e-3});
  for (auto _ : state) {
    CirculationValues values = solver.loop().initial;
    benchmark::DoNotOptimize(solver.to_limit_cycle(values, loop_cycle_settings(1e-8)).beats);
  }
}
void healthy_gradient(benchmark::State& state) {
  const Loop loop = find_circulation_set("wiggers-healthy-0d").loop;
  CirculationValues values = loop.initial;
  LoopSolver(loop, {"runge-kutta-4", 1e-9, 1e-9, 1e-3}).to_limit_cycle(values, loop_cycle_settings(1e-8));
  for (auto _ : state) benchmark::DoNotOptimize(loop_sensitivities(loop, values, 1e-3).values[0]);
}
void cell_cycle(benchmark::State& state) {
  CellStudy study = make_cell_study(find_model("ttp06-endo"));
  study.dt_ms = 0.05;
  for (auto _ : state) {
    std::vector<double> y = start_of(study);
    benchmark::DoNotOptimize(to_limit_cycle(study, y, LimitCycleSettings{}).beats);
  }
}
void cell_gradient(benchmark::State& state) {
  CellStudy study = make_cell_study(find_model("ttp06-endo"));
  study.dt_ms = 0.05;
  std::vector<double> y = start_of(study);
  to_limit_cycle(study, y, LimitCycleSettings{});
  for (auto _ : state) benchmark::DoNotOptimize(cell_sensitivities(study, y).values[0]);
}
// The whole heart's study: cells and all walls from the scene's start; one warm start; 20 parameters'
// derivatives.
void study_cold(benchmark::State& state) {
  const Scene scene = read_scene(std::string(WIGGERS_SCENES) + "/whole_heart.toml", {});
  for (auto _ : state)
    benchmark::DoNotOptimize(HeartStudy(scene).to_limit_cycle({}, nullptr).certificate.beats);
}
void study_warm(benchmark::State& state) {
  HeartStudy heart(read_scene(std::string(WIGGERS_SCENES) + "/whole_heart.toml", {}));
  const HeartState start = heart.to_limit_cycle({}, nullptr);
  const double a_XB = 3.75e5;
  double factor = 1;
  for (auto _ : state) {
    heart.set_parameter("walls.LV.a_XB_kPa", a_XB * (factor = factor > 1 ? 1.0 : 1.01));
    benchmark::DoNotOptimize(heart.to_limit_cycle({}, &start).certificate.beats);
  }
}
void study_gradient(benchmark::State& state) {
  HeartStudy heart(read_scene(std::string(WIGGERS_SCENES) + "/whole_heart.toml", {}));
  const HeartState cycle = heart.to_limit_cycle({}, nullptr);
  std::vector<std::string> names;
  for (const NamedParameter& p : heart.parameters())
    if (p.name.starts_with("circulation.circuit") || p.name.ends_with("a_XB_kPa") ||
        p.name.ends_with("stiffness_kPa"))
      names.push_back(p.name);
  state.counters["parameters"] = static_cast<double>(names.size());
  for (auto _ : state) benchmark::DoNotOptimize(heart.sensitivities(cycle, names).values[0]);
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
BENCHMARK(healthy_cycle)->Unit(benchmark::kMillisecond);
BENCHMARK(healthy_gradient)->Unit(benchmark::kMillisecond);
BENCHMARK(cell_cycle)->Unit(benchmark::kMillisecond);
BENCHMARK(cell_gradient)->Unit(benchmark::kMillisecond);
BENCHMARK(study_cold)->Unit(benchmark::kMillisecond);
BENCHMARK(study_warm)->Unit(benchmark::kMillisecond);
BENCHMARK(study_gradient)->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(cold_start, whole_heart, "whole_heart.toml")->Unit(benchmark::kMillisecond);

BENCHMARK_MAIN();
