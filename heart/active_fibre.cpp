#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <wiggers/cellmodels/rdq20_midpoint.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/heart/active_fibre.hpp>

namespace wiggers {

ActiveFibre::ActiveFibre(ActiveFibreSettings settings, const std::vector<double>& force_parameters,
                         std::unique_ptr<CellSource> cell, std::string place)
    : settings_(settings), force_(force_parameters), cell_(std::move(cell)), place_(std::move(place)) {
  const double SL0 = force_.constants().p[Rdq20::SL0];
  const std::vector<double> rest = rdq20_steady_state(force_parameters, settings_.rest_calcium_uM, SL0);
  std::copy(rest.begin(), rest.end(), bridges_.begin());
  mu1_rest_ = rest[Rdq20::mu1_P] + rest[Rdq20::mu1_N];
}

void ActiveFibre::start(double stretch) {
  stretch_ = stretch_before_ = stretch;
  tension_ = stiffness_ = 0;
}

void ActiveFibre::begin_step(double t, double dt) {
  dt_ = dt;
  cell_->advance(t, dt);
  tension_ = stiffness_ = 0;
  if (!settings_.active) return;
  const auto& p = force_.constants().p;
  const double SL = p[Rdq20::SL0] * stretch_;
  if (Rdq20::dissociation_constant(SL, p) <= 0)
    throw NumericalFailure(fmt::format(
        "{}: sarcomere length {:.4g} um makes the calcium dissociation constant of RDQ20 negative: the "
        "wall is stretched beyond the force model. Check volumes and stiffness of this wall.",
        place_, SL));
  const double calcium = cell_->calcium_uM();
  if (settings_.regulation == RegulationScheme::midpoint) {
    const double middle = calcium_before_ < 0 ? calcium : 0.5 * (calcium_before_ + calcium);
    if (!Rdq20Midpoint<double>().step_regulation(dt, bridges_.data(), middle, SL, force_.constants(),
                                                 regulation_))
      throw NumericalFailure(
          fmt::format("{}: rates of RDQ20 at calcium {} uM are beyond a step of {} s; try a smaller "
                      "dt_s.",
                      place_, middle, dt));
  } else {
    regulation_ = force_.step_regulation(bridges_.data(), calcium, SL, dt, settings_.regulatory_substeps);
  }
  calcium_before_ = calcium;
  for (int i = 0; i < Rdq20::n_probabilities; ++i)
    if (!(bridges_[i] > -1e-6 && bridges_[i] < 1 + 1e-6))
      throw NumericalFailure(
          fmt::format("{}: probability {} = {} of RDQ20 left [0, 1]; try a smaller {}.", place_,
                      Rdq20::states[i].name, bridges_[i],
                      settings_.regulation == RegulationScheme::midpoint ? "dt_s" : "regulatory_substep_us"));
  const double v_before = -(stretch_ - stretch_before_) / dt;  // shortening positive
  std::copy(bridges_.begin() + 16, bridges_.end(), moments_before_.begin());
  force_.step_crossbridges(bridges_.data(), regulation_,
                           settings_.rate == RateScheme::lagged ? v_before : 0.0, dt);
  const double scale = force_.scale(SL);
  if (settings_.rate == RateScheme::implicit) {
    // Predicted without sliding but with the detachment rate of the last velocity.
    const double r = p[Rdq20::r0] + p[Rdq20::alpha] * std::abs(v_before);
    const double S0_start = moments_before_[0] + moments_before_[2];
    const double S1_inf = p[Rdq20::mu1_fP] * regulation_.permissivity / r;
    const double S0_inf = p[Rdq20::mu0_fP] * regulation_.permissivity / r;
    const double decay = std::exp(-r * dt);
    const double S1 = S1_inf + (moments_before_[1] + moments_before_[3] - S1_inf) * decay;
    const double S0_mean = S0_inf * (-std::expm1(-r * dt)) / (r * dt) + (S0_start - S0_inf) * decay;
    tension_ = scale * S1;
    stiffness_ = scale * S0_mean;
  } else {
    tension_ = force_.tension_kPa(bridges_.data(), SL);
    stiffness_ = settings_.rate == RateScheme::none ? 0 : force_.stiffness_kPa(bridges_.data(), SL);
  }
  if (settings_.subtract_rest_tension) tension_ = std::max(0.0, tension_ - scale * mu1_rest_);
  if (!settings_.stabilise) stiffness_ = 0;
}

void ActiveFibre::accept_step(double stretch) {
  if (settings_.active) {
    if (settings_.rate == RateScheme::implicit) {
      std::copy(moments_before_.begin(), moments_before_.end(), bridges_.begin() + 16);
      force_.step_crossbridges(bridges_.data(), regulation_, -(stretch - stretch_) / dt_, dt_);
    }
    tension_ += stiffness_ * (stretch - stretch_);
  }
  stiffness_ = 0;
  stretch_before_ = stretch_;
  stretch_ = stretch;
}

void ActiveFibre::move_to(double stretch) {
  stretch_before_ += stretch - stretch_;
  stretch_ = stretch;
}

void ActiveFibre::save(std::vector<double>& out) const {
  out.insert(out.end(), {stretch_, stretch_before_, tension_, calcium_before_});
  out.insert(out.end(), bridges_.begin(), bridges_.end());
  cell_->save(out);
}

void ActiveFibre::restore(std::span<const double>& in) {
  stretch_ = take_saved(in);
  stretch_before_ = take_saved(in);
  tension_ = take_saved(in);
  calcium_before_ = take_saved(in);
  stiffness_ = 0;
  for (double& value : bridges_) value = take_saved(in);
  cell_->restore(in);
}

std::vector<WallOutput> ActiveFibre::outputs() const {
  std::vector<WallOutput> list = {
      {"calcium", "uM", "calcium that the force model sees"},
      {"active_tension", "kPa", "active tension, rest tension removed, stabilising term included"},
      {"stretch", "1", "fibre stretch"}};
  if (cell_->has_potential()) list.push_back({"membrane_potential", "mV", "membrane potential"});
  return list;
}

void ActiveFibre::output_values(double* values) const {
  values[0] = cell_->calcium_uM();
  values[1] = tension_;
  values[2] = stretch_;
  if (cell_->has_potential()) values[3] = cell_->potential_mV();
}

}  // namespace wiggers
