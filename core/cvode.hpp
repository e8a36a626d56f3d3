// CVODE (SUNDIALS; linked is its superset CVODES, for sensitivities), wrapped: variable-order BDF with Newton
// and a dense Jacobian, every return code checked.
//
// Failures throw NumericalFailure with the time reached, the reason in words and what to try. The step limit
// of the library (500 internal steps a call) is lifted: it is a trap for long beats.
#pragma once

#include <functional>
#include <memory>
#include <string>
#include <vector>
#include <wiggers/core/adaptive.hpp>

namespace wiggers {

struct OdeSystem {
  std::size_t size = 0;
  // derivative(t, y, dy)
  std::function<void(double, const double*, double*)> derivative;
  // jacobian(t, y, J): J[row + size * column] = d(dy_row)/d(y_column); empty: difference quotients.
  std::function<void(double, const double*, double*)> jacobian;
  // roots(t, y, values): where one of n_roots values changes sign the right-hand side has a kink or a jump.
  // The integrator stops there, calls on_root(t, which, direction) and starts afresh.
  std::size_t n_roots = 0;
  std::function<void(double, const double*, double*)> roots;
  std::function<void(double, std::size_t, int)> on_root;
  // Forward sensitivities along n_directions: variation(t, y, S, dS) sets dS[k] = (df/dy) S[k] + df/dtheta_k.
  // Where the right-hand side is continuous but for a kink they need nothing at a root; a jump is the
  // caller's.
  std::size_t n_directions = 0;
  std::function<void(double, const double*, const double* const*, double* const*)> variation;
};

struct OdeTolerances {
  double relative = 1e-8;
  std::vector<double> absolute;  // one per component
};

class Cvode {
 public:
  Cvode(OdeSystem system, OdeTolerances tolerances);
  ~Cvode();
  Cvode(const Cvode&) = delete;
  Cvode& operator=(const Cvode&) = delete;

  // Starts afresh at (t, y): at the beginning, and after every jump of the right-hand side.
  void restart(double t, const std::vector<double>& y);

  // Advances to t_out and returns the state there. The right-hand side is never evaluated beyond `limit`:
  // where it jumps next. Outputs before the limit are interpolated, steps are not shortened for them.
  const std::vector<double>& advance(double t_out, double limit);
  const std::vector<double>& advance(double t_end) { return advance(t_end, t_end); }

  // Sensitivities where the next restart begins, [direction][component]; and at the time reached.
  void set_directions(const std::vector<std::vector<double>>& values);
  std::vector<std::vector<double>> directions();

  // Largest internal step (0: no limit).
  void set_largest_step(double h);

  AdaptiveCounts counts() const;

 private:
  struct Implementation;
  std::unique_ptr<Implementation> implementation_;
};

}  // namespace wiggers
