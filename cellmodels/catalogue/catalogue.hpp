// The cell models, by name, behind one interface. How to add one: models/ionic_model.hpp.
//
// CellModel is for tools (command line, CVODE, tests, Python): one cell, plain arrays, a virtual call per
// evaluation. Code that steps many cells uses the model templates and CellPopulation (population.hpp).
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <string_view>
#include <vector>
#include <wiggers/cellmodels/models/invariant.hpp>
#include <wiggers/cellmodels/models/stimulus.hpp>
#include <wiggers/cellmodels/schemes/voltage_table.hpp>
#include <wiggers/core/adaptive.hpp>
#include <wiggers/core/quantity.hpp>

namespace wiggers {

// A fixed-step integrator bound to a model and its parameters.
class CellStepper {
 public:
  virtual ~CellStepper() = default;
  virtual void restart() = 0;  // after a jump of the inputs
  virtual void step(double h, double* y, const double* inputs) = 0;
};

// A model's equations bound to parameters: what is derived from them is computed once.
class CellEquations {
 public:
  virtual ~CellEquations() = default;
  // rates[i] = dy_i/dt per time_unit; observables may be null.
  virtual void evaluate(const double* y, const double* inputs, double* rates, double* observables) const = 0;
  // Exact: jacobian[row + n * column] = d(rate_row)/d(y_column).
  virtual void jacobian(const double* y, const double* inputs, double* jacobian) const = 0;
  // Rates of one interval between branch potentials only (0: below the first), until told otherwise.
  virtual void choose_interval(int interval) = 0;
};

class CellModel {
 public:
  virtual ~CellModel() = default;

  std::string_view name, title, source, time_unit;
  std::span<const Quantity> states, parameters, inputs, observables;
  std::span<const ParameterSet> parameter_sets;
  std::span<const bool> is_gate;
  int membrane_potential = -1;  // index of the state with this role, -1 if the model has none
  int cytosolic_calcium = -1;
  std::span<const double> branch_potentials;  // where rates jump, mV, ascending
  bool has_voltage_table = false;             // functions of V that tables can stand in for
  StimulusPulse default_stimulus;
  std::span<const Invariant> invariants;
  std::string_view no_invariants;  // why there are none

  bool is_ionic() const { return membrane_potential >= 0; }
  bool has_calcium() const { return cytosolic_calcium >= 0; }
  int charge_invariant() const;  // index of the membrane charge among the invariants, -1: none

  // rates[i] = dy_i/dt per time_unit; observables may be null.
  virtual void evaluate(const double* y, const double* inputs, const double* parameters, double* rates,
                        double* observables) const = 0;
  // Exact Jacobian: jacobian[row + n * column] = d(rate_row)/d(y_column).
  virtual void jacobian(const double* y, const double* inputs, const double* parameters,
                        double* jacobian) const = 0;
  virtual std::unique_ptr<CellEquations> equations(const std::vector<double>& parameters) const = 0;
  // Refuses an unknown name with the nearest.
  virtual std::unique_ptr<CellStepper> stepper(std::string_view integrator,
                                               const std::vector<double>& parameters) const = 0;
  // Integrators that choose their steps (adaptive_integrators()); `absolute` is for a state of size one, see
  // absolute_tolerances.
  std::unique_ptr<AdaptiveIntegrator> adaptive(std::string_view integrator,
                                               const std::vector<double>& parameters, double relative,
                                               double absolute) const;
  // Per state: small concentrations get 1 % of it, the membrane potential ten times.
  std::vector<double> absolute_tolerances(double of_size_one) const;

  // Of a force model: its strength as a key of a wall ("a_XB_kPa").
  Quantity strength_key;

  // Index of the parameter or observable with a role; -1: none.
  int parameter(Role role) const;
  int observable(Role role) const;

  // What the model derives from its parameters once, as plain numbers; and one row of its table of functions
  // of V for steps of h (voltage_table.hpp; empty for models without has_voltage_table).
  virtual std::vector<double> derived_constants(const double* parameters) const = 0;
  virtual std::vector<double> voltage_table_row(double V, double h, Decay decay,
                                                const double* parameters) const = 0;

  // Takes out what schemes let drift, where a model says how.
  virtual void normalise(double* y) const = 0;

  // What the equations keep. Whether they do depends on the parameters; a model without invariants keeps all.
  virtual bool keeps_invariants(const double* parameters) const = 0;
  virtual std::vector<double> invariant_values(const double* y, const double* parameters) const = 0;
  // Moves the balancing states so that the invariants have the given values.
  virtual void hold_invariants(double* y, const double* parameters,
                               const std::vector<double>& values) const = 0;
  // The membrane charge among them (mV); 0 if the model has none.
  double charge(const double* y, const double* parameters) const;

  std::vector<double> default_state() const;
  // A number that tells parameter sets apart: saved with states, and compared when they are read.
  std::uint32_t fingerprint(const std::vector<double>& parameters) const;

 protected:
  virtual std::unique_ptr<AdaptiveIntegrator> rosenbrock(const std::vector<double>& parameters,
                                                         double relative,
                                                         const std::vector<double>& absolute) const = 0;

 public:
  // The values of a named set; refuses an unknown name with the nearest.
  std::vector<double> parameter_values(std::string_view set) const;
};

std::span<const CellModel* const> catalogue();
const CellModel& find_model(std::string_view name);  // refuses an unknown name with the nearest

// Names of the integrators every model works with.
std::span<const std::string_view> fixed_step_integrators();
std::span<const std::string_view> adaptive_integrators();
bool is_adaptive(std::string_view integrator);
[[noreturn]] void refuse_integrator(std::string_view name);

}  // namespace wiggers
