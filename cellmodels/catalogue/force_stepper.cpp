#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <wiggers/cellmodels/catalogue/force_stepper.hpp>
#include <wiggers/cellmodels/models/force_models.hpp>
#include <wiggers/core/cvode.hpp>
#include <wiggers/core/errors.hpp>

namespace wiggers {

namespace {

template <class Model, class T>
class StepperFor final : public ForceStepperOf<T> {
 public:
  explicit StepperFor(const std::vector<T>& parameters) : constants_(Model::constants(parameters.data())) {
    this->reference_length_um_ = constants_.p[index_of(Model::parameters, Role::reference_length)];
  }
  bool begin(const ForceScheme& scheme, const T& h, T* y, const T& calcium, const T& length,
             const T& velocity_before, ForcesOf<T>& forces) override {
    if (!step_.begin(scheme, h, y, calcium, length, velocity_before, constants_)) return false;
    forces = {step_.tension_kPa, step_.stiffness_kPa};
    return true;
  }
  bool finish(const T& h, T* y, const T& velocity) override {
    return step_.finish(h, y, velocity, constants_);
  }
  ForcesOf<T> forces(const T* y, const T& length) const override {
    return {Model::tension(y, length, constants_), Model::stiffness(y, length, constants_)};
  }
  bool holds_at(const T& length) const override { return Model::holds_at(length, constants_.p); }
  std::string beyond(double length) const override {
    std::array<double, Model::parameters.size()> p;
    for (std::size_t k = 0; k < p.size(); ++k) p[k] = value_of(constants_.p[k]);
    return Model::beyond(length, p.data());
  }

 private:
  typename Model::template Constants<T> constants_;
  ForceStep<Model, T> step_;
};

// Calls work<Model>() for a force model; refuses any other.
template <class Work>
void with_force_model(const CellModel& model, Work work) {
  bool found = false;
  std::vector<std::string> known;
  ForceModels::each([&]<class Model>() {
    known.emplace_back(Model::name);
    if (model.name != Model::name) return;
    found = true;
    work.template operator()<Model>();
  });
  if (!found) refuse_unknown("force model", model.name, known);
}

// Gradients of the model's invariants, one a row.
template <class Model>
Eigen::MatrixXd invariant_gradients(const std::vector<double>& y, const std::vector<double>& parameters) {
  const auto n = static_cast<Eigen::Index>(y.size());
  if constexpr (HasInvariants<Model>) {
    using D = Dual<static_cast<int>(Model::states.size())>;
    std::vector<D> at;
    for (std::size_t i = 0; i < y.size(); ++i) at.push_back(D::variable(y[i], static_cast<int>(i)));
    const auto values = Model::invariant_values(at.data(), Model::constants(parameters.data()));
    Eigen::MatrixXd rows(static_cast<Eigen::Index>(values.size()), n);
    for (Eigen::Index k = 0; k < rows.rows(); ++k)
      for (Eigen::Index i = 0; i < n; ++i)
        rows(k, i) = values[static_cast<std::size_t>(k)].derivative[static_cast<std::size_t>(i)];
    return rows;
  }
  return Eigen::MatrixXd(0, n);
}

}  // namespace

template <class T>
std::unique_ptr<ForceStepperOf<T>> make_force_stepper(const CellModel& model,
                                                      const std::vector<T>& parameters) {
  std::unique_ptr<ForceStepperOf<T>> stepper;
  with_force_model(model,
                   [&]<class Model>() { stepper = std::make_unique<StepperFor<Model, T>>(parameters); });
  return stepper;
}
template std::unique_ptr<ForceStepperOf<double>> make_force_stepper(const CellModel&,
                                                                    const std::vector<double>&);
template std::unique_ptr<ForceStepperOf<Tangent>> make_force_stepper(const CellModel&,
                                                                     const std::vector<Tangent>&);

std::vector<const CellModel*> force_models() {
  std::vector<const CellModel*> list;
  for (const CellModel* model : catalogue())
    if (!model->is_ionic()) list.push_back(model);
  return list;
}

void check_sarcomere_length(const CellModel& model, const std::vector<double>& parameters, double length_um) {
  with_force_model(model, [&]<class Model>() {
    check_range(Model::inputs[Model::SL], length_um, "sarcomere length");
    if (!Model::holds_at(length_um, parameters.data()))
      throw InputError(fmt::format("{} at sarcomere length SL = {} um: {}", Model::name, length_um,
                                   Model::beyond(length_um, parameters.data())));
  });
}

std::vector<double> steady_force_state(const CellModel& model, const std::vector<double>& parameters,
                                       double calcium_uM, double length_um) {
  std::vector<double> y = model.default_state();
  with_force_model(model, [&]<class Model>() {
    check_range(Model::inputs[Model::Ca], calcium_uM, "calcium");
    if constexpr (requires { Model::spread(y.data()); }) Model::spread(y.data());
  });
  check_sarcomere_length(model, parameters, length_um);
  const double inputs[3] = {calcium_uM, length_um, 0};
  OdeSystem system;
  system.size = model.states.size();
  system.derivative = [&](double, const double* y, double* dy) {
    model.evaluate(y, inputs, parameters.data(), dy, nullptr);
  };
  system.jacobian = [&](double, const double* y, double* jacobian) {
    model.jacobian(y, inputs, parameters.data(), jacobian);
  };
  Cvode solver(system, {1e-10, std::vector<double>(system.size, 1e-14)});
  solver.restart(0, y);
  std::vector<double> rates(system.size);
  double residual = 0;
  // The slowest rate may be below 1/s; decades of seconds until nothing moves.
  for (double t = 1; t <= 1e6; t *= 10) {
    y = solver.advance(t);
    model.evaluate(y.data(), inputs, parameters.data(), rates.data(), nullptr);
    residual = 0;
    for (double rate : rates) residual = std::max(residual, std::abs(rate));
    if (residual < 1e-11) break;
  }
  if (residual > 1e-6) {
    // The rate of a state that is bound at once (calcium of millimolar) is the difference of two large
    // numbers: how far it is from rest counts, as its own rate constant tells.
    std::vector<double> jacobian(system.size * system.size);
    model.jacobian(y.data(), inputs, parameters.data(), jacobian.data());
    residual = 0;
    for (std::size_t i = 0; i < system.size; ++i)
      residual =
          std::max(residual, std::abs(rates[i]) / std::max(1.0, std::abs(jacobian[i + system.size * i])));
  }
  if (!(residual <= 1e-6))
    throw NumericalFailure(
        fmt::format("no steady state of {} at calcium {} uM, sarcomere length {} um: the largest rate is "
                    "still {:.2g} 1/s",
                    model.name, calcium_uM, length_um, residual));
  return y;
}

std::vector<Tangent> steady_force_state(const CellModel& model, const std::vector<Tangent>& parameters,
                                        const Tangent& calcium_uM, const Tangent& length_um) {
  std::vector<double> p;
  for (const Tangent& parameter : parameters) p.push_back(parameter.value);
  const std::vector<double> y = steady_force_state(model, p, calcium_uM.value, length_um.value);
  const auto n = static_cast<Eigen::Index>(y.size());
  // Rates with derivatives by the directions at a state that is held, and by the state.
  const std::vector<Tangent> held(y.begin(), y.end());
  const Tangent inputs[3] = {calcium_uM, length_um, 0.0};
  std::vector<Tangent> rates(y.size());
  Eigen::MatrixXd kept;
  with_force_model(model, [&]<class Model>() {
    rates_from<Model, Tangent>(
        Model::template evaluate<Tangent>(held.data(), inputs, Model::constants(parameters.data())),
        held.data(), rates.data());
    kept = invariant_gradients<Model>(y, p);
  });
  const double plain[3] = {calcium_uM.value, length_um.value, 0.0};
  Eigen::MatrixXd jacobian(n, n);
  model.jacobian(y.data(), plain, p.data(), jacobian.data());
  Eigen::MatrixXd system(n + kept.rows(), n), right(n + kept.rows(), tangent_lanes);
  system.topRows(n) = jacobian;
  // Invariants are kept; of what else is free the smallest change, which keeps the symmetry.
  system.bottomRows(kept.rows()) = kept * jacobian.cwiseAbs().maxCoeff();
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
