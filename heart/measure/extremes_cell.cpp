// Ionic cells and force models at the extremes.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <wiggers/cellmodels/catalogue/force_stepper.hpp>
#include <wiggers/cellmodels/pacing/action_potential.hpp>
#include <wiggers/cellmodels/pacing/pacing.hpp>
#include <wiggers/cellmodels/population/population.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/heart/measure/extremes.hpp>
#include <wiggers/heart/measure/trade.hpp>

namespace wiggers {

namespace {

struct Condition {
  std::string name;
  PacingProtocol protocol;
  std::vector<double> parameters, start;
};

std::vector<Condition> conditions(const CellModel& model) {
  const StimulusPulse pulse{-25.71, 3, 0};
  const Condition base{
      "60 beats a minute", {1000, pulse}, model.parameter_values("default"), model.default_state()};
  std::vector<Condition> list = {base};
  const auto add = [&](std::string name, const std::function<void(Condition&)>& change) {
    Condition c = base;
    c.name = std::move(name);
    change(c);
    list.push_back(c);
  };
  add("20 beats a minute", [](Condition& c) { c.protocol.period_ms = 3000; });
  add("240 beats a minute", [](Condition& c) { c.protocol.period_ms = 250; });
  add("no stimulus", [](Condition& c) { c.protocol.stimulus = {0, 0, 0}; });
  add("stimulus x 2", [](Condition& c) { c.protocol.stimulus.amplitude_A_per_F *= 2; });
  for (double V : {-40.0, 0.0, 15.0})
    add(fmt::format("start at {} mV", V),
        [&](Condition& c) { c.start[static_cast<std::size_t>(model.membrane_potential)] = V; });
  for (double K_o : {3.0, 8.0}) {
    if (std::ranges::none_of(model.parameters, [](const Quantity& q) { return q.name == "K_o"; })) break;
    add(fmt::format("K_o {} mM", K_o),
        [&](Condition& c) { c.parameters[require_index(model.parameters, "parameter", "K_o")] = K_o; });
  }
  for (double gate : {0.0, 1.0})
    add(fmt::format("all gates at {}", gate), [&](Condition& c) {
      for (std::size_t i = 0; i < c.start.size(); ++i)
        if (model.is_gate[i]) c.start[i] = gate;
    });
  for (double factor : {0.2, 5.0})
    add(fmt::format("calcium x {}", factor), [&](Condition& c) {
      for (std::size_t i = 0; i < c.start.size(); ++i)
        if (model.states[i].name.starts_with("Ca_")) c.start[i] *= factor;
    });
  return list;
}

std::optional<double> apd(const CellModel& model, const Condition& c, const CellIntegrator& integrator) {
  std::vector<double> t, V, state = c.start;
  PacedCell(model, c.parameters, c.protocol, integrator)
      .beat(state, std::max(0.1, is_adaptive(integrator.name) ? 0.1 : integrator.dt_ms),
            [&](double time, const double* y, double) {
              t.push_back(time);
              V.push_back(y[model.membrane_potential]);
            });
  return action_potential_duration(t, V, 0.9);
}

}  // namespace

ExtremesStudy extremes_cell(const CellModel& model, const ExtremesSettings& settings, Progress& progress) {
  ExtremesStudy study;
  study.subject = fmt::format("{}: a step is stable if {} beats complete with physical states", model.name,
                              settings.beats);
  study.step_unit = "ms";
  study.accurate_means = "APD90 within 1 ms up to, ms";
  study.roughly_means = "APD90 within 5 % up to, ms";
  const auto list = conditions(model);
  const auto schemes = fixed_step_integrators();
  const double n_jobs = static_cast<double>(list.size() * schemes.size());
  double done = 0;
  for (const Condition& c : list) {
    std::optional<double> exact;
    try {
      exact = apd(model, c, {"cvode", 1e-9, 1e-11, 0});
    } catch (const NumericalFailure&) {
      // no reference under this condition: only stability is told
    }
    for (std::string_view scheme : schemes) {
      StabilityRow row{std::string(scheme), c.name, {}, {}, {}, {}};
      const double largest = 2;
      row.stable = largest_step(5e-4, largest, [&](double h) {
        check_interrupt();
        PacedCell cell(model, c.parameters, c.protocol, {std::string(scheme), 1e-8, 1e-10, h});
        std::vector<double> state = c.start;
        try {
          // Forward Euler's steps are so small that two beats must do.
          const int beats = scheme == "forward-euler" ? std::min(2, settings.beats) : settings.beats;
          for (int beat = 0; beat < beats; ++beat) cell.beat(state);
          return true;
        } catch (const NumericalFailure& failure) {
          const std::string text = failure.what();
          const auto from = text.find("state "), to = text.find(" left");
          if (from != std::string::npos && to != std::string::npos)
            row.note = fmt::format("above: {} out of range",
                                   text.substr(from + 6, text.find(' ', from + 6) - from - 6));
          return false;
        }
      });
      if (row.stable && exact) {
        const auto within = [&](double bar) {
          return largest_step(5e-4, *row.stable, [&](double h) {
            try {
              const auto own = apd(model, c, {std::string(scheme), 1e-8, 1e-10, h});
              return own && std::abs(*own - *exact) <= bar;
            } catch (const NumericalFailure&) {
              return false;
            }
          });
        };
        row.accurate = within(1.0);
        row.roughly = within(0.05 * *exact);
      } else if (row.stable) {
        row.note = "no action potential in the beat";
      }
      study.rows.push_back(row);
      progress.update(0.7 * ++done / n_jobs, row.scheme + ", " + c.name);
    }
  }

  std::mt19937 random(settings.seed);
  std::uniform_real_distribution<double> unit(0, 1);
  const auto pick = [&](auto&& from) { return *(from.begin() + static_cast<long>(random() % from.size())); };
  std::vector<std::string> all(schemes.begin(), schemes.end());
  for (std::string_view name : adaptive_integrators())
    if (name != "odeint-dopri5") all.emplace_back(name);
  const std::vector<double> singular = {-47.13, -40, -14.1, -10, 3.3328, 7.9, 15, 19.9, 0};
  for (int k = 0; k < settings.draws; ++k) {
    check_interrupt();
    Condition c = list.front();
    for (std::size_t i = 0; i < c.start.size(); ++i) {
      const Quantity& q = model.states[i];
      if (static_cast<int>(i) == model.membrane_potential)
        c.start[i] =
            unit(random) < 0.5 ? pick(singular) + 1e-9 * (unit(random) - 0.5) : -120 + 180 * unit(random);
      else if (q.unit == "mM")
        c.start[i] *= std::pow(10.0, 2 * unit(random) - 1);
      else
        c.start[i] = unit(random) < 0.1 ? 0.0 : unit(random) < 0.1 ? 1.0 : unit(random);
    }
    c.protocol.period_ms = 250 + 2750 * unit(random) * unit(random);
    c.protocol.stimulus.amplitude_A_per_F *= 2 * unit(random);
    for (double& p : c.parameters)
      if (unit(random) < 0.1) p *= std::pow(10.0, 0.6 * unit(random) - 0.3);
    const std::string scheme = pick(all);
    const double dt = std::pow(10.0, -2.3 + 2 * unit(random)), rtol = std::pow(10.0, -8 + 5 * unit(random));
    book_draw(study.draws, fmt::format("draw {}: {} dt {:.3g} rtol {:.1g}", k, scheme, dt, rtol), [&] {
      PacedCell cell(model, c.parameters, c.protocol, {scheme, rtol, 0.01 * rtol, dt});
      std::vector<double> state = c.start;
      cell.beat(state);
      for (double value : state)
        if (!std::isfinite(value)) return false;
      return true;
    });
    if (k % 20 == 0) progress.update(0.7 + 0.3 * k / settings.draws, fmt::format("draw {}", k));
  }
  return study;
}

ExtremesStudy extremes_force(const CellModel& model, const ExtremesSettings& settings, Progress& progress) {
  ExtremesStudy study;
  study.subject = fmt::format(
      "{}: calcium 0.1 -> 10 uM at once, held 100 ms, and back; stable: probabilities in [-1e-10, 1], sum "
      "1 within 1e-12",
      model.name);
  study.step_unit = "ms";
  study.accurate_means = "tension within 1 % of its peak up to, ms";
  study.roughly_means = "within 5 % up to, ms";
  struct Case {
    std::string set;
    double SL, rate;
  };
  std::vector<Case> cases;
  for (const ParameterSet& set : model.parameter_sets)
    for (double SL : {1.7, 2.0, 2.3})
      for (double rate : {-20.0, 0.0, 20.0}) cases.push_back({std::string(set.name), SL, rate});
  double done = 0;
  for (const Case& c : cases) {
    const auto parameters = model.parameter_values(c.set);
    const auto stepper = make_force_stepper<double>(model, parameters);
    const std::string condition = fmt::format("{}, SL {} um, rate {} um/s", c.set, c.SL, c.rate);
    if (!stepper->holds_at(c.SL)) {
      study.rows.push_back(
          {"any", condition, {}, {}, {}, "refused: the model does not describe this length"});
      continue;
    }
    // The length stands still while the rate acts: how a staggered step sees a fast stretch.
    const auto run = [&](bool midpoint, double h_ms, std::vector<double>& tension) {
      std::vector<double> y = model.default_state();
      const double h = 1e-3 * h_ms;
      const long n = std::lround(0.2 / h);
      for (long k = 0; k < n; ++k) {
        const double calcium = static_cast<double>(k) * h < 0.1 - 1e-12 ? 10.0 : 0.1;
        ForcesOf<double> forces;
        const auto regulation = midpoint ? RegulationScheme::midpoint : RegulationScheme::forward_euler;
        if (!stepper->begin({regulation, 1, RateScheme::lagged}, h, y.data(), calcium, c.SL,
                            -c.rate / stepper->reference_length_um(), forces))
          return false;
        if (!probabilities_kept(model, y, 1e-10, 1e-12 * (1 + static_cast<double>(k)))) return false;
        tension.push_back(forces.tension_kPa);
      }
      return true;
    };
    std::vector<double> exact;
    run(true, 0.01, exact);
    double top = 1e-12;
    for (double T : exact) top = std::max(top, std::abs(T));
    for (bool midpoint : {true, false}) {
      StabilityRow row{midpoint ? "frozen-midpoint" : "forward-euler", condition, {}, {}, {}, {}};
      const std::vector<double> steps = {5, 2, 1, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01};
      for (double h : steps) {
        std::vector<double> T;
        if (!run(midpoint, h, T)) continue;
        if (!row.stable) row.stable = h;
        double error = 0;
        const auto stride = static_cast<std::size_t>(std::lround(h / 0.01));
        for (std::size_t k = 0; k < T.size(); ++k)
          error =
              std::max(error, std::abs(T[k] - exact[std::min((k + 1) * stride - 1, exact.size() - 1)]) / top);
        if (!row.roughly && error <= 0.05) row.roughly = h;
        if (!row.accurate && error <= 0.01) row.accurate = h;
        if (row.accurate) break;
      }
      study.rows.push_back(row);
    }
    progress.update(0.8 * ++done / static_cast<double>(cases.size()), condition);
  }
  std::mt19937 random(settings.seed);
  std::uniform_real_distribution<double> unit(0, 1);
  for (int k = 0; k < settings.draws; ++k) {
    const auto& set = model.parameter_sets[random() % model.parameter_sets.size()];
    const double calcium = std::pow(10.0, -3 + 6 * unit(random)), SL = 0.5 + 3.5 * unit(random);
    const double rate = 200 * unit(random) - 100, h = std::pow(10.0, -5 + 3 * unit(random));
    book_draw(study.draws,
              fmt::format("draw {}: {} Ca {:.3g} SL {:.3g} rate {:.3g} h {:.3g}", k, set.name, calcium, SL,
                          rate, h),
              [&] {
                const auto parameters = model.parameter_values(set.name);
                check_sarcomere_length(model, parameters, SL);
                PopulationSettings population;
                population.single_precision = random() % 2 == 0;
                CellPopulation cells(model, 3, population, parameters);
                cells.set_input("Ca", calcium);
                cells.set_input("SL", SL);
                cells.set_input("dSL/dt", rate);
                for (int step = 0; step < 20; ++step) cells.step(h);
                return probabilities_kept(model, cells.state_of(1),
                                          population.single_precision ? 1e-4 : 1e-10,
                                          population.single_precision ? 1e-4 : 1e-11);
              });
  }
  return study;
}

}  // namespace wiggers
