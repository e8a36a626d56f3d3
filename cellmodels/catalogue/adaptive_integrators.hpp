// The adaptive integrators that are libraries: CVODE, and two of Boost.Odeint. CellModel::adaptive makes them
// by name.
#pragma once

#include <memory>
#include <vector>
#include <wiggers/cellmodels/catalogue/catalogue.hpp>
#include <wiggers/core/adaptive.hpp>

namespace wiggers {

// Variable-order BDF with Newton and the exact Jacobian; stops at the branch potential.
std::unique_ptr<AdaptiveIntegrator> make_cvode(const CellModel& model, const std::vector<double>& parameters,
                                               double relative, const std::vector<double>& absolute);

// Explicit Runge-Kutta 5(4) of Dormand and Prince: here to show stiffness, its step is set by stability.
std::unique_ptr<AdaptiveIntegrator> make_odeint_dopri5(const CellModel& model,
                                                       const std::vector<double>& parameters, double relative,
                                                       double absolute);

// Odeint's Rosenbrock 4(3) with the exact Jacobian. Odeint takes one absolute tolerance for all states.
std::unique_ptr<AdaptiveIntegrator> make_odeint_rosenbrock4(const CellModel& model,
                                                            const std::vector<double>& parameters,
                                                            double relative, double absolute);

}  // namespace wiggers
