#include <fmt/core.h>
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>
#include <set>
#include <wiggers/cellmodels/catalogue/force_stepper.hpp>
#include <wiggers/core/cvode.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/files.hpp>
#include <wiggers/core/memory.hpp>
#include <wiggers/core/progress.hpp>
#include <wiggers/core/table.hpp>
#include <wiggers/core/units.hpp>

#include "shared.hpp"
#include "verbs.hpp"

namespace wiggers::command {

namespace {

// A value, or a piecewise linear series of time (s).
struct Signal {
  std::vector<double> t, y;
  bool constant() const { return t.empty(); }
  double begin() const { return constant() ? 0 : t.front(); }
  double end() const { return constant() ? 0 : t.back(); }

  std::size_t segment(double when) const {
    const auto upper = std::upper_bound(t.begin(), t.end(), when);
    const auto k = static_cast<std::size_t>(upper - t.begin());
    return std::clamp<std::size_t>(k, 1, t.size() - 1);
  }
  double at(double when) const {
    if (constant()) return y[0];
    if (when <= t.front()) return y.front();
    if (when >= t.back()) return y.back();
    const std::size_t k = segment(when);
    return y[k - 1] + (when - t[k - 1]) / (t[k] - t[k - 1]) * (y[k] - y[k - 1]);
  }
  // Slope to the right of `when`.
  double slope(double when) const {
    if (constant() || when < t.front() || when >= t.back()) return 0;
    const std::size_t k = segment(when);
    return (y[k] - y[k - 1]) / (t[k] - t[k - 1]);
  }
};

Signal read_signal(const std::string& text, std::string_view option, const Quantity& quantity,
                   double unit_mM) {
  Signal s;
  if (!std::filesystem::exists(text)) {
    s.y = {parse_number(text, fmt::format("{} (a number, or a CSV file that exists)", option))};
    check_range(quantity, s.y[0], option);
    return s;
  }
  const Table table = read_csv(text);
  const Column* time = nullptr;
  for (const char* name : {"t", "time", "t_s", "t_ms", "time_s", "time_ms"})
    if (!time) time = table.find(name);
  if (!time) throw InputError(fmt::format("{}: no column of time ('t [s]' or 't [ms]')", text));
  const bool in_ms = time->unit == "ms" || time->name.ends_with("_ms");
  const Column* value = nullptr;
  double factor = 1;
  if (const Column* own = table.find(quantity.name)) {
    value = own;
  } else if (unit_mM > 0 && table.find("Ca_i")) {
    value = table.find("Ca_i");
    factor = unit_mM;
  } else {
    for (const Column& column : table.columns)
      if (!value && column.name.starts_with(quantity.name) && column.name.find('/') == std::string::npos)
        value = &column;
  }
  if (!value && table.columns.size() == 2) value = &table.columns[&table.columns[0] == time ? 1 : 0];
  if (!value) throw InputError(fmt::format("{}: no column '{} [{}]'", text, quantity.name, quantity.unit));
  if (unit_mM > 0 && value->unit == "mM") factor = unit_mM;
  for (std::size_t k = 0; k < table.n_rows(); ++k) {
    s.t.push_back(time->values[k] * (in_ms ? units::s_per_ms : 1.0));
    s.y.push_back(value->values[k] * factor);
    check_range(quantity, s.y.back(), fmt::format("{}: row {}", text, k + 1));
    if (!std::isfinite(s.t[k])) throw InputError(fmt::format("{}: row {}: time is not finite", text, k + 1));
    if (k > 0 && !(s.t[k] > s.t[k - 1]))
      throw InputError(fmt::format("{}: row {}: time does not increase", text, k + 1));
  }
  if (s.t.size() < 2) throw InputError(fmt::format("{}: a series needs at least two rows", text));
  return s;
}

struct Options {
  std::string model, parameters, calcium, length, output, start = "steady";
  std::vector<std::string> set;
  double rtol = 1e-8, atol = 1e-13, sample_ms = 1, duration_s = 0;
  int beats = 1;
  bool steady = false, quiet = false, json = false;
};

void run_force(const Options& o) {
  const CellModel& model = o.model.empty() ? *force_models().front() : find_model(o.model);
  if (model.is_ionic())
    throw InputError(fmt::format("--model = {} is no force model: see wiggers cell", model.name));
  const std::vector<double> parameters = parameters_from(model, o.parameters, o.set);
  const Signal calcium = read_signal(o.calcium, "--calcium", model.inputs[0], units::uM_per_mM);
  const Signal length = read_signal(o.length, "--sarcomere-length", model.inputs[1], 0);
  for (double SL : length.y) check_sarcomere_length(model, parameters, SL);
  if (!o.output.empty()) require_writable(o.output, "-o", FileKind::table);

  std::vector<double> observables(model.observables.size()), rates(model.states.size());
  if (o.steady) {
    if (!calcium.constant() || !length.constant())
      throw InputError("--steady takes one calcium and one sarcomere length, not series");
    const std::vector<double> y = steady_force_state(model, parameters, calcium.y[0], length.y[0]);
    const double inputs[3] = {calcium.y[0], length.y[0], 0};
    model.evaluate(y.data(), inputs, parameters.data(), rates.data(), observables.data());
    const double Ta = observables[static_cast<std::size_t>(model.observable(Role::tension))],
                 Ka = observables[static_cast<std::size_t>(model.observable(Role::stiffness))];
    fmt::print("steady tension {:.10g} kPa, stiffness {:.10g} kPa", Ta, Ka);
    nlohmann::ordered_json summary = {{"Ta_kPa", Ta}, {"Ka_kPa", Ka}};
    for (std::size_t k = 0; k < observables.size(); ++k)
      if (model.observables[k].role == Role::none) {
        fmt::print(", {} {:.10g}", model.observables[k].name, observables[k]);
        summary[std::string(model.observables[k].name)] = observables[k];
      }
    fmt::print("\n");
    if (!o.output.empty()) {
      Table table;
      table.add("Ca", "uM").values = {inputs[0]};
      table.add("SL", "um").values = {inputs[1]};
      for (std::size_t i = 0; i < observables.size(); ++i)
        table.add(std::string(model.observables[i].name), std::string(model.observables[i].unit)).values = {
            observables[i]};
      for (std::size_t i = 0; i < y.size(); ++i)
        table.add(std::string(model.states[i].name), std::string(model.states[i].unit)).values = {y[i]};
      write_csv(o.output, table);
    }
    if (o.json) {
      fmt::print("{}\n", summary.dump());
    }
    return;
  }

  const double begin = std::min(calcium.constant() ? length.begin() : calcium.begin(),
                                length.constant() ? calcium.begin() : length.begin());
  double end = std::max(calcium.end(), length.end());
  if (o.duration_s > 0) end = begin + o.duration_s;
  if (!(end > begin)) throw InputError("nothing to integrate over: give a series, --duration-s, or --steady");
  check_option("--duration-s", end - begin, 1e-6, 1e4);
  check_option("--sample-ms", o.sample_ms, 1e-3, 1e3 * (end - begin));
  require_memory(
      1e3 * (end - begin) / o.sample_ms,
      static_cast<double>(1 + model.inputs.size() + model.observables.size() + model.states.size()),
      fmt::format("--sample-ms {} over {} s", o.sample_ms, end - begin), "Take a larger --sample-ms.");
  check_option("--beats", o.beats, 1, 1e6);
  check_option("--rtol", o.rtol, 1e-13, 0.1);
  check_option("--atol", o.atol, 1e-18, 1);
  std::vector<double> y = model.default_state();
  if (o.start == "steady")
    y = steady_force_state(model, parameters, calcium.at(begin), length.at(begin));
  else if (o.start != "published")
    refuse_unknown("start", o.start, std::vector<std::string>{"steady", "published"});

  // Rate of length: taken as constant within a span, so that it jumps only at the series' kinks.
  double inputs[3] = {calcium.at(begin), length.at(begin), 0};
  OdeSystem system;
  system.size = model.states.size();
  system.derivative = [&](double t, const double* state, double* dy) {
    inputs[0] = calcium.at(t);
    inputs[1] = length.at(t);
    model.evaluate(state, inputs, parameters.data(), dy, nullptr);
  };
  system.jacobian = [&](double t, const double* state, double* jacobian) {
    inputs[0] = calcium.at(t);
    inputs[1] = length.at(t);
    model.jacobian(state, inputs, parameters.data(), jacobian);
  };
  Cvode solver(system, {o.rtol, std::vector<double>(system.size, o.atol)});
  std::set<double> kinks;  // where the rate of length jumps
  for (std::size_t k = 0; k < length.t.size(); ++k) {
    const double before = k == 0 ? 0 : length.slope(length.t[k - 1]);
    const double after = length.slope(length.t[k]);
    if (std::abs(after - before) > 1e-12 && length.t[k] > begin && length.t[k] < end)
      kinks.insert(length.t[k]);
  }
  std::set<double> samples;
  const double step = o.sample_ms * units::s_per_ms;
  for (long k = 0;; ++k) {
    double t = begin + static_cast<double>(k) * step;
    if (t > end - 1e-9 * step) break;
    for (double kink : kinks)
      if (std::abs(kink - t) < 1e-9 * step) t = kink;
    samples.insert(t);
  }
  samples.insert(end);
  std::set<double> stops(samples);
  stops.insert(kinks.begin(), kinks.end());

  Table table;
  table.add("t", "s", "time");
  for (const Quantity& q : model.inputs)
    table.add(std::string(q.name), std::string(q.unit), std::string(q.meaning));
  for (const Quantity& q : model.observables)
    table.add(std::string(q.name), std::string(q.unit), std::string(q.meaning));
  for (const Quantity& q : model.states)
    table.add(std::string(q.name), std::string(q.unit), std::string(q.meaning));
  Progress progress("force", o.quiet ? Progress::Style::quiet : Progress::Style::automatic);
  for (int beat = 0; beat < o.beats; ++beat) {
    const bool last = beat + 1 == o.beats;
    const auto record = [&](double t) {
      if (!last) return;
      const double shown[3] = {calcium.at(t), length.at(t), length.slope(t)};
      model.evaluate(y.data(), shown, parameters.data(), rates.data(), observables.data());
      std::size_t c = 0;
      table.columns[c++].values.push_back(t);
      for (double value : shown) table.columns[c++].values.push_back(value);
      for (double value : observables) table.columns[c++].values.push_back(value);
      for (double value : y) table.columns[c++].values.push_back(value);
    };
    inputs[2] = length.slope(begin);
    solver.restart(begin, y);
    for (double stop : stops) {
      if (stop > begin) y = solver.advance(stop);
      if (samples.count(stop)) record(stop);
      if (kinks.count(stop)) {
        inputs[2] = length.slope(stop);
        solver.restart(stop, y);
      }
      progress.update((beat + (stop - begin) / (end - begin)) / o.beats);
    }
  }
  const auto& tension = table.at("Ta").values;
  const auto peak = std::max_element(tension.begin(), tension.end());
  const double peak_time = table.columns[0].values[static_cast<std::size_t>(peak - tension.begin())];
  fmt::print("tension {:.6g} to {:.6g} kPa, peak at {:.4g} s\n",
             *std::min_element(tension.begin(), tension.end()), *peak, peak_time);
  if (!o.output.empty()) {
    write_csv(o.output, table);
    fmt::print("series: {}\n", o.output);
  }
  if (o.json) {
    const nlohmann::ordered_json summary = {{"Ta_max_kPa", *peak},
                                            {"Ta_min_kPa", *std::min_element(tension.begin(), tension.end())},
                                            {"time_of_peak_s", peak_time}};
    fmt::print("{}\n", summary.dump());
  }
}

}  // namespace

void add_force(CLI::App& app) {
  auto o = std::make_shared<Options>();
  CLI::App* verb = app.add_subcommand("force", "Active force for given calcium and sarcomere length");
  verb->add_option("--model", o->model, "force model, see wiggers models [rdq20]");
  verb->add_option("--parameters", o->parameters,
                   "named parameter set, see wiggers models NAME --sets [the model's first: human37]");
  verb->add_option("--set", o->set, "change a parameter: name=value, in the parameter's unit")->take_all();
  verb->add_option("--calcium", o->calcium,
                   "calcium, uM, or CSV with 't [s]' (or ms) and 'Ca [uM]' (or Ca_i [mM])")
      ->required();
  verb->add_option("--sarcomere-length", o->length, "sarcomere length, um, or CSV with 't [s]' and 'SL [um]'")
      ->required();
  verb->add_flag("--steady", o->steady, "steady tension at one calcium and one length");
  verb->add_option("--start", o->start,
                   "steady: at the first calcium and length | published: all unbound [steady]");
  verb->add_option("--beats", o->beats, "repeat the series so often; the last is written [1]");
  verb->add_option("--duration-s", o->duration_s, "duration, s [that of the series]");
  verb->add_option("--sample-ms", o->sample_ms, "spacing of the output rows, ms [1]");
  verb->add_option("--rtol", o->rtol, "relative tolerance of cvode, 1 [1e-8]");
  verb->add_option("--atol", o->atol, "absolute tolerance of cvode, 1 [1e-13]");
  verb->add_option("-o,--output", o->output, "CSV file: time, inputs, tension, stiffness, states");
  verb->add_flag("--quiet", o->quiet, "no progress");
  verb->add_flag("--json", o->json, "end standard output with one line of JSON");
  verb->callback([o] { run_force(*o); });
}

}  // namespace wiggers::command
