#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <wiggers/circulation/elastance.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/units.hpp>
#include <wiggers/heart/cell_source.hpp>

namespace wiggers {

IonicCellSource::IonicCellSource(const CellModel& model, std::vector<double> parameters,
                                 std::vector<double> state_at_onset, Pacing pacing,
                                 CalciumRescaling rescaling)
    : model_(model),
      parameters_(std::move(parameters)),
      state_(std::move(state_at_onset)),
      pacing_(std::move(pacing)),
      rescaling_(rescaling),
      stepper_(model.stepper(pacing_.integrator, parameters_)) {
  charge_ = model_.invariant(state_.data(), parameters_.data());
  // The beat begins `activation` before the stimulus, so the cell is then late in its own cycle.
  const double phase = wrapped(-pacing_.activation_ms, pacing_.period_ms);
  advance_local(0, phase);
}

void IonicCellSource::advance(double t, double dt) {
  // A multistep scheme starts afresh with each beat: a resumed run then repeats an undisturbed one bit for
  // bit.
  if (t == 0) stepper_->restart();
  const double from = wrapped(t * units::ms_per_s - pacing_.activation_ms, pacing_.period_ms);
  const double to = from + dt * units::ms_per_s;
  // Within rounding of the end of the cycle counts as the end.
  if (to < pacing_.period_ms - 1e-9) {
    advance_local(from > pacing_.period_ms - 1e-9 ? 0 : from, to);
    return;
  }
  if (from < pacing_.period_ms - 1e-9) advance_local(from, pacing_.period_ms);
  if (model_.keeps_invariant(parameters_.data()))
    model_.hold_invariant(state_.data(), parameters_.data(), charge_);
  if (to > pacing_.period_ms + 1e-9) advance_local(0, to - pacing_.period_ms);
}

void IonicCellSource::advance_local(double from, double to) {
  const double off = pacing_.stimulus.duration_ms;
  double t = from;
  while (t < to - 1e-12) {
    const bool stimulated = t < off - 1e-9;
    const double stop = stimulated ? std::min(off, to) : to;
    const double current[1] = {stimulated ? pacing_.stimulus.amplitude_A_per_F : 0.0};
    if (t <= 1e-9 || std::abs(t - off) < 1e-9) stepper_->restart();
    const auto n = static_cast<long>(std::ceil((stop - t) / pacing_.substep_ms - 1e-9));
    const double h = (stop - t) / static_cast<double>(n);
    for (long k = 0; k < n; ++k) stepper_->step(h, state_.data(), current);
    t = stop;
  }
  const double V = state_[model_.membrane_potential];
  if (!(V > -150 && V < 150))
    throw NumericalFailure(
        fmt::format("{}: membrane potential {} mV left its physical range {:.4g} ms after the stimulus "
                    "(integrator {}, sub-step "
                    "{} ms). Try a smaller electrophysiology_substep_ms.",
                    model_.name, V, to, pacing_.integrator, pacing_.substep_ms));
}

double IonicCellSource::calcium_uM() const {
  return rescaling_(state_[model_.cytosolic_calcium] * units::uM_per_mM);
}

void IonicCellSource::save(std::vector<double>& out) const {
  out.push_back(charge_);
  out.insert(out.end(), state_.begin(), state_.end());
}

void IonicCellSource::restore(std::span<const double>& in) {
  charge_ = take_saved(in);
  for (double& value : state_) value = take_saved(in);
  stepper_->restart();
}

PrescribedCalcium::PrescribedCalcium(Shape shape, double period_ms, double activation_ms)
    : shape_(shape), period_ms_(period_ms), activation_ms_(activation_ms), calcium_(shape.rest_uM) {}

double PrescribedCalcium::at(double s) const {
  const double q = shape_.rise_ms / shape_.decay_ms;
  // Maximum of exp(-s/decay) - exp(-s/rise).
  const double peak = std::pow(q, q / (1 - q)) - std::pow(q, 1 / (1 - q));
  return shape_.rest_uM + (shape_.peak_uM - shape_.rest_uM) / peak *
                              (std::exp(-s / shape_.decay_ms) - std::exp(-s / shape_.rise_ms));
}

void PrescribedCalcium::advance(double t, double dt) {
  calcium_ = at(wrapped((t + dt) * units::ms_per_s - activation_ms_, period_ms_));
}

}  // namespace wiggers
