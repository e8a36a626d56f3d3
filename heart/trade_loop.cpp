// Work and precision of the 0D loop: one beat on its limit cycle.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <wiggers/core/errors.hpp>
#include <wiggers/heart/trade.hpp>

namespace wiggers {

TradeStudy trade_loop(const Loop& loop, Progress& progress) {
  TradeStudy study;
  study.subject = "loop: one beat";
  study.protocol = "from the reference's limit cycle, compared every ms";
  study.reference =
      "cvode rtol 1e-12, atol 1e-12, restarted at activation break points; confirmed by "
      "runge-kutta-4 at 0.02 ms";
  study.measures = trade_measures("loop");
  constexpr double sample_s = 1e-3;
  const LoopSolver finest(loop, {"cvode", 1e-12, 1e-12, 1e-3});
  CirculationValues start = loop.initial;
  progress.update(0, "reference");
  LimitCycleSettings settings;
  settings.distance = 1e-9;
  settings.relaxing_beats = 0;
  finest.to_limit_cycle(start, settings);
  const auto run = [&](const LoopIntegrator& integrator) {
    Table table = circulation_table();
    CirculationValues state = start;
    LoopSolver(loop, integrator).beat(state, sample_s, &table);
    return table;
  };
  const Table exact = run({"cvode", 1e-12, 1e-12, 1e-3});
  const auto errors = [&](const Table& trace) {
    double pressure = 0, volume = 0, flow = 0;
    for (std::size_t c = 1; c < trace.columns.size(); ++c) {
      double& largest = trace.columns[c].unit == "mmHg" ? pressure
                        : trace.columns[c].unit == "mL" ? volume
                                                        : flow;
      for (std::size_t k = 0; k < trace.n_rows(); ++k)
        largest = std::max(largest, std::abs(trace.columns[c].values[k] - exact.columns[c].values[k]));
    }
    const auto stroke = [](const Table& t) {
      const auto& V = t.at("V_LV").values;
      return *std::max_element(V.begin(), V.end()) - *std::min_element(V.begin(), V.end());
    };
    return std::vector<double>{pressure, volume, flow, std::abs(stroke(trace) - stroke(exact))};
  };
  const auto confirmed = errors(run({"runge-kutta-4", 1e-9, 1e-9, 2e-5}));
  for (std::size_t m = 0; m < confirmed.size(); ++m) study.measures[m].reference_confirmed = confirmed[m];
  std::vector<std::pair<LoopIntegrator, std::string>> jobs;
  for (const char* name : {"forward-euler", "runge-kutta-4"})
    for (double dt_ms : {5.0, 2.0, 1.0, 0.5, 0.2, 0.1, 0.05})
      jobs.push_back({{name, 1e-9, 1e-9, 1e-3 * dt_ms}, fmt::format("dt {} ms", dt_ms)});
  for (double rtol : {1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10})
    jobs.push_back({{"cvode", rtol, rtol, 1e-3}, fmt::format("rtol {:.0e}", rtol)});
  for (std::size_t k = 0; k < jobs.size(); ++k) {
    const auto& [integrator, text] = jobs[k];
    TradeRow row{integrator.name, text, {}, 0, 0, 0, {}};
    try {
      // Steps above the sampling are compared at their own ends: spans between samples would shorten them.
      if (integrator.name != "cvode" && integrator.dt_s > sample_s) {
        Table table = circulation_table(), same = circulation_table();
        CirculationValues state = start;
        LoopSolver(loop, integrator).beat(state, integrator.dt_s, &table);
        const auto stride = static_cast<std::size_t>(std::lround(integrator.dt_s / sample_s));
        Table every = exact;
        for (Column& column : every.columns) {
          std::vector<double> kept;
          for (std::size_t r = 0; r < column.values.size(); r += stride) kept.push_back(column.values[r]);
          if (kept.size() < table.n_rows()) kept.push_back(column.values.back());
          column.values = kept;
        }
        double pressure = 0, volume = 0, flow = 0;
        for (std::size_t c = 1; c < table.columns.size(); ++c) {
          double& largest = table.columns[c].unit == "mmHg" ? pressure
                            : table.columns[c].unit == "mL" ? volume
                                                            : flow;
          for (std::size_t r = 0; r < std::min(table.n_rows(), every.n_rows()); ++r)
            largest = std::max(largest, std::abs(table.columns[c].values[r] - every.columns[c].values[r]));
        }
        const auto stroke = [](const Table& t) {
          const auto& V = t.at("V_LV").values;
          return *std::max_element(V.begin(), V.end()) - *std::min_element(V.begin(), V.end());
        };
        row.errors = {pressure, volume, flow, std::abs(stroke(table) - stroke(every))};
      } else {
        row.errors = errors(run(integrator));
      }
      const LoopSolver solver(loop, integrator);
      row.cost_s = median_cost([&] {
        CirculationValues state = start;
        solver.beat(state);
      });
      if (integrator.name != "cvode") row.steps = std::lround(loop.period_s / integrator.dt_s);
      for (double error : row.errors)
        if (!std::isfinite(error)) throw NumericalFailure("diverged");
    } catch (const NumericalFailure&) {
      row.errors.clear();
      row.failure = "diverges";
    }
    study.rows.push_back(row);
    progress.update(static_cast<double>(k + 1) / static_cast<double>(jobs.size()),
                    row.method + " " + row.setting);
  }
  return study;
}

}  // namespace wiggers
