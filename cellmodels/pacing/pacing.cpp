#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <set>
#include <wiggers/cellmodels/pacing/beat_features.hpp>
#include <wiggers/cellmodels/pacing/cell_sense.hpp>
#include <wiggers/cellmodels/pacing/pacing.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/fixed_step.hpp>
#include <wiggers/core/limit_cycle_solve.hpp>
#include <wiggers/core/progress.hpp>

namespace wiggers {

void check_protocol(const CellModel& model, const PacingProtocol& protocol,
                    const CellIntegrator& integrator) {
  const double pulse_end = protocol.stimulus.onset_ms + protocol.stimulus.duration_ms;
  if (!(protocol.period_ms > 0) || !std::isfinite(protocol.period_ms))
    throw InputError(fmt::format("period = {} ms must be positive", protocol.period_ms));
  if (!(protocol.stimulus.duration_ms >= 0) || !(protocol.stimulus.onset_ms >= 0))
    throw InputError("stimulus duration and onset must not be negative");
  if (protocol.period_ms <= pulse_end)
    throw InputError(fmt::format("period = {} ms is not longer than the stimulus, which ends at {} ms",
                                 protocol.period_ms, pulse_end));
  if (!std::isfinite(protocol.stimulus.amplitude_A_per_F) ||
      std::abs(protocol.stimulus.amplitude_A_per_F) > 1000)
    throw InputError(
        fmt::format("stimulus = {} A/F is outside -1000 to 1000", protocol.stimulus.amplitude_A_per_F));
  if (is_adaptive(integrator.name)) {
    if (!(integrator.relative_tolerance >= 1e-13 && integrator.relative_tolerance <= 1e-1))
      throw InputError(fmt::format("rtol = {} is outside 1e-13 to 0.1", integrator.relative_tolerance));
    if (!(integrator.absolute_tolerance >= 1e-16 && integrator.absolute_tolerance <= 1))
      throw InputError(fmt::format("atol = {} is outside 1e-16 to 1", integrator.absolute_tolerance));
  } else {
    (void)model.stepper(integrator.name, model.parameter_values(model.parameter_sets.front().name));
    if (!(integrator.dt_ms >= 1e-5 && integrator.dt_ms <= protocol.period_ms))
      throw InputError(fmt::format("dt = {} ms is outside 1e-5 to the period {} ms", integrator.dt_ms,
                                   protocol.period_ms));
  }
}

void require_limit_cycle(const CellModel& model, const std::vector<double>& parameters) {
  if (model.keeps_invariants(parameters.data())) return;
  std::string what = "its charge is not kept", remedy = "";
  for (std::size_t k = 0; k < parameters.size(); ++k)
    if (model.parameters[k].role == Role::stimulus_share) {
      what = fmt::format("the stimulus charge is booked to no ion ({} = {})", model.parameters[k].name,
                         parameters[k]);
      remedy = fmt::format("set {} = 1, or ", model.parameters[k].name);
    }
  throw InputError(
      fmt::format("{}: there is no limit cycle to find: {}, so the cell gains charge every beat; {}pace a "
                  "number of beats",
                  model.name, what, remedy));
}

void make_admissible(const CellModel& model, std::vector<double>& state) {
  for (std::size_t i = 0; i < state.size(); ++i)
    state[i] = std::clamp(state[i], model.states[i].lower, model.states[i].upper);
}

namespace {
// A change over a beat of ten tolerances is noise, and a slow cell's distance is a thousand such changes.
constexpr double tolerance_per_distance = 1e-4;
constexpr double changes_above_noise = 1e3;
// Of a cell whose multiplier is known: its noise is some sixty tolerances.
constexpr double tolerance_per_change = 1e-2;
constexpr double slowest_multiplier = 0.999;

bool missed(const LimitCycleCertificate& c, const LimitCycleSettings& settings) {
  return c.is_cycle() && c.distance > settings.distance;
}
}  // namespace

void CellIntegrator::tighten(double relative) {
  relative_tolerance = std::max(tightest_tolerance, std::min(relative_tolerance, relative));
  absolute_tolerance = std::max(1e-16, std::min(absolute_tolerance, 0.01 * relative_tolerance));
}

PacedCell::PacedCell(const CellModel& model, std::vector<double> parameters, PacingProtocol protocol,
                     CellIntegrator integrator)
    : model_(model),
      parameters_(std::move(parameters)),
      protocol_(protocol),
      integrator_(std::move(integrator)) {
  check_protocol(model_, protocol_, integrator_);
}

void PacedCell::check_range(double t, const double* state) const {
  for (std::size_t i = 0; i < model_.states.size(); ++i) {
    const Quantity& q = model_.states[i];
    // An adaptive method may overshoot a bound by about its own tolerance.
    const double relative =
        is_adaptive(integrator_.name) ? std::max(1e-6, 20 * integrator_.relative_tolerance) : 1e-6;
    const double slack = relative * (std::isfinite(q.upper) ? std::max(1.0, std::abs(q.upper)) : 1.0);
    const bool is_number = std::isfinite(state[i]);
    if (is_number && state[i] >= q.lower - slack && state[i] <= q.upper + slack) continue;
    const bool adaptive = is_adaptive(integrator_.name);
    const StimulusPulse& pulse = protocol_.stimulus;
    throw NumericalFailure(fmt::format(
        "{}: state {}{} left its physical range {} to {} {}{} at t = {:.4g} ms of the beat (integrator "
        "{}{}). "
        "Try {}; if that does not help, look at the stimulus ({:.4g} A/F for {:.4g} ms) and the parameters.",
        model_.name, q.name, is_number ? fmt::format(" = {} {}", state[i], q.unit) : "", q.lower, q.upper,
        q.unit, is_number ? "" : " and is no number", t, integrator_.name,
        adaptive ? "" : fmt::format(", dt {} ms", integrator_.dt_ms),
        adaptive                            ? "a smaller rtol"
        : integrator_.name == "rush-larsen" ? "a smaller step, or integrator cvode"
                                            : "a smaller step, or integrator rush-larsen or cvode",
        pulse.amplitude_A_per_F, pulse.duration_ms));
  }
}

void PacedCell::beat(std::vector<double>& state, double sample_ms, const Sampler& sampler) {
  std::vector<double> times;
  if (sampler) {
    const auto n = static_cast<long>(std::floor(protocol_.period_ms / sample_ms * (1 + 1e-12)));
    for (long k = 0; k <= n; ++k)
      times.push_back(std::min(protocol_.period_ms, static_cast<double>(k) * sample_ms));
  }
  beat_at(state, times, sampler);
}

BeatRows PacedCell::feature_rows(std::vector<double> state) {
  BeatRows rows;
  const auto sampler = [&](double t, const double* y, double) {
    rows.t_ms.push_back(t);
    rows.potential_mV.push_back(y[model_.membrane_potential]);
    if (model_.has_calcium()) rows.calcium_mM.push_back(y[model_.cytosolic_calcium]);
  };
  rows.stimulus_edges_ms = {protocol_.stimulus.onset_ms,
                            protocol_.stimulus.onset_ms + protocol_.stimulus.duration_ms};
  if (!is_adaptive(integrator_.name)) {
    beat(state, integrator_.dt_ms, sampler);
    return rows;
  }
  // A first look tells where the features are; there a second one is as close as they ask for. Samples do not
  // change the steps, so both are of one solution.
  constexpr double first_look_ms = 0.25, close_ms = 0.005;
  std::vector<double> coarse;
  for (double t = 0; t < protocol_.period_ms; t += first_look_ms) coarse.push_back(t);
  coarse.push_back(protocol_.period_ms);
  coarse.insert(coarse.end(), rows.stimulus_edges_ms.begin(), rows.stimulus_edges_ms.end());
  std::vector<double> first_state = state;
  beat_at(first_state, coarse, sampler);
  const std::vector<double>&t = rows.t_ms, &V = rows.potential_mV, &Ca = rows.calcium_mM;
  std::set<std::size_t> places;
  const auto row = [](const auto& series, auto it) { return static_cast<std::size_t>(it - series.begin()); };
  const auto peak = row(V, std::max_element(V.begin(), V.end()));
  places.insert({peak, row(V, std::min_element(V.begin(), V.end()))});
  if (!Ca.empty())
    places.insert(
        {row(Ca, std::max_element(Ca.begin(), Ca.end())), row(Ca, std::min_element(Ca.begin(), Ca.end()))});
  std::size_t steepest = 1;
  for (std::size_t k = 1; k < t.size(); ++k) {
    if ((V[k] - V[k - 1]) * (t[steepest] - t[steepest - 1]) >
        (V[steepest] - V[steepest - 1]) * (t[k] - t[k - 1]))
      steepest = k;
    for (double share : {0.5, 0.9}) {
      const double level = V[peak] - share * (V[peak] - std::min(V.front(), V.back()));
      if ((V[k] >= level) != (V[k - 1] >= level)) places.insert(k);
    }
  }
  places.insert(steepest);
  std::vector<double> fine = coarse;
  for (std::size_t k : places)
    for (double at = std::max(0.0, t[k] - 2 * first_look_ms);
         at < std::min(protocol_.period_ms, t[k] + 2 * first_look_ms); at += close_ms)
      fine.push_back(at);
  // Rows a rounding error apart have no slope between them; the stimulus's edges stay.
  std::sort(fine.begin(), fine.end());
  std::vector<double> times;
  const auto& edges = rows.stimulus_edges_ms;
  const auto near_edge = [&](double at) {
    return std::any_of(edges.begin(), edges.end(),
                       [&](double edge) { return at != edge && std::abs(at - edge) < 0.5 * close_ms; });
  };
  for (double at : fine)
    if ((times.empty() || at - times.back() > 0.2 * close_ms) && !near_edge(at)) times.push_back(at);
  rows.t_ms.clear();
  rows.potential_mV.clear();
  rows.calcium_mM.clear();
  beat_at(state, times, sampler);
  return rows;
}

void PacedCell::beat_at(std::vector<double>& state, const std::vector<double>& times,
                        const Sampler& sampler) {
  const double period = protocol_.period_ms;
  const StimulusPulse& pulse = protocol_.stimulus;
  // Stops: the pulse's edges (the right-hand side jumps there) and the sample times.
  const double edges[] = {pulse.onset_ms, pulse.onset_ms + pulse.duration_ms};
  const auto is_edge = [&](double t) { return pulse.duration_ms > 0 && (t == edges[0] || t == edges[1]); };
  std::set<double> stops = {period};
  if (pulse.duration_ms > 0) stops.insert(std::begin(edges), std::end(edges));
  std::set<double> samples;
  if (sampler) {
    samples.insert(times.begin(), times.end());
    samples.insert(period);
    // A sample within rounding of an edge or of the end is that instant.
    for (double stop : stops)
      for (auto it = samples.begin(); it != samples.end();)
        it = (*it != stop && std::abs(*it - stop) < 1e-9 * period) ? samples.erase(it) : std::next(it);
    for (double stop : stops)
      for (double time : times)
        if (std::abs(stop - time) < 1e-9 * period) samples.insert(stop);
    stops.insert(samples.begin(), samples.end());
  }
  stops.erase(stops.begin(), stops.upper_bound(0.0));

  double inputs[1] = {pulse.current_on_span(0)};
  if (sampler && samples.count(0.0)) sampler(0, state.data(), inputs[0]);

  if (is_adaptive(integrator_.name)) {
    if (!adaptive_)
      adaptive_ = model_.adaptive(integrator_.name, parameters_, integrator_.relative_tolerance,
                                  integrator_.absolute_tolerance);
    // Spans between edges; the samples inside are interpolated.
    double begin = 0;
    std::vector<double> inside;
    for (double stop : stops) {
      const bool ends = stop == period || is_edge(stop);
      if (!ends) {
        inside.push_back(stop - begin);
        continue;
      }
      adaptive_->restart();
      try {
        adaptive_->advance(stop - begin, state.data(), inputs, inside, [&](std::size_t k, const double* y) {
          check_range(begin + inside[k], y);
          sampler(begin + inside[k], y, inputs[0]);
        });
      } catch (const NumericalFailure& failure) {
        if (std::string_view(failure.what()).starts_with(model_.name)) throw;  // says where already
        throw NumericalFailure(
            fmt::format("{}: {} (in the span from {} ms of the beat)", model_.name, failure.what(), begin));
      }
      check_range(stop, state.data());
      inside.clear();
      begin = stop;
      if (is_edge(stop)) inputs[0] = pulse.current_on_span(stop);
      if (sampler && samples.count(stop)) sampler(stop, state.data(), inputs[0]);
    }
    return;
  }

  const auto stepper = model_.stepper(integrator_.name, parameters_);
  double t = 0;
  for (double stop : stops) {
    const long n_steps = whole_steps(stop - t, integrator_.dt_ms);
    const double h = (stop - t) / static_cast<double>(n_steps);
    // Steps that differ only by rounding count as equal: multistep schemes keep their history.
    const double step = std::abs(h - integrator_.dt_ms) < 1e-9 * integrator_.dt_ms ? integrator_.dt_ms : h;
    for (long k = 0; k < n_steps; ++k) {
      stepper->step(step, state.data(), inputs);
      // Cheap at this cadence, and it stops a diverging run before it overflows.
      if ((k & 15) == 15) {
        check_range(t + static_cast<double>(k + 1) * step, state.data());
        check_interrupt();
      }
    }
    t = stop;
    check_range(t, state.data());
    if (is_edge(stop)) {
      inputs[0] = pulse.current_on_span(stop);
      stepper->restart();
    }
    if (sampler && samples.count(stop)) sampler(stop, state.data(), inputs[0]);
  }
}

std::vector<double> PacedCell::scales(const std::vector<double>& start) const {
  std::vector<double> s;
  for (std::size_t i = 0; i < start.size(); ++i)
    s.push_back(static_cast<int>(i) == model_.membrane_potential ? 10.0 : std::abs(start[i]) + 1e-3);
  return s;
}

BeatMap PacedCell::beat_map(const std::vector<double>& start) const {
  BeatMap map;
  map.scales = scales(start);
  for (const Quantity& q : model_.states) map.positive.push_back(q.unit == "mM");
  map.admit = [this, held = model_.invariant_values(start.data(), parameters_.data())](
                  std::vector<double>& proposal) {
    make_admissible(model_, proposal);
    model_.hold_invariants(proposal.data(), parameters_.data(), held);
  };
  return map;
}

LimitCycleCertificate PacedCell::to_limit_cycle(
    std::vector<double>& state, LimitCycleSettings settings,
    const std::function<void(const LimitCycleCertificate&)>& after_beat) {
  require_limit_cycle(model_, parameters_);
  // The noise of an adaptive integrator bounds the distance that a search can reach: it is searched with a
  // tolerance that allows the distance asked for, and where that does not do with tighter ones, from where
  // the last ended, as far as double precision allows.
  CellIntegrator finer = integrator_;
  const bool adaptive = is_adaptive(integrator_.name);
  if (adaptive) finer.tighten(tolerance_per_distance * settings.distance);
  const auto search_finely = [&](std::vector<double>& from, const LimitCycleSettings& how) {
    PacedCell cell(model_, parameters_, protocol_, finer);
    const LimitCycleCertificate found = cell.search(from, how, after_beat, this);
    charge_drift_ = cell.charge_drift();
    finer = cell.integrator_;
    return found;
  };
  LimitCycleCertificate certificate =
      adaptive ? search_finely(state, settings) : search(state, settings, after_beat);
  int beats = certificate.beats;
  while (adaptive && (certificate.noisy || missed(certificate, settings)) &&
         finer.relative_tolerance > 1.01 * CellIntegrator::tightest_tolerance && beats < settings.max_beats) {
    // By what is missing, and some more.
    finer.tighten(std::clamp(0.1 * settings.distance / certificate.distance, 0.01, 0.1) *
                  finer.relative_tolerance);
    LimitCycleSettings rest = settings;
    rest.max_beats = settings.max_beats - beats;
    rest.known_multiplier = certificate.multiplier;
    if (certificate.good()) {  // what is left of the way leads to no other cycle
      rest.attractor = Attractor::any;
      rest.plain_beats = 0;
    }
    std::vector<double> closer = state;
    LimitCycleCertificate next;
    try {
      next = search_finely(closer, rest);
    } catch (const NumericalFailure&) {
      break;  // asks for more than double precision has
    }
    beats += next.beats;
    if (!next.is_cycle() && certificate.is_cycle()) break;
    state = closer;
    certificate = next;
  }
  certificate.beats = beats;
  multiplier_ = certificate.multiplier;
  if (certificate.is_cycle()) {
    CellSense sense(model_);
    std::vector<double> y = state;
    for (int k = 0; k < certificate.period; ++k)
      beat(y, 1.0, [&](double t, const double* row, double) { sense.see(t, row); });
    judge_cell(certificate, sense.finding());
  }
  if (certificate.verdict == LimitCycleVerdict::period_n) {
    std::vector<BeatPeaks> beats_of_cycle;
    std::vector<double> y = state;
    for (int k = 0; k < certificate.period; ++k) {
      const BeatRows rows = feature_rows(y);
      beats_of_cycle.push_back(peaks_of(rows.potential_mV, rows.calcium_mM));
      beat(y);
    }
    certificate.reason =
        words_of_beats(beats_of_cycle) + (certificate.reason.empty() ? "" : " ") + certificate.reason;
  }
  if (missed(certificate, settings))
    certificate.reason = fmt::format(
        "The search stopped at the integrator's noise, at {:.0f} times the distance asked for ({:.1g}): {}.",
        certificate.distance / settings.distance, settings.distance,
        is_adaptive(integrator_.name) ? "tighten --rtol, or ask for less"
                                      : "take a smaller step, or ask for less");
  return certificate;
}

LimitCycleCertificate PacedCell::search(std::vector<double>& state, LimitCycleSettings settings,
                                        const std::function<void(const LimitCycleCertificate&)>& after_beat,
                                        PacedCell* coarse) {
  if (is_adaptive(integrator_.name)) settings.map_noise = integrator_.relative_tolerance;
  const std::vector<double> held = model_.invariant_values(state.data(), parameters_.data());
  const double charge = model_.charge(state.data(), parameters_.data());
  BeatMap map = beat_map(state);
  // While the change over a beat is far above the coarse cell's noise, its beats do.
  const double near = coarse ? changes_above_noise * coarse->integrator_.relative_tolerance : 0;
  bool far = coarse != nullptr;
  const auto watch = [&](const LimitCycleCertificate& c) {
    if (far && c.residual < near) {
      far = false;
      integrator_.tighten(tolerance_per_change * settings.distance *
                          (1 - std::min(c.multiplier, slowest_multiplier)));
    }
    if (after_beat) after_beat(c);
  };
  map.beat = [&](const std::vector<double>& start) {
    std::vector<double> image = start;
    (far ? *coarse : *this).beat(image);
    // The scheme's own drift of the charge is reported, then removed: the map is projected on the leaf.
    charge_drift_ = model_.charge(image.data(), parameters_.data()) - charge;
    model_.hold_invariants(image.data(), parameters_.data(), held);
    return image;
  };
  return find_limit_cycle(map, settings, state, watch);
}

std::optional<double> PacedCell::integrator_shift(const std::vector<double>& on_cycle,
                                                  const std::function<void()>& between_beats) const {
  CellIntegrator finer = integrator_;
  finer.dt_ms *= 0.5;
  finer.relative_tolerance = std::max(1e-13, 0.1 * finer.relative_tolerance);
  finer.absolute_tolerance = std::max(1e-16, 0.1 * finer.absolute_tolerance);
  LimitCycleSettings settings;
  settings.distance = 1e-5;
  settings.max_beats = 100;
  settings.known_multiplier = multiplier_;
  if (is_adaptive(finer.name))
    finer.tighten(tolerance_per_change * settings.distance * (1 - std::min(multiplier_, slowest_multiplier)));
  std::vector<double> moved = on_cycle;
  PacedCell cell(model_, parameters_, protocol_, finer);
  try {
    const auto certificate = cell.search(moved, settings, [&](const LimitCycleCertificate&) {
      if (between_beats) between_beats();
    });
    if (!certificate.good()) return std::nullopt;
  } catch (const NumericalFailure&) {
    return std::nullopt;  // the finer integrator asks for more than double precision has
  }
  const std::vector<double> s = scales(on_cycle);
  double largest = 0;
  for (std::size_t i = 0; i < s.size(); ++i)
    largest = std::max(largest, std::abs(moved[i] - on_cycle[i]) / s[i]);
  return largest;
}

}  // namespace wiggers
