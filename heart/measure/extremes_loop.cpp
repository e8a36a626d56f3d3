// Loops and hearts at the extremes.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <wiggers/core/errors.hpp>
#include <wiggers/heart/indexes/indexes.hpp>
#include <wiggers/heart/measure/extremes.hpp>
#include <wiggers/heart/run/run.hpp>

namespace wiggers {

namespace {

bool physical(const CirculationValues& y) {
  for (double value : y)
    if (!std::isfinite(value)) return false;
  return true;
}

struct LoopCondition {
  std::string name;
  std::function<void(Loop&)> change;
};

std::vector<LoopCondition> loop_conditions() {
  std::vector<LoopCondition> list = {{"as given", [](Loop&) {}}};
  for (double factor : {0.01, 100.0})
    list.push_back({fmt::format("Rmin x {}", factor), [factor](Loop& l) {
                      for (auto& valve : l.circulation.valves) valve.Rmin *= factor;
                    }});
  list.push_back({"Rmax 1e9", [](Loop& l) {
                    for (auto& valve : l.circulation.valves) valve.Rmax = 1e9;
                  }});
  for (double factor : {0.01, 100.0})
    list.push_back({fmt::format("compliances x {}", factor), [factor](Loop& l) {
                      for (auto& vessel : l.circulation.vessels) vessel.C *= factor;
                    }});
  list.push_back({"elastances x 20", [](Loop& l) {
                    for (auto& e : l.elastance) e.EA *= 20;
                  }});
  for (double factor : {0.1, 3.0})
    list.push_back({factor < 1 ? "near-empty" : "overfilled", [factor](Loop& l) {
                      for (int n = 0; n < n_nodes; ++n) l.initial[n] *= factor;
                    }});
  return list;
}

}  // namespace

ExtremesStudy extremes_loop(const Loop& loop, const ExtremesSettings& settings, Progress& progress) {
  ExtremesStudy study;
  study.subject = fmt::format("loop: a step is stable if {} beats complete", settings.beats);
  study.step_unit = "ms";
  study.accurate_means = "peak LV pressure within 0.1 % up to, ms";
  study.roughly_means = "within 1 % up to, ms";
  const auto peak = [](const LoopSolver& solver, CirculationValues state, int beats, double sample_s) {
    Table table = circulation_table(solver.loop().circulation);
    for (int beat = 0; beat < beats - 1; ++beat) solver.beat(state);
    solver.beat(state, sample_s, &table);
    if (!physical(state)) throw NumericalFailure("not finite");
    const auto& p = table.at("p_LV").values;
    return *std::max_element(p.begin(), p.end());
  };
  double done = 0;
  const auto list = loop_conditions();
  for (const LoopCondition& condition : list) {
    Loop changed = loop;
    condition.change(changed);
    double exact = 0;
    try {
      exact = peak(LoopSolver(changed, {"cvode", 1e-9, 1e-9, 1e-3}), changed.initial, settings.beats, 1e-3);
    } catch (const NumericalFailure& failure) {
      study.rows.push_back({"any", condition.name, {}, {}, {}, std::string("reference: ") + failure.what()});
      continue;
    }
    for (const char* scheme : {"forward-euler", "runge-kutta-4"}) {
      StabilityRow row{scheme, condition.name, {}, {}, {}, {}};
      const auto within = [&](double bar) {
        return [&, bar](double h_ms) {
          check_interrupt();
          try {
            const double own = peak(LoopSolver(changed, {scheme, 1e-9, 1e-9, 1e-3 * h_ms}), changed.initial,
                                    settings.beats, std::max(1e-3, 1e-3 * h_ms));
            return std::abs(own - exact) <= bar * std::abs(exact);
          } catch (const NumericalFailure&) {
            return false;
          }
        };
      };
      row.stable = largest_step(1e-3, 20, within(1e9));
      if (row.stable) {
        row.accurate = largest_step(1e-3, *row.stable, within(1e-3));
        row.roughly = largest_step(1e-3, *row.stable, within(1e-2));
      }
      study.rows.push_back(row);
    }
    progress.update(0.6 * ++done / static_cast<double>(list.size()), condition.name);
  }
  std::mt19937 random(settings.seed);
  std::uniform_real_distribution<double> unit(0, 1);
  const auto factor = [&](double decades) { return std::pow(10.0, decades * (2 * unit(random) - 1)); };
  for (int k = 0; k < settings.draws; ++k) {
    check_interrupt();
    Loop changed = loop;
    for (auto& valve : changed.circulation.valves) {
      valve.Rmin *= factor(2);
      valve.Rmax = std::pow(10.0, 3 + 6 * unit(random));
    }
    for (auto& vessel : changed.circulation.vessels) {
      vessel.C *= factor(2);
      vessel.R *= factor(1);
      vessel.L *= factor(1);
    }
    for (auto& e : changed.elastance) {
      e.EA *= std::pow(20.0, unit(random));
      e.EB *= factor(0.7);
    }
    for (double& value : changed.initial) value *= 0.05 + 3 * unit(random);
    const char* const names[] = {"cvode", "forward-euler", "runge-kutta-4"};
    LoopIntegrator integrator{names[random() % 3], std::pow(10.0, -9 + 6 * unit(random)), 1e-6,
                              std::pow(10.0, -4.3 + 2 * unit(random))};
    book_draw(study.draws, fmt::format("draw {}: {} dt {:.3g}", k, integrator.name, integrator.dt_s), [&] {
      const LoopSolver solver(changed, integrator);
      CirculationValues state = changed.initial;
      for (int beat = 0; beat < 2; ++beat) solver.beat(state);
      return physical(state);
    });
    if (k % 20 == 0) progress.update(0.6 + 0.4 * k / settings.draws, fmt::format("draw {}", k));
  }
  return study;
}

ExtremesStudy extremes_heart(const std::filesystem::path& scene, const std::vector<std::string>& overrides,
                             const ExtremesSettings& settings, Progress& progress) {
  ExtremesStudy study;
  const int beats = std::min(settings.beats, 3);
  study.subject = fmt::format("heart, {}: {} beats from the scene's start", scene.filename().string(), beats);
  study.step_unit = "ms";
  study.accurate_means = "peak LV pressure within 1 % and no step-to-step oscillation above 5 mL/s up to, ms";
  study.roughly_means = "within 5 % and 100 mL/s up to, ms";
  struct Result {
    double peak = 0, flip = 0;
  };
  const auto run = [&](std::vector<std::string> more) {
    std::vector<std::string> all = overrides;
    all.insert(all.end(), more.begin(), more.end());
    all.push_back("run.until=beats");
    all.push_back(fmt::format("run.beats={}", beats));
    HeartRun heart(read_scene(scene, all));
    heart.prepare(Progress::Style::quiet);
    heart.advance(Progress::Style::quiet, {});
    const auto& p = heart.trace().at("p_LV").values;
    const double peak = *std::max_element(p.begin(), p.end());
    if (!std::isfinite(peak)) throw NumericalFailure("not finite");
    return Result{peak, largest_flip(heart.trace().at("Q_AV").values)};
  };
  const Result exact = run({"solver.dt_s=1e-4", "solver.stretch_rate=implicit"});
  struct Case {
    std::string scheme, condition;
    std::vector<std::string> overrides;
  };
  std::vector<Case> cases;
  for (const char* rate : {"implicit", "lagged"})
    for (bool active : {true, false})
      for (bool volumes : {true, false})
        for (const char* inductors : {"explicit", "implicit"})
          cases.push_back(
              {fmt::format("{} rate, inductors {}", rate, inductors),
               fmt::format("active stress {}, volumes {}", active ? "stabilised" : "plain",
                           volumes ? "stabilised" : "plain"),
               {fmt::format("solver.stretch_rate={}", rate), fmt::format("solver.inductors={}", inductors),
                fmt::format("solver.stabilise.active_stress={}", active),
                fmt::format("solver.stabilise.volumes={}", volumes)}});
  double done = 0;
  for (const Case& c : cases) {
    StabilityRow row{c.scheme, c.condition, {}, {}, {}, {}};
    for (double dt_ms : {10.0, 5.0, 4.0, 2.0, 1.0, 0.5, 0.2, 0.1, 0.05}) {
      check_interrupt();
      std::vector<std::string> more = c.overrides;
      more.push_back(fmt::format("solver.dt_s={}", 1e-3 * dt_ms));
      try {
        const Result own = run(more);
        const double error = std::abs(own.peak / exact.peak - 1);
        if (!row.stable) row.stable = dt_ms;
        if (!row.roughly && error < 0.05 && own.flip < 100) row.roughly = dt_ms;
        if (!row.accurate && error < 0.01 && own.flip < 5) row.accurate = dt_ms;
        if (row.accurate) break;
      } catch (const NumericalFailure& failure) {
        row.note = fmt::format("at {} ms: {}", dt_ms, std::string(failure.what()).substr(0, 90));
      } catch (const InputError& refusal) {
        const std::string text = refusal.what();
        row.note = fmt::format("{} ms refused: {}", dt_ms, text.substr(0, text.find(';')));
      }
    }
    study.rows.push_back(row);
    progress.update(0.7 * ++done / static_cast<double>(cases.size()), c.condition);
  }
  std::mt19937 random(settings.seed);
  std::uniform_real_distribution<double> unit(0, 1);
  const auto pick = [&](std::initializer_list<const char*> from) {
    return *(from.begin() + random() % from.size());
  };
  for (int k = 0; k < settings.draws; ++k) {
    check_interrupt();
    std::vector<std::string> more = {
        fmt::format("solver.dt_s={:.17g}", 0.8 / std::floor(0.8 / std::pow(10.0, -3.5 + 1.2 * unit(random)))),
        fmt::format("solver.stretch_rate={}", pick({"lagged", "implicit", "none"})),
        fmt::format("solver.regulation={}", pick({"frozen-midpoint", "forward-euler"})),
        fmt::format("solver.inductors={}", pick({"explicit", "implicit"})),
        fmt::format("solver.stabilise.volumes={}", unit(random) < 0.7),
        fmt::format("solver.stabilise.active_stress={}", unit(random) < 0.7),
        fmt::format("circulation.circuit.SYS.C_AR={:.4g}", 1.5 * std::pow(10.0, 2 * unit(random) - 1)),
        fmt::format("circulation.circuit.SYS.R_AR={:.4g}", 0.64 * std::pow(10.0, 2 * unit(random) - 1)),
        fmt::format("circulation.valves.AV.Rmin={:.4g}", 0.0075 * std::pow(10.0, 3 * unit(random) - 1))};
    std::string text = fmt::format("draw {}:", k);
    for (const std::string& o : more) text += " " + o;
    book_draw(study.draws, text, [&] {
      const Result own = run(more);
      return std::isfinite(own.peak) && own.peak > 0 && own.peak < 5000;
    });
    progress.update(0.7 + 0.3 * k / settings.draws, fmt::format("draw {}", k));
  }
  return study;
}

}  // namespace wiggers
