#include <wiggers/cellmodels/catalogue/adaptive_integrators.hpp>
#include <wiggers/cellmodels/catalogue/odeint_steppers.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/progress.hpp>

namespace wiggers {

namespace {

using Advance = std::string (*)(const OdeintProblem&, double, double*, double&, long&);

class OdeintCell final : public AdaptiveIntegrator {
 public:
  OdeintCell(const CellModel& model, const std::vector<double>& parameters, double relative, double absolute,
             Advance advance)
      : equations_(model.equations(parameters)), advance_(advance) {
    problem_.size = model.states.size();
    problem_.relative = relative;
    problem_.absolute = absolute;
    problem_.rates = [this](const double* y, double* dy) {
      if ((++counts_.evaluations & 63) == 0) check_interrupt();
      equations_->evaluate(y, inputs_, dy, nullptr);
    };
    problem_.jacobian = [this](const double* y, double* columns) {
      ++counts_.jacobians;
      equations_->jacobian(y, inputs_, columns);
    };
  }
  void restart() override { h_ = first_step; }
  AdaptiveCounts counts() const override { return counts_; }
  void advance(double span, double* y, const double* inputs, std::span<const double> samples,
               const OnSample& on_sample) override {
    inputs_ = inputs;
    problem_.samples = samples.data();
    problem_.n_samples = samples.size();
    problem_.on_sample = on_sample;
    const std::string failure = advance_(problem_, span, y, h_, counts_.steps);
    if (!failure.empty()) throw NumericalFailure(failure);
  }

 private:
  static constexpr double first_step = 1e-4;  // small beside every time constant; it grows at once
  std::unique_ptr<CellEquations> equations_;
  Advance advance_;
  OdeintProblem problem_;
  const double* inputs_ = nullptr;
  double h_ = first_step;
  AdaptiveCounts counts_;
};

}  // namespace

std::unique_ptr<AdaptiveIntegrator> make_odeint_dopri5(const CellModel& model,
                                                       const std::vector<double>& parameters, double relative,
                                                       double absolute) {
  return std::make_unique<OdeintCell>(model, parameters, relative, absolute, odeint_dopri5);
}
std::unique_ptr<AdaptiveIntegrator> make_odeint_rosenbrock4(const CellModel& model,
                                                            const std::vector<double>& parameters,
                                                            double relative, double absolute) {
  return std::make_unique<OdeintCell>(model, parameters, relative, absolute, odeint_rosenbrock4);
}

}  // namespace wiggers
