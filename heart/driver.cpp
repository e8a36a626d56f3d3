#include <fmt/format.h>

#include <Eigen/Core>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <wiggers/circulation/loop.hpp>
#include <wiggers/core/dual.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/heart/driver.hpp>

namespace wiggers {

namespace {
using Jet = Dual<n_chambers>;
using Matrix = Eigen::Matrix<double, n_chambers, n_chambers, Eigen::RowMajor>;
using Vector = Eigen::Matrix<double, n_chambers, 1>;

constexpr int largest_newton_iterations = 60;
constexpr double pressure_tolerance_mmHg = 1e-9;
constexpr double volume_tolerance_mL = 1e-9;
}  // namespace

HeartDriver::HeartDriver(DriverSettings settings, CirculationParameters circulation,
                         std::vector<std::unique_ptr<Wall>> walls)
    : settings_(settings), circulation_(circulation), walls_(std::move(walls)) {
  n_steps_ = std::lround(settings_.period_s / settings_.dt_s);
}

void HeartDriver::start(const CirculationValues& initial) {
  y_ = initial;
  for (const auto& wall : walls_) {
    double V[n_chambers], p[n_chambers];
    const auto cavities = wall->cavities();
    for (std::size_t k = 0; k < cavities.size(); ++k) V[k] = y_[cavities[k]];
    wall->start(0, V, p);
    for (std::size_t k = 0; k < cavities.size(); ++k) p_[cavities[k]] = p[k];
  }
  const double bag = settings_.pericardium.pressure(y_[V_LA] + y_[V_LV] + y_[V_RA] + y_[V_RV]);
  for (double& pressure : p_) pressure += bag;
  Q_ = valve_flows<double>(circulation_, p_.data(), y_[p_AR_SYS], y_[p_AR_PUL]);
}

void HeartDriver::move_to(const CirculationValues& values) {
  y_ = values;
  for (const auto& wall : walls_) {
    double V[n_chambers];
    const auto cavities = wall->cavities();
    for (std::size_t k = 0; k < cavities.size(); ++k) V[k] = y_[cavities[k]];
    wall->move_to(V);
  }
}

// Volumes at the end of the step that the circulation wants, and their derivatives by the pressures.
void HeartDriver::wanted_volumes(const double* p, double* volumes, double* slopes) const {
  if (!settings_.stabilise_volumes) {
    for (int c = 0; c < n_chambers; ++c) volumes[c] = y_[c];
    std::fill(slopes, slopes + n_chambers * n_chambers, 0.0);
    return;
  }
  Jet pressure[n_chambers];
  for (int c = 0; c < n_chambers; ++c) pressure[c] = Jet::variable(p[c], c);
  const auto Q = valve_flows<Jet>(circulation_, pressure, Jet(y_[p_AR_SYS]), Jet(y_[p_AR_PUL]));
  const Jet net[n_chambers] = {y_[Q_VEN_PUL] - Q[MV], Q[MV] - Q[AV], y_[Q_VEN_SYS] - Q[TV], Q[TV] - Q[PV]};
  for (int c = 0; c < n_chambers; ++c) {
    volumes[c] = y_[c] + settings_.dt_s * net[c].value;
    for (int k = 0; k < n_chambers; ++k) slopes[n_chambers * c + k] = settings_.dt_s * net[c].derivative[k];
  }
}

void HeartDriver::step(double t, BeatAudit& audit) {
  const double dt = settings_.dt_s;
  for (const auto& wall : walls_) wall->begin_step(t, dt);

  std::array<double, n_chambers> p = p_;
  std::array<double, n_chambers> volume{}, wanted{};
  bool converged = false;
  int iteration = 0;
  double error = 0;
  int worst = 0;
  Vector wall_volume = Vector::Zero();
  while (!converged && iteration < largest_newton_iterations) {
    ++iteration;
    Matrix slopes;
    wanted_volumes(p.data(), wanted.data(), slopes.data());
    // Walls carry the pressure across them: the cavity's less that of the bag, which follows the wanted
    // volumes.
    Vector across_slope = Vector::Zero();
    double bag = 0;
    if (settings_.pericardium.present()) {
      const auto jet = settings_.pericardium.pressure(
          Dual<1>::variable(wanted[LA] + wanted[LV] + wanted[RA] + wanted[RV], 0));
      bag = jet.value;
      across_slope = jet.derivative[0] * slopes.colwise().sum().transpose();
    }
    Matrix system = Matrix::Zero();
    for (const auto& wall : walls_) {
      const auto cavities = wall->cavities();
      const std::size_t n = cavities.size();
      double pressures[n_chambers], V[n_chambers], C[n_chambers * n_chambers];
      for (std::size_t k = 0; k < n; ++k) pressures[k] = p[cavities[k]] - bag;
      wall->linearise(pressures, V, C);
      for (std::size_t k = 0; k < n; ++k) {
        volume[cavities[k]] = V[k];
        for (std::size_t j = 0; j < n; ++j) system(cavities[k], cavities[j]) = C[n * k + j];
      }
    }
    Vector mismatch;
    for (int c = 0; c < n_chambers; ++c) mismatch(c) = wanted[c] - volume[c];
    const Matrix across = Matrix::Identity() - Vector::Ones() * across_slope.transpose();
    Vector dp = (system * across - slopes).partialPivLu().solve(mismatch);
    // A diode's kink can make Newton jump to and fro; half steps end that.
    if (iteration > 15) dp *= 0.5;
    if (!dp.allFinite()) break;
    error = mismatch.cwiseAbs().maxCoeff(&worst);
    const Vector across_change = across * dp;
    for (const auto& wall : walls_) {
      const auto cavities = wall->cavities();
      double change[n_chambers];
      for (std::size_t k = 0; k < cavities.size(); ++k) change[k] = across_change(cavities[k]);
      wall->update(change);
    }
    for (int c = 0; c < n_chambers; ++c) wall_volume(c) = volume[c];
    wall_volume += system * across_change;
    double largest_change = 0;
    for (int c = 0; c < n_chambers; ++c) {
      p[c] += dp(c);
      largest_change = std::max(largest_change, std::abs(dp(c)) / (1 + std::abs(p[c])));
    }
    converged = largest_change < pressure_tolerance_mmHg && error < volume_tolerance_mL;
  }
  audit.newton_iterations += iteration;
  audit.most_newton_iterations = std::max(audit.most_newton_iterations, iteration);
  if (!converged) {
    for (const auto& wall : walls_) wall->reject_step();
    throw NumericalFailure(fmt::format(
        "no balance of wall and blood volumes at t = {:.4f} s of the beat: after {} Newton iterations {} "
        "still misses "
        "{:.3g} mL at {:.3g} mmHg. Try a smaller dt_s (now {} s){}.",
        t + dt, iteration, chamber_names[worst], error, p[worst], dt,
        settings_.stabilise_volumes ? "" : ", or stabilise volumes (solver.stabilise.volumes = true)"));
  }
  for (const auto& wall : walls_) wall->accept_step();

  p_ = p;
  Q_ = valve_flows<double>(circulation_, p_.data(), y_[p_AR_SYS], y_[p_AR_PUL]);
  CirculationValues rates;
  circulation_rates<double>(circulation_, y_.data(), p_.data(), Q_, rates.data());
  audit.dissipated_mmHg_mL += dt * dissipated_power(circulation_, y_.data(), p_.data(), Q_);
  if (settings_.implicit_inductors) {
    const CircuitParameters& s = circulation_.circuits[SYS];
    const CircuitParameters& l = circulation_.circuits[PUL];
    rates[Q_AR_SYS] /= 1 + dt * s.R_AR / s.L_AR;
    rates[Q_VEN_SYS] /= 1 + dt * s.R_VEN / s.L_VEN;
    rates[Q_AR_PUL] /= 1 + dt * l.R_AR / l.L_AR;
    rates[Q_VEN_PUL] /= 1 + dt * l.R_VEN / l.L_VEN;
  }
  for (int k = 0; k < n_circulation_states; ++k) y_[k] += dt * rates[k];
  for (int c = 0; c < n_chambers; ++c) {
    audit.chamber_work_mmHg_mL -= p_[c] * dt * rates[c];
    audit.volume_mismatch_mL = std::max(audit.volume_mismatch_mL, std::abs(wall_volume(c) - y_[c]));
  }
  for (int v = 0; v < n_valves; ++v) audit.valve_volume_mL[v] += dt * Q_[v];
  for (int k = 0; k < n_circulation_states; ++k)
    if (!std::isfinite(y_[k]) || std::abs(y_[k]) > 1e6)
      throw NumericalFailure(fmt::format(
          "the circulation diverged at t = {:.4f} s of the beat: {} = {:.3g} {}. Its explicit "
          "step is stable below "
          "{:.2f} ms (2 L/R of the stiffest branch); dt_s is {} s. Take a smaller step{}.",
          t + dt, circulation_state_quantities[k].name, y_[k], circulation_state_quantities[k].unit,
          1e3 * largest_explicit_step(circulation_), dt,
          settings_.stabilise_volumes ? "" : ", or stabilise volumes (solver.stabilise.volumes = true)"));
}

Table HeartDriver::trace() const {
  Table table = circulation_table();
  for (const auto& wall : walls_) {
    const auto cavities = wall->cavities();
    const std::string name(cavities.size() == 1 ? chamber_names[cavities.front()] : "ventricles");
    for (const WallOutput& output : wall->outputs())
      table.add(name + "." + output.name, output.unit, output.meaning);
  }
  return table;
}

void HeartDriver::record(Table& table, double t) const {
  append_circulation_row(table, t, y_.data(), p_.data(), Q_);
  std::size_t column = 1 + n_circulation_states + n_chambers + n_valves;
  for (const auto& wall : walls_) {
    const std::size_t n = wall->outputs().size();
    std::vector<double> values(n);
    wall->output_values(values.data());
    for (double value : values) table.columns[column++].values.push_back(value);
  }
}

BeatAudit HeartDriver::beat(Table* table) {
  BeatAudit audit;
  const double volume = total_volume(circulation_, y_.data());
  if (table) {
    table->clear_rows();
    record(*table, 0);
  }
  for (long n = 0; n < n_steps_; ++n) {
    step(static_cast<double>(n) * settings_.dt_s, audit);
    if (table) record(*table, static_cast<double>(n + 1) * settings_.dt_s);
  }
  audit.blood_volume_change_mL = total_volume(circulation_, y_.data()) - volume;
  return audit;
}

std::vector<double> HeartDriver::save() const {
  std::vector<double> out(y_.begin(), y_.end());
  out.insert(out.end(), p_.begin(), p_.end());
  out.insert(out.end(), Q_.begin(), Q_.end());
  for (const auto& wall : walls_) wall->save(out);
  return out;
}

void HeartDriver::restore(const std::vector<double>& saved) {
  std::span<const double> in = saved;
  for (double& value : y_) value = take_saved(in);
  for (double& value : p_) value = take_saved(in);
  for (double& value : Q_) value = take_saved(in);
  for (const auto& wall : walls_) wall->restore(in);
}

}  // namespace wiggers
