#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <wiggers/cellmodels/catalogue/catalogue.hpp>
#include <wiggers/cellmodels/catalogue/rdq20_stepper.hpp>
#include <wiggers/core/cvode.hpp>
#include <wiggers/core/errors.hpp>

namespace wiggers {

void check_sarcomere_length(const std::vector<double>& p, double sarcomere_length_um) {
  check_range(Rdq20::inputs[Rdq20::SL], sarcomere_length_um, "sarcomere length");
  const double kd = Rdq20::dissociation_constant(sarcomere_length_um, p.data());
  if (kd > 0) return;
  const double bound = 2.15 - p[Rdq20::Kd0] / p[Rdq20::alphaKd];
  throw InputError(
      fmt::format("sarcomere length SL = {} um: the calcium dissociation constant Kd0 - alphaKd (2.15 - SL) "
                  "= {:.4g} uM is not "
                  "positive; with these parameters SL must stay {} {:.4g} um",
                  sarcomere_length_um, kd, p[Rdq20::alphaKd] < 0 ? "below" : "above", bound));
}

std::vector<double> rdq20_steady_state(const std::vector<double>& parameters, double calcium_uM,
                                       double sarcomere_length_um) {
  check_range(Rdq20::inputs[Rdq20::Ca], calcium_uM, "calcium");
  check_sarcomere_length(parameters, sarcomere_length_um);
  const CellModel& model = find_model(Rdq20::name);
  const double inputs[3] = {calcium_uM, sarcomere_length_um, 0};
  OdeSystem system;
  system.size = model.states.size();
  system.derivative = [&](double, const double* y, double* dy) {
    model.evaluate(y, inputs, parameters.data(), dy, nullptr);
  };
  system.jacobian = [&](double, const double* y, double* jacobian) {
    model.jacobian(y, inputs, parameters.data(), jacobian);
  };
  Cvode solver(system, {1e-10, std::vector<double>(system.size, 1e-14)});
  // From rest with a little probability everywhere: the closure's quotients stay well defined.
  std::vector<double> y(system.size, 0.0);
  for (int i = 0; i < Rdq20::n_probabilities; ++i) y[i] = 1e-6;
  y[0] = 1 - 15e-6;
  solver.restart(0, y);
  std::vector<double> rates(system.size);
  double residual = 0;
  // The slowest rate is of the order of Koff/mu; decades of seconds until nothing moves.
  for (double t = 1; t <= 1e6; t *= 10) {
    y = solver.advance(t);
    model.evaluate(y.data(), inputs, parameters.data(), rates.data(), nullptr);
    residual = 0;
    for (double rate : rates) residual = std::max(residual, std::abs(rate));
    if (residual < 1e-11) break;
  }
  if (residual > 1e-6)
    throw NumericalFailure(
        fmt::format("no steady state of {} at calcium {} uM, sarcomere length {} um: the largest rate is "
                    "still {:.2g} 1/s",
                    model.name, calcium_uM, sarcomere_length_um, residual));
  return y;
}

std::vector<Tangent> rdq20_steady_state(const std::vector<Tangent>& parameters, const Tangent& calcium_uM,
                                        const Tangent& sarcomere_length_um) {
  std::vector<double> p;
  for (const Tangent& parameter : parameters) p.push_back(parameter.value);
  const std::vector<double> y = rdq20_steady_state(p, calcium_uM.value, sarcomere_length_um.value);
  const CellModel& model = find_model(Rdq20::name);
  const auto n = static_cast<Eigen::Index>(y.size());
  // Rates with derivatives by the directions at a state that is held, and by the state.
  const std::vector<Tangent> held(y.begin(), y.end());
  const Tangent inputs[3] = {calcium_uM, sarcomere_length_um, 0.0};
  std::vector<Tangent> rates(y.size());
  rates_from<Rdq20, Tangent>(
      Rdq20::evaluate<Tangent>(held.data(), inputs, Rdq20::constants(parameters.data())), held.data(),
      rates.data());
  const double plain[3] = {calcium_uM.value, sarcomere_length_um.value, 0.0};
  Eigen::MatrixXd system(n + 1, n), right(n + 1, tangent_lanes);
  Eigen::MatrixXd jacobian(n, n);
  model.jacobian(y.data(), plain, p.data(), jacobian.data());
  system.topRows(n) = jacobian;
  // Probabilities keep their sum; of what else is free the smallest change, which keeps the symmetry.
  system.row(n).setZero();
  system.row(n).head(Rdq20::n_probabilities).setOnes();
  system.row(n) *= jacobian.cwiseAbs().maxCoeff();
  right.setZero();
  for (Eigen::Index i = 0; i < n; ++i)
    for (int k = 0; k < tangent_lanes; ++k) right(i, k) = -rates[static_cast<std::size_t>(i)].derivative[k];
  const Eigen::MatrixXd moves = system.completeOrthogonalDecomposition().solve(right);
  std::vector<Tangent> result(y.begin(), y.end());
  for (Eigen::Index i = 0; i < n; ++i)
    for (int k = 0; k < tangent_lanes; ++k) result[static_cast<std::size_t>(i)].derivative[k] = moves(i, k);
  return result;
}

}  // namespace wiggers
