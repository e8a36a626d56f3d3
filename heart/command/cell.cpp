#include <fmt/core.h>
#include <fmt/format.h>

#include <cmath>
#include <memory>
#include <nlohmann/json.hpp>
#include <wiggers/cellmodels/pacing/beat_features.hpp>
#include <wiggers/cellmodels/pacing/cell_sense.hpp>
#include <wiggers/cellmodels/pacing/cell_study.hpp>
#include <wiggers/cellmodels/pacing/pacing.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/files.hpp>
#include <wiggers/core/memory.hpp>
#include <wiggers/core/progress.hpp>
#include <wiggers/core/result_file.hpp>
#include <wiggers/core/table.hpp>
#include <wiggers/heart/scene/accuracy.hpp>

#include "shared.hpp"
#include "verbs.hpp"

namespace wiggers::command {

namespace {

struct Options {
  std::string accuracy, model, parameters, integrator = "cvode", until, output, rhs, start, final_state;
  std::vector<std::string> set;
  double period_ms = 1000, dt_ms = 0.02, rtol = 1e-8, atol = 1e-10, sample_ms = 1, distance = 1e-6;
  double stimulus = 0, duration_ms = 0, onset_ms = 0;
  bool stimulus_given = false, duration_given = false;
  int beats = 0, max_beats = 2000;
  std::string method = "anderson", attractor = "paced";
  bool quiet = false, json = false, other_parameters = false;
};

// Cross-check with another implementation: derivatives and observables at given states.
void evaluate_rows(const CellModel& model, const std::vector<double>& parameters, const Options& o) {
  if (!o.until.empty() || o.beats != 0)
    throw InputError("--rhs evaluates given states: --beats and --until have no place there");
  if (o.output.empty()) throw InputError("--rhs needs -o FILE.csv for the derivatives");
  require_writable(o.output, "-o", FileKind::table);
  const Table states = read_csv(o.rhs);
  const auto check_unit = [&](const Quantity& q) {
    const Column* column = states.find(q.name);
    if (column && !column->unit.empty() && column->unit != q.unit)
      throw InputError(
          fmt::format("{}: column '{}' is in {}, it must be in {}", o.rhs, q.name, column->unit, q.unit));
  };
  for (const Quantity& q : model.states) check_unit(q);
  for (const Quantity& q : model.inputs) check_unit(q);
  Table out;
  out.add("case", "");
  for (const Quantity& q : model.states)
    out.add(fmt::format("d{}/dt", q.name), q.unit == "1" ? fmt::format("1/{}", model.time_unit)
                                                         : fmt::format("{}/{}", q.unit, model.time_unit));
  for (const Quantity& q : model.observables) out.add(std::string(q.name), std::string(q.unit));
  std::vector<double> y(model.states.size()), in(model.inputs.size()), rates(y.size()),
      observables(model.observables.size());
  const Column* cases = states.find("case");
  for (std::size_t row = 0; row < states.n_rows(); ++row) {
    for (std::size_t i = 0; i < y.size(); ++i) y[i] = states.at(model.states[i].name).values[row];
    for (std::size_t i = 0; i < in.size(); ++i) {
      const Column* column = states.find(model.inputs[i].name);
      in[i] = column ? column->values[row] : model.inputs[i].default_value;
    }
    for (std::size_t i = 0; i < y.size(); ++i)
      if (!std::isfinite(y[i]))
        throw InputError(fmt::format("{}: row {}, state {} is not finite", o.rhs, row, model.states[i].name));
    for (std::size_t i = 0; i < in.size(); ++i)
      check_range(model.inputs[i], in[i], fmt::format("{}: row {}", o.rhs, row));
    model.evaluate(y.data(), in.data(), parameters.data(), rates.data(), observables.data());
    std::size_t c = 0;
    out.columns[c++].values.push_back(cases ? cases->values[row] : static_cast<double>(row));
    for (double rate : rates) out.columns[c++].values.push_back(rate);
    for (double value : observables) out.columns[c++].values.push_back(value);
  }
  write_csv(o.output, out);
  fmt::print("{}: {} rows, derivatives of {} states: {}\n", model.name, states.n_rows(), y.size(), o.output);
}

// A saved state carries a column of this name and its model's, with the fingerprint of the parameters.
constexpr std::string_view saved_by = "fingerprint of ";

// The last row of a table of states by name. Refuses a state of another model or, unless asked for, of other
// parameters.
std::vector<double> read_state(const CellModel& model, const std::vector<double>& parameters,
                               const std::string& path, bool other_parameters) {
  const Table table = read_csv(path);
  for (const Column& column : table.columns) {
    if (!column.name.starts_with(saved_by)) continue;
    const std::string saved_model = column.name.substr(saved_by.size());
    if (saved_model != model.name)
      throw InputError(
          fmt::format("{}: this state is of model {}, not of {}", path, saved_model, model.name));
    if (!other_parameters && column.values.back() != static_cast<double>(model.fingerprint(parameters)))
      throw InputError(
          fmt::format("{}: this state was saved with other parameters of {} (fingerprint {:.0f}, now {}); "
                      "give the same --parameters "
                      "and --set, or --other-parameters to start from it all the same",
                      path, model.name, column.values.back(), model.fingerprint(parameters)));
  }
  for (const Quantity& q : model.states)
    if (const Column* column = table.find(q.name); column && !column->unit.empty() && column->unit != q.unit)
      throw InputError(
          fmt::format("{}: state {} is in {}, it must be in {}", path, q.name, column->unit, q.unit));
  std::vector<double> y;
  for (const Quantity& q : model.states) {
    const double value = table.at(q.name).values.back();
    // What adaptive integrators leave behind may overshoot a gate's bounds by their tolerance.
    Quantity wide = q;
    if (q.unit == "1") {
      wide.lower -= 0.01;
      wide.upper += 0.01;
    }
    check_range(wide, value, path);
    y.push_back(value);
  }
  // A state of another charge leads to another cycle; other sums (of a Markov chain) have no meaning. Bounds
  // may have been overshot by what is allowed above.
  if (model.keeps_invariants(parameters.data()))
    require_invariants(model, model.invariant_values(y.data(), parameters.data()),
                       model.invariant_values(model.default_state().data(), parameters.data()), false, path);
  return y;
}

FileKind kind_of_table(const std::string& path) {
  return path.ends_with(".h5") ? FileKind::result : FileKind::table;
}

void write_table(const std::string& path, const Table& table, const std::string& model,
                 const nlohmann::ordered_json& summary) {
  if (kind_of_table(path) == FileKind::result) {
    ResultWriter file;
    for (const Column& column : table.columns)
      file.dataset("/cells/" + model + "/" + column.name, column.values, column.unit, column.meaning);
    file.text("/summary", summary.dump());
    file.write(path);
  } else {
    write_csv(path, table);
  }
}

// Features of the beat that begins with the stimulus after a state, by the integrator's own text; the same
// that Python gives.
nlohmann::ordered_json beat_features(const CellModel& model, const std::vector<double>& parameters,
                                     const Options& o, StimulusPulse pulse, PacedCell& paced,
                                     const std::vector<double>& beat_start) {
  std::vector<double> start = beat_start;
  PacedCell cell(model, parameters, {o.period_ms, {pulse.amplitude_A_per_F, pulse.duration_ms, 0}},
                 {o.integrator, o.rtol, o.atol, o.dt_ms});
  if (pulse.onset_ms > 0) {
    std::vector<double> beat = beat_start;
    paced.beat_at(beat, {pulse.onset_ms}, [&](double t, const double* y, double) {
      if (std::abs(t - pulse.onset_ms) < 1e-9 * o.period_ms) start.assign(y, y + start.size());
    });
    pulse.onset_ms = 0;
  }
  BeatRows rows;
  if (o.integrator == "rush-larsen" || o.integrator == "rush-larsen-2") {
    CellStudy study = make_cell_study(model);
    study.parameters = parameters;
    study.protocol = {o.period_ms, pulse};
    study.dt_ms = o.dt_ms;
    study.integrator = o.integrator;
    const std::vector<double> published = model.default_state();
    study.charge_offset_mV =
        model.charge(start.data(), parameters.data()) - model.charge(published.data(), parameters.data());
    PacedRows fixed = paced_rows(study, start);
    rows = {fixed.t_ms,
            fixed.potential_mV,
            fixed.calcium_mM,
            {pulse.onset_ms, pulse.onset_ms + pulse.duration_ms}};
  } else {
    rows = cell.feature_rows(start);
  }
  nlohmann::ordered_json out;
  visit_features(rows.t_ms, rows.potential_mV, rows.calcium_mM, rows.stimulus_edges_ms,
                 [&](const std::string& name, const std::string&, double value) { out[name] = value; });
  if (const std::string why = no_action_potential(rows.potential_mV); !why.empty())
    out["no_action_potential"] = why;
  return out;
}

std::string feature_line(const nlohmann::ordered_json& f) {
  const auto number = [&](const char* name) { return f[name].get<double>(); };
  return fmt::format(
      "V {:.3f} to {:.3f} mV{}{}", number("V_min_mV"), number("V_peak_mV"),
      f.contains("calcium_peak_uM") ? fmt::format(", Ca_i {:.4g} to {:.4g} uM",
                                                  number("calcium_diastolic_uM"), number("calcium_peak_uM"))
                                    : "",
      f.contains("APD90_ms") ? fmt::format(", APD90 {:.3f} ms", number("APD90_ms"))
      : f.contains("no_action_potential")
          ? fmt::format("; no action potential: {}", f["no_action_potential"].get<std::string>())
          : "");
}

void pace(const CellModel& model, const std::vector<double>& parameters, const Options& o) {
  if (!model.is_ionic())
    throw InputError(fmt::format("{} is a force model: it is driven by calcium and length, see wiggers force",
                                 model.name));
  const bool to_cycle = end_of_run(o.until, o.beats);
  if (!o.output.empty()) require_writable(o.output, "-o", kind_of_table(o.output));
  if (!o.final_state.empty()) require_writable(o.final_state, "--final-state", FileKind::table);
  check_option("--period-ms", o.period_ms, 1, 1e5);
  check_option("--sample-ms", o.sample_ms, 1e-3, o.period_ms);
  require_memory(o.period_ms / o.sample_ms,
                 static_cast<double>(1 + model.states.size() + model.observables.size()),
                 fmt::format("--sample-ms {} over --period-ms {}", o.sample_ms, o.period_ms),
                 "Take a larger --sample-ms.");
  check_option("--stimulus-onset-ms", o.onset_ms, 0, o.period_ms);
  check_limit_cycle_options(o.distance, o.max_beats);
  const LimitCycleMethod method = limit_cycle_method(o.method);
  const Attractor attractor = attractor_named(o.attractor);
  if (is_adaptive(o.integrator)) {
    check_option("--rtol", o.rtol, 1e-13, 0.1);
    check_option("--atol", o.atol, 1e-16, 1);
  } else {
    check_option("--dt-ms", o.dt_ms, 1e-4, o.period_ms);
  }
  StimulusPulse pulse = model.default_stimulus;
  if (o.stimulus_given) pulse.amplitude_A_per_F = o.stimulus;
  if (o.duration_given) pulse.duration_ms = o.duration_ms;
  pulse.onset_ms = o.onset_ms;
  PacedCell cell(model, parameters, {o.period_ms, pulse}, {o.integrator, o.rtol, o.atol, o.dt_ms});
  std::vector<double> state =
      o.start.empty() ? model.default_state() : read_state(model, parameters, o.start, o.other_parameters);
  const double charge = model.charge(state.data(), parameters.data());

  Progress progress(fmt::format("cell {}", model.name),
                    o.quiet ? Progress::Style::quiet : Progress::Style::automatic);
  LimitCycleCertificate certificate;
  int beats = 0;
  if (to_cycle) {
    LimitCycleSettings settings;
    settings.distance = o.distance;
    settings.max_beats = o.max_beats;
    settings.method = method;
    settings.attractor = attractor;
    certificate = cell.to_limit_cycle(state, settings, [&](const LimitCycleCertificate& c) {
      progress.update(-1, fmt::format("beat {}, distance {:.1e}", c.beats, c.distance));
    });
    beats = certificate.beats;
  } else {
    for (; beats < o.beats - 1; ++beats) {
      progress.update(static_cast<double>(beats) / o.beats, fmt::format("beat {}", beats));
      cell.beat(state);
    }
  }
  // The last beat, sampled. On a limit cycle it is one beat more, from the cycle.
  Table table;
  table.add("t", "ms", "time since the beginning of the beat");
  for (const Quantity& q : model.states)
    table.add(std::string(q.name), std::string(q.unit), std::string(q.meaning));
  for (const Quantity& q : model.observables)
    table.add(std::string(q.name), std::string(q.unit), std::string(q.meaning));
  std::vector<double> rates(model.states.size()), observables(model.observables.size());
  const std::vector<double> onset_state = state;
  CellSense sense(model);
  if (!to_cycle) {
    std::vector<double> same = state;
    cell.beat(same, std::min(1.0, o.period_ms), [&](double t, const double* y, double) { sense.see(t, y); });
  }
  cell.beat(state, o.sample_ms, [&](double t, const double* y, double stimulus) {
    model.evaluate(y, &stimulus, parameters.data(), rates.data(), observables.data());
    std::size_t c = 0;
    table.columns[c++].values.push_back(t);
    for (std::size_t i = 0; i < model.states.size(); ++i) table.columns[c++].values.push_back(y[i]);
    for (double value : observables) table.columns[c++].values.push_back(value);
  });
  ++beats;
  progress.finish(fmt::format("{} beats", beats));

  const bool has_charge = model.charge_invariant() >= 0;
  nlohmann::ordered_json summary = {{"model", model.name}, {"period_ms", o.period_ms}, {"beats", beats}};
  std::optional<double> shift;
  if (to_cycle) {
    if (certificate.good()) shift = cell.integrator_shift(onset_state, check_interrupt);
    summary["limit_cycle"] = {{"verdict", certificate.text()},        {"distance", certificate.distance},
                              {"beats", certificate.beats},           {"residual", certificate.residual},
                              {"multiplier", certificate.multiplier}, {"period_beats", certificate.period},
                              {"integrator_shift", nullptr}};
    if (has_charge) {
      summary["limit_cycle"]["charge_mV"] = charge;
      summary["limit_cycle"]["charge_drift_mV"] = cell.charge_drift();
    }
    if (shift) summary["limit_cycle"]["integrator_shift"] = *shift;
  }
  if (to_cycle && !certificate.reason.empty()) summary["limit_cycle"]["reason"] = certificate.reason;
  const std::string unphysical = to_cycle ? "" : sense.finding();
  if (!unphysical.empty()) summary["unphysical"] = unphysical;
  // Features are of the solution, whatever the spacing of the rows.
  const auto features = beat_features(model, parameters, o, pulse, cell, onset_state);
  summary["V_max_mV"] = features["V_peak_mV"];
  summary["V_min_mV"] = features["V_min_mV"];
  if (model.has_calcium()) {
    summary["Ca_i_max_mM"] = 1e-3 * features["calcium_peak_uM"].get<double>();
    summary["Ca_i_min_mM"] = 1e-3 * features["calcium_diastolic_uM"].get<double>();
  }
  if (features.contains("APD90_ms")) summary["APD90_ms"] = features["APD90_ms"];
  if (features.contains("no_action_potential"))
    summary["no_action_potential"] = features["no_action_potential"];
  summary["features"] = features;
  if (to_cycle && certificate.verdict == LimitCycleVerdict::period_n) {
    std::vector<double> beat_state = onset_state;
    summary["beats_of_cycle"] = nlohmann::ordered_json::array();
    for (int beat = 0; beat < certificate.period; ++beat) {
      summary["beats_of_cycle"].push_back(beat_features(model, parameters, o, pulse, cell, beat_state));
      cell.beat(beat_state);
    }
  }
  if (has_charge && model.keeps_invariants(parameters.data()))
    summary["charge_drift_mV"] =
        to_cycle ? cell.charge_drift() : model.charge(state.data(), parameters.data()) - charge;
  for (std::size_t i = 0; i < model.states.size(); ++i)
    summary["end_state"][std::string(model.states[i].name)] = state[i];

  fmt::print("{}: {}, period {} ms, {} beats\n", model.name, model.title, o.period_ms, beats);
  if (to_cycle) {
    fmt::print("limit cycle: {}, distance {:.1e}, leading multiplier {:.4f}, {} beats\n", certificate.text(),
               certificate.distance, certificate.multiplier, certificate.beats);
    if (has_charge)
      fmt::print("  conserved charge {:.6g} mV, drift of a beat {:.1e} mV (held)\n", charge,
                 cell.charge_drift());
    if (shift)
      fmt::print("  {} moves the cycle by {:.1e}\n",
                 is_adaptive(o.integrator) ? "a tolerance at most a tenth as large" : "half the step",
                 *shift);
    if (!certificate.reason.empty()) fmt::print("note: {}\n", certificate.reason);
  }
  if (summary.contains("beats_of_cycle"))
    for (std::size_t beat = 0; beat < summary["beats_of_cycle"].size(); ++beat)
      fmt::print("beat {}: {}\n", beat + 1, feature_line(summary["beats_of_cycle"][beat]));
  else
    fmt::print("{}\n", feature_line(features));
  if (!to_cycle && summary.contains("charge_drift_mV") &&
      std::abs(summary["charge_drift_mV"].get<double>()) > 10)
    fmt::print(
        "warning: the scheme has moved the cell's conserved charge by {:.3g} mV; smaller steps or cvode keep "
        "it, and --until limit-cycle holds it\n",
        summary["charge_drift_mV"].get<double>());
  if (!o.output.empty()) {
    write_table(o.output, table, o.model, summary);
    fmt::print("last beat: {}\n", o.output);
  }
  if (!o.final_state.empty()) {
    Table last;
    last.add(std::string(saved_by) + std::string(model.name), "1").values = {
        static_cast<double>(model.fingerprint(parameters))};
    for (std::size_t i = 0; i < model.states.size(); ++i)
      last.add(std::string(model.states[i].name), std::string(model.states[i].unit)).values = {state[i]};
    write_csv(o.final_state, last);
    fmt::print("final state: {}\n", o.final_state);
  }
  if (o.json) fmt::print("{}\n", summary.dump());
  if (!unphysical.empty()) throw NumericalFailure(unphysical);
  if (to_cycle && !certificate.good() && certificate.verdict != LimitCycleVerdict::period_n)
    throw NumericalFailure(limit_cycle_failure(certificate));
}

}  // namespace

void add_cell(CLI::App& app) {
  auto o = std::make_shared<Options>();
  CLI::App* verb = app.add_subcommand("cell", "Pace one cell, or evaluate its equations at given states");
  verb->add_option("model", o->model, "cell model, see wiggers models")->required();
  verb->add_option("--parameters", o->parameters, "named parameter set [the model's first]");
  verb->add_option("--set", o->set, "change a parameter: name=value, in the parameter's unit")->take_all();
  verb->add_option("--period-ms", o->period_ms, "pacing period, ms [1000]");
  verb->add_option("--beats", o->beats, "number of beats");
  verb->add_option("--until", o->until, "limit-cycle: pace until the cell repeats itself");
  verb->add_option("--method", o->method,
                   "limit-cycle search: anderson | newton | kinsol | pacing [anderson]");
  verb->add_option(
      "--attractor", o->attractor,
      "paced: the one that plain pacing from the start is heading for, cycles of several beats included | "
      "any: whichever cycle of one beat is found [paced]");
  CLI::Option* distance = verb->add_option(
      "--distance", o->distance, "scaled distance to the limit cycle, 1 [1e-6, or that of --accuracy]");
  verb->add_option("--max-beats", o->max_beats, "give up on the limit cycle after so many beats [2000]");
  CLI::Option* accuracy =
      verb->add_option("--accuracy", o->accuracy,
                       "draft | standard | reference: integrator and tolerance together [standard]");
  CLI::Option* integrator = verb->add_option(
      "--integrator", o->integrator,
      "adaptive: cvode | rosenbrock | odeint-rosenbrock4 | odeint-dopri5; fixed steps: rush-larsen | "
      "rush-larsen-2 | generalised-rush-larsen | generalised-rush-larsen-2 | bdf2-imex | forward-euler "
      "[cvode]");
  verb->add_option("--dt-ms", o->dt_ms, "step of the fixed-step integrators, ms [0.02]");
  CLI::Option* rtol =
      verb->add_option("--rtol", o->rtol, "relative tolerance of the adaptive integrators, 1 [1e-8]");
  CLI::Option* atol = verb->add_option(
      "--atol", o->atol, "absolute tolerance of the adaptive integrators for a state of size one [rtol/100]");
  verb->add_option("--sample-ms", o->sample_ms, "spacing of the output rows, ms [1]");
  CLI::Option* stimulus = verb->add_option("--stimulus-A-per-F", o->stimulus,
                                           "stimulus current, A/F, negative depolarises [the model's]");
  CLI::Option* duration = verb->add_option("--stimulus-ms,--stimulus-duration-ms", o->duration_ms,
                                           "duration of the stimulus, ms [the model's]");
  verb->add_option("--stimulus-onset-ms", o->onset_ms, "onset of the stimulus in the period, ms [0]");
  verb->add_option("--start", o->start,
                   "CSV with the starting state (last row, states by name) [published values]");
  verb->add_flag("--other-parameters", o->other_parameters, "accept a --start saved with other parameters");
  verb->add_option("--final-state", o->final_state, "write the final state to this CSV");
  verb->add_option("--rhs", o->rhs, "CSV with states: write derivatives and currents to -o, pace nothing");
  verb->add_option("-o,--output", o->output, "CSV or HDF5 (.h5) file of the last beat");
  verb->add_flag("--quiet", o->quiet, "no progress");
  verb->add_flag("--json", o->json, "end standard output with one line of JSON");
  accuracy->excludes(integrator)->excludes(rtol)->excludes(atol);
  verb->callback([o, stimulus, duration, atol, distance] {
    if (!o->accuracy.empty()) {
      const CellAccuracy& chosen = cell_accuracy(o->accuracy);
      o->integrator = chosen.integrator.name;
      o->rtol = chosen.integrator.relative_tolerance;
      if (distance->count() == 0) o->distance = chosen.distance;
      fmt::print("accuracy {}: {}\n", chosen.name, chosen.expected);
    }
    if (atol->count() == 0) o->atol = std::max(1e-16, 0.01 * o->rtol);
    const CellModel& model = find_model(o->model);
    o->stimulus_given = stimulus->count() > 0;
    o->duration_given = duration->count() > 0;
    const std::vector<double> parameters = parameters_from(model, o->parameters, o->set);
    if (!o->rhs.empty())
      evaluate_rows(model, parameters, *o);
    else
      pace(model, parameters, *o);
  });
}

}  // namespace wiggers::command
