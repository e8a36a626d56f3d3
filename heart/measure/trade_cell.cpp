// Work and precision of the ionic models: one beat of 800 ms from the published initial values, stimulus
// -25.71 A/F for 3 ms. Output every 0.1 ms, by interpolation where steps are longer.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <wiggers/cellmodels/pacing/action_potential.hpp>
#include <wiggers/cellmodels/pacing/pacing.hpp>
#include <wiggers/cellmodels/population/population.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/heart/measure/trade.hpp>

namespace wiggers {

namespace {

constexpr double period_ms = 800, grid_ms = 0.1;
constexpr StimulusPulse pulse{-25.71, 3, 0};

struct Trace {
  double sample_ms = grid_ms;
  std::vector<double> t, V, calcium, end;
};

// "state m = ... left its physical range" without the advice behind it.
std::string shortened(const std::string& text) {
  const auto begin = text.find("state "), end = text.find(" (integrator");
  return begin == std::string::npos ? text : text.substr(begin, end == std::string::npos ? end : end - begin);
}

std::vector<double> errors(const CellModel& model, const Trace& trace, const Trace& exact) {
  const auto apd = action_potential_duration(trace.t, trace.V, 0.9);
  const auto apd_exact = action_potential_duration(exact.t, exact.V, 0.9);
  const auto up = upward_crossing(trace.t, trace.V, 0), up_exact = upward_crossing(exact.t, exact.V, 0);
  if (!apd || !up) throw NumericalFailure("no action potential");
  double square = 0, norm = 0, largest = 0, late = 0;
  const auto stride = static_cast<std::size_t>(std::lround(trace.sample_ms / grid_ms));
  for (std::size_t k = 0; k < trace.V.size(); ++k) {
    const std::size_t same = std::min(k * stride, exact.V.size() - 1);
    const double difference = std::abs(trace.V[k] - exact.V[same]);
    square += difference * difference;
    norm += exact.V[same] * exact.V[same];
    largest = std::max(largest, difference);
    if (trace.t[k] > 10) late = std::max(late, difference);
  }
  const auto peak = [](const Trace& x) { return *std::max_element(x.calcium.begin(), x.calcium.end()); };
  double end = 0;
  for (std::size_t i = 0; i < exact.end.size(); ++i) {
    const double scale = static_cast<int>(i) == model.membrane_potential
                             ? 10.0
                             : std::abs(model.states[i].default_value) + 1e-3;
    end = std::max(end, std::abs(trace.end[i] - exact.end[i]) / scale);
  }
  return {std::abs(*apd - *apd_exact),
          std::sqrt(square / norm),
          largest,
          late,
          std::abs(*up - *up_exact),
          exact.calcium.empty() ? 0 : std::abs(peak(trace) / peak(exact) - 1),
          end};
}

Trace sampled_beat(const CellModel& model, const std::vector<double>& parameters,
                   const CellIntegrator& integrator) {
  Trace trace;
  if (!is_adaptive(integrator.name)) trace.sample_ms = std::max(grid_ms, integrator.dt_ms);
  trace.end = model.default_state();
  PacedCell cell(model, parameters, {period_ms, pulse}, integrator);
  cell.beat(trace.end, trace.sample_ms, [&](double t, const double* y, double) {
    trace.t.push_back(t);
    trace.V.push_back(y[model.membrane_potential]);
    if (model.has_calcium()) trace.calcium.push_back(y[model.cytosolic_calcium]);
  });
  return trace;
}

TradeRow single_cell(const CellModel& model, const std::vector<double>& parameters,
                     const CellIntegrator& integrator, std::string setting, const Trace& exact) {
  TradeRow row{integrator.name, std::move(setting), {}, 0, 0, 0, {}};
  try {
    row.errors = errors(model, sampled_beat(model, parameters, integrator), exact);
    PacedCell cell(model, parameters, {period_ms, pulse}, integrator);
    long beats = 0;
    row.cost_s = median_cost([&] {
      std::vector<double> state = model.default_state();
      cell.beat(state);
      ++beats;
    });
    const AdaptiveCounts counts = cell.counts();
    row.steps = is_adaptive(integrator.name) ? counts.steps / beats
                                             : static_cast<long>(std::lround(period_ms / integrator.dt_ms));
    row.evaluations = counts.evaluations / beats;
  } catch (const NumericalFailure& failure) {
    row.errors.clear();
    row.failure = shortened(failure.what());
  }
  return row;
}

// A population's beat, sampled; and its cost per cell.
TradeRow batch(const CellModel& model, const std::vector<double>& parameters,
               const PopulationSettings& settings, double dt_ms, std::string setting, const Trace& exact) {
  TradeRow row{settings.integrator + ", batch", std::move(setting), {}, 0, 0, 0, {}};
  try {
    CellPopulation one(model, 1, settings, parameters);
    Trace trace;
    const int per_sample = std::max(1, static_cast<int>(std::lround(grid_ms / dt_ms)));
    trace.sample_ms = per_sample * dt_ms;
    const auto n_samples = static_cast<long>(std::lround(period_ms / trace.sample_ms));
    const auto n_stimulated = static_cast<long>(std::lround(pulse.duration_ms / trace.sample_ms));
    for (long k = 0; k <= n_samples; ++k) {
      const std::vector<double> y = one.state_of(0);
      trace.t.push_back(static_cast<double>(k) * trace.sample_ms);
      trace.V.push_back(y[static_cast<std::size_t>(model.membrane_potential)]);
      if (model.has_calcium()) trace.calcium.push_back(y[static_cast<std::size_t>(model.cytosolic_calcium)]);
      trace.end = y;
      if (k == n_samples) break;
      one.set_input("i_stim", k < n_stimulated ? pulse.amplitude_A_per_F : 0);
      one.step(dt_ms, per_sample);
    }
    row.errors = errors(model, trace, exact);
    constexpr int n_cells = 1024, n_steps = 20;
    CellPopulation many(model, n_cells, settings, parameters);
    many.step(dt_ms, n_steps);
    row.steps = static_cast<long>(std::lround(period_ms / dt_ms));
    row.cost_s =
        median_cost([&] { many.step(dt_ms, n_steps); }) * static_cast<double>(row.steps) / n_steps / n_cells;
  } catch (const NumericalFailure& failure) {
    row.errors.clear();
    row.failure = shortened(failure.what());
  }
  return row;
}

}  // namespace

TradeStudy trade_cell(const CellModel& model, const std::vector<double>& parameters, Progress& progress) {
  TradeStudy study;
  study.subject = fmt::format("{}: one beat of one cell", model.name);
  study.protocol =
      "800 ms from the published initial values, stimulus -25.71 A/F for 3 ms, compared every 0.1 ms";
  study.reference = "cvode rtol 1e-12, atol 1e-14; confirmed by rosenbrock rtol 1e-9";
  study.measures = trade_measures("cell");
  progress.update(0, "reference");
  const Trace exact = sampled_beat(model, parameters, {"cvode", 1e-12, 1e-14, 0});
  const auto confirmed =
      errors(model, sampled_beat(model, parameters, {"rosenbrock", 1e-9, 1e-11, 0}), exact);
  for (std::size_t m = 0; m < confirmed.size(); ++m) study.measures[m].reference_confirmed = confirmed[m];

  struct Fixed {
    const char* name;
    double smallest, largest;
  };
  std::vector<std::function<TradeRow()>> jobs;
  const double steps[] = {1.0, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.0025};
  for (const Fixed& fixed : {Fixed{"forward-euler", 0.0025, 0.02}, Fixed{"rush-larsen", 0.0025, 1},
                             Fixed{"rush-larsen-2", 0.0025, 1}, Fixed{"generalised-rush-larsen", 0.005, 1},
                             Fixed{"generalised-rush-larsen-2", 0.005, 1}, Fixed{"bdf2-imex", 0.0025, 1}})
    for (double dt : steps)
      if (dt >= fixed.smallest && dt <= fixed.largest)
        jobs.push_back([&, fixed, dt] {
          return single_cell(model, parameters, {fixed.name, 1e-8, 1e-10, dt}, fmt::format("dt {} ms", dt),
                             exact);
        });
  for (const char* name : {"rosenbrock", "cvode", "odeint-rosenbrock4", "odeint-dopri5"})
    for (double rtol : {1e-2, 1e-3, 3e-4, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-10}) {
      // The fixed-order methods below 1e-8 cost more than the reference.
      if (rtol < 1e-8 && std::string_view(name) != "cvode") continue;
      jobs.push_back([&, name, rtol] {
        return single_cell(model, parameters, {name, rtol, 0.01 * rtol, 0}, fmt::format("rtol {:.0e}", rtol),
                           exact);
      });
    }
  for (const char* name : {"rush-larsen", "rush-larsen-2"})
    for (double dt : {0.1, 0.05, 0.02, 0.01})
      for (double spacing : {0.0, 0.05, 0.1, 0.2})
        for (bool single : {false, true}) {
          if (single && spacing != 0.1 && spacing != 0) continue;
          if (spacing > 0 && !model.has_voltage_table) continue;
          PopulationSettings settings;
          settings.integrator = name;
          settings.table_spacing_mV = spacing;
          settings.single_precision = single;
          std::string text =
              fmt::format("dt {} ms, {}{}", dt, single ? "float" : "double",
                          spacing > 0 ? fmt::format(", tables {} mV", spacing) : std::string());
          jobs.push_back(
              [&, settings, dt, text] { return batch(model, parameters, settings, dt, text, exact); });
        }
  for (std::size_t k = 0; k < jobs.size(); ++k) {
    study.rows.push_back(jobs[k]());
    progress.update(static_cast<double>(k + 1) / static_cast<double>(jobs.size()),
                    study.rows.back().method + " " + study.rows.back().setting);
  }
  return study;
}

}  // namespace wiggers
