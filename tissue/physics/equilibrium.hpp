// Static equilibria: Newton with backtracking inside an adaptive continuation of the load.
//
// The load is ramped by s from 0 to 1: step 0.1 at first, doubled after an easy solve, halved after a failed
// one (an inverted element, a residual that does not fall); the first guess is the secant through the last
// two equilibria. A step is halved back until every volume ratio is positive and the residual, or its work
// along the step, has fallen.
#pragma once

#include <Eigen/Core>
#include <functional>
#include <optional>
#include <span>
#include <string>
#include <vector>
#include <wiggers/tissue/physics/mechanics.hpp>

namespace wiggers {

struct EquilibriumSettings {
  SolverKind solver = SolverKind::direct;
  double relative_tolerance = 1e-8;  // of the residual, to the norm of the applied loads
  double linear_tolerance = 1e-4;    // linear systems: residual over right-hand side
  int max_newton = 25;
  int easy_newton = 4;  // doubles the load step
  double first_step = 0.1, smallest_step = 1e-3;
  bool secant_predictor = true;
};

// Direct up to 60 000 unknowns, where its memory and time stop being modest, multigrid above.
EquilibriumSettings static_settings(const NodeSpace& space);

struct EquilibriumReport {
  int load_steps = 0, failed_steps = 0, newton_iterations = 0, linear_iterations = 0;
  double smallest_J = 0;
  int worst_cell = -1;
  std::vector<double> volumes_m3;
  double residual = 0;
};

// Pressures (Pa) of all surfaces at the share s of the load.
using LoadPath = std::function<std::vector<double>(double s)>;
using TensionPath = std::function<std::vector<CellTension>(double s)>;

// Brings the mechanics to equilibrium from its present displacement, which must be an equilibrium at s = 0
// (or near one). Throws NumericalFailure, with the load reached and the worst element, when the smallest step
// fails; the displacement is then the last equilibrium found. `on_step(s)` after each load step.
EquilibriumReport find_equilibrium(Mechanics& mechanics, const LoadPath& loads,
                                   const EquilibriumSettings& settings = {}, const TensionPath& tension = {},
                                   const std::function<void(double)>& on_step = {});

// The same with the volume of one surface prescribed, from its present one to `volume_m3`: its pressure
// follows (Schur complement, one more solve). Returns the pressure; `slope` (optional) gets dp/dV, whose sign
// tells stability.
double inflate_to_volume(Mechanics& mechanics, int surface, double volume_m3,
                         std::vector<double> pressures_Pa, const EquilibriumSettings& settings = {},
                         double* slope = nullptr, EquilibriumReport* report = nullptr);

// Several surfaces to their volumes (m3) at once, those without one at their pressure: Newton with the
// pressures as multipliers, in a continuation of the volumes. `pressures_Pa` follow; the work is added to the
// report. Returns dV/dp of the surfaces with a volume, in their order.
Eigen::MatrixXd reach_volumes(Mechanics& mechanics, const std::vector<std::optional<double>>& volumes_m3,
                              std::vector<double>& pressures_Pa, const EquilibriumSettings& settings,
                              EquilibriumReport& report);

}  // namespace wiggers
