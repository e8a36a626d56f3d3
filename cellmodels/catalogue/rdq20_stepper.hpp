// One step of RDQ20 as heart and tissue take it: regulatory units by sub-stepped forward Euler at constant
// inputs, then the crossbridges exactly for frozen regulatory units.
//
// Forward Euler of the regulatory units is stable for sub-steps below about 2/lambda_max: 0.34 ms (human37),
// 0.156 ms (ventricles), 0.076 ms (atria); probabilities that leave [0, 1] are reported, never clamped.
#pragma once

#include <cmath>
#include <vector>
#include <wiggers/cellmodels/models/rdq20.hpp>
#include <wiggers/core/sensitivity.hpp>

namespace wiggers {

template <class T>
class Rdq20StepperOf {
 public:
  using Constants = Rdq20::Constants<T>;
  explicit Rdq20StepperOf(const std::vector<T>& parameters)
      : constants_(Rdq20::constants(parameters.data())) {}

  const Constants& constants() const { return constants_; }

  // Advances the probabilities y[0..15] over dt (s) in n_substeps; returns the rates the crossbridges need.
  Rdq20::Regulation<T> step_regulation(T* y, const T& calcium_uM, const T& sarcomere_length_um, const T& dt,
                                       int n_substeps) const {
    const T h = dt / static_cast<double>(n_substeps);
    for (int k = 0; k < n_substeps; ++k) {
      const auto ru = Rdq20::regulation(y, calcium_uM, sarcomere_length_um, constants_);
      for (int i = 0; i < Rdq20::n_probabilities; ++i) y[i] += h * ru.derivative[i];
    }
    return Rdq20::regulation(y, calcium_uM, sarcomere_length_um, constants_);
  }

  // Advances the moments y[16..19] exactly over dt (s) for frozen rates, shortening velocity -(dSL/dt)/SL0.
  void step_crossbridges(T* y, const Rdq20::Regulation<T>& ru, const T& shortening_velocity,
                         const T& dt) const {
    Rdq20::step_crossbridges(dt, y, ru, shortening_velocity, constants_);
  }

  // Active tension and stiffness (kPa) of a state at a sarcomere length.
  T tension_kPa(const T* y, const T& sarcomere_length_um) const {
    return scale(sarcomere_length_um) * (y[Rdq20::mu1_P] + y[Rdq20::mu1_N]);
  }
  T stiffness_kPa(const T* y, const T& sarcomere_length_um) const {
    return scale(sarcomere_length_um) * (y[Rdq20::mu0_P] + y[Rdq20::mu0_N]);
  }
  T scale(const T& sarcomere_length_um) const {
    return constants_.p[Rdq20::a_XB] * Rdq20::overlap(sarcomere_length_um, constants_.p);
  }

 private:
  Constants constants_;
};
using Rdq20Stepper = Rdq20StepperOf<double>;

// Steady state at constant calcium and length without sliding, by long integration in time (Newton on these
// equations can find spurious roots with negative probabilities). The residual is checked.
std::vector<double> rdq20_steady_state(const std::vector<double>& parameters, double calcium_uM,
                                       double sarcomere_length_um);

// The same with derivatives: of the equations' steady state, by the implicit function theorem.
std::vector<Tangent> rdq20_steady_state(const std::vector<Tangent>& parameters, const Tangent& calcium_uM,
                                        const Tangent& sarcomere_length_um);

// Refuses a sarcomere length at which the dissociation constant is not positive.
void check_sarcomere_length(const std::vector<double>& parameters, double sarcomere_length_um);

}  // namespace wiggers
