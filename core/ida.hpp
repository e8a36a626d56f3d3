// IDA (SUNDIALS), wrapped: variable-order BDF for differential-algebraic systems F(t, y, y') = 0, with
// consistent initial values and root finding. As in cvode.hpp, failures throw NumericalFailure in words.
#pragma once

#include <functional>
#include <memory>
#include <vector>

namespace wiggers {

struct DaeSystem {
  std::size_t size = 0;
  std::vector<bool> differential;  // false: algebraic, y' does not occur
  // residual(t, y, dy, r); dense Jacobian by difference quotients
  std::function<void(double, const double*, const double*, double*)> residual;
  // The integrator stops where one of n_roots values changes sign and starts afresh there.
  std::size_t n_roots = 0;
  std::function<void(double, const double*, double*)> roots;
};

class Ida {
 public:
  Ida(DaeSystem system, double relative, std::vector<double> absolute);
  ~Ida();
  Ida(const Ida&) = delete;
  Ida& operator=(const Ida&) = delete;

  // Starts afresh at t: the differential components of y are kept, the algebraic ones and y' are made
  // consistent. `ahead` is a time after t that says how long steps are.
  void restart(double t, const std::vector<double>& y, const std::vector<double>& dy, double ahead);
  // To t_out; nothing is evaluated beyond `limit`.
  const std::vector<double>& advance(double t_out, double limit);
  const std::vector<double>& derivatives() const;
  long steps() const;

 private:
  struct Implementation;
  std::unique_ptr<Implementation> implementation_;
};

}  // namespace wiggers
