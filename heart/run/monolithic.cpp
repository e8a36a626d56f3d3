#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numeric>
#include <set>
#include <wiggers/cellmodels/catalogue/force_stepper.hpp>
#include <wiggers/cellmodels/pacing/pacing.hpp>
#include <wiggers/circulation/loop.hpp>
#include <wiggers/core/cvode.hpp>
#include <wiggers/core/dual.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/ida.hpp>
#include <wiggers/core/limit_cycle_solve.hpp>
#include <wiggers/core/progress.hpp>
#include <wiggers/core/units.hpp>
#include <wiggers/heart/run/monolithic.hpp>
#include <wiggers/heart/run/paced_cells.hpp>
#include <wiggers/heart/scene/wall_kind.hpp>

namespace wiggers {

namespace {

// Calcium of one beat at equal spacing, periodic; cubic through the four nearest points.
struct CalciumTrace {
  std::vector<double> values_uM;
  double period_s = 1;
  double lowest = 0;
  double at(double t) const {
    const auto n = static_cast<long>(values_uM.size());
    const double x = wrapped(t, period_s) / period_s * static_cast<double>(n);
    const long k = std::min(static_cast<long>(x), n - 1);
    const double s = x - static_cast<double>(k);
    const auto v = [&](long i) { return values_uM[static_cast<std::size_t>((k + i + n) % n)]; };
    return v(0) + 0.5 * s *
                      (v(1) - v(-1) +
                       s * (2 * v(-1) - 5 * v(0) + 4 * v(1) - v(2) + s * (3 * (v(0) - v(1)) + v(2) - v(-1))));
  }
};

CalciumTrace calcium_trace_of(const Scene& scene, const CellType& type) {
  CalciumTrace trace;
  trace.period_s = scene.period_s;
  const double period_ms = scene.period_s * units::ms_per_s;
  if (!type.ionic) {
    trace.lowest = type.transient.rest_uM;
    const auto n = static_cast<long>(std::lround(period_ms / 0.05));
    for (long k = 0; k < n; ++k) {
      PrescribedCalcium source(type.transient, period_ms, 0);
      source.advance(0, static_cast<double>(k) * scene.period_s / static_cast<double>(n));
      trace.values_uM.push_back(source.calcium_uM());
    }
    return trace;
  }
  PacedCell cell(*type.ionic, type.ionic_parameters, {period_ms, type.stimulus}, {"cvode", 1e-10, 1e-12, 0});
  std::vector<double> state = type.ionic->default_state();
  LimitCycleSettings settings;
  settings.distance = 1e-6;
  settings.attractor = Attractor::paced;
  if (type.from_limit_cycle) {
    const auto certificate =
        cell.to_limit_cycle(state, settings, [](const LimitCycleCertificate&) { check_interrupt(); });
    if (certificate.distance > 1e-4)
      require_one_beat_cycle(certificate, type.name, *type.ionic, 1e-3 * period_ms);
  }
  const double sample_ms = period_ms / std::lround(period_ms / 0.05);
  cell.beat(state, sample_ms, [&](double, const double* y, double) {
    trace.values_uM.push_back(1e3 * y[type.ionic->cytosolic_calcium]);
  });
  trace.values_uM.pop_back();  // the end is the beginning
  CalciumRescaling rescaling = type.rescaling;
  const double diastolic = *std::min_element(trace.values_uM.begin(), trace.values_uM.end());
  if (rescaling.reading == CalciumReading::peak) rescaling.diastolic_uM = diastolic;
  for (double& value : trace.values_uM) value = rescaling(value);
  trace.lowest = *std::min_element(trace.values_uM.begin(), trace.values_uM.end());
  return trace;
}

struct Fibre {
  const FibrePlan* plan = nullptr;
  const CalciumTrace* calcium = nullptr;
  std::unique_ptr<ForceStepper> force;
  std::unique_ptr<CellEquations> equations;
  double activation_s = 0;
  std::size_t offset = 0;  // of its states
  std::vector<double> rest;
};

}  // namespace

struct MonolithicHeart::Implementation {
  Scene scene;
  MonolithicSettings settings;
  std::map<std::string, CalciumTrace> calcium;
  std::array<std::unique_ptr<ContinuousWall>, n_chambers> walls;
  std::array<int, n_chambers> fibre_of{-1, -1, -1, -1};
  std::vector<Fibre> fibres;
  std::size_t n_differential = n_circulation_states;
  std::vector<double> state;  // differential
  std::array<double, n_chambers> pressures_guess{};
  std::set<double> breaks;
  bool damped = false;
  double volume = 0;

  // Tension above rest (kPa) and its excess (negative: at rest).
  double tension(const Fibre& f, const double* y, double lambda, double* excess) const {
    const double SL = f.force->reference_length_um() * lambda;
    const double T = f.force->forces(y + f.offset, SL).tension_kPa;
    const double rest =
        f.plan->settings.subtract_rest_tension ? f.force->forces(f.rest.data(), SL).tension_kPa : 0.0;
    if (excess) *excess = T - rest;
    return f.plan->settings.subtract_rest_tension ? std::max(0.0, T - rest) : T;
  }
  // Pressure (mmHg) of a chamber: of its wall at a volume and its rate (mL/s), and of the bag.
  double pressure(int c, double t, const double* y, double dV_dt) const {
    const ContinuousWall& wall = *walls[c];
    double T = 0;
    if (fibre_of[c] >= 0) {
      const Fibre& f = fibres[static_cast<std::size_t>(fibre_of[c])];
      if (f.plan->settings.active) T = tension(f, y, wall.stretch(y[c], nullptr), nullptr);
    }
    return wall.pressure(t, y[c], dV_dt, T) +
           scene.pericardium.pressure(std::accumulate(y + 1, y + n_chambers, y[0]));
  }
  // All rates for given pressures.
  void rates(double t, const double* y, const double* p, double* dy) const {
    const auto Q = valve_flows(scene.circulation, p, y);
    circulation_rates<double>(scene.circulation, y, p, Q, dy);
    for (int c = 0; c < n_chambers; ++c) {
      if (fibre_of[c] < 0) continue;
      const Fibre& f = fibres[static_cast<std::size_t>(fibre_of[c])];
      double slope = 0;
      const double lambda = walls[c]->stretch(y[c], &slope);
      const double SL0 = f.force->reference_length_um();
      const double velocity = scene.rate == RateScheme::none ? 0.0 : SL0 * slope * dy[c];
      const double in[3] = {f.calcium->at(t - f.activation_s), SL0 * lambda, velocity};
      f.equations->evaluate(y + f.offset, in, dy + f.offset, nullptr);
    }
  }
  void explicit_pressures(double t, const double* y, double* p) const {
    for (int c = 0; c < n_chambers; ++c) p[c] = pressure(c, t, y, 0);
  }
  // Where the right-hand side has kinks: pressure across each valve, tension above rest.
  std::size_t n_roots() const { return n_valves + fibres.size(); }
  void roots(const double* y, const double* p, double* values) const {
    const auto drops = valve_drops(p, y);
    std::copy(drops.begin(), drops.end(), values);
    for (std::size_t k = 0; k < fibres.size(); ++k) values[n_valves + k] = 1;
    for (int c = 0; c < n_chambers; ++c)
      if (fibre_of[c] >= 0)
        (void)tension(fibres[static_cast<std::size_t>(fibre_of[c])], y, walls[c]->stretch(y[c], nullptr),
                      &values[n_valves + fibre_of[c]]);
  }
  std::vector<double> absolute() const {
    std::vector<double> a;
    const double r = settings.relative_tolerance;
    a.assign(n_differential, 0.1 * r);
    // Probabilities are of size one; what else a force model has (moments, distortions) is small.
    for (const Fibre& f : fibres)
      for (std::size_t i = 0; i < f.rest.size(); ++i) {
        const Quantity& q = f.plan->force->states[i];
        a[f.offset + i] = (q.lower == 0 && q.upper == 1 ? 1e-2 : 1e-4) * r;
      }
    return a;
  }

  using Output = std::function<void(double, const double* y, const double* p)>;
  void integrate(std::vector<double>& y, double sample_s, const Output& output) {
    // Break points that differ by rounding are one.
    std::set<double> stops;
    for (double t : breaks)
      if (stops.empty() || t - *stops.rbegin() > 1e-9 * scene.period_s) stops.insert(t);
    const auto n = output ? std::lround(scene.period_s / sample_s) : 0;
    std::vector<double> samples;
    for (long k = 1; k <= n; ++k)
      samples.push_back(scene.period_s * static_cast<double>(k) / static_cast<double>(n));
    stops.insert(scene.period_s);
    if (uses_ida())
      integrate_dae(y, stops, samples, output);
    else
      integrate_ode(y, stops, samples, output);
  }
  void integrate_ode(std::vector<double>& y, const std::set<double>& stops,
                     const std::vector<double>& samples, const Output& output) {
    std::array<double, n_chambers> p{};
    OdeSystem system;
    system.size = n_differential;
    system.derivative = [&](double t, const double* x, double* dx) {
      double now[n_chambers];
      explicit_pressures(t, x, now);
      rates(t, x, now, dx);
    };
    system.n_roots = n_roots();
    system.roots = [&](double t, const double* x, double* values) {
      double now[n_chambers];
      explicit_pressures(t, x, now);
      roots(x, now, values);
    };
    Cvode solver(system, {settings.relative_tolerance, absolute()});
    const auto emit = [&](double t, const std::vector<double>& x) {
      explicit_pressures(t, x.data(), p.data());
      output(t, x.data(), p.data());
    };
    if (output) emit(0, y);
    double begin = 0;
    std::size_t next = 0;
    for (double stop : stops) {
      solver.restart(begin, y);
      for (; next < samples.size() && samples[next] < stop - 1e-12; ++next)
        emit(samples[next], solver.advance(samples[next], stop));
      y = solver.advance(stop);
      if (next < samples.size() && samples[next] <= stop + 1e-12) {
        emit(stop, y);
        ++next;
      }
      begin = stop;
    }
  }
  void integrate_dae(std::vector<double>& y, const std::set<double>& stops,
                     const std::vector<double>& samples, const Output& output) {
    DaeSystem system;
    system.size = n_differential + n_chambers;
    system.differential.assign(n_differential, true);
    system.differential.resize(system.size, false);
    system.residual = [&](double t, const double* x, const double* dx, double* r) {
      std::vector<double> now(n_differential);
      const double* p = x + n_differential;
      rates(t, x, p, now.data());
      for (std::size_t i = 0; i < n_differential; ++i) r[i] = dx[i] - now[i];
      // The volumes' rates as the flows give them, so that no algebraic equation contains y'.
      for (int c = 0; c < n_chambers; ++c)
        r[n_differential + static_cast<std::size_t>(c)] =
            p[c] - pressure(c, t, x, now[static_cast<std::size_t>(c)]);
    };
    system.n_roots = n_roots();
    system.roots = [&](double, const double* x, double* values) { roots(x, x + n_differential, values); };
    std::vector<double> tolerances = absolute();
    tolerances.resize(system.size, settings.relative_tolerance);
    Ida solver(system, settings.relative_tolerance, tolerances);
    std::vector<double> x = y, dx(system.size, 0.0);
    x.insert(x.end(), pressures_guess.begin(), pressures_guess.end());
    double begin = 0;
    std::size_t next = 0;
    for (double stop : stops) {
      // Newton starts from y' that belongs to the pressures at hand.
      rates(begin, x.data(), x.data() + n_differential, dx.data());
      solver.restart(begin, x, dx, std::min(stop, begin + 1e-3));
      if (begin == 0 && output) {
        const std::vector<double>& start = solver.advance(0, stop);
        output(0, start.data(), start.data() + n_differential);
      }
      for (; next < samples.size() && samples[next] < stop - 1e-12; ++next) {
        const std::vector<double>& now = solver.advance(samples[next], stop);
        output(samples[next], now.data(), now.data() + n_differential);
      }
      x = solver.advance(stop, stop);
      dx = solver.derivatives();
      if (next < samples.size() && samples[next] <= stop + 1e-12) {
        output(stop, x.data(), x.data() + n_differential);
        ++next;
      }
      begin = stop;
    }
    std::copy(x.begin(), x.begin() + static_cast<long>(n_differential), y.begin());
    std::copy(x.begin() + static_cast<long>(n_differential), x.end(), pressures_guess.begin());
  }
  bool uses_ida() const { return damped || settings.as_dae; }
};

bool MonolithicHeart::has_equations(const WallPlan& wall) {
  return wall.fibres.size() <= 1 && wall.recipe->continuous(1) != nullptr;
}

MonolithicHeart::MonolithicHeart(const Scene& scene, MonolithicSettings settings)
    : implementation_(std::make_unique<Implementation>()) {
  Implementation& m = *implementation_;
  m.scene = scene;
  m.settings = settings;
  for (const WallPlan& plan : m.scene.walls)
    if (!has_equations(plan))
      throw InputError(
          fmt::format("the monolithic reference has no equations of a {} wall in continuous time; use "
                      "reduced or elastance "
                      "walls",
                      plan.kind));
  for (const auto& [name, type] : m.scene.cells) m.calcium.emplace(name, calcium_trace_of(m.scene, type));
  m.state.assign(scene.initial.begin(), scene.initial.end());
  for (const WallPlan& plan : m.scene.walls) {
    const int c = plan.cavities.front();
    m.walls[c] = plan.recipe->continuous(m.scene.period_s);
    m.damped = m.damped || m.walls[c]->damped();
    const auto stop_at = [&m](double time) {
      const double t = wrapped(time, m.scene.period_s);
      if (t > 1e-9 && t < m.scene.period_s - 1e-9) m.breaks.insert(t);
    };
    for (double kink : m.walls[c]->kinks()) stop_at(kink);
    if (plan.fibres.empty()) continue;
    Fibre fibre;
    fibre.plan = &plan.fibres.front();
    fibre.calcium = &m.calcium.at(fibre.plan->cells);
    const CellModel& model = *fibre.plan->force;
    fibre.force = make_force_stepper<double>(model, fibre.plan->force_parameters);
    fibre.equations = model.equations(fibre.plan->force_parameters);
    fibre.activation_s = fibre.plan->activation_ms / units::ms_per_s;
    fibre.rest = steady_force_state(model, fibre.plan->force_parameters, fibre.calcium->lowest,
                                    fibre.force->reference_length_um());
    fibre.offset = m.state.size();
    m.state.insert(m.state.end(), fibre.rest.begin(), fibre.rest.end());
    m.fibre_of[c] = static_cast<int>(m.fibres.size());
    stop_at(fibre.activation_s);
    m.fibres.push_back(std::move(fibre));
  }
  m.n_differential = m.state.size();
  m.volume = total_volume(m.scene.circulation, m.state.data());
  m.explicit_pressures(0, m.state.data(), m.pressures_guess.data());
}

MonolithicHeart::~MonolithicHeart() = default;

bool MonolithicHeart::uses_ida() const { return implementation_->uses_ida(); }

LimitCycleCertificate MonolithicHeart::to_limit_cycle(double distance) {
  Implementation& m = *implementation_;
  BeatMap map;
  map.scales = circulation_scales();
  map.scales.resize(m.n_differential, 1.0);
  map.beat = [&](const std::vector<double>& start) {
    std::vector<double> y = start;
    m.integrate(y, 0, {});
    return y;
  };
  map.admit = [&](std::vector<double>& y) {
    for (const Fibre& f : m.fibres) {
      const CellModel& model = *f.plan->force;
      for (std::size_t i = 0; i < model.states.size(); ++i)
        if (model.states[i].lower == 0) y[f.offset + i] = std::max(0.0, y[f.offset + i]);
      model.normalise(&y[f.offset]);
    }
    hold_total_volume(m.scene.circulation, y.data(), m.volume);
  };
  LimitCycleSettings settings = loop_cycle_settings(distance);
  settings.map_noise = m.settings.relative_tolerance;
  LimitCycleCertificate certificate =
      find_limit_cycle(map, settings, m.state, [](const LimitCycleCertificate&) { check_interrupt(); });
  if (!certificate.good()) return certificate;
  PhysicalSense sense;
  std::vector<double> last = m.state;
  m.integrate(last, m.scene.period_s / 200, [&](double t, const double* y, const double* p) {
    sense.see(t, y, p, valve_flows(m.scene.circulation, p, y));
  });
  if (sense.finding()) {
    certificate.verdict = LimitCycleVerdict::unphysical;
    certificate.reason = sense.finding()->text();
  }
  return certificate;
}

Table MonolithicHeart::beat(double sample_s) {
  Implementation& m = *implementation_;
  Table table = circulation_table(m.scene.circulation);
  m.integrate(m.state, sample_s, [&](double t, const double* y, const double* p) {
    append_circulation_row(m.scene.circulation, table, t, y, p, valve_flows(m.scene.circulation, p, y));
  });
  return table;
}

}  // namespace wiggers
