#include <fmt/format.h>

#include <Eigen/Core>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <wiggers/circulation/loop.hpp>
#include <wiggers/core/dual.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/memory.hpp>
#include <wiggers/core/progress.hpp>
#include <wiggers/core/sensitivity.hpp>
#include <wiggers/heart/coupling/driver.hpp>

namespace wiggers {

namespace {
using Jet = Dual<n_chambers>;
using Matrix = Eigen::Matrix<double, n_chambers, n_chambers, Eigen::RowMajor>;
using Vector = Eigen::Matrix<double, n_chambers, 1>;

constexpr int largest_newton_iterations = 60;
constexpr double pressure_tolerance_mmHg = 1e-9;
constexpr double volume_tolerance_mL = 1e-9;
constexpr int most_step_halvings = 4;
}  // namespace

template <class T>
HeartDriverOf<T>::HeartDriverOf(DriverSettingsOf<T> settings, CirculationParametersOf<T> circulation,
                                std::vector<std::unique_ptr<WallOf<T>>> walls)
    : settings_(settings), circulation_(circulation), walls_(std::move(walls)) {
  n_steps_ = std::lround(value_of(settings_.period_s) / value_of(settings_.dt_s));
  plain_ = converted<double>(circulation_);
  const PericardiumOf<T>& bag = settings_.pericardium;
  plain_bag_ = {value_of(bag.pressure_mmHg), value_of(bag.reference_volume_mL), value_of(bag.exponent)};
  outputs_ = wall_outputs();
  for (const auto& wall : walls_) n_outputs_.push_back(wall->outputs().size());
}

template <class T>
void HeartDriverOf<T>::tell_arterial_pressures() {
  const double arterial[] = {value_of(y_[p_AR_SYS]), value_of(y_[p_AR_PUL])};
  for (const auto& wall : walls_) wall->set_arterial_pressures(arterial);
}

template <class T>
void HeartDriverOf<T>::start(const Values& initial) {
  y_ = initial;
  tell_arterial_pressures();
  for (const auto& wall : walls_) {
    T V[n_chambers], p[n_chambers];
    const auto cavities = wall->cavities();
    for (std::size_t k = 0; k < cavities.size(); ++k) V[k] = y_[cavities[k]];
    wall->start(T(0.0), V, p);
    for (std::size_t k = 0; k < cavities.size(); ++k) p_[cavities[k]] = p[k];
  }
  const T bag = settings_.pericardium.pressure(T(y_[LA] + y_[LV] + y_[RA] + y_[RV]));
  for (T& pressure : p_) pressure += bag;
  Q_ = valve_flows(circulation_, p_.data(), y_.data());
}

template <class T>
void HeartDriverOf<T>::move_to(const Values& values) {
  y_ = values;
  tell_arterial_pressures();
  for (const auto& wall : walls_) {
    T V[n_chambers];
    const auto cavities = wall->cavities();
    for (std::size_t k = 0; k < cavities.size(); ++k) V[k] = y_[cavities[k]];
    wall->move_to(V);
  }
}

// Volumes at the end of the step that the circulation wants, and their derivatives by the pressures.
template <class T>
[[gnu::flatten]] void HeartDriverOf<T>::wanted_volumes(const T* p, const T& step, T* volumes,
                                                       double* slopes) const {
  if (!settings_.stabilise_volumes) {
    for (int c = 0; c < n_chambers; ++c) volumes[c] = y_[c];
    std::fill(slopes, slopes + n_chambers * n_chambers, 0.0);
    return;
  }
  Jet pressure[n_chambers];
  for (int c = 0; c < n_chambers; ++c) pressure[c] = Jet::variable(value_of(p[c]), c);
  CirculationValues y;
  for (int k = 0; k < n_circulation_states; ++k) y[k] = value_of(y_[k]);
  const auto net = chamber_inflows(plain_, pressure, y.data(), valve_flows(plain_, pressure, y.data()));
  const double dt = value_of(step);
  for (int c = 0; c < n_chambers; ++c)
    for (int k = 0; k < n_chambers; ++k) slopes[n_chambers * c + k] = dt * net[c].derivative[k];
  if constexpr (std::is_same_v<T, double>) {
    for (int c = 0; c < n_chambers; ++c) volumes[c] = y_[c] + dt * net[c].value;
  } else {
    const auto gains = chamber_inflows(circulation_, p, y_.data(), valve_flows(circulation_, p, y_.data()));
    for (int c = 0; c < n_chambers; ++c) volumes[c] = y_[c] + step * gains[c];
  }
}

template <class T>
void HeartDriverOf<T>::step(const T& t, BeatAudit& audit) {
  step_over(t, settings_.dt_s, 0, audit);
}

// Newton on the cavity pressures. Throws NumericalFailure if it does not converge.
template <class T>
void HeartDriverOf<T>::balance(const T& t, const T& dt, BeatAudit& audit, std::array<T, n_chambers>& p,
                               std::array<double, n_chambers>& wall_volumes) {
  std::array<T, n_chambers> volume{}, wanted{};
  bool converged = false;
  double volume_tolerance = volume_tolerance_mL, pressure_tolerance = pressure_tolerance_mmHg;
  for (const auto& wall : walls_) {
    volume_tolerance = std::max(volume_tolerance, wall->volume_tolerance_mL());
    pressure_tolerance = std::max(pressure_tolerance, wall->volume_tolerance_mL());
  }
  int iteration = 0;
  double error = 0;
  int worst = 0;
  Vector wall_volume = Vector::Zero();
  // Derivatives follow one iteration behind the values: they are complete after one more.
  bool last = false;
  while (!last && iteration < largest_newton_iterations) {
    if (converged) last = true;
    ++iteration;
    Matrix slopes;
    wanted_volumes(p.data(), dt, wanted.data(), slopes.data());
    // Walls carry the pressure across them: the cavity's less that of the bag, which follows the wanted
    // volumes.
    Vector across_slope = Vector::Zero();
    T bag = 0.0;
    if (settings_.pericardium.present()) {
      const T sum = wanted[LA] + wanted[LV] + wanted[RA] + wanted[RV];
      bag = settings_.pericardium.pressure(sum);
      across_slope = plain_bag_.pressure(Dual<1>::variable(value_of(sum), 0)).derivative[0] *
                     slopes.colwise().sum().transpose();
    }
    Matrix system = Matrix::Zero();
    for (const auto& wall : walls_) {
      const auto cavities = wall->cavities();
      const std::size_t n = cavities.size();
      T pressures[n_chambers], V[n_chambers];
      double C[n_chambers * n_chambers];
      for (std::size_t k = 0; k < n; ++k) pressures[k] = p[cavities[k]] - bag;
      wall->linearise(pressures, V, C);
      for (std::size_t k = 0; k < n; ++k) {
        volume[cavities[k]] = V[k];
        for (std::size_t j = 0; j < n; ++j) system(cavities[k], cavities[j]) = C[n * k + j];
      }
    }
    std::array<T, n_chambers> mismatch;
    for (int c = 0; c < n_chambers; ++c) mismatch[c] = wanted[c] - volume[c];
    const Matrix across = Matrix::Identity() - Vector::Ones() * across_slope.transpose();
    const Matrix inverse = (system * across - slopes).inverse();
    // A diode's kink can make Newton jump to and fro; half steps end that.
    const double damping = iteration > 15 && !last ? 0.5 : 1.0;
    const auto times = [](const Matrix& m, const std::array<T, n_chambers>& x, double factor) {
      std::array<T, n_chambers> y;
      for (int c = 0; c < n_chambers; ++c) {
        y[c] = (factor * m(c, 0)) * x[0];
        for (int k = 1; k < n_chambers; ++k) y[c] += (factor * m(c, k)) * x[k];
      }
      return y;
    };
    const std::array<T, n_chambers> dp = times(inverse, mismatch, damping);
    bool finite = true;
    for (const T& change : dp) finite = finite && std::isfinite(value_of(change));
    if (!finite) {
      converged = false;
      break;
    }
    error = 0;
    for (int c = 0; c < n_chambers; ++c)
      if (std::abs(value_of(mismatch[c])) >= error) {
        error = std::abs(value_of(mismatch[c]));
        worst = c;
      }
    // Walls take the same share of the correction as the pressures do, the least that any of them can.
    const std::array<T, n_chambers> whole_change = times(across, dp, 1.0);
    const auto change_of = [](const WallOf<T>& wall, const std::array<T, n_chambers>& all, T* own) {
      const auto cavities = wall.cavities();
      for (std::size_t k = 0; k < cavities.size(); ++k) own[k] = all[cavities[k]];
    };
    double share = 1;
    for (const auto& wall : walls_) {
      T change[n_chambers];
      change_of(*wall, whole_change, change);
      share = std::min(share, wall->admissible_share(change));
    }
    std::array<T, n_chambers> across_change = whole_change;
    if (share < 1)
      for (T& change : across_change) change *= share;
    for (const auto& wall : walls_) {
      T change[n_chambers];
      change_of(*wall, across_change, change);
      wall->update(change, share);
    }
    Vector plain_change;
    for (int c = 0; c < n_chambers; ++c) {
      wall_volume(c) = value_of(volume[c]);
      plain_change(c) = value_of(across_change[c]);
    }
    wall_volume += system * plain_change;
    double largest_change = 0;
    for (int c = 0; c < n_chambers; ++c) {
      p[c] += share * dp[c];
      largest_change = std::max(largest_change, std::abs(value_of(dp[c])) / (1 + std::abs(value_of(p[c]))));
    }
    converged = share == 1 && largest_change < pressure_tolerance && error < volume_tolerance;
    for (const auto& wall : walls_) converged = converged && wall->balanced();
    if (std::is_same_v<T, double> && converged) last = true;
  }
  audit.newton_iterations += iteration;
  audit.most_newton_iterations = std::max(audit.most_newton_iterations, iteration);
  if (!converged) {
    std::string trouble;
    for (const auto& wall : walls_)
      if (const std::string said = wall->trouble(); !said.empty()) trouble += " " + said;
    throw NumericalFailure(fmt::format(
        "no balance of wall and blood volumes at t = {:.4f} s of the beat: after {} Newton iterations {} "
        "still misses {:.3g} mL at {:.3g} mmHg.{} Try a smaller dt_s (now {} s){}.",
        value_of(t) + value_of(dt), iteration, chamber_names[worst], error, value_of(p[worst]), trouble,
        value_of(dt),
        settings_.stabilise_volumes ? "" : ", or stabilise volumes (solver.stabilise.volumes = true)"));
  }
  for (int c = 0; c < n_chambers; ++c) wall_volumes[c] = wall_volume(c);
}

template <class T>
void HeartDriverOf<T>::step_over(const T& t, const T& dt, int halvings, BeatAudit& audit) {
  tell_arterial_pressures();
  for (const auto& wall : walls_) wall->begin_step(t, dt);
  std::array<T, n_chambers> p = p_;
  std::array<double, n_chambers> wall_volume{};
  try {
    balance(t, dt, audit, p, wall_volume);
    for (const auto& wall : walls_) wall->confirm_step();
  } catch (const NumericalFailure&) {
    bool may_halve = false;
    for (const auto& wall : walls_) {
      wall->reject_step();
      may_halve = may_halve || wall->may_halve_steps();
    }
    if (!may_halve || halvings == most_step_halvings) throw;
    const T half = 0.5 * dt;
    step_over(t, half, halvings + 1, audit);
    step_over(t + half, half, halvings + 1, audit);
    return;
  }
  for (const auto& wall : walls_) wall->accept_step();

  p_ = p;
  Q_ = valve_flows(circulation_, p_.data(), y_.data());
  Values rates;
  circulation_rates(circulation_, y_.data(), p_.data(), Q_, rates.data());
  if constexpr (std::is_same_v<T, double>)
    audit.dissipated_mmHg_mL += dt * dissipated_power(circulation_, y_.data(), p_.data(), Q_);
  if (settings_.implicit_inductors) {
    for (int v = 0; v < n_vessels; ++v)
      rates[n_nodes + v] /= 1.0 + dt * circulation_.vessels[v].R / circulation_.vessels[v].L;
  }
  for (int k = 0; k < n_circulation_states; ++k) y_[k] += dt * rates[k];
  for (int c = 0; c < n_chambers; ++c) {
    audit.chamber_work_mmHg_mL -= value_of(p_[c]) * value_of(dt) * value_of(rates[c]);
    audit.volume_mismatch_mL = std::max(audit.volume_mismatch_mL, std::abs(wall_volume[c] - value_of(y_[c])));
  }
  for (int v = 0; v < n_valves; ++v) audit.valve_volume_mL[v] += value_of(dt) * value_of(Q_[v]);
  for (int k = 0; k < n_circulation_states; ++k)
    if (!std::isfinite(value_of(y_[k])) || std::abs(value_of(y_[k])) > 1e6)
      throw NumericalFailure(fmt::format(
          "the circulation diverged at t = {:.4f} s of the beat: {} = {:.3g} {}. Its explicit "
          "step is stable below "
          "{:.2f} ms (2 L/R of the stiffest branch); dt_s is {} s. Take a smaller step{}.",
          value_of(t) + value_of(dt), circulation_state_quantities[k].name, value_of(y_[k]),
          circulation_state_quantities[k].unit, 1e3 * largest_explicit_step(plain_), value_of(dt),
          settings_.stabilise_volumes ? "" : ", or stabilise volumes (solver.stabilise.volumes = true)"));
}

template <class T>
std::vector<WallOutput> HeartDriverOf<T>::wall_outputs() const {
  std::vector<WallOutput> all;
  for (const auto& wall : walls_) {
    const auto cavities = wall->cavities();
    const std::string name(cavities.size() == 1   ? chamber_names[cavities.front()]
                           : cavities.size() == 2 ? "ventricles"
                                                  : "heart");
    for (WallOutput output : wall->outputs()) {
      output.name = name + "." + output.name;
      all.push_back(std::move(output));
    }
  }
  return all;
}

template <class T>
Table HeartDriverOf<T>::trace() const {
  Table table = circulation_table(plain_);
  for (const WallOutput& output : outputs_) table.add(output.name, output.unit, output.meaning);
  return table;
}

namespace {
struct PlainRow {
  double y[n_circulation_states], p[n_chambers];
  std::array<double, n_valves> Q;
};
}  // namespace

template <class T>
void HeartDriverOf<T>::record(Table& table, double t) const {
  PlainRow row;
  for (int k = 0; k < n_circulation_states; ++k) row.y[k] = value_of(y_[k]);
  for (int c = 0; c < n_chambers; ++c) row.p[c] = value_of(p_[c]);
  for (int v = 0; v < n_valves; ++v) row.Q[v] = value_of(Q_[v]);
  append_circulation_row(plain_, table, t, row.y, row.p, row.Q);
  std::vector<double> values(outputs_.size());
  double* at = values.data();
  for (std::size_t w = 0; w < walls_.size(); at += n_outputs_[w++]) walls_[w]->output_values(at);
  const std::size_t first = circulation_columns(plain_);
  for (std::size_t k = 0; k < values.size(); ++k) table.columns[first + k].values.push_back(values[k]);
}

template <class T>
void HeartDriverOf<T>::show(double t, PhysicalSense& sense) const {
  PlainRow row;
  for (int k = 0; k < n_circulation_states; ++k) row.y[k] = value_of(y_[k]);
  for (int c = 0; c < n_chambers; ++c) row.p[c] = value_of(p_[c]);
  for (int v = 0; v < n_valves; ++v) row.Q[v] = value_of(Q_[v]);
  sense.see(t, row.y, row.p, row.Q);
  std::vector<double> values(outputs_.size());
  double* at = values.data();
  for (std::size_t w = 0; w < walls_.size(); at += n_outputs_[w++]) walls_[w]->output_values(at);
  for (std::size_t k = 0; k < values.size(); ++k)
    sense.see(t, outputs_[k].name, outputs_[k].unit, values[k], outputs_[k].lower, outputs_[k].upper);
}

template <class T>
PhysicalSense HeartDriverOf<T>::sense_of(const Table& trace) const {
  PhysicalSense sense;
  const std::size_t first_wall_column = circulation_columns(plain_);
  for (std::size_t k = 0; k < trace.n_rows(); ++k) {
    const auto at = [&](std::size_t column) { return trace.columns[column].values[k]; };
    PlainRow row;
    for (int i = 0; i < n_circulation_states; ++i) row.y[i] = at(1 + i);
    for (int c = 0; c < n_chambers; ++c) row.p[c] = at(1 + n_circulation_states + c);
    for (int v = 0; v < n_valves; ++v) row.Q[v] = at(1 + n_circulation_states + n_chambers + v);
    sense.see(at(0), row.y, row.p, row.Q);
    for (std::size_t i = 0; i < outputs_.size(); ++i)
      sense.see(at(0), outputs_[i].name, outputs_[i].unit, at(first_wall_column + i), outputs_[i].lower,
                outputs_[i].upper);
  }
  return sense;
}

template <class T>
BeatAudit HeartDriverOf<T>::beat(Table* table) {
  if (table) {
    require_memory(static_cast<double>(n_steps_), static_cast<double>(table->columns.size()),
                   fmt::format("a beat of {} s in steps of {} s", value_of(settings_.period_s),
                               value_of(settings_.dt_s)),
                   "Take a larger solver.dt_s.");
    table->clear_rows();
  }
  return beat_rows([&](const T& time) {
    if (table) record(*table, value_of(time));
  });
}

template <class T>
BeatAudit HeartDriverOf<T>::beat_rows(const std::function<void(const T&)>& on_row) {
  BeatAudit audit;
  const double volume = value_of(total_volume(circulation_, y_.data()));
  on_row(T(0.0));
  for (long n = 0; n < n_steps_; ++n) {
    check_interrupt();
    step(static_cast<double>(n) * settings_.dt_s, audit);
    on_row(static_cast<double>(n + 1) * settings_.dt_s);
  }
  audit.blood_volume_change_mL = value_of(total_volume(circulation_, y_.data())) - volume;
  return audit;
}

// Rows of a beat: of very short steps every n-th, so that a beat does not fill the memory.
template <class T>
long HeartDriverOf<T>::steps_per_row() const {
  const long least = (n_steps_ + most_rows_per_beat - 1) / most_rows_per_beat;
  for (long n = least; n <= 10 * least; ++n)
    if (n_steps_ % n == 0) return n;
  return least;
}

template <class T>
long HeartDriverOf<T>::rows_after(long steps) const {
  const long n = steps_per_row();
  return 1 + steps / n + (steps == n_steps_ && steps % n != 0 ? 1 : 0);
}

template <class T>
BeatUnderWay HeartDriverOf<T>::begin_beat() const {
  BeatUnderWay beat;
  beat.trace = trace();
  beat.blood_volume_mL = value_of(total_volume(circulation_, y_.data()));
  record(beat.trace, 0);
  return beat;
}

template <class T>
bool HeartDriverOf<T>::step_beat(BeatUnderWay& beat) {
  step(static_cast<double>(beat.steps) * settings_.dt_s, beat.audit);
  ++beat.steps;
  if (beat.steps % steps_per_row() == 0 || beat.steps == n_steps_)
    record(beat.trace, static_cast<double>(beat.steps) * value_of(settings_.dt_s));
  beat.audit.blood_volume_change_mL = value_of(total_volume(circulation_, y_.data())) - beat.blood_volume_mL;
  return beat.steps == n_steps_;
}

template <class T>
std::vector<T> HeartDriverOf<T>::save() const {
  std::vector<T> out(y_.begin(), y_.end());
  out.insert(out.end(), p_.begin(), p_.end());
  out.insert(out.end(), Q_.begin(), Q_.end());
  for (const auto& wall : walls_) wall->save(out);
  return out;
}

template <class T>
void HeartDriverOf<T>::restore(const std::vector<T>& saved) {
  std::span<const T> in = saved;
  for (T& value : y_) value = take_saved(in);
  for (T& value : p_) value = take_saved(in);
  for (T& value : Q_) value = take_saved(in);
  for (const auto& wall : walls_) wall->restore(in);
  if (!in.empty())
    throw InputError("the saved state is of another heart: it has more numbers than this one takes");
}

template class HeartDriverOf<double>;
template class HeartDriverOf<Tangent>;

}  // namespace wiggers
