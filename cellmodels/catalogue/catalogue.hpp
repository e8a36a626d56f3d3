// The cell models, by name, behind one interface. A new model is one header and one line in catalogue.cpp.
//
// CellModel is for tools (command line, CVODE, tests, Python): one cell, plain arrays, a virtual call per
// evaluation. Code that steps many cells uses the model templates and CellPopulation (population.hpp).
#pragma once

#include <cstdint>
#include <limits>
#include <memory>
#include <span>
#include <string_view>
#include <vector>
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
  // Rates of one side of the branch potential only, until told otherwise (see CellModel::branch_potential).
  virtual void choose_side(bool below) = 0;
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
  double branch_potential = std::numeric_limits<double>::quiet_NaN();  // where rates jump, mV; NaN: nowhere
  StimulusPulse default_stimulus;
  std::string_view invariant_meaning;  // empty: none

  bool is_ionic() const { return membrane_potential >= 0; }

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

  // What the model derives from its parameters once, as plain numbers; and one row of its table of functions
  // of V for steps of h (voltage_table.hpp; empty for models without a membrane).
  virtual std::vector<double> derived_constants(const double* parameters) const = 0;
  virtual std::vector<double> voltage_table_row(double V, double h, Decay decay,
                                                const double* parameters) const = 0;

  // The conserved quantity (charge of an ionic model). Whether it is conserved depends on the parameters.
  virtual bool keeps_invariant(const double* parameters) const = 0;
  virtual double invariant(const double* y, const double* parameters) const = 0;
  // Moves the balancing ion so that the invariant has the given value.
  virtual void hold_invariant(double* y, const double* parameters, double value) const = 0;

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
