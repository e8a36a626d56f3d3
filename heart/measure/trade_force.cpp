// Work and precision of a force model: one twitch of 800 ms under an analytic calcium transient with
// shortening. The cost is that of one cell; a batch's is per cell.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <numbers>
#include <wiggers/cellmodels/catalogue/force_stepper.hpp>
#include <wiggers/cellmodels/population/population.hpp>
#include <wiggers/core/cvode.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/heart/measure/trade.hpp>

namespace wiggers {

namespace {

constexpr double duration_s = 0.8;

// Rest, rise and decay as in a ventricular twitch; the sarcomere shortens by 8 % and returns within 400 ms.
struct Twitch {
  double rest_uM = 0.1, peak_uM = 0.8, rise_s = 0.02, decay_s = 0.06, SL0 = 2.2;
  double calcium(double t) const {
    const double top = std::log(rise_s / decay_s) * rise_s * decay_s / (rise_s - decay_s);
    const auto shape = [&](double x) { return std::exp(-x / decay_s) - std::exp(-x / rise_s); };
    return rest_uM + (peak_uM - rest_uM) * shape(t) / shape(top);
  }
  double length(double t) const {
    const double s = std::sin(std::numbers::pi * std::min(t, 0.4) / 0.4);
    return SL0 * (1 - 0.08 * s * s);
  }
  double rate(double t) const {
    return t >= 0.4 ? 0.0 : -SL0 * 0.08 * std::numbers::pi / 0.4 * std::sin(2 * std::numbers::pi * t / 0.4);
  }
  void inputs(double t, double* in) const {
    in[0] = calcium(t);
    in[1] = length(t);
    in[2] = rate(t);
  }
};

using Tension = std::vector<double>;  // every 5 ms: what all steps below divide
constexpr double grid_s = 5e-3;

std::vector<double> errors(const Tension& trace, const Tension& exact) {
  const auto top = std::max_element(exact.begin(), exact.end());
  double largest = 0;
  for (std::size_t k = 0; k < exact.size(); ++k) largest = std::max(largest, std::abs(trace[k] - exact[k]));
  const auto own = std::max_element(trace.begin(), trace.end());
  return {100 * largest / *top, 100 * std::abs(*own / *top - 1)};
}

void require_probabilities(const CellModel& model, const std::vector<double>& y, double t) {
  if (!probabilities_kept(model, y, 1e-6, 1e-6))
    throw NumericalFailure(fmt::format("probabilities left [0, 1] at {} s", t));
}

}  // namespace

bool probabilities_kept(const CellModel& model, const std::vector<double>& y, double below, double sum) {
  for (std::size_t i = 0; i < y.size(); ++i)
    if (const Quantity& q = model.states[i];
        q.lower == 0 && q.upper == 1 && !(y[i] >= -below && y[i] <= 1 + below))
      return false;
  const auto parameters = model.parameter_values(model.parameter_sets.front().name);
  const auto now = model.invariant_values(y.data(), parameters.data()),
             wanted = model.invariant_values(model.default_state().data(), parameters.data());
  for (std::size_t k = 0; k < now.size(); ++k)
    if (!(std::abs(now[k] - wanted[k]) <= sum)) return false;
  return true;
}

TradeStudy trade_force(const CellModel& model, std::string_view parameter_set, Progress& progress) {
  const std::vector<double> parameters = model.parameter_values(parameter_set);
  const auto stepper = make_force_stepper<double>(model, parameters);
  const auto equations = model.equations(parameters);
  Twitch twitch;
  twitch.SL0 = stepper->reference_length_um();
  const std::vector<double> rest = steady_force_state(model, parameters, twitch.rest_uM, twitch.SL0);
  const auto tension = [&](const std::vector<double>& y, double length) {
    return stepper->forces(y.data(), length).tension_kPa;
  };

  TradeStudy study;
  study.subject = fmt::format("{}, {}: one twitch", model.name, parameter_set);
  study.protocol =
      "800 ms, calcium 0.1 to 0.8 uM (rise 20 ms, decay 60 ms), sarcomere shortening by 8 % and back in 400 "
      "ms, "
      "compared every 5 ms";
  study.reference = "cvode rtol 1e-11; confirmed by frozen-midpoint at 0.02 ms";
  study.measures = trade_measures("force");

  const auto integrate = [&](double rtol) {
    OdeSystem system;
    system.size = model.states.size();
    system.derivative = [&](double t, const double* y, double* dy) {
      double in[3];
      twitch.inputs(t, in);
      equations->evaluate(y, in, dy, nullptr);
    };
    system.jacobian = [&](double t, const double* y, double* j) {
      double in[3];
      twitch.inputs(t, in);
      equations->jacobian(y, in, j);
    };
    Cvode solver(system, {rtol, std::vector<double>(system.size, 1e-2 * rtol)});
    Tension T = {tension(rest, twitch.length(0))};
    solver.restart(0, rest);
    for (double begin : {0.0, 0.4}) {  // the shortening has a kink at 400 ms
      if (begin > 0) solver.restart(begin, solver.advance(begin));
      for (long k = std::lround(begin / grid_s) + 1; k <= std::lround((begin + 0.4) / grid_s); ++k) {
        const double t = static_cast<double>(k) * grid_s;
        T.push_back(tension(solver.advance(t, begin + 0.4), twitch.length(t)));
      }
    }
    return T;
  };
  // A step from t to t + h; the trace of a fixed-step method.
  using Step = std::function<void(double t, double h, std::vector<double>& y)>;
  const auto march = [&](double h, const Step& step) {
    std::vector<double> y = rest;
    Tension T = {tension(y, twitch.length(0))};
    const long n = std::lround(duration_s / h), every = std::lround(grid_s / h);
    for (long k = 0; k < n; ++k) {
      const double t = static_cast<double>(k) * h;
      step(t, h, y);
      if ((k + 1) % every != 0) continue;
      require_probabilities(model, y, t);
      T.push_back(tension(y, twitch.length(t + h)));
    }
    return T;
  };
  const Step midpoint = [&](double t, double h, std::vector<double>& y) {
    double in[3];
    twitch.inputs(t + 0.5 * h, in);
    ForcesOf<double> forces;
    if (!stepper->begin({RegulationScheme::midpoint, 1, RateScheme::lagged}, h, y.data(), in[0], in[1],
                        -in[2] / twitch.SL0, forces))
      throw NumericalFailure("rates beyond the method's reach");
  };
  const auto substepped = [&](int substeps) {
    return [&, substeps](double t, double h, std::vector<double>& y) {
      ForcesOf<double> forces;
      (void)stepper->begin({RegulationScheme::forward_euler, substeps, RateScheme::lagged}, h, y.data(),
                           twitch.calcium(t + h), twitch.length(t + h),
                           -twitch.rate(t + 0.5 * h) / twitch.SL0, forces);
    };
  };

  progress.update(0, "reference");
  const Tension exact = integrate(1e-11);
  const auto confirmed = errors(march(2e-5, midpoint), exact);
  for (std::size_t m = 0; m < confirmed.size(); ++m) study.measures[m].reference_confirmed = confirmed[m];

  const auto add = [&](std::string method, std::string setting, const std::function<Tension()>& run) {
    TradeRow row{std::move(method), std::move(setting), {}, 0, 0, 0, {}};
    try {
      row.errors = errors(run(), exact);
      row.cost_s = median_cost([&] { (void)run(); });
    } catch (const NumericalFailure& failure) {
      row.errors.clear();
      row.failure = failure.what();
    }
    study.rows.push_back(row);
    progress.update(-1, row.method + " " + row.setting);
  };
  for (double h_ms : {5.0, 2.5, 1.0, 0.5, 0.25, 0.1, 0.05})
    add("frozen-midpoint", fmt::format("dt {} ms", h_ms), [&, h_ms] { return march(1e-3 * h_ms, midpoint); });
  for (double h_ms : {1.0, 0.5, 0.25})
    for (double substep_us : {500.0, 250.0, 100.0, 50.0, 25.0, 10.0})
      if (substep_us <= 1000 * h_ms)
        add("forward-euler-substeps", fmt::format("dt {} ms, sub-step {} us", h_ms, substep_us),
            [&, h_ms, substep_us] {
              return march(1e-3 * h_ms, substepped(static_cast<int>(std::lround(1000 * h_ms / substep_us))));
            });
  for (double rtol : {1e-3, 1e-4, 1e-5, 1e-6, 1e-8})
    add("cvode", fmt::format("rtol {:.0e}", rtol), [&, rtol] { return integrate(rtol); });
  // Batches: cost per cell.
  for (bool single : {false, true})
    for (double h_ms : {2.5, 1.0, 0.5}) {
      PopulationSettings settings;
      settings.single_precision = single;
      constexpr int n_cells = 512;
      const auto run = [&](std::size_t n) {
        CellPopulation cells(model, n, settings, parameters);
        for (std::size_t cell = 0; cell < n; ++cell) cells.set_state_of(cell, rest);
        const double h = 1e-3 * h_ms;
        const long steps = std::lround(duration_s / h), every = std::lround(grid_s / h);
        Tension T = {tension(rest, twitch.length(0))};
        for (long k = 0; k < steps; ++k) {
          const double t = (static_cast<double>(k) + 0.5) * h;
          cells.set_input("Ca", twitch.calcium(t));
          cells.set_input("SL", twitch.length(t));
          cells.set_input("dSL/dt", twitch.rate(t));
          cells.step(h);
          if (n == 1 && (k + 1) % every == 0)
            T.push_back(tension(cells.state_of(0), twitch.length(t + 0.5 * h)));
        }
        return T;
      };
      TradeRow row{"frozen-midpoint, batch",
                   fmt::format("dt {} ms, {}", h_ms, single ? "float" : "double"),
                   {},
                   0,
                   0,
                   0,
                   {}};
      try {
        row.errors = errors(run(1), exact);
        row.cost_s = median_cost([&] { (void)run(n_cells); }) / n_cells;
      } catch (const NumericalFailure& failure) {
        row.errors.clear();
        row.failure = failure.what();
      }
      study.rows.push_back(row);
    }
  return study;
}

}  // namespace wiggers
