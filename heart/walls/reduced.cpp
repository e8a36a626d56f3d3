#include <algorithm>
#include <cmath>
#include <wiggers/core/dual.hpp>
#include <wiggers/core/sensitivity.hpp>
#include <wiggers/core/units.hpp>
#include <wiggers/heart/walls/reduced.hpp>

namespace wiggers {

namespace {
using Jet = Dual<1>;

// Outer radius (m) of a sphere of the given volume (mL).
template <class T>
T outer_radius_m(const T& volume_mL) {
  return 0.01 * cbrt(T(volume_mL * (3 / (4 * M_PI))));
}

// p(V) at the end of a step of dt from V_before.
template <class U, class P>
U pressure_kPa(const ReducedWallParametersOf<P>& w, const FibreLaw<P>& fibre, const P& V_before, const P& dt,
               const U& V) {
  const auto& rule = gauss_8();
  U p = passive_pressure(w.sphere, w.passive, rule, V);
  if (fibre.active || w.viscosity_Pa_s > 0.0) {
    const U lambda = mean_stretch(w.sphere, rule, V);
    const U G = pressure_per_tension(w.sphere, rule, V);
    if (fibre.active) p = p + (w.n_f + w.n_n) * fibre(lambda) * G;
    if (w.viscosity_Pa_s > 0.0) p = p + (2e-3 * w.viscosity_Pa_s / dt) * (lambda - fibre.stretch) * G;
  }
  if (w.epicardial_stiffness_Pa_per_m > 0.0 || w.epicardial_damping_Pa_s_per_m > 0.0) {
    const U b = outer_radius_m(U(V + w.sphere.Vw_mL));
    const P b0 = outer_radius_m(P(w.sphere.V0_mL + w.sphere.Vw_mL));
    const P b_before = outer_radius_m(P(V_before + w.sphere.Vw_mL));
    p = p + 1e-3 *
                (w.epicardial_stiffness_Pa_per_m * (b - b0) +
                 w.epicardial_damping_Pa_s_per_m / dt * (b - b_before)) *
                square(U(b0 / b));
  }
  return p;
}

template <class T>
ReducedWallParameters plain(const ReducedWallParametersOf<T>& w) {
  const auto v = [](const T& x) { return value_of(x); };
  ReducedWallParameters p;
  p.sphere = {v(w.sphere.V0_mL), v(w.sphere.Vw_mL)};
  p.passive = {v(w.passive.C_kPa), v(w.passive.b_ff), v(w.passive.b_ss), v(w.passive.b_nn)};
  p.n_f = v(w.n_f);
  p.n_n = v(w.n_n);
  p.viscosity_Pa_s = v(w.viscosity_Pa_s);
  p.epicardial_stiffness_Pa_per_m = v(w.epicardial_stiffness_Pa_per_m);
  p.epicardial_damping_Pa_s_per_m = v(w.epicardial_damping_Pa_s_per_m);
  return p;
}
}  // namespace

template <class T>
ReducedWallOf<T>::ReducedWallOf(int chamber, ReducedWallParametersOf<T> parameters, ActiveFibreOf<T> fibre)
    : chamber_{chamber}, parameters_(parameters), plain_(plain(parameters)), fibre_(std::move(fibre)) {}

template <class T>
void ReducedWallOf<T>::start(const T&, const T* volumes, T* pressures) {
  V_ = newton_V_ = volumes[0];
  fibre_.start(stretch_at(V_));
  pressures[0] = pressure_kPa(parameters_, fibre_.law(), V_, dt_, V_) * units::mmHg_per_kPa;
}

template <class T>
void ReducedWallOf<T>::begin_step(const T& t, const T& dt) {
  backup_.clear();
  save(backup_);
  dt_ = dt;
  newton_V_ = V_;
  fibre_.begin_step(t, dt);
}

template <class T>
void ReducedWallOf<T>::linearise(const T* pressures, T* volumes, double* dV_dp) {
  const FibreLaw<T> law = fibre_.law();
  const FibreLaw<double> plain_law{law.active, value_of(law.tension_kPa), value_of(law.stiffness_kPa),
                                   value_of(law.stretch)};
  const Jet p =
      pressure_kPa(plain_, plain_law, value_of(V_), value_of(dt_), Jet::variable(value_of(newton_V_), 0));
  dV_dp_ = 1 / (p.derivative[0] * units::mmHg_per_kPa);
  T here;
  if constexpr (std::is_same_v<T, double>)
    here = p.value;
  else
    here = pressure_kPa(parameters_, law, V_, dt_, newton_V_);
  linearised_V_ = newton_V_ + (pressures[0] - here * units::mmHg_per_kPa) * dV_dp_;
  volumes[0] = linearised_V_;
  dV_dp[0] = dV_dp_;
}

template <class T>
void ReducedWallOf<T>::update(const T* pressure_change, double) {
  const T wanted = linearised_V_ + dV_dp_ * pressure_change[0];
  // A cavity volume stays positive, and a trial step does not run away.
  const T low = 0.5 * newton_V_, high = 2.0 * newton_V_ + 1.0;
  newton_V_ = wanted < low ? low : high < wanted ? high : wanted;
}

template <class T>
void ReducedWallOf<T>::accept_step() {
  fibre_.accept_step(stretch_at(newton_V_));
  V_ = newton_V_;
}

template <class T>
void ReducedWallOf<T>::reject_step() {
  std::span<const T> in = backup_;
  restore(in);
}

template <class T>
void ReducedWallOf<T>::move_to(const T* volumes) {
  V_ = newton_V_ = volumes[0];
  fibre_.move_to(stretch_at(V_));
}

template <class T>
void ReducedWallOf<T>::save(std::vector<T>& out) const {
  out.push_back(V_);
  fibre_.save(out);
}

template <class T>
void ReducedWallOf<T>::restore(std::span<const T>& in) {
  V_ = newton_V_ = take_saved(in);
  fibre_.restore(in);
}

template class ReducedWallOf<double>;
template class ReducedWallOf<Tangent>;

}  // namespace wiggers
