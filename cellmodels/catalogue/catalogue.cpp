#include <algorithm>
#include <cstring>
#include <string>
#include <type_traits>
#include <wiggers/cellmodels/catalogue/adaptive_integrators.hpp>
#include <wiggers/cellmodels/catalogue/catalogue.hpp>
#include <wiggers/cellmodels/models/force_models.hpp>
#include <wiggers/cellmodels/models/ionic_models.hpp>
#include <wiggers/cellmodels/schemes/branches.hpp>
#include <wiggers/cellmodels/schemes/jacobian.hpp>
#include <wiggers/cellmodels/schemes/rosenbrock.hpp>
#include <wiggers/cellmodels/schemes/voltage_table.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/fixed_step.hpp>

namespace wiggers {

namespace {

// Names do not depend on the model.
constexpr std::array<std::string_view, 6> fixed_names = {ForwardEuler<Rdq20, double>::name,
                                                         RushLarsen1<Rdq20, double>::name,
                                                         RushLarsen2<Rdq20, double>::name,
                                                         GeneralisedRushLarsen1<Rdq20, double>::name,
                                                         GeneralisedRushLarsen2<Rdq20, double>::name,
                                                         Bdf2Imex<Rdq20, double>::name};
constexpr std::array<std::string_view, 4> adaptive_names = {"cvode", Rosenbrock4<Rdq20>::name,
                                                            "odeint-dopri5", "odeint-rosenbrock4"};

template <class Model>
class EquationsOf final : public CellEquations {
 public:
  explicit EquationsOf(const std::vector<double>& parameters)
      : constants_(Model::constants(parameters.data())) {}
  void evaluate(const double* y, const double* in, double* rates, double* out) const override {
    const auto e = Model::template evaluate<double>(y, in, constants_);
    rates_from<Model, double>(e, y, rates);
    if (out)
      for (std::size_t i = 0; i < e.observable.size(); ++i) out[i] = e.observable[i];
  }
  void jacobian(const double* y, const double* in, double* result) const override {
    constexpr std::size_t n = Model::states.size();
    std::array<std::array<double, n>, n> rows;
    std::array<double, n> rates;
    rates_and_jacobian<Model>(y, in, constants_, rates.data(), rows.data());
    for (std::size_t column = 0; column < n; ++column)
      for (std::size_t row = 0; row < n; ++row) result[row + n * column] = rows[row][column];
  }
  void choose_interval(int interval) override { keep_to_interval<Model>(constants_, interval); }

 private:
  typename Model::template Constants<double> constants_;
};

template <class Model, template <class, class> class Integrator>
class StepperOf final : public CellStepper {
 public:
  explicit StepperOf(const std::vector<double>& parameters)
      : constants_(Model::constants(parameters.data())) {}
  void restart() override { integrator_.restart(); }
  void step(double h, double* y, const double* inputs) override {
    integrator_.step(h, y, inputs, constants_);
  }

 private:
  Integrator<Model, double> integrator_;
  typename Model::template Constants<double> constants_;
};

template <class Model>
class CellModelOf final : public CellModel {
 public:
  CellModelOf() {
    name = Model::name;
    title = Model::title;
    source = Model::source;
    time_unit = Model::time_unit;
    states = Model::states;
    parameters = Model::parameters;
    inputs = Model::inputs;
    observables = Model::observables;
    parameter_sets = Model::parameter_sets;
    is_gate = wiggers::is_gate<Model>;
    membrane_potential = potential_of<Model>;
    cytosolic_calcium = calcium_of<Model>;
    has_voltage_table = InParts<Model>;
    if constexpr (n_branches < Model >> 0) branch_potentials = Model::branch_potentials;
    if constexpr (IonicModel<Model>) default_stimulus = Model::default_stimulus;
    if (const int k = parameter(Role::strength); k >= 0) {
      strength_key = parameters[static_cast<std::size_t>(k)];
      key_ = std::string(strength_key.name) + "_" + std::string(strength_key.unit);
      strength_key.name = key_;
    }
    if constexpr (HasInvariants<Model>)
      invariants = Model::invariants;
    else
      no_invariants = Model::no_invariants;
  }

  void evaluate(const double* y, const double* in, const double* p, double* rates,
                double* out) const override {
    EquationsOf<Model>({p, p + Model::parameters.size()}).evaluate(y, in, rates, out);
  }
  void jacobian(const double* y, const double* in, const double* p, double* result) const override {
    EquationsOf<Model>({p, p + Model::parameters.size()}).jacobian(y, in, result);
  }
  std::unique_ptr<CellEquations> equations(const std::vector<double>& p) const override {
    return std::make_unique<EquationsOf<Model>>(p);
  }
  std::unique_ptr<AdaptiveIntegrator> rosenbrock(const std::vector<double>& p, double relative,
                                                 const std::vector<double>& absolute) const override {
    return std::make_unique<Rosenbrock4<Model>>(Model::constants(p.data()), relative, absolute);
  }

  std::unique_ptr<CellStepper> stepper(std::string_view integrator,
                                       const std::vector<double>& p) const override {
    if (integrator == fixed_names[0]) return std::make_unique<StepperOf<Model, ForwardEuler>>(p);
    if (integrator == fixed_names[1]) return std::make_unique<StepperOf<Model, RushLarsen1>>(p);
    if (integrator == fixed_names[2]) return std::make_unique<StepperOf<Model, RushLarsen2>>(p);
    if (integrator == fixed_names[3]) return std::make_unique<StepperOf<Model, GeneralisedRushLarsen1>>(p);
    if (integrator == fixed_names[4]) return std::make_unique<StepperOf<Model, GeneralisedRushLarsen2>>(p);
    if (integrator == fixed_names[5]) return std::make_unique<StepperOf<Model, Bdf2Imex>>(p);
    refuse_integrator(integrator);
  }

  std::vector<double> derived_constants(const double* p) const override {
    const auto constants = Model::constants(p);
    static_assert(std::is_trivially_copyable_v<decltype(constants)>);
    std::vector<double> values(sizeof(constants) / sizeof(double));
    std::memcpy(values.data(), &constants, sizeof(constants));
    return values;
  }
  std::vector<double> voltage_table_row(double V, double h, Decay decay, const double* p) const override {
    if constexpr (InParts<Model>) {
      const auto row = wiggers::voltage_table_row<Model, double>(V, h, decay, Model::constants(p));
      return {row.begin(), row.end()};
    }
    return {};
  }

  void normalise([[maybe_unused]] double* y) const override {
    if constexpr (requires { Model::normalise(y); }) Model::normalise(y);
  }
  bool keeps_invariants(const double* p) const override { return wiggers::keeps_invariants<Model>(p); }
  std::vector<double> invariant_values(const double* y, const double* p) const override {
    if constexpr (HasInvariants<Model>) {
      const auto values = Model::invariant_values(y, Model::constants(p));
      return {values.begin(), values.end()};
    }
    return {};
  }
  void hold_invariants(double* y, const double* p, const std::vector<double>& values) const override {
    if constexpr (HasInvariants<Model>)
      wiggers::hold_invariants<Model>(y, Model::constants(p), values.data());
  }

 private:
  std::string key_;
};

template <class Model>
const CellModelOf<Model> the_model;

// The ionic models in their order, then the force models.
const std::vector<const CellModel*>& all_models() {
  static const std::vector<const CellModel*> all = [] {
    std::vector<const CellModel*> list;
    IonicModels::each([&]<class Model>() { list.push_back(&the_model<Model>); });
    ForceModels::each([&]<class Model>() { list.push_back(&the_model<Model>); });
    return list;
  }();
  return all;
}

}  // namespace

std::span<const CellModel* const> catalogue() { return all_models(); }

const CellModel& find_model(std::string_view name) {
  std::vector<std::string> known;
  for (const CellModel* model : all_models()) {
    if (model->name == name) return *model;
    known.emplace_back(model->name);
  }
  refuse_unknown("cell model", name, known);
}

std::span<const std::string_view> fixed_step_integrators() { return fixed_names; }
std::span<const std::string_view> adaptive_integrators() { return adaptive_names; }
bool is_adaptive(std::string_view integrator) {
  return std::find(adaptive_names.begin(), adaptive_names.end(), integrator) != adaptive_names.end();
}
void refuse_integrator(std::string_view name) {
  std::vector<std::string> known(adaptive_names.begin(), adaptive_names.end());
  known.insert(known.end(), fixed_names.begin(), fixed_names.end());
  refuse_unknown("integrator", name, known);
}

std::vector<double> CellModel::absolute_tolerances(double of_size_one) const {
  std::vector<double> absolute;
  for (const Quantity& q : states) {
    const double size = q.unit == "mM" && q.default_value < 0.1 ? 1e-2 : q.unit == "mV" ? 10.0 : 1.0;
    absolute.push_back(of_size_one * size);
  }
  return absolute;
}

std::unique_ptr<AdaptiveIntegrator> CellModel::adaptive(std::string_view integrator,
                                                        const std::vector<double>& p, double relative,
                                                        double absolute) const {
  const std::vector<double> tolerances = absolute_tolerances(absolute);
  if (integrator == adaptive_names[0]) return make_cvode(*this, p, relative, tolerances);
  if (integrator == adaptive_names[1]) return rosenbrock(p, relative, tolerances);
  if (integrator == adaptive_names[2]) return make_odeint_dopri5(*this, p, relative, absolute);
  if (integrator == adaptive_names[3]) return make_odeint_rosenbrock4(*this, p, relative, absolute);
  refuse_integrator(integrator);
}

// FNV-1a of the model's name and the parameters' bytes.
std::uint32_t CellModel::fingerprint(const std::vector<double>& values) const {
  std::uint32_t hash = 2166136261u;
  const auto add = [&](const void* bytes, std::size_t count) {
    for (std::size_t i = 0; i < count; ++i)
      hash = (hash ^ static_cast<const unsigned char*>(bytes)[i]) * 16777619u;
  };
  add(name.data(), name.size());
  add(values.data(), values.size() * sizeof(double));
  return hash;
}

namespace {
int index_in(std::span<const Quantity> quantities, Role role) {
  for (std::size_t k = 0; k < quantities.size(); ++k)
    if (quantities[k].role == role) return static_cast<int>(k);
  return -1;
}
}  // namespace
int CellModel::parameter(Role role) const { return index_in(parameters, role); }
int CellModel::observable(Role role) const { return index_in(observables, role); }

int CellModel::charge_invariant() const {
  for (std::size_t k = 0; k < invariants.size(); ++k)
    if (invariants[k].is_charge) return static_cast<int>(k);
  return -1;
}

double CellModel::charge(const double* y, const double* p) const {
  const int k = charge_invariant();
  return k < 0 ? 0 : invariant_values(y, p)[static_cast<std::size_t>(k)];
}

std::vector<double> CellModel::default_state() const {
  std::vector<double> y;
  for (const Quantity& q : states) y.push_back(q.default_value);
  return y;
}

std::vector<double> CellModel::parameter_values(std::string_view set) const {
  std::vector<double> values;
  for (const Quantity& q : parameters) values.push_back(q.default_value);
  std::vector<std::string> known;
  for (const ParameterSet& candidate : parameter_sets) {
    if (candidate.name == set) {
      for (std::size_t k = 0; k < candidate.n_changes; ++k)
        values[require_index(parameters, "parameter", candidate.changes[k].name)] =
            candidate.changes[k].value;
      return values;
    }
    known.emplace_back(candidate.name);
  }
  refuse_unknown(std::string("parameter set of ") + std::string(name), set, known);
}

}  // namespace wiggers
