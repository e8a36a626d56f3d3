#include <cstring>
#include <string>
#include <type_traits>
#include <wiggers/cellmodels/catalogue.hpp>
#include <wiggers/cellmodels/crn.hpp>
#include <wiggers/cellmodels/rdq20.hpp>
#include <wiggers/cellmodels/ttp06.hpp>
#include <wiggers/cellmodels/voltage_table.hpp>
#include <wiggers/core/dual.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/fixed_step.hpp>

namespace wiggers {

namespace {

constexpr std::array<std::string_view, 4> integrator_names = {
    ForwardEuler<Crn, double>::name, RushLarsen1<Crn, double>::name, RushLarsen2<Crn, double>::name,
    Bdf2Imex<Crn, double>::name};

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
constexpr bool is_ionic_model = requires {
  Model::membrane_potential;
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
    is_gate = Model::is_gate;
    if constexpr (is_ionic_model<Model>) {
      membrane_potential = Model::membrane_potential;
      cytosolic_calcium = Model::cytosolic_calcium;
      default_stimulus = Model::default_stimulus;
      invariant_meaning = Model::invariant_meaning;
    }
  }

  void evaluate(const double* y, const double* in, const double* p, double* rates,
                double* out) const override {
    const auto e = Model::template evaluate<double>(y, in, Model::constants(p));
    rates_from<Model, double>(e, y, rates);
    if (out)
      for (std::size_t i = 0; i < e.observable.size(); ++i) out[i] = e.observable[i];
  }

  void jacobian(const double* y, const double* in, const double* p, double* result) const override {
    constexpr int n = static_cast<int>(Model::states.size());
    using D = Dual<n>;
    std::array<D, Model::states.size()> yd, rates;
    std::array<D, Model::inputs.size()> ind;
    for (int i = 0; i < n; ++i) yd[i] = D::variable(y[i], i);
    for (std::size_t i = 0; i < ind.size(); ++i) ind[i] = D(in[i]);
    rates_from<Model, D>(Model::template evaluate<D>(yd.data(), ind.data(), Model::constants(p)), yd.data(),
                         rates.data());
    for (int column = 0; column < n; ++column)
      for (int row = 0; row < n; ++row) result[row + n * column] = rates[row].derivative[column];
  }

  std::unique_ptr<CellStepper> stepper(std::string_view integrator,
                                       const std::vector<double>& p) const override {
    if (integrator == integrator_names[0]) return std::make_unique<StepperOf<Model, ForwardEuler>>(p);
    if (integrator == integrator_names[1]) return std::make_unique<StepperOf<Model, RushLarsen1>>(p);
    if (integrator == integrator_names[2]) return std::make_unique<StepperOf<Model, RushLarsen2>>(p);
    if (integrator == integrator_names[3]) return std::make_unique<StepperOf<Model, Bdf2Imex>>(p);
    std::vector<std::string> known = {"cvode"};
    for (std::string_view present : integrator_names) known.emplace_back(present);
    refuse_unknown("integrator", integrator, known);
  }

  std::vector<double> derived_constants(const double* p) const override {
    const auto constants = Model::constants(p);
    static_assert(std::is_trivially_copyable_v<decltype(constants)>);
    std::vector<double> values(sizeof(constants) / sizeof(double));
    std::memcpy(values.data(), &constants, sizeof(constants));
    return values;
  }
  std::vector<double> voltage_table_row(double V, double h, const double* p) const override {
    if constexpr (is_ionic_model<Model>) {
      const auto row = wiggers::voltage_table_row<Model, double>(V, h, Model::constants(p));
      return {row.begin(), row.end()};
    }
    return {};
  }

  bool keeps_invariant(const double* p) const override {
    if constexpr (is_ionic_model<Model>) return Model::keeps_invariant(p);
    return false;
  }
  double invariant(const double* y, const double* p) const override {
    if constexpr (is_ionic_model<Model>) return Model::invariant(y, Model::constants(p));
    return 0;
  }
  void hold_invariant(double* y, const double* p, double value) const override {
    if constexpr (is_ionic_model<Model>) {
      const auto c = Model::constants(p);
      y[Model::balancing_ion] += (value - Model::invariant(y, c)) / Model::invariant_slope(c);
    }
  }
};

const CellModelOf<Crn> crn;
const CellModelOf<Ttp06<Ttp06Type::endo>> ttp06_endo;
const CellModelOf<Ttp06<Ttp06Type::mid>> ttp06_mid;
const CellModelOf<Ttp06<Ttp06Type::epi>> ttp06_epi;
const CellModelOf<Rdq20> rdq20;
const CellModel* const all_models[] = {&crn, &ttp06_endo, &ttp06_mid, &ttp06_epi, &rdq20};

}  // namespace

std::span<const CellModel* const> catalogue() { return all_models; }

const CellModel& find_model(std::string_view name) {
  std::vector<std::string> known;
  for (const CellModel* model : all_models) {
    if (model->name == name) return *model;
    known.emplace_back(model->name);
  }
  refuse_unknown("cell model", name, known);
}

std::span<const std::string_view> fixed_step_integrators() { return integrator_names; }

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
