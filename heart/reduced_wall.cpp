#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <wiggers/circulation/names.hpp>
#include <wiggers/core/dual.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/units.hpp>
#include <wiggers/heart/reduced_wall.hpp>

namespace wiggers {

namespace {
using Jet = Dual<1>;

// Outer radius (m) of a sphere of the given volume (mL).
template <class T>
T outer_radius_m(const T& volume_mL) {
  return 0.01 * cbrt(T(volume_mL * (3 / (4 * M_PI))));
}
}  // namespace

ReducedWall::ReducedWall(int chamber, ReducedWallParameters parameters, std::vector<double> force_parameters,
                         std::unique_ptr<CellSource> cell, RateScheme rate, bool stabilise_active_stress)
    : chamber_{chamber},
      parameters_(parameters),
      force_(force_parameters),
      cell_(std::move(cell)),
      rate_(rate),
      stabilise_(stabilise_active_stress) {
  const double SL0 = force_.constants().p[Rdq20::SL0];
  const std::vector<double> rest = rdq20_steady_state(force_parameters, parameters_.rest_calcium_uM, SL0);
  std::copy(rest.begin(), rest.end(), bridges_.begin());
  mu1_rest_ = rest[Rdq20::mu1_P] + rest[Rdq20::mu1_N];
}

template <class T>
T ReducedWall::pressure_kPa(const T& V) const {
  const ReducedWallParameters& w = parameters_;
  const auto& rule = gauss_8();
  T p = passive_pressure(w.sphere, w.passive, rule, V);
  const T lambda = mean_stretch(w.sphere, rule, V);
  if (w.active || w.viscosity_Pa_s > 0) {
    const T G = pressure_per_tension(w.sphere, rule, V);
    if (w.active) p = p + (w.n_f + w.n_n) * (tension_ + stiffness_ * (lambda - stretch_)) * G;
    if (w.viscosity_Pa_s > 0) p = p + (2e-3 * w.viscosity_Pa_s / dt_) * (lambda - stretch_) * G;
  }
  if (w.epicardial_stiffness_Pa_per_m > 0 || w.epicardial_damping_Pa_s_per_m > 0) {
    const T b = outer_radius_m(T(V + w.sphere.Vw_mL));
    const double b0 = outer_radius_m(w.sphere.V0_mL + w.sphere.Vw_mL);
    const double b_before = outer_radius_m(V_ + w.sphere.Vw_mL);
    p = p + 1e-3 *
                (w.epicardial_stiffness_Pa_per_m * (b - b0) +
                 w.epicardial_damping_Pa_s_per_m / dt_ * (b - b_before)) *
                square(T(b0 / b));
  }
  return p;
}
template double ReducedWall::pressure_kPa<double>(const double&) const;
template Jet ReducedWall::pressure_kPa<Jet>(const Jet&) const;

void ReducedWall::start(double, const double* volumes, double* pressures) {
  V_ = newton_V_ = volumes[0];
  stretch_ = stretch_before_ = mean_stretch(parameters_.sphere, gauss_8(), V_);
  tension_ = stiffness_ = 0;
  pressures[0] = pressure_kPa(V_) * units::mmHg_per_kPa;
}

void ReducedWall::begin_step(double t, double dt) {
  backup_.clear();
  save(backup_);
  dt_ = dt;
  newton_V_ = V_;
  cell_->advance(t, dt);
  tension_ = stiffness_ = 0;
  if (parameters_.active) advance_force(dt);
}

void ReducedWall::advance_force(double dt) {
  const auto& p = force_.constants().p;
  const double SL = p[Rdq20::SL0] * stretch_;
  if (Rdq20::dissociation_constant(SL, p) <= 0)
    throw NumericalFailure(
        fmt::format("{}: sarcomere length {:.4g} um makes the calcium dissociation constant of RDQ20 "
                    "negative: the wall is "
                    "stretched beyond the force model. Check volumes and stiffness of this wall.",
                    chamber_names[chamber_[0]], SL));
  const double calcium = cell_->calcium_uM();
  regulation_ = force_.step_regulation(bridges_.data(), calcium, SL, dt, parameters_.regulatory_substeps);
  for (int i = 0; i < Rdq20::n_probabilities; ++i)
    if (!(bridges_[i] > -1e-6 && bridges_[i] < 1 + 1e-6))
      throw NumericalFailure(
          fmt::format("{}: probability {} = {} of RDQ20 left [0, 1]; try a smaller "
                      "regulatory_substep_us.",
                      chamber_names[chamber_[0]], Rdq20::states[i].name, bridges_[i]));
  const double v_before = -(stretch_ - stretch_before_) / dt;  // shortening positive
  std::copy(bridges_.begin() + 16, bridges_.end(), moments_before_.begin());
  const double S0_start = moments_before_[0] + moments_before_[2];
  const double v = rate_ == RateScheme::lagged ? v_before : 0.0;
  force_.step_crossbridges(bridges_.data(), regulation_, v, dt);
  const double scale = force_.scale(SL);
  if (rate_ == RateScheme::implicit) {
    // Predicted without sliding but with the detachment rate of the last velocity.
    const double r = p[Rdq20::r0] + p[Rdq20::alpha] * std::abs(v_before);
    const double S1_inf = p[Rdq20::mu1_fP] * regulation_.permissivity / r;
    const double S0_inf = p[Rdq20::mu0_fP] * regulation_.permissivity / r;
    const double decay = std::exp(-r * dt);
    const double S1 = S1_inf + (moments_before_[1] + moments_before_[3] - S1_inf) * decay;
    const double S0_mean = S0_inf * (-std::expm1(-r * dt)) / (r * dt) + (S0_start - S0_inf) * decay;
    tension_ = scale * S1;
    stiffness_ = scale * S0_mean;
  } else {
    tension_ = force_.tension_kPa(bridges_.data(), SL);
    stiffness_ = rate_ == RateScheme::none ? 0 : force_.stiffness_kPa(bridges_.data(), SL);
  }
  if (parameters_.subtract_rest_tension) tension_ = std::max(0.0, tension_ - scale * mu1_rest_);
  if (!stabilise_) stiffness_ = 0;
}

void ReducedWall::linearise(const double* pressures, double* volumes, double* dV_dp) {
  const Jet p = pressure_kPa(Jet::variable(newton_V_, 0));
  dV_dp_ = 1 / (p.derivative[0] * units::mmHg_per_kPa);
  linearised_V_ = newton_V_ + (pressures[0] - p.value * units::mmHg_per_kPa) * dV_dp_;
  volumes[0] = linearised_V_;
  dV_dp[0] = dV_dp_;
}

void ReducedWall::update(const double* pressure_change) {
  const double wanted = linearised_V_ + dV_dp_ * pressure_change[0];
  // A cavity volume stays positive, and a trial step does not run away.
  newton_V_ = std::clamp(wanted, 0.5 * newton_V_, 2 * newton_V_ + 1);
}

void ReducedWall::accept_step() {
  const double stretch = mean_stretch(parameters_.sphere, gauss_8(), newton_V_);
  if (parameters_.active && rate_ == RateScheme::implicit) {
    std::copy(moments_before_.begin(), moments_before_.end(), bridges_.begin() + 16);
    force_.step_crossbridges(bridges_.data(), regulation_, -(stretch - stretch_) / dt_, dt_);
  }
  if (parameters_.active) tension_ += stiffness_ * (stretch - stretch_);
  stretch_before_ = stretch_;
  stretch_ = stretch;
  V_ = newton_V_;
}

void ReducedWall::reject_step() {
  std::span<const double> in = backup_;
  restore(in);
}

void ReducedWall::move_to(const double* volumes) {
  const double rate_step = stretch_ - stretch_before_;
  V_ = newton_V_ = volumes[0];
  stretch_ = mean_stretch(parameters_.sphere, gauss_8(), V_);
  stretch_before_ = stretch_ - rate_step;
}

void ReducedWall::save(std::vector<double>& out) const {
  out.insert(out.end(), {V_, stretch_, stretch_before_, tension_});
  out.insert(out.end(), bridges_.begin(), bridges_.end());
  cell_->save(out);
}

void ReducedWall::restore(std::span<const double>& in) {
  V_ = newton_V_ = take_saved(in);
  stretch_ = take_saved(in);
  stretch_before_ = take_saved(in);
  tension_ = take_saved(in);
  for (double& value : bridges_) value = take_saved(in);
  cell_->restore(in);
}

std::vector<WallOutput> ReducedWall::outputs() const {
  std::vector<WallOutput> list = {
      {"calcium", "uM", "calcium that the force model sees"},
      {"active_tension", "kPa", "active tension, rest tension removed, stabilising term included"},
      {"stretch", "1", "mean fibre stretch"}};
  if (cell_->has_potential()) list.push_back({"membrane_potential", "mV", "membrane potential"});
  return list;
}

void ReducedWall::output_values(double* values) const {
  values[0] = cell_->calcium_uM();
  values[1] = tension_;
  values[2] = stretch_;
  if (cell_->has_potential()) values[3] = cell_->potential_mV();
}

}  // namespace wiggers
