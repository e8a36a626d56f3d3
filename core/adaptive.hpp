// Integrators that choose their own steps, behind one interface.
#pragma once

#include <functional>
#include <span>

namespace wiggers {

struct AdaptiveCounts {
  long steps = 0;
  long rejected = 0;
  long evaluations = 0;
  long jacobians = 0;
  long factorisations = 0;
};

class AdaptiveIntegrator {
 public:
  virtual ~AdaptiveIntegrator() = default;
  // After a jump of the right-hand side or of the state.
  virtual void restart() = 0;
  // (index of the sample, state there)
  using OnSample = std::function<void(std::size_t, const double*)>;
  // Advances y over a span in which the inputs are constant. `samples` are ascending times inside the span,
  // from its beginning; on_sample gets the interpolated state: steps are never shortened for output. Throws
  // NumericalFailure with the time inside the span and the reason.
  virtual void advance(double span, double* y, const double* inputs, std::span<const double> samples = {},
                       const OnSample& on_sample = {}) = 0;
  virtual AdaptiveCounts counts() const = 0;
};

}  // namespace wiggers
