#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <wiggers/circulation/elastance.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/fixed_step.hpp>
#include <wiggers/core/units.hpp>
#include <wiggers/heart/walls/cell_source.hpp>

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
  const double on = pacing_.stimulus.duration_ms, off = pacing_.period_ms - on;
  n_on_ = whole_steps(on, pacing_.substep_ms);
  n_off_ = whole_steps(off, pacing_.substep_ms);
  h_on_ = n_on_ > 0 ? on / static_cast<double>(n_on_) : 0;
  h_off_ = off / static_cast<double>(n_off_);
  held_ = model_.invariant_values(state_.data(), parameters_.data());
  // The beat begins `activation` before the stimulus, so the cell is then late in its own cycle.
  const double phase = wrapped(-pacing_.activation_ms, pacing_.period_ms);
  advance_to(phase);
  read_out(phase);
}

double IonicCellSource::grid_time(long step) const {
  if (step <= n_on_) return static_cast<double>(step) * h_on_;
  return pacing_.stimulus.duration_ms + static_cast<double>(step - n_on_) * h_off_;
}

void IonicCellSource::advance(const double& t, const double& dt) {
  // A multistep scheme starts afresh with each beat: a resumed run then repeats an undisturbed one bit for
  // bit.
  if (t == 0) stepper_->restart();
  const double from = wrapped(t * units::ms_per_s - pacing_.activation_ms, pacing_.period_ms);
  double to = from + dt * units::ms_per_s;
  // Within rounding of the end of the cycle counts as the end, and the end as the next onset.
  if (from < pacing_.period_ms - 1e-9 && to >= pacing_.period_ms - 1e-9) {
    advance_to(pacing_.period_ms);
    if (model_.keeps_invariants(parameters_.data()))
      model_.hold_invariants(state_.data(), parameters_.data(), held_);
    step_ = 0;
  }
  if (to >= pacing_.period_ms - 1e-9) to = std::max(0.0, to - pacing_.period_ms);
  advance_to(to);
  read_out(to);
  const double V = state_[model_.membrane_potential];
  if (!(V > -150 && V < 150))
    throw NumericalFailure(fmt::format(
        "{}: membrane potential {} mV left its physical range {:.4g} ms after the stimulus (integrator "
        "{}, sub-step {} ms). Try a smaller electrophysiology_substep_ms.",
        model_.name, V, to, pacing_.integrator, pacing_.substep_ms));
}

void IonicCellSource::advance_to(double local) {
  while (grid_time(step_) < local - 1e-9) {
    const bool stimulated = step_ < n_on_;
    if (step_ == 0 || step_ == n_on_) stepper_->restart();
    const double current[1] = {stimulated ? pacing_.stimulus.amplitude_A_per_F : 0.0};
    calcium_before_ = state_[model_.cytosolic_calcium];
    potential_before_ = state_[model_.membrane_potential];
    stepper_->step(stimulated ? h_on_ : h_off_, state_.data(), current);
    ++step_;
  }
}

void IonicCellSource::read_out(double local) {
  calcium_mM_ = state_[model_.cytosolic_calcium];
  potential_mV_ = state_[model_.membrane_potential];
  const double reached = grid_time(step_);
  if (step_ == 0 || local > reached - 1e-9) return;
  const double share = (local - grid_time(step_ - 1)) / (reached - grid_time(step_ - 1));
  calcium_mM_ = calcium_before_ + share * (calcium_mM_ - calcium_before_);
  potential_mV_ = potential_before_ + share * (potential_mV_ - potential_before_);
}

double IonicCellSource::calcium_uM() const { return rescaling_(calcium_mM_ * units::uM_per_mM); }

void IonicCellSource::save(std::vector<double>& out) const {
  out.insert(out.end(), held_.begin(), held_.end());
  out.insert(out.end(),
             {static_cast<double>(step_), calcium_before_, potential_before_, calcium_mM_, potential_mV_});
  out.insert(out.end(), state_.begin(), state_.end());
}

void IonicCellSource::restore(std::span<const double>& in) {
  for (double& value : held_) value = take_saved(in);
  step_ = take_saved_count(in, n_on_ + n_off_);
  calcium_before_ = take_saved(in);
  potential_before_ = take_saved(in);
  calcium_mM_ = take_saved(in);
  potential_mV_ = take_saved(in);
  for (double& value : state_) value = take_saved(in);
  stepper_->restart();
}

}  // namespace wiggers
