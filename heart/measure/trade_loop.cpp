// Work and precision of the 0D loop: one beat on its limit cycle.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <wiggers/core/errors.hpp>
#include <wiggers/heart/measure/trade.hpp>

namespace wiggers {

namespace {

// Largest differences of pressures, volumes and flows, and of the stroke volume; rows of `trace` are every
// stride-th of `exact`, the last the last.
std::vector<double> errors(const Table& trace, const Table& exact, std::size_t stride) {
  double pressure = 0, volume = 0, flow = 0;
  const std::size_t last = exact.n_rows() - 1;
  for (std::size_t c = 1; c < trace.columns.size(); ++c) {
    const std::string& unit = trace.columns[c].unit;
    double& largest = unit == "mmHg" ? pressure : unit == "mL" ? volume : flow;
    for (std::size_t k = 0; k < trace.n_rows(); ++k)
      largest = std::max(largest, std::abs(trace.columns[c].values[k] -
                                           exact.columns[c].values[std::min(k * stride, last)]));
  }
  const auto stroke = [](const Table& t) {
    const auto& V = t.at("V_LV").values;
    return *std::max_element(V.begin(), V.end()) - *std::min_element(V.begin(), V.end());
  };
  return {pressure, volume, flow, std::abs(stroke(trace) - stroke(exact))};
}

}  // namespace

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
  finest.to_limit_cycle(start, loop_cycle_settings(1e-9));
  const auto run = [&](const LoopIntegrator& integrator, double spacing_s) {
    Table table = circulation_table(loop.circulation);
    CirculationValues state = start;
    LoopSolver(loop, integrator).beat(state, spacing_s, &table);
    return table;
  };
  const Table exact = run({"cvode", 1e-12, 1e-12, 1e-3}, sample_s);
  const auto confirmed = errors(run({"runge-kutta-4", 1e-9, 1e-9, 2e-5}, sample_s), exact, 1);
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
      const bool coarse = integrator.name != "cvode" && integrator.dt_s > sample_s;
      const auto stride =
          coarse ? static_cast<std::size_t>(std::lround(integrator.dt_s / sample_s)) : std::size_t(1);
      row.errors = errors(run(integrator, sample_s * static_cast<double>(stride)), exact, stride);
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
