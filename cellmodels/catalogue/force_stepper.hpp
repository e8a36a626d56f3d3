// A force model, chosen by name, as a wall steps it: numbers are plain, or dual to carry sensitivities. Many
// of them at once are a CellPopulation (force_step).
#pragma once

#include <memory>
#include <string>
#include <vector>
#include <wiggers/cellmodels/catalogue/catalogue.hpp>
#include <wiggers/cellmodels/schemes/force_step.hpp>
#include <wiggers/core/sensitivity.hpp>

namespace wiggers {

template <class T>
struct ForcesOf {
  T tension_kPa = 0, stiffness_kPa = 0;
};

template <class T>
class ForceStepperOf {
 public:
  virtual ~ForceStepperOf() = default;
  // See ForceStep: velocities are -(dSL/dt)/SL0, 1/s. False where the model cannot be stepped so far.
  virtual bool begin(const ForceScheme& scheme, const T& h_s, T* y, const T& calcium_uM, const T& length_um,
                     const T& velocity_before, ForcesOf<T>& forces) = 0;
  virtual bool finish(const T& h_s, T* y, const T& velocity) = 0;
  // At a state and length, kPa.
  virtual ForcesOf<T> forces(const T* y, const T& length_um) const = 0;
  virtual bool holds_at(const T& length_um) const = 0;
  virtual std::string beyond(double length_um) const = 0;  // why it does not
  const T& reference_length_um() const { return reference_length_um_; }

 protected:
  T reference_length_um_ = 0;
};

// Refuses a model that is no force model, naming those that are.
template <class T>
std::unique_ptr<ForceStepperOf<T>> make_force_stepper(const CellModel& model,
                                                      const std::vector<T>& parameters);
using ForceStepper = ForceStepperOf<double>;

// Steady state at constant calcium and length without sliding, by long integration in time (Newton on these
// equations can find spurious roots with negative probabilities). The residual is checked.
std::vector<double> steady_force_state(const CellModel& model, const std::vector<double>& parameters,
                                       double calcium_uM, double length_um);
// The same with derivatives: of the equations' steady state, by the implicit function theorem.
std::vector<Tangent> steady_force_state(const CellModel& model, const std::vector<Tangent>& parameters,
                                        const Tangent& calcium_uM, const Tangent& length_um);

// Refuses a sarcomere length that a model with these parameters does not describe.
void check_sarcomere_length(const CellModel& model, const std::vector<double>& parameters, double length_um);

// The force models of the catalogue; the first is the default.
std::vector<const CellModel*> force_models();

}  // namespace wiggers
