#include <algorithm>
#include <cmath>
#include <wiggers/core/dual.hpp>
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

ReducedWall::ReducedWall(int chamber, ReducedWallParameters parameters, ActiveFibre fibre)
    : chamber_{chamber}, parameters_(parameters), fibre_(std::move(fibre)) {}

template <class T>
T ReducedWall::pressure_kPa(const T& V) const {
  const ReducedWallParameters& w = parameters_;
  const auto& rule = gauss_8();
  T p = passive_pressure(w.sphere, w.passive, rule, V);
  if (fibre_.is_active() || w.viscosity_Pa_s > 0) {
    const T lambda = mean_stretch(w.sphere, rule, V);
    const T G = pressure_per_tension(w.sphere, rule, V);
    if (fibre_.is_active()) p = p + (w.n_f + w.n_n) * fibre_.tension_kPa(lambda) * G;
    if (w.viscosity_Pa_s > 0) p = p + (2e-3 * w.viscosity_Pa_s / dt_) * (lambda - fibre_.stretch()) * G;
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

void ReducedWall::start(double, const double* volumes, double* pressures) {
  V_ = newton_V_ = volumes[0];
  fibre_.start(mean_stretch(parameters_.sphere, gauss_8(), V_));
  pressures[0] = pressure_kPa(V_) * units::mmHg_per_kPa;
}

void ReducedWall::begin_step(double t, double dt) {
  backup_.clear();
  save(backup_);
  dt_ = dt;
  newton_V_ = V_;
  fibre_.begin_step(t, dt);
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
  fibre_.accept_step(mean_stretch(parameters_.sphere, gauss_8(), newton_V_));
  V_ = newton_V_;
}

void ReducedWall::reject_step() {
  std::span<const double> in = backup_;
  restore(in);
}

void ReducedWall::move_to(const double* volumes) {
  V_ = newton_V_ = volumes[0];
  fibre_.move_to(mean_stretch(parameters_.sphere, gauss_8(), V_));
}

void ReducedWall::save(std::vector<double>& out) const {
  out.push_back(V_);
  fibre_.save(out);
}

void ReducedWall::restore(std::span<const double>& in) {
  V_ = newton_V_ = take_saved(in);
  fibre_.restore(in);
}

}  // namespace wiggers
