// Cost of cell steps: populations in every precision, with and without tables, on every instruction set,
// beside the scalar model with the C library's functions, measured in the same run. One item is one
// cell-step.
//
//   bench_cells                      one core, and both where the name says threads:2
//   bench_cells --benchmark_filter=ttp06
#include <benchmark/benchmark.h>

#include <thread>
#include <wiggers/cellmodels/catalogue/force_stepper.hpp>
#include <wiggers/cellmodels/models/crn.hpp>
#include <wiggers/cellmodels/models/ttp06.hpp>
#include <wiggers/cellmodels/pacing/pacing.hpp>
#include <wiggers/cellmodels/population/population.hpp>
#include <wiggers/core/fixed_step.hpp>
#include <wiggers/core/simd.hpp>
#if __has_include(<xsimd/xsimd.hpp>)
#include <xsimd/xsimd.hpp>
#endif

using namespace wiggers;

namespace {

constexpr double step_ms = 0.02;

// Cells at different places of their action potential, as in tissue.
CellPopulation sheet(const char* model, std::size_t n, const PopulationSettings& settings) {
  CellPopulation cells(find_model(model), n, settings);
  if (!cells.model().is_ionic()) {
    cells.set_input("Ca", 0.6);
    cells.set_input("SL", 2.1);
    return cells;
  }
  CellPopulation one(find_model(model), 1);
  std::vector<std::vector<double>> phases;
  one.set_input("i_stim", -52);
  one.step(step_ms, 50);
  one.set_input("i_stim", 0);
  for (int k = 0; k < 64; ++k) {
    phases.push_back(one.state_of(0));
    one.step(step_ms, 300);
  }
  for (std::size_t cell = 0; cell < n; ++cell) cells.set_state_of(cell, phases[cell * 64 / n]);
  return cells;
}

void population(benchmark::State& state, const char* model, PopulationSettings settings, std::size_t n,
                int steps_a_call) {
  if (!settings.instruction_set.empty() && settings.instruction_set != "best") {
    bool usable = false;
    for (InstructionSet set : usable_instruction_sets())
      usable = usable || to_string(set) == settings.instruction_set;
    if (!usable) {
      state.SkipWithError("this processor has no such instructions");
      return;
    }
  }
  CellPopulation cells = sheet(model, n, settings);
  const double h = cells.model().is_ionic() ? step_ms : 1e-3;
  cells.step(h, 1);
  for (auto _ : state) cells.step(h, steps_a_call);
  state.SetItemsProcessed(static_cast<std::int64_t>(n) * steps_a_call * state.iterations());
  state.counters["ns_per_cell_step"] =
      benchmark::Counter(1e-9 * static_cast<double>(n) * steps_a_call,
                         benchmark::Counter::kIsIterationInvariantRate | benchmark::Counter::kInvert);
}

// The same model text on plain doubles with the C library's exp and log.
template <class Model>
void scalar_libm(benchmark::State& state) {
  constexpr std::size_t n = 4096;
  CellPopulation start = sheet(std::string(Model::name).c_str(), n, {});
  std::vector<std::vector<double>> cells;
  for (std::size_t cell = 0; cell < n; ++cell) cells.push_back(start.state_of(cell));
  const auto parameters = defaults_of(Model::parameters);
  const auto constants = Model::constants(parameters.data());
  const double no_stimulus[1] = {0};
  RushLarsen1<Model, double> integrator;
  for (auto _ : state)
    for (auto& cell : cells) integrator.step(step_ms, cell.data(), no_stimulus, constants);
  state.SetItemsProcessed(static_cast<std::int64_t>(n) * state.iterations());
  state.counters["ns_per_cell_step"] =
      benchmark::Counter(1e-9 * static_cast<double>(n),
                         benchmark::Counter::kIsIterationInvariantRate | benchmark::Counter::kInvert);
}

void scalar_rdq20(benchmark::State& state) {
  const CellModel& model = find_model("rdq20");
  const auto stepper = make_force_stepper<double>(model, model.parameter_values("fedele2023-ventricles"));
  std::vector<double> y = model.default_state();
  for (auto _ : state) {
    ForcesOf<double> forces;
    stepper->begin({RegulationScheme::forward_euler, 40, RateScheme::lagged}, 1e-3, y.data(), 0.6, 2.1, 0,
                   forces);
    benchmark::DoNotOptimize(y);
  }
}

// One beat of one cell with error control: APD90 within 0.01 ms (docs/trade.md).
void one_beat(benchmark::State& state, const char* name, const char* integrator, double rtol) {
  const CellModel& model = find_model(name);
  PacedCell cell(model, model.parameter_values("default"), {800, {-25.71, 3, 0}},
                 {integrator, rtol, 0.01 * rtol, 0});
  for (auto _ : state) {
    std::vector<double> y = model.default_state();
    cell.beat(y);
    benchmark::DoNotOptimize(y);
  }
}

// From the published start to a distance of 1e-6.
void limit_cycle(benchmark::State& state, const char* name, const char* integrator, double dt_ms) {
  const CellModel& model = find_model(name);
  int beats = 0;
  for (auto _ : state) {
    PacedCell cell(model, model.parameter_values("default"), {800, {-25.71, 3, 0}},
                   {integrator, 1e-8, 1e-10, dt_ms});
    std::vector<double> y = model.default_state();
    beats = cell.to_limit_cycle(y, {}).beats;
  }
  state.counters["beats"] = beats;
}

// The library functions that the kernels could stand on instead: one exp of 4096 numbers.
template <class V>
void our_exp(benchmark::State& state) {
  std::vector<typename V::Scalar> x(4096), y(4096);
  for (std::size_t i = 0; i < x.size(); ++i)
    x[i] = static_cast<typename V::Scalar>(-20 + 0.01 * static_cast<double>(i));
  for (auto _ : state) {
    for (std::size_t i = 0; i < x.size(); i += V::lanes) exp(V::load(&x[i])).store(&y[i]);
    benchmark::DoNotOptimize(y.data());
    benchmark::ClobberMemory();
  }
  state.SetItemsProcessed(4096 * state.iterations());
}
void libm_exp(benchmark::State& state) {
  std::vector<double> x(4096), y(4096);
  for (std::size_t i = 0; i < x.size(); ++i) x[i] = -20 + 0.01 * static_cast<double>(i);
  for (auto _ : state) {
    for (std::size_t i = 0; i < x.size(); ++i) y[i] = std::exp(x[i]);
    benchmark::DoNotOptimize(y.data());
    benchmark::ClobberMemory();
  }
  state.SetItemsProcessed(4096 * state.iterations());
}
#if __has_include(<xsimd/xsimd.hpp>)
void xsimd_exp(benchmark::State& state) {
  using V = xsimd::batch<double>;
  std::vector<double> x(4096), y(4096);
  for (std::size_t i = 0; i < x.size(); ++i) x[i] = -20 + 0.01 * static_cast<double>(i);
  for (auto _ : state) {
    for (std::size_t i = 0; i < x.size(); i += V::size)
      xsimd::exp(V::load_unaligned(&x[i])).store_unaligned(&y[i]);
    benchmark::DoNotOptimize(y.data());
    benchmark::ClobberMemory();
  }
  state.SetItemsProcessed(4096 * state.iterations());
}
#endif

void add(const char* model, const std::string& what, PopulationSettings settings, std::size_t n = 4096,
         int steps_a_call = 1) {
  auto* b = benchmark::RegisterBenchmark(
      (std::string(model) + "/" + what + "/cells:" + std::to_string(n) +
       "/threads:" + std::to_string(settings.threads))
          .c_str(),
      [=](benchmark::State& state) { population(state, model, settings, n, steps_a_call); });
  if (settings.threads > 1) b->UseRealTime();
}

}  // namespace

int main(int argc, char** argv) {
  benchmark::Initialize(&argc, argv);
  benchmark::RegisterBenchmark("ttp06-endo/scalar-libm", scalar_libm<Ttp06<Ttp06Type::endo>>);
  benchmark::RegisterBenchmark("crn/scalar-libm", scalar_libm<Crn>);
  for (const char* model : {"ttp06-endo", "crn"}) {
    for (const char* set : {"baseline", "avx2", "avx512"}) {
      PopulationSettings s;
      s.instruction_set = set;
      add(model, std::string("rush-larsen/double/") + set, s);
      s.table_spacing_mV = 0.1;
      add(model, std::string("rush-larsen/double/tables/") + set, s);
      s.single_precision = true;
      add(model, std::string("rush-larsen/float/tables/") + set, s);
      s.table_spacing_mV = 0;
      add(model, std::string("rush-larsen/float/") + set, s);
    }
    PopulationSettings second;
    second.integrator = "rush-larsen-2";
    add(model, "rush-larsen-2/double", second);
    second.table_spacing_mV = 0.1;
    add(model, "rush-larsen-2/double/tables", second);
  }
  PopulationSettings tables;
  tables.table_spacing_mV = 0.1;
  const int cores = static_cast<int>(std::thread::hardware_concurrency());
  for (std::size_t n : {1000, 10000, 100000, 1000000})
    for (int threads : {1, cores}) {
      tables.threads = threads;
      // One step a call sweeps memory, as tissue does; many steps a call keep a block in the cache.
      add("ttp06-endo", "tables/one-step-a-call", tables, n, 1);
      if (n == 1000000) add("ttp06-endo", "tables/20-steps-a-call", tables, n, 20);
    }
  benchmark::RegisterBenchmark("rdq20/scalar-forward-euler-40-substeps-1ms", scalar_rdq20);
  for (const char* set : {"baseline", "avx2", "avx512"}) {
    PopulationSettings s;
    s.instruction_set = set;
    add("rdq20", std::string("frozen-midpoint-1ms/double/") + set, s, 1024);
    s.single_precision = true;
    add("rdq20", std::string("frozen-midpoint-1ms/float/") + set, s, 1024);
  }
  benchmark::RegisterBenchmark("one-beat/ttp06-endo/rosenbrock-3e-4", one_beat, "ttp06-endo", "rosenbrock",
                               3e-4)
      ->Unit(benchmark::kMillisecond);
  benchmark::RegisterBenchmark("one-beat/crn/rosenbrock-1e-4", one_beat, "crn", "rosenbrock", 1e-4)
      ->Unit(benchmark::kMillisecond);
  for (const char* name : {"ttp06-endo", "crn"})
    for (double dt : {0.05, 0.1})
      benchmark::RegisterBenchmark(
          (std::string("limit-cycle/") + name + "/rush-larsen/dt:" + std::to_string(dt)).c_str(), limit_cycle,
          name, "rush-larsen", dt)
          ->Unit(benchmark::kMillisecond);
  benchmark::RegisterBenchmark("exp/libm", libm_exp);
  benchmark::RegisterBenchmark("exp/ours/baseline", our_exp<Vec<double, 2, isa::Baseline>>);
#if __has_include(<xsimd/xsimd.hpp>)
  benchmark::RegisterBenchmark("exp/xsimd/baseline", xsimd_exp);
#endif
  benchmark::RunSpecifiedBenchmarks();
}
