#include <fmt/format.h>

#include <Eigen/Core>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <wiggers/circulation/network.hpp>
#include <wiggers/core/dual.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/sensitivity.hpp>
#include <wiggers/core/units.hpp>
#include <wiggers/heart/walls/triseg_wall.hpp>

namespace wiggers {

namespace {
using Jet = Dual<4>;
// A Newton step moves volumes by at most 10 mL and the junction by at most 0.4 cm; the junction stays open.
constexpr double largest_volume_step = 10, largest_radius_step = 0.4, smallest_radius = 0.05;

template <class T>
double step_share(const std::array<T, 4>& u, const std::array<T, 4>& step) {
  double share = 1;
  const auto at = [&](int i) { return value_of(u[i]); };
  const auto move = [&](int i) { return value_of(step[i]); };
  for (int i = 0; i < 4; ++i) {
    const double bound = i == 3 ? largest_radius_step : largest_volume_step;
    if (std::abs(move(i)) > bound) share = std::min(share, bound / std::abs(move(i)));
  }
  if (at(3) + share * move(3) < smallest_radius)
    share = std::min(share, (at(3) - smallest_radius) / -move(3));
  for (int i = 0; i < 2; ++i)
    if (at(i) + share * move(i) < 0.5 * at(i)) share = std::min(share, -0.5 * at(i) / move(i));
  return share;
}

// U: of the unknowns; P: of parameters and fibres.
template <class U, class P>
TriSegBalance<U> balance_of(const TriSegParametersOf<P>& p, const std::array<FibreLaw<P>, n_segments>& fibres,
                            const std::array<U, 4>& u) {
  return triseg_balance<U>(p.caps, u[0], u[1], u[2], u[3], [&](int i, const U& stretch) {
    U stress = usyk_fibre_stress(p.passive[i], square(stretch));
    if (fibres[i].active) stress = stress + (p.n_f + p.n_n) * stretch * fibres[i](stretch);
    return stress;
  });
}

template <class T>
TriSegParameters without_derivatives(const TriSegParametersOf<T>& w) {
  TriSegParameters p;
  for (int i = 0; i < n_segments; ++i) {
    p.caps[i] = {value_of(w.caps[i].wall_volume_mL), value_of(w.caps[i].reference_area_cm2)};
    const auto& law = w.passive[i];
    p.passive[i] = {value_of(law.C_kPa), value_of(law.b_ff), value_of(law.b_ss), value_of(law.b_nn)};
  }
  p.n_f = value_of(w.n_f);
  p.n_n = value_of(w.n_n);
  return p;
}
}  // namespace

template <class T>
TriSegWallOf<T>::TriSegWallOf(TriSegParametersOf<T> parameters,
                              std::array<std::unique_ptr<ActiveFibreOf<T>>, n_segments> fibres)
    : cavities_{LV, RV},
      parameters_(parameters),
      plain_(without_derivatives(parameters)),
      fibres_(std::move(fibres)) {}

template <class T>
TriSegBalance<T> TriSegWallOf<T>::balance(const Unknowns& u) const {
  return balance_of(parameters_, {fibres_[0]->law(), fibres_[1]->law(), fibres_[2]->law()}, u);
}

template <class T>
auto TriSegWallOf<T>::plain_balance(const Unknowns& u, int first) const {
  std::array<Jet, 4> jets;
  for (int i = 0; i < 4; ++i) jets[i] = i < first ? Jet(value_of(u[i])) : Jet::variable(value_of(u[i]), i);
  std::array<FibreLaw<double>, n_segments> laws;
  for (int i = 0; i < n_segments; ++i) {
    const FibreLaw<T> law = fibres_[i]->law();
    laws[i] = {law.active, value_of(law.tension_kPa), value_of(law.stiffness_kPa), value_of(law.stretch)};
  }
  return balance_of(plain_, laws, jets);
}

template <class T>
void TriSegWallOf<T>::solve_junction(Unknowns& u) const {
  double residual = 0;
  for (int iteration = 0; iteration < 200; ++iteration) {
    const auto slopes = plain_balance(u, 2);
    Eigen::Matrix2d slope;
    slope << slopes.axial.derivative[2], slopes.axial.derivative[3], slopes.radial.derivative[2],
        slopes.radial.derivative[3];
    const Eigen::Matrix2d inverse = slope.inverse();
    if (!inverse.allFinite()) break;
    const TriSegBalance<T> b = balance(u);
    residual = std::max(std::abs(value_of(b.axial)), std::abs(value_of(b.radial)));
    const Unknowns step = {T(0.0), T(0.0), T(-(inverse(0, 0) * b.axial + inverse(0, 1) * b.radial)),
                           T(-(inverse(1, 0) * b.axial + inverse(1, 1) * b.radial))};
    const double share = step_share(u, step);
    for (int i = 2; i < 4; ++i) u[i] += share * step[i];
    if (share == 1 && std::abs(value_of(step[2])) < 1e-11 * (1 + std::abs(value_of(u[2]))) &&
        std::abs(value_of(step[3])) < 1e-11 * value_of(u[3]))
      return;
  }
  throw NumericalFailure(
      fmt::format("the three ventricular walls find no common junction for volumes {:.1f} and {:.1f} mL: the "
                  "tensions still differ "
                  "by {:.2g} kPa cm. Check wall volumes and reference areas.",
                  value_of(u[0]), value_of(u[1]), residual));
}

template <class T>
void TriSegWallOf<T>::start(const T&, const T* volumes, T* pressures) {
  for (auto& fibre : fibres_) fibre->start(T(1.0));
  // From a septum bulging into the RV, with the junction of a sphere around the LV and its walls.
  const T outer =
      volumes[0] + parameters_.caps[segment_L].wall_volume_mL + parameters_.caps[segment_S].wall_volume_mL;
  const T radius = cbrt(T(outer * (3 / (4 * M_PI))));
  u_ = {volumes[0], volumes[1], T(0.2 * outer), T(0.85 * radius)};
  solve_junction(u_);
  newton_ = u_;
  const auto b = balance(u_);
  for (int i = 0; i < n_segments; ++i) fibres_[i]->start(b.caps[i].stretch);
  pressures[0] = b.p_LV * units::mmHg_per_kPa;
  pressures[1] = b.p_RV * units::mmHg_per_kPa;
}

template <class T>
void TriSegWallOf<T>::begin_step(const T& t, const T& dt) {
  backup_.clear();
  save(backup_);
  newton_ = u_;
  for (auto& fibre : fibres_) fibre->begin_step(t, dt);
}

// Newton's system of the four unknowns: junction tensions zero, pressures as given.
template <class T>
void TriSegWallOf<T>::linearise(const T* pressures, T* volumes, double* dV_dp) {
  const auto b = plain_balance(newton_, 0);
  const Jet* rows[4] = {&b.axial, &b.radial, &b.p_LV, &b.p_RV};
  Eigen::Matrix4d slope;
  for (int r = 0; r < 4; ++r)
    for (int c = 0; c < 4; ++c) slope(r, c) = rows[r]->derivative[c];
  T residual[4];
  if constexpr (std::is_same_v<T, double>) {
    for (int r = 0; r < 4; ++r) residual[r] = rows[r]->value;
  } else {
    const TriSegBalance<T> here = balance(newton_);
    const T* own[4] = {&here.axial, &here.radial, &here.p_LV, &here.p_RV};
    for (int r = 0; r < 4; ++r) residual[r] = *own[r];
  }
  const auto factors = slope.partialPivLu();
  Eigen::Matrix<double, 4, 2> per_pressure = Eigen::Matrix<double, 4, 2>::Zero();
  per_pressure(2, 0) = per_pressure(3, 1) = units::kPa_per_mmHg;
  per_pressure = factors.solve(per_pressure).eval();
  const T right[4] = {T(-residual[0]), T(-residual[1]), T(pressures[0] * units::kPa_per_mmHg - residual[2]),
                      T(pressures[1] * units::kPa_per_mmHg - residual[3])};
  if constexpr (std::is_same_v<T, double>) {
    const Eigen::Vector4d solution = factors.solve(Eigen::Vector4d(right[0], right[1], right[2], right[3]));
    for (int i = 0; i < 4; ++i) correction_[i] = solution(i);
  } else {
    const Eigen::Matrix4d inverse = factors.inverse();
    for (int i = 0; i < 4; ++i) {
      correction_[i] = inverse(i, 0) * right[0];
      for (int k = 1; k < 4; ++k) correction_[i] = correction_[i] + inverse(i, k) * right[k];
    }
  }
  for (int i = 0; i < 4; ++i)
    for (int p = 0; p < 2; ++p) per_pressure_[p][i] = per_pressure(i, p);
  for (int v = 0; v < 2; ++v) {
    volumes[v] = newton_[v] + correction_[v];
    for (int p = 0; p < 2; ++p) dV_dp[2 * v + p] = per_pressure_[p][v];
  }
}

template <class T>
void TriSegWallOf<T>::update(const T* dp, double driver_share) {
  Unknowns step;
  for (int i = 0; i < 4; ++i)
    step[i] = driver_share * correction_[i] + per_pressure_[0][i] * dp[0] + per_pressure_[1][i] * dp[1];
  const double share = step_share(newton_, step);
  for (int i = 0; i < 4; ++i) newton_[i] += share * step[i];
}

template <class T>
void TriSegWallOf<T>::accept_step() {
  const auto b = balance(newton_);
  for (int i = 0; i < n_segments; ++i) fibres_[i]->accept_step(b.caps[i].stretch);
  u_ = newton_;
}

template <class T>
void TriSegWallOf<T>::reject_step() {
  std::span<const T> in = backup_;
  restore(in);
}

template <class T>
void TriSegWallOf<T>::move_to(const T* volumes) {
  u_[0] = volumes[0];
  u_[1] = volumes[1];
  solve_junction(u_);
  newton_ = u_;
  const auto b = balance(u_);
  for (int i = 0; i < n_segments; ++i) fibres_[i]->move_to(b.caps[i].stretch);
}

template <class T>
void TriSegWallOf<T>::save(std::vector<T>& out) const {
  out.insert(out.end(), u_.begin(), u_.end());
  for (const auto& fibre : fibres_) fibre->save(out);
}

template <class T>
void TriSegWallOf<T>::restore(std::span<const T>& in) {
  for (T& value : u_) value = take_saved(in);
  newton_ = u_;
  for (const auto& fibre : fibres_) fibre->restore(in);
}

template <class T>
std::vector<WallOutput> TriSegWallOf<T>::outputs() const {
  std::vector<WallOutput> list = {
      {"septum_volume", "mL", "midwall volume of the septal cap, positive towards the RV"},
      {"junction_radius", "cm", "radius of the junction circle"}};
  for (int i = 0; i < n_segments; ++i)
    for (WallOutput output : fibres_[i]->outputs()) {
      output.name = fmt::format("{}_{}", segment_names[i], output.name);
      list.push_back(output);
    }
  return list;
}

template <class T>
void TriSegWallOf<T>::output_values(double* values) const {
  *values++ = value_of(u_[2]);
  *values++ = value_of(u_[3]);
  for (const auto& fibre : fibres_) {
    fibre->output_values(values);
    values += fibre->outputs().size();
  }
}

template class TriSegWallOf<double>;
template class TriSegWallOf<Tangent>;

}  // namespace wiggers
