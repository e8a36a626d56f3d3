#include <fmt/format.h>

#include <Eigen/Core>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <wiggers/circulation/names.hpp>
#include <wiggers/core/dual.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/units.hpp>
#include <wiggers/heart/walls/triseg_wall.hpp>

namespace wiggers {

namespace {
using Jet = Dual<4>;
// A Newton step moves volumes by at most 10 mL and the junction by at most 0.4 cm; the junction stays open.
constexpr double largest_volume_step = 10, largest_radius_step = 0.4, smallest_radius = 0.05;

double step_share(const std::array<double, 4>& u, const std::array<double, 4>& step) {
  double share = 1;
  for (int i = 0; i < 4; ++i) {
    const double bound = i == 3 ? largest_radius_step : largest_volume_step;
    if (std::abs(step[i]) > bound) share = std::min(share, bound / std::abs(step[i]));
  }
  if (u[3] + share * step[3] < smallest_radius) share = std::min(share, (u[3] - smallest_radius) / -step[3]);
  for (int i = 0; i < 2; ++i)
    if (u[i] + share * step[i] < 0.5 * u[i]) share = std::min(share, -0.5 * u[i] / step[i]);
  return share;
}
}  // namespace

TriSegWall::TriSegWall(TriSegParameters parameters,
                       std::array<std::unique_ptr<ActiveFibre>, n_segments> fibres)
    : cavities_{LV, RV}, parameters_(parameters), fibres_(std::move(fibres)) {}

template <class T>
TriSegBalance<T> TriSegWall::balance(const std::array<T, 4>& u) const {
  return triseg_balance<T>(parameters_.caps, u[0], u[1], u[2], u[3], [this](int i, const T& stretch) {
    T stress = usyk_fibre_stress(parameters_.passive[i], square(stretch));
    if (const auto law = fibres_[i]->law(); law.active)
      stress = stress + (parameters_.n_f + parameters_.n_n) * stretch * law(stretch);
    return stress;
  });
}

void TriSegWall::solve_junction(Unknowns& u) const {
  double residual = 0;
  for (int iteration = 0; iteration < 200; ++iteration) {
    std::array<Jet, 4> jets;
    for (int i = 0; i < 4; ++i) jets[i] = i < 2 ? Jet(u[i]) : Jet::variable(u[i], i);
    const auto b = balance(jets);
    Eigen::Matrix2d slope;
    slope << b.axial.derivative[2], b.axial.derivative[3], b.radial.derivative[2], b.radial.derivative[3];
    const Eigen::Vector2d right(-b.axial.value, -b.radial.value);
    const Eigen::Vector2d d = slope.partialPivLu().solve(right);
    residual = right.lpNorm<Eigen::Infinity>();
    if (!d.allFinite()) break;
    const std::array<double, 4> step = {0, 0, d(0), d(1)};
    const double share = step_share(u, step);
    for (int i = 2; i < 4; ++i) u[i] += share * step[i];
    if (share == 1 && std::abs(d(0)) < 1e-11 * (1 + std::abs(u[2])) && std::abs(d(1)) < 1e-11 * u[3]) return;
  }
  throw NumericalFailure(
      fmt::format("the three ventricular walls find no common junction for volumes {:.1f} and {:.1f} mL: the "
                  "tensions still differ "
                  "by {:.2g} kPa cm. Check wall volumes and reference areas.",
                  u[0], u[1], residual));
}

void TriSegWall::start(const double&, const double* volumes, double* pressures) {
  for (auto& fibre : fibres_) fibre->start(1);
  // From a septum bulging into the RV, with the junction of a sphere around the LV and its walls.
  const double outer =
      volumes[0] + parameters_.caps[segment_L].wall_volume_mL + parameters_.caps[segment_S].wall_volume_mL;
  const double radius = std::cbrt(3 * outer / (4 * M_PI));
  u_ = {volumes[0], volumes[1], 0.2 * outer, 0.85 * radius};
  solve_junction(u_);
  newton_ = u_;
  const auto b = balance(u_);
  for (int i = 0; i < n_segments; ++i) fibres_[i]->start(b.caps[i].stretch);
  pressures[0] = b.p_LV * units::mmHg_per_kPa;
  pressures[1] = b.p_RV * units::mmHg_per_kPa;
}

void TriSegWall::begin_step(const double& t, const double& dt) {
  backup_.clear();
  save(backup_);
  newton_ = u_;
  for (auto& fibre : fibres_) fibre->begin_step(t, dt);
}

// Newton's system of the four unknowns: junction tensions zero, pressures as given.
void TriSegWall::linearise(const double* pressures, double* volumes, double* dV_dp) {
  std::array<Jet, 4> jets;
  for (int i = 0; i < 4; ++i) jets[i] = Jet::variable(newton_[i], i);
  const auto b = balance(jets);
  const Jet* rows[4] = {&b.axial, &b.radial, &b.p_LV, &b.p_RV};
  Eigen::Matrix4d slope;
  for (int r = 0; r < 4; ++r)
    for (int c = 0; c < 4; ++c) slope(r, c) = rows[r]->derivative[c];
  Eigen::Matrix<double, 4, 3> right;
  right.setZero();
  right(0, 0) = -b.axial.value;
  right(1, 0) = -b.radial.value;
  right(2, 0) = pressures[0] * units::kPa_per_mmHg - b.p_LV.value;
  right(3, 0) = pressures[1] * units::kPa_per_mmHg - b.p_RV.value;
  right(2, 1) = right(3, 2) = units::kPa_per_mmHg;
  const Eigen::Matrix<double, 4, 3> solution = slope.partialPivLu().solve(right);
  for (int i = 0; i < 4; ++i) {
    correction_[i] = solution(i, 0);
    per_pressure_[0][i] = solution(i, 1);
    per_pressure_[1][i] = solution(i, 2);
  }
  for (int v = 0; v < 2; ++v) {
    volumes[v] = newton_[v] + correction_[v];
    for (int p = 0; p < 2; ++p) dV_dp[2 * v + p] = per_pressure_[p][v];
  }
}

void TriSegWall::update(const double* dp, double driver_share) {
  std::array<double, 4> step;
  for (int i = 0; i < 4; ++i)
    step[i] = driver_share * correction_[i] + per_pressure_[0][i] * dp[0] + per_pressure_[1][i] * dp[1];
  const double share = step_share(newton_, step);
  for (int i = 0; i < 4; ++i) newton_[i] += share * step[i];
}

void TriSegWall::accept_step() {
  const auto b = balance(newton_);
  for (int i = 0; i < n_segments; ++i) fibres_[i]->accept_step(b.caps[i].stretch);
  u_ = newton_;
}

void TriSegWall::reject_step() {
  std::span<const double> in = backup_;
  restore(in);
}

void TriSegWall::move_to(const double* volumes) {
  u_[0] = volumes[0];
  u_[1] = volumes[1];
  solve_junction(u_);
  newton_ = u_;
  const auto b = balance(u_);
  for (int i = 0; i < n_segments; ++i) fibres_[i]->move_to(b.caps[i].stretch);
}

void TriSegWall::save(std::vector<double>& out) const {
  out.insert(out.end(), u_.begin(), u_.end());
  for (const auto& fibre : fibres_) fibre->save(out);
}

void TriSegWall::restore(std::span<const double>& in) {
  for (double& value : u_) value = take_saved(in);
  newton_ = u_;
  for (const auto& fibre : fibres_) fibre->restore(in);
}

std::vector<WallOutput> TriSegWall::outputs() const {
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

void TriSegWall::output_values(double* values) const {
  *values++ = u_[2];
  *values++ = u_[3];
  for (const auto& fibre : fibres_) {
    fibre->output_values(values);
    values += fibre->outputs().size();
  }
}

}  // namespace wiggers
