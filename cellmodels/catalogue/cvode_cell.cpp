#include <algorithm>
#include <wiggers/cellmodels/catalogue/adaptive_integrators.hpp>
#include <wiggers/core/cvode.hpp>

namespace wiggers {

namespace {

class CvodeCell final : public AdaptiveIntegrator {
 public:
  CvodeCell(const CellModel& model, const std::vector<double>& parameters, double relative,
            const std::vector<double>& absolute)
      : n_(model.states.size()),
        potential_(model.membrane_potential),
        branches_(model.branch_potentials),
        equations_(model.equations(parameters)),
        solver_(system(), {relative, absolute}) {}

  void restart() override { fresh_ = true; }

  void advance(double span, double* y, const double* inputs, std::span<const double> samples,
               const OnSample& on_sample) override {
    inputs_ = inputs;
    if (fresh_) {
      t_ = 0;
      equations_->choose_interval(static_cast<int>(
          std::ranges::count_if(branches_, [&](double branch) { return y[potential_] >= branch; })));
      solver_.restart(t_, std::vector<double>(y, y + n_));
      fresh_ = false;
    }
    const double end = t_ + span;
    for (std::size_t k = 0; k < samples.size(); ++k)
      on_sample(k, solver_.advance(samples[k] >= span ? end : t_ + samples[k], end).data());
    const std::vector<double>& state = solver_.advance(end);
    std::copy(state.begin(), state.end(), y);
    t_ = end;
  }

  AdaptiveCounts counts() const override { return solver_.counts(); }

 private:
  OdeSystem system() {
    OdeSystem s;
    s.size = n_;
    s.derivative = [this](double, const double* y, double* dy) {
      equations_->evaluate(y, inputs_, dy, nullptr);
    };
    s.jacobian = [this](double, const double* y, double* j) { equations_->jacobian(y, inputs_, j); };
    if (!branches_.empty()) {
      s.n_roots = branches_.size();
      s.roots = [this](double, const double* y, double* value) {
        for (std::size_t k = 0; k < branches_.size(); ++k) value[k] = y[potential_] - branches_[k];
      };
      s.on_root = [this](double, std::size_t which, int direction) {
        equations_->choose_interval(static_cast<int>(which) + (direction > 0 ? 1 : 0));
      };
    }
    return s;
  }

  std::size_t n_;
  int potential_;
  std::span<const double> branches_;
  std::unique_ptr<CellEquations> equations_;
  const double* inputs_ = nullptr;
  Cvode solver_;
  double t_ = 0;
  bool fresh_ = true;
};

}  // namespace

std::unique_ptr<AdaptiveIntegrator> make_cvode(const CellModel& model, const std::vector<double>& parameters,
                                               double relative, const std::vector<double>& absolute) {
  return std::make_unique<CvodeCell>(model, parameters, relative, absolute);
}

}  // namespace wiggers
