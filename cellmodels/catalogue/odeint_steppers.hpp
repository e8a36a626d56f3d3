// Boost.Odeint's steppers behind plain functions. Debian's uBLAS, which Odeint's Rosenbrock method stands on,
// does not compile as C++20; odeint_steppers.cpp is compiled as C++17 and includes none of our other headers.
#pragma once

#include <cstddef>
#include <functional>
#include <string>

namespace wiggers {

struct OdeintProblem {
  std::size_t size = 0;
  std::function<void(const double* y, double* dy)> rates;
  std::function<void(const double* y, double* columns)> jacobian;  // columns[row + size * column]
  double relative = 1e-6, absolute = 1e-8;
  const double* samples = nullptr;  // ascending times in [0, span]
  std::size_t n_samples = 0;
  std::function<void(std::size_t, const double*)> on_sample;
};

// Advances y over span; h is the step to begin with and becomes the next one; steps is increased. Returns an
// empty text, or why the integration stopped.
std::string odeint_dopri5(const OdeintProblem& problem, double span, double* y, double& h, long& steps);
std::string odeint_rosenbrock4(const OdeintProblem& problem, double span, double* y, double& h, long& steps);

}  // namespace wiggers
