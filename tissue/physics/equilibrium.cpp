#include <fmt/format.h>

#include <Eigen/Dense>
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
  std::vector<std::optional<double>> wanted(pressures.size());
  wanted[surface] = volume_m3;
  const Eigen::MatrixXd compliance =
      reach_volumes(mechanics, wanted, pressures, settings, counted ? *counted : own);
  if (slope) *slope = 1 / compliance(0, 0);
  return pressures[surface];
}

Eigen::MatrixXd reach_volumes(Mechanics& mechanics, const std::vector<std::optional<double>>& volumes_m3,
                              std::vector<double>& pressures, const EquilibriumSettings& settings,
                              EquilibriumReport& report) {
  Newton newton(mechanics, settings, report);
  mechanics.set_step(0);
  std::vector<int> held;  // surfaces of prescribed volume
  for (std::size_t k = 0; k < volumes_m3.size(); ++k)
    if (volumes_m3[k]) held.push_back(static_cast<int>(k));
  const auto m = static_cast<Eigen::Index>(held.size());
  const std::vector<double> start = mechanics.assemble(pressures, false).volumes_m3;
  double s = 0, step = settings.first_step;
  double scale = newton.load_norm(pressures);  // of the forces: pressures themselves may go to zero
  std::vector<double> right, y;
  std::vector<std::vector<double>> Y(held.size());
  Eigen::MatrixXd compliance = Eigen::MatrixXd::Zero(m, m);
  while (s < 1) {
    const double next = std::min(1.0, s + step);
    const std::vector<double> good = mechanics.displacement(), good_pressures = pressures;
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
      Eigen::VectorXd mismatch(m);
      bool volumes_met = true;
      for (Eigen::Index k = 0; k < m; ++k) {
        const auto surface = static_cast<std::size_t>(held[static_cast<std::size_t>(k)]);
        const double wanted = start[surface] + next * (*volumes_m3[surface] - start[surface]);
        mismatch(k) = wanted - balance.volumes_m3[surface];
        volumes_met = volumes_met && std::abs(mismatch(k)) <= 1e-9 * std::abs(wanted);
      }
      const double tolerance =
          settings.relative_tolerance * std::max({first, scale, newton.load_norm(pressures)});
      newton.failure = fmt::format(
          "no equilibrium after {} Newton iterations: residual {:.3g} N, smallest J {:.3g} in {}", iteration,
          balance.residual, balance.smallest_J, mechanics.place_of_cell(balance.worst_cell));
      if (balance.residual <= tolerance && volumes_met) {
        converged = true;
        break;
      }
      newton.solver.matrix_changed();
      right = mechanics.residual();
      for (double& value : right) value = -value;
      bool solved = newton.solve(right, y);
      for (std::size_t k = 0; k < held.size() && solved; ++k)
        solved = newton.solve(mechanics.load(held[k]), Y[k]);
      if (!solved) break;
      ++report.newton_iterations;
      // dd = y - sum Y_k dp_k, and -b_j . dd = mismatch_j.
      for (Eigen::Index j = 0; j < m; ++j) {
        const auto& load = mechanics.load(held[static_cast<std::size_t>(j)]);
        mismatch(j) += mechanics.product(load, y);
        for (Eigen::Index k = 0; k < m; ++k)
          compliance(j, k) = mechanics.product(load, Y[static_cast<std::size_t>(k)]);
      }
      const Eigen::VectorXd dp = compliance.partialPivLu().solve(mismatch);
      for (std::size_t k = 0; k < held.size(); ++k)
        for (std::size_t i = 0; i < y.size(); ++i) y[i] -= Y[k][i] * dp(static_cast<Eigen::Index>(k));
      const std::vector<double> from = mechanics.displacement();
      double factor = 1;
      for (int halvings = 0; halvings <= most_halvings; ++halvings, factor *= 0.5) {
        newton.set(from, y, factor);
        if (mechanics.smallest_volume_ratio(mechanics.displacement()).first > 0) break;
      }
      for (std::size_t k = 0; k < held.size(); ++k)
        pressures[held[k]] += factor * dp(static_cast<Eigen::Index>(k));
    }
    if (converged) {
      s = next;
      scale = std::max(scale, newton.load_norm(pressures));
      if (iteration <= settings.easy_newton) step *= 2;
      continue;
    }
    mechanics.displacement() = good;
    pressures = good_pressures;
    step *= 0.5;
    if (step < settings.smallest_step)
      throw NumericalFailure(fmt::format("volume control: stopped at {:.1f} % of the change of volume: {}",
                                         100 * s, newton.failure));
  }
  return compliance;
}

}  // namespace wiggers
