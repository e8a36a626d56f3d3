#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <set>
#include <wiggers/circulation/loop.hpp>
#include <wiggers/circulation/loop_beat.hpp>
#include <wiggers/core/cvode.hpp>
#include <wiggers/core/dual.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/limit_cycle_solve.hpp>
#include <wiggers/core/memory.hpp>
#include <wiggers/core/progress.hpp>

namespace wiggers {

namespace {

using Jet = Dual<n_circulation_states>;

constexpr int rows_watched = 200;  // of a beat, where the integrator chooses its own steps

// A cycle that a finer integrator moves by more than this (scaled: 2 mL, 0.2 mmHg) is the integrator's.
constexpr double largest_shift = 0.02;

template <bool with_shunts, class T>
void loop_rates_of(const Loop& loop, double t, const T* y, T* dy) {
  T p[n_chambers];
  loop_pressures(loop, t, y, p);
  const auto Q = valve_flows(loop.circulation, p, y);
  if constexpr (with_shunts)
    circulation_rates<T>(loop.circulation, y, p, Q, dy);
  else
    rates_without_shunts<T>(loop.circulation, y, p, Q, dy);
}
// For steps of a fixed length, where a call costs as much as its work.
[[gnu::flatten]] void loop_rates_without_shunts(const Loop& loop, double t, const double* y, double* dy) {
  loop_rates_of<false>(loop, t, y, dy);
}
template <class T>
void loop_rates(const Loop& loop, double t, const T* y, T* dy) {
  if (loop.circulation.has_shunts())
    loop_rates_of<true>(loop, t, y, dy);
  else
    loop_rates_of<false>(loop, t, y, dy);
}

void check_state(const double* y, double t) {
  for (int k = 0; k < n_circulation_states; ++k)
    if (!std::isfinite(y[k]) || std::abs(y[k]) > 1e6)
      throw NumericalFailure(
          fmt::format("the loop diverged: {} = {} {} at t = {:.4g} s of the beat. Try a smaller "
                      "step, or integrator cvode.",
                      circulation_state_quantities[k].name, y[k], circulation_state_quantities[k].unit, t));
}

}  // namespace

std::size_t circulation_columns(const CirculationParameters& c) {
  std::size_t n = 1 + n_circulation_states + n_chambers + n_valves;
  for (const auto& shunt : c.shunts) n += shunt.present;
  return n;
}

Table circulation_table(const CirculationParameters& c) {
  Table table;
  table.add("t_s", "s", "time within the beat");
  for (const Quantity& q : circulation_state_quantities)
    table.add(std::string(q.name), std::string(q.unit), std::string(q.meaning));
  for (std::string_view chamber : chamber_names)
    table.add(fmt::format("p_{}", chamber), "mmHg", fmt::format("pressure in {}", chamber));
  for (std::string_view valve : valve_names)
    table.add(fmt::format("Q_{}", valve), "mL/s", fmt::format("flow through {}, forward positive", valve));
  for (int s = 0; s < n_shunts; ++s)
    if (c.shunts[s].present)
      table.add(fmt::format("Q_{}", shunt_names[s]), "mL/s",
                fmt::format("flow through the {}, from {} to {}", network::shunts[s].meaning,
                            network::node_name(network::shunts[s].from),
                            network::node_name(network::shunts[s].to)));
  return table;
}

void append_circulation_row(const CirculationParameters& c, Table& table, double t, const double* y,
                            const double* p, const std::array<double, n_valves>& Q) {
  std::size_t column = 0;
  table.columns[column++].values.push_back(t);
  for (int k = 0; k < n_circulation_states; ++k) table.columns[column++].values.push_back(y[k]);
  for (int k = 0; k < n_chambers; ++k) table.columns[column++].values.push_back(p[k]);
  for (int k = 0; k < n_valves; ++k) table.columns[column++].values.push_back(Q[k]);
  for_each_shunt_flow(c, p, y, [&](int, double flow) { table.columns[column++].values.push_back(flow); });
}

LimitCycleSettings loop_cycle_settings(double distance) {
  LimitCycleSettings settings;
  settings.distance = distance;
  settings.plain_beats = 2;
  settings.relaxing_beats = 0;
  return settings;
}

namespace {
// Times the distance asked for: the change over a beat below which the next may be the last.
constexpr double near_the_end = 1e3;
}  // namespace

std::vector<double> circulation_scales() {
  std::vector<double> scales(n_circulation_states, 100);
  std::fill_n(scales.begin() + n_chambers, n_vessels, 10);
  return scales;
}

LoopSolver::LoopSolver(Loop loop, LoopIntegrator integrator)
    : loop_(std::move(loop)), integrator_(std::move(integrator)) {
  if (std::find(loop_integrators.begin(), loop_integrators.end(), integrator_.name) == loop_integrators.end())
    refuse_unknown("integrator", integrator_.name,
                   std::vector<std::string>(loop_integrators.begin(), loop_integrators.end()));
  if (!(integrator_.relative_tolerance >= 1e-13 && integrator_.relative_tolerance <= 0.1))
    throw InputError(fmt::format("rtol = {} is outside 1e-13 to 0.1", integrator_.relative_tolerance));
  if (!(integrator_.absolute_tolerance >= 1e-14 && integrator_.absolute_tolerance <= 1))
    throw InputError(fmt::format("atol = {} is outside 1e-14 to 1", integrator_.absolute_tolerance));
  if (!(integrator_.dt_s >= 1e-7 && integrator_.dt_s <= loop_.period_s))
    throw InputError(
        fmt::format("dt = {} s is outside 1e-7 to the period, {} s", integrator_.dt_s, loop_.period_s));
  std::set<double> breaks;
  for (const ElastanceParameters& e : loop_.elastance)
    for (double offset : {0.0, e.TC, e.TC + e.TR}) {
      const double t = wrapped(e.tC + offset, loop_.period_s);
      if (t > 1e-12 * loop_.period_s && t < (1 - 1e-12) * loop_.period_s) breaks.insert(t);
    }
  // Instants that differ by rounding only are one.
  for (double t : breaks)
    if (breaks_.empty() || t - breaks_.back() > 1e-9 * loop_.period_s) breaks_.push_back(t);
  if (integrator_.name == "runge-kutta-4")
    steps_ = std::make_shared<LoopBeat<double>>(loop_, integrator_.dt_s);
}

std::array<double, n_chambers> LoopSolver::pressures(double t, const double* y) const {
  std::array<double, n_chambers> p{};
  loop_pressures(loop_, t, y, p.data());
  return p;
}

void LoopSolver::beat(CirculationValues& state, double sample_s, Table* table, PhysicalSense* sense) const {
  const double period = loop_.period_s;
  const auto record = [&](double t) {
    const auto p = pressures(t, state.data());
    append_circulation_row(loop_.circulation, *table, t, state.data(), p.data(),
                           valve_flows(loop_.circulation, p.data(), state.data()));
  };
  const auto watch = [&](double t, const double* y) {
    const auto p = pressures(t, y);
    sense->see(t, y, p.data(), valve_flows(loop_.circulation, p.data(), y));
  };
  // Where to stop: break points of the activation (restart there), sample times, the end.
  std::set<double> stops(breaks_.begin(), breaks_.end());
  std::set<double> samples;
  if (table) {
    require_memory(period / sample_s, static_cast<double>(table->columns.size()),
                   fmt::format("a row every {} s over {} s", sample_s, period), "Take fewer rows.");
    const auto n = static_cast<long>(std::floor(period / sample_s * (1 + 1e-12)));
    for (long k = 0; k <= n; ++k) {
      double t = std::min(period, static_cast<double>(k) * sample_s);
      for (double stop : breaks_)
        if (std::abs(stop - t) < 1e-9 * period) t = stop;
      samples.insert(t);
    }
    if (period - *samples.rbegin() < 1e-9 * period && *samples.rbegin() < period)
      samples.erase(std::prev(samples.end()));
    samples.insert(period);
    stops.insert(samples.begin(), samples.end());
    record(0);
  }
  stops.insert(period);
  stops.erase(0.0);

  if (integrator_.name == "cvode") {
    OdeSystem system;
    system.size = n_circulation_states;
    system.derivative = [this](double t, const double* y, double* dy) {
      loop_rates<double>(loop_, t, y, dy);
    };
    system.jacobian = [this](double t, const double* y, double* jacobian) {
      Jet yd[n_circulation_states], dy[n_circulation_states];
      for (int k = 0; k < n_circulation_states; ++k) yd[k] = Jet::variable(y[k], k);
      loop_rates<Jet>(loop_, t, yd, dy);
      for (int column = 0; column < n_circulation_states; ++column)
        for (int row = 0; row < n_circulation_states; ++row)
          jacobian[row + n_circulation_states * column] = dy[row].derivative[column];
    };
    Cvode solver(system, {integrator_.relative_tolerance,
                          std::vector<double>(n_circulation_states, integrator_.absolute_tolerance)});
    std::vector<double> y(state.begin(), state.end());
    solver.restart(0, y);
    std::vector<double> ends = breaks_;
    ends.push_back(period);
    double begin = 0;
    for (double stop : stops) {
      if (sense) {
        const double parts = std::ceil((stop - begin) / period * rows_watched);
        for (int k = 0; k < parts; ++k) {
          const double t = begin + (stop - begin) * k / parts;
          watch(t, solver.advance(t, *std::lower_bound(ends.begin(), ends.end(), stop)).data());
        }
        begin = stop;
      }
      // Rows between break points are interpolated.
      y = solver.advance(stop, *std::lower_bound(ends.begin(), ends.end(), stop));
      std::copy(y.begin(), y.end(), state.begin());
      check_state(state.data(), stop);
      if (table && samples.count(stop)) record(stop);
      if (stop < period && std::binary_search(breaks_.begin(), breaks_.end(), stop)) solver.restart(stop, y);
    }
    return;
  }

  if (integrator_.name == "runge-kutta-4") {
    const std::vector<double> sample_times(samples.begin(), samples.end());
    auto next = sample_times.begin();
    int step = 0;
    if (next != sample_times.end()) ++next;  // the start is recorded already
    steps_->run(
        state.data(),
        [&](double t, const double* y, const double* p, const ValveStates& open) {
          check_state(y, t);
          // What is unphysical is so for longer than a few steps.
          if (sense && step++ % 4 == 0) sense->see(t, y, p, flows_when(loop_, open, p, y));
          if (next == sample_times.end() || t < *next - 1e-9 * period) return;
          record(*next);
          ++next;
        },
        sample_times);
    return;
  }

  double t = 0;
  CirculationValues k1;
  const bool shunts = loop_.circulation.has_shunts();
  for (double stop : stops) {
    const auto n = static_cast<long>(std::ceil((stop - t) / integrator_.dt_s * (1 - 1e-12)));
    const double h = (stop - t) / static_cast<double>(n);
    for (long step = 0; step < n; ++step) {
      if ((step & 63) == 63) check_interrupt();
      const double now = t + static_cast<double>(step) * h;
      if (shunts)
        loop_rates(loop_, now, state.data(), k1.data());
      else
        loop_rates_without_shunts(loop_, now, state.data(), k1.data());
      for (int i = 0; i < n_circulation_states; ++i) state[i] += h * k1[i];
      if (sense) watch(t + static_cast<double>(step + 1) * h, state.data());
    }
    t = stop;
    check_state(state.data(), t);
    if (table && samples.count(stop)) record(stop);
  }
}

LimitCycleCertificate LoopSolver::search(CirculationValues& state, LimitCycleSettings settings,
                                         const std::function<void(const LimitCycleCertificate&)>& after_beat,
                                         PhysicalSense* sense) const {
  if (integrator_.name == "cvode") settings.map_noise = integrator_.relative_tolerance;
  const double volume = total_volume(loop_.circulation, state.data());
  BeatMap map;
  map.scales = circulation_scales();
  // A look at every step costs a tenth of a beat: beats are looked at once the end is near.
  double residual = std::numeric_limits<double>::infinity();
  bool looked_at = false;
  map.beat = [&](const std::vector<double>& start) {
    CirculationValues image;
    std::copy(start.begin(), start.end(), image.begin());
    looked_at = sense && residual < near_the_end * settings.distance;
    if (looked_at) *sense = {};  // of the latest beat
    beat(image, 0, nullptr, looked_at ? sense : nullptr);
    return std::vector<double>(image.begin(), image.end());
  };
  map.admit = [&](std::vector<double>& proposal) {
    hold_total_volume(loop_.circulation, proposal.data(), volume);
  };
  std::vector<double> y(state.begin(), state.end());
  LimitCycleCertificate certificate = find_limit_cycle(map, settings, y, [&](const LimitCycleCertificate& c) {
    residual = c.residual;
    if (after_beat) after_beat(c);
  });
  std::copy(y.begin(), y.end(), state.begin());
  if (sense && certificate.good() && !looked_at) {
    CirculationValues last = state;
    *sense = {};
    beat(last, 0, nullptr, sense);
  }
  return certificate;
}

LimitCycleCertificate LoopSolver::to_limit_cycle(
    CirculationValues& state, LimitCycleSettings settings,
    const std::function<void(const LimitCycleCertificate&)>& after_beat) const {
  const bool adaptive = integrator_.name == "cvode";
  PhysicalSense sense;
  LimitCycleCertificate certificate = search(state, settings, after_beat, &sense);
  if (!certificate.good()) return certificate;
  if (const auto& finding = sense.finding()) {
    certificate.verdict = LimitCycleVerdict::unphysical;
    certificate.reason = finding->text();
    return certificate;
  }
  const bool may_be_coarse =
      integrator_.name == "forward-euler" || (adaptive && integrator_.relative_tolerance > 1e-6);
  if (!may_be_coarse) return certificate;
  const auto shift = integrator_shift(state);
  if (shift && *shift <= largest_shift) return certificate;
  certificate.verdict = LimitCycleVerdict::not_converged;
  certificate.reason = fmt::format(
      "{} is too coarse for this loop: {} {}. Take {}.", integrator_.name,
      adaptive ? "with a tolerance ten times smaller" : "with half the step",
      shift ? fmt::format("the cycle is {:.2g} away (scaled; {} is allowed)", *shift, largest_shift)
            : "there is no cycle",
      adaptive ? "a smaller rtol" : "a smaller step, runge-kutta-4, or cvode");
  return certificate;
}

std::optional<double> LoopSolver::integrator_shift(const CirculationValues& on_cycle) const {
  LoopIntegrator finer = integrator_;
  finer.dt_s *= 0.5;
  finer.relative_tolerance = std::max(1e-13, 0.1 * finer.relative_tolerance);
  finer.absolute_tolerance = std::max(1e-14, 0.1 * finer.absolute_tolerance);
  CirculationValues moved = on_cycle;
  LimitCycleSettings settings = loop_cycle_settings(1e-8);
  settings.max_beats = 100;
  try {
    if (!LoopSolver(loop_, finer).search(moved, settings, {}, nullptr).good()) return {};
  } catch (const NumericalFailure&) {
    return {};
  }
  const std::vector<double> scales = circulation_scales();
  double largest = 0;
  for (std::size_t i = 0; i < moved.size(); ++i)
    largest = std::max(largest, std::abs(moved[i] - on_cycle[i]) / scales[i]);
  return largest;
}

}  // namespace wiggers
