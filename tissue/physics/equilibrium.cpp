#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/progress.hpp>
#include <wiggers/tissue/physics/equilibrium.hpp>

namespace wiggers {

namespace {

constexpr int most_halvings = 7;

struct Newton {
  Mechanics& mechanics;
  const EquilibriumSettings& settings;
  LinearSolver solver;
  EquilibriumReport& report;
  std::string failure;

  Newton(Mechanics& m, const EquilibriumSettings& s, EquilibriumReport& r)
      : mechanics(m), settings(s), solver(m.matrix(), s.solver), report(r) {}

  double load_norm(std::span<const double> pressures) const {
    double sum = 0;
    for (std::size_t k = 0; k < pressures.size(); ++k) {
      const auto& load = mechanics.load(static_cast<int>(k));
      sum += std::abs(pressures[k]) * std::sqrt(mechanics.product(load, load));
    }
    return sum;
  }

  bool solve(const std::vector<double>& right, std::vector<double>& x) {
    x.assign(right.size(), 0.0);
    const SolveReport linear = solver.solve(right.data(), x.data(), settings.linear_tolerance, 1e-300, 2000);
    report.linear_iterations += linear.iterations;
    if (!linear.converged) failure = "the linear solver failed: " + linear.reason;
    return linear.converged;
  }

  // d = from + factor * step on own nodes, ghosts brought up to date.
  void set(const std::vector<double>& from, const std::vector<double>& step, double factor) {
    auto& d = mechanics.displacement();
    d = from;
    for (std::size_t k = 0; k < step.size(); ++k) d[k] += factor * step[k];
    mechanics.partition().update_ghosts(mechanics.nodes(), d.data(), 3);
  }

  // To equilibrium at fixed pressures. False, with `failure` set, if it does not get there.
  bool to_balance(std::span<const double> pressures, int& iterations) {
    double first = -1;
    bool settled = false;
    std::vector<double> right, step;
    Balance balance = mechanics.assemble(pressures, false);
    for (iterations = 0; iterations < settings.max_newton; ++iterations) {
      if (mechanics.partition().any(interrupt_requested())) throw Interrupted("stopped on request");
      if (!balance.finite || !(balance.smallest_J > 0)) {
        failure = fmt::format("an element is turned inside out: J = {:.3g} in {}", balance.smallest_J,
                              mechanics.place_of_cell(balance.worst_cell));
        return false;
      }
      if (first < 0) first = balance.residual;
      report.smallest_J = balance.smallest_J;
      report.worst_cell = balance.worst_cell;
      report.volumes_m3 = balance.volumes_m3;
      report.residual = balance.residual;
      const double tolerance = settings.relative_tolerance * std::max(first, load_norm(pressures));
      if (balance.residual <= tolerance || settled) return true;
      mechanics.assemble(pressures, true);
      solver.matrix_changed();
      right = mechanics.residual();
      for (double& value : right) value = -value;
      if (!solve(right, step)) return false;
      ++report.newton_iterations;
      const double work = std::abs(mechanics.product(mechanics.residual(), step));
      // Small loads on stiff tissue: round-off hides the residual's last digits, the step still shows them.
      // At rest there is no displacement to compare it with: 1e-14 m is nothing.
      settled =
          mechanics.product(step, step) <=
          std::max(1e-28, 1e-18 * mechanics.product(mechanics.displacement(), mechanics.displacement()));
      const std::vector<double> from = mechanics.displacement();
      double factor = 1;
      int halvings = 0;
      for (;; ++halvings, factor *= 0.5) {
        set(from, step, factor);
        const Balance trial = mechanics.assemble(pressures, false);
        // The work of the residual along the step must fall. Its norm alone would be a bad judge: bending of
        // nearly incompressible tissue has to go through states with more residual.
        const bool good = trial.finite && trial.smallest_J > 0 &&
                          (trial.residual <= (1 - 1e-4 * factor) * balance.residual ||
                           std::abs(mechanics.product(mechanics.residual(), step)) <= 0.8 * work ||
                           trial.residual <= tolerance);
        if (good) {
          balance = trial;
          break;
        }
        if (halvings == most_halvings) {
          failure =
              fmt::format("the residual does not fall below {:.3g} N; smallest J {:.3g} in {}",
                          balance.residual, trial.smallest_J, mechanics.place_of_cell(trial.worst_cell));
          return false;
        }
      }
    }
    failure = fmt::format(
        "no equilibrium after {} Newton iterations: residual {:.3g} N, smallest J {:.3g} in {}", iterations,
        balance.residual, balance.smallest_J, mechanics.place_of_cell(balance.worst_cell));
    return false;
  }
};

}  // namespace

EquilibriumSettings static_settings(const NodeSpace& space) {
  EquilibriumSettings settings;
  settings.solver = 3L * space.n_global <= 60000 ? SolverKind::direct : SolverKind::gmres_gamg;
  return settings;
}

EquilibriumReport find_equilibrium(Mechanics& mechanics, const LoadPath& loads,
                                   const EquilibriumSettings& settings, const TensionPath& tension,
                                   const std::function<void(double)>& on_step) {
  EquilibriumReport report;
  Newton newton(mechanics, settings, report);
  mechanics.set_step(0);
  double s = 0, step = settings.first_step, last_step = 0;
  std::vector<double> good = mechanics.displacement(), before = good;
  while (s < 1) {
    const double next = std::min(1.0, s + step);
    if (tension) mechanics.set_tension(tension(next));
    if (settings.secant_predictor && last_step > 0) {
      auto& d = mechanics.displacement();
      for (std::size_t k = 0; k < d.size(); ++k)
        d[k] = good[k] + (next - s) / last_step * (good[k] - before[k]);
      if (!(mechanics.smallest_volume_ratio(d).first > 0)) d = good;
    }
    int iterations = 0;
    if (newton.to_balance(loads(next), iterations)) {
      before = good;
      good = mechanics.displacement();
      last_step = next - s;
      s = next;
      ++report.load_steps;
      if (on_step) on_step(s);
      if (iterations <= settings.easy_newton) step *= 2;
    } else {
      mechanics.displacement() = good;
      ++report.failed_steps;
      step *= 0.5;
      if (step < settings.smallest_step)
        throw NumericalFailure(
            fmt::format("static equilibrium: stopped at {:.1f} % of the load, the step is below {:.1e} of "
                        "it: {}. Try a finer or "
                        "better mesh there, a smaller load, or a stiffer material",
                        100 * s, settings.smallest_step, newton.failure));
    }
  }
  return report;
}

double inflate_to_volume(Mechanics& mechanics, int surface, double volume_m3, std::vector<double> pressures,
                         const EquilibriumSettings& settings, double* slope, EquilibriumReport* counted) {
  EquilibriumReport own;
  EquilibriumReport& report = counted ? *counted : own;
  Newton newton(mechanics, settings, report);
  mechanics.set_step(0);
  const double start = mechanics.assemble(pressures, false).volumes_m3[surface];
  double s = 0, step = settings.first_step;
  double scale = newton.load_norm(pressures);  // of the forces: the pressure itself may go to zero
  std::vector<double> right, y, Y;
  while (s < 1) {
    const double next = std::min(1.0, s + step);
    const double wanted = start + next * (volume_m3 - start);
    const std::vector<double> good = mechanics.displacement();
    const double good_pressure = pressures[surface];
    bool converged = false;
    int iteration = 0;
    double first = -1;
    for (; iteration < settings.max_newton; ++iteration) {
      if (mechanics.partition().any(interrupt_requested())) throw Interrupted("stopped on request");
      const Balance balance = mechanics.assemble(pressures, true);
      if (!balance.finite || !(balance.smallest_J > 0)) {
        newton.failure = fmt::format("an element is turned inside out: J = {:.3g} in {}", balance.smallest_J,
                                     mechanics.place_of_cell(balance.worst_cell));
        break;
      }
      if (first < 0) first = balance.residual;
      const double mismatch = wanted - balance.volumes_m3[surface];
      const double tolerance =
          settings.relative_tolerance * std::max({first, scale, newton.load_norm(pressures)});
      newton.failure = fmt::format(
          "no equilibrium after {} Newton iterations: residual {:.3g} N, smallest J {:.3g} in {}", iteration,
          balance.residual, balance.smallest_J, mechanics.place_of_cell(balance.worst_cell));
      if (balance.residual <= tolerance && std::abs(mismatch) <= 1e-9 * std::abs(wanted)) {
        converged = true;
        break;
      }
      newton.solver.matrix_changed();
      right = mechanics.residual();
      for (double& value : right) value = -value;
      if (!newton.solve(right, y) || !newton.solve(mechanics.load(surface), Y)) break;
      ++report.newton_iterations;
      // dd = y - Y dp, and -b.dd = mismatch.
      const double compliance = mechanics.product(mechanics.load(surface), Y);
      const double dp = (mismatch + mechanics.product(mechanics.load(surface), y)) / compliance;
      if (slope) *slope = 1 / compliance;
      for (std::size_t k = 0; k < y.size(); ++k) y[k] -= Y[k] * dp;
      const std::vector<double> from = mechanics.displacement();
      double factor = 1;
      for (int halvings = 0; halvings <= most_halvings; ++halvings, factor *= 0.5) {
        newton.set(from, y, factor);
        if (mechanics.smallest_volume_ratio(mechanics.displacement()).first > 0) break;
      }
      pressures[surface] += factor * dp;
    }
    if (converged) {
      s = next;
      scale = std::max(scale, newton.load_norm(pressures));
      if (iteration <= settings.easy_newton) step *= 2;
      continue;
    }
    mechanics.displacement() = good;
    pressures[surface] = good_pressure;
    step *= 0.5;
    if (step < settings.smallest_step)
      throw NumericalFailure(fmt::format("volume control: stopped at {:.1f} % of the change of volume: {}",
                                         100 * s, newton.failure));
  }
  return pressures[surface];
}

void reach_volumes(Mechanics& mechanics, const std::vector<std::optional<double>>& volumes_m3,
                   std::vector<double>& pressures, const EquilibriumSettings& settings,
                   EquilibriumReport& report) {
  constexpr int most_rounds = 30;
  constexpr double good_enough_m3 = 1e-11;  // 1e-5 mL
  for (int round = 0;; ++round) {
    const std::vector<double> now = mechanics.assemble(pressures, false).volumes_m3;
    double worst = 0;
    for (std::size_t k = 0; k < volumes_m3.size(); ++k)
      if (volumes_m3[k]) worst = std::max(worst, std::abs(now[k] - *volumes_m3[k]));
    // Volumes alone say nothing of the balance: once round at least.
    if (round > 0 && worst <= good_enough_m3) return;
    if (round == most_rounds)
      throw NumericalFailure(fmt::format(
          "the cavities do not reach their volumes together, {:.2g} mL are missing", 1e6 * worst));
    for (std::size_t k = 0; k < volumes_m3.size(); ++k)
      if (volumes_m3[k])
        pressures[k] = inflate_to_volume(mechanics, static_cast<int>(k), *volumes_m3[k], pressures, settings,
                                         nullptr, &report);
  }
}

}  // namespace wiggers
