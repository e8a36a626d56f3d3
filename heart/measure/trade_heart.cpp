// Work and precision of the reduced heart: the scene on its limit cycle, indexes of the beat compared.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <wiggers/core/errors.hpp>
#include <wiggers/heart/measure/trade.hpp>
#include <wiggers/heart/run/monolithic.hpp>
#include <wiggers/heart/run/run.hpp>

namespace wiggers {

namespace {

std::vector<double> measures_of(const BeatIndexes& b) {
  const auto time = [](const std::optional<double>& t) { return t ? 1e3 * *t : std::nan(""); };
  return {b.ventricle[0].pressure_max_mmHg, b.ventricle[0].EDV_mL,      b.ventricle[0].SV_mL,
          b.ventricle[0].EF_percent,        b.aorta.pressure_max_mmHg,  b.valve[AV].peak_flow_mL_per_s,
          time(b.valve[AV].opens_s),        time(b.valve[AV].closes_s), time(b.valve[MV].opens_s)};
}

std::vector<double> monolithic_values(const Scene& scene) {
  MonolithicHeart heart(scene, {1e-7, false});
  if (heart.to_limit_cycle(1e-5).verdict != LimitCycleVerdict::period_1)
    throw NumericalFailure("no limit cycle");
  return measures_of(compute_indexes(heart.beat(2.5e-4), atrial_activations_s(scene)));
}

struct HeartBeat {
  std::vector<double> values;
  double cost_s = 0;
  long steps = 0;
};

HeartBeat on_cycle(const std::filesystem::path& scene, const std::vector<std::string>& overrides) {
  std::vector<std::string> all = overrides;
  all.push_back("run.until=limit-cycle");
  HeartRun run(read_scene(scene, all));
  run.prepare(Progress::Style::quiet);
  run.advance(Progress::Style::quiet, {});
  if (run.scene().until_limit_cycle && run.certificate().verdict != LimitCycleVerdict::period_1)
    throw NumericalFailure("no limit cycle");
  HeartBeat beat{measures_of(run.indexes()), 0, run.driver().steps_per_beat()};
  beat.cost_s = median_cost([&] { run.driver().beat(nullptr); });
  return beat;
}

}  // namespace

TradeStudy trade_heart(const std::filesystem::path& scene, const std::vector<std::string>& overrides,
                       Progress& progress) {
  TradeStudy study;
  study.subject = fmt::format("heart, {}: one beat", scene.filename().string());
  study.protocol = "the scene's limit cycle with each setting, cells on theirs; indexes compared";
  study.measures = trade_measures("heart");
  const auto with = [&](std::vector<std::string> more) {
    std::vector<std::string> all = overrides;
    all.insert(all.end(), more.begin(), more.end());
    return all;
  };
  const auto staggered_reference = [&] {
    return on_cycle(scene, with({"solver.dt_s=1.25e-4", "solver.stretch_rate=implicit",
                                 "solver.regulation=frozen-midpoint",
                                 "solver.electrophysiology_integrator=rush-larsen-2",
                                 "solver.electrophysiology_substep_ms=0.0125"}))
        .values;
  };
  progress.update(0, "reference");
  const Scene plain = read_scene(scene, overrides);
  const bool stepped_only =
      !std::all_of(plain.walls.begin(), plain.walls.end(), MonolithicHeart::has_equations);
  const std::vector<double> exact = stepped_only ? staggered_reference() : monolithic_values(plain);
  const auto errors = [&](const std::vector<double>& values) {
    std::vector<double> e;
    for (std::size_t m = 0; m < values.size(); ++m) e.push_back(std::abs(values[m] - exact[m]));
    return e;
  };
  progress.update(0.2, "second reference");
  const std::string staggered = "staggered, implicit rate, dt 0.125 ms, cells by rush-larsen-2 at 12.5 us";
  std::vector<double> confirmed;
  if (stepped_only) {
    study.reference = staggered + "; confirmed by the lagged rate at dt 0.0625 ms";
    confirmed = errors(on_cycle(scene, with({"solver.dt_s=6.25e-5", "solver.stretch_rate=lagged",
                                             "solver.electrophysiology_integrator=rush-larsen-2",
                                             "solver.electrophysiology_substep_ms=0.0125"}))
                           .values);
  } else {
    study.reference = "monolithic, cvode rtol 1e-7; confirmed by " + staggered;
    confirmed = errors(staggered_reference());
  }
  for (std::size_t m = 0; m < confirmed.size(); ++m) study.measures[m].reference_confirmed = confirmed[m];

  struct Job {
    std::string method, setting;
    std::vector<std::string> overrides;
  };
  std::vector<Job> jobs;
  const auto add = [&](const char* rate, const char* regulation, double dt_ms, const char* integrator,
                       double substep_ms) {
    jobs.push_back(
        {fmt::format("{} rate, {}", rate, regulation),
         fmt::format("dt {} ms, {} {} ms", dt_ms, integrator, substep_ms),
         {fmt::format("solver.stretch_rate={}", rate), fmt::format("solver.regulation={}", regulation),
          fmt::format("solver.dt_s={}", dt_ms * 1e-3),
          fmt::format("solver.electrophysiology_integrator={}", integrator),
          fmt::format("solver.electrophysiology_substep_ms={}", substep_ms)}});
  };
  for (const char* rate : {"lagged", "implicit"})
    for (double dt_ms : {2.0, 1.0, 0.5, 0.25}) {
      add(rate, "frozen-midpoint", dt_ms, "rush-larsen-2", 0.05);
      if (dt_ms == 1.0 || dt_ms == 0.5) add(rate, "forward-euler", dt_ms, "rush-larsen-2", 0.05);
    }
  for (double substep : {0.2, 0.1, 0.05, 0.02}) {
    add("implicit", "frozen-midpoint", 1.0, "rush-larsen", substep);
    if (substep != 0.05) add("implicit", "frozen-midpoint", 1.0, "rush-larsen-2", substep);
  }
  add("lagged", "forward-euler", 1.0, "rush-larsen", 0.05);
  add("implicit", "forward-euler", 1.0, "rush-larsen-2", 0.1);
  add("implicit", "frozen-midpoint", 2.0, "rush-larsen-2", 0.2);
  add("implicit", "frozen-midpoint", 0.25, "rush-larsen-2", 0.02);
  for (std::size_t k = 0; k < jobs.size(); ++k) {
    TradeRow row{jobs[k].method, jobs[k].setting, {}, 0, 0, 0, {}};
    try {
      const HeartBeat beat = on_cycle(scene, with(jobs[k].overrides));
      row.errors = errors(beat.values);
      row.cost_s = beat.cost_s;
      row.steps = beat.steps;
      for (double error : row.errors)
        if (!std::isfinite(error)) throw NumericalFailure("a valve does not move");
    } catch (const InputError& refusal) {
      row.errors.clear();
      row.failure = std::string("refused: ") + refusal.what();
    } catch (const NumericalFailure& failure) {
      row.errors.clear();
      row.failure = failure.what();
    }
    study.rows.push_back(row);
    progress.update(0.3 + 0.7 * static_cast<double>(k + 1) / static_cast<double>(jobs.size()),
                    row.method + " " + row.setting);
  }
  return study;
}

}  // namespace wiggers
