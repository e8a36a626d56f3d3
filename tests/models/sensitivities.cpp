// Derivatives through the limit cycle against central differences of tightly converged cycles.
//
// Two differences are combined by Richardson, for several steps, of which the one with the
// smallest error estimate counts; within that estimate (a third of the two differences' distance) they
// resolve nothing. A derivative counts as wrong by its difference over the larger of the two, and of a
// hundredth of |output/parameter|: what moves an output by less than 1e-4 of itself for a change of the
// parameter by one percent is below what differences can resolve. Steps do not divide the spans between break
// points: where they do, the scheme has a kink and its derivative is one-sided.
#include <catch2/catch.hpp>
#include <cmath>
#include <map>
#include <wiggers/cellmodels/catalogue/force_stepper.hpp>
#include <wiggers/cellmodels/pacing/cell_study.hpp>
#include <wiggers/circulation/loop_beat.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/heart/run/run.hpp>
#include <wiggers/heart/study/heart_study.hpp>
#include <wiggers/heart/study/loop_study.hpp>

using namespace wiggers;

namespace {

using Outputs = std::map<std::string, double>;

bool is_event_time(const std::string& output) {
  return output.ends_with("opens_s") || output.ends_with("closes_s") || output.ends_with("time_to_peak_ms");
}

// solve(parameter, value) gives the outputs of a tightly converged cycle. Returns the worst errors (smooth
// outputs, event times) over all pairs and how many pairs were compared.
struct Worst {
  double smooth = 0, events = 0, unresolved = 0;
  std::size_t compared = 0;
  std::string smooth_at, events_at;
};
template <class Solve>
Worst compare(const Sensitivities& table, const std::vector<NamedParameter>& parameters,
              const std::vector<double>& relative_steps, Solve solve) {
  Worst worst;
  for (std::size_t j = 0; j < table.parameters.size(); ++j) {
    const auto& p = *std::find_if(parameters.begin(), parameters.end(),
                                  [&](const NamedParameter& q) { return q.name == table.parameters[j]; });
    // Times and offsets may be zero: their size is that of a tenth of a beat, or of a charge that matters.
    const bool may_be_zero = p.name.ends_with(".tC") || p.name.ends_with("activation_ms");
    const double size = p.name == "charge_offset_mV" ? 1e4
                        : may_be_zero                ? (p.quantity.unit == "ms" ? 80 : 0.08)
                                                     : std::abs(p.value);
    // Of several steps each output takes the one whose own two quotients agree best.
    std::vector<std::array<Outputs, 4>> points;
    std::vector<double> steps;
    for (double relative : relative_steps) {
      // A period moves the last step's end, which must not pass a whole step.
      const double room = std::min(p.quantity.upper - p.value, p.value - p.quantity.lower);
      const double wanted = size * (p.name == "period_ms" ? 0.1 * relative : relative);
      const double h = room > 0 ? std::min(wanted, 0.9 * room) : wanted;
      steps.push_back(h);
      points.push_back({solve(p.name, p.value - h), solve(p.name, p.value - 0.5 * h),
                        solve(p.name, p.value + 0.5 * h), solve(p.name, p.value + h)});
    }
    for (std::size_t i = 0; i < table.outputs.size(); ++i) {
      const std::string& name = table.outputs[i];
      double quotient = 0, resolution = 1e300;
      for (std::size_t s = 0; s < steps.size(); ++s) {
        const auto& [a, b, c, d] = points[s];
        REQUIRE(a.count(name) == 1);
        const double near = (c.at(name) - b.at(name)) / steps[s];
        const double wide = (d.at(name) - a.at(name)) / (2 * steps[s]);
        if (std::abs(near - wide) / 3 >= resolution) continue;
        resolution = std::abs(near - wide) / 3;
        quotient = (4 * near - wide) / 3;
      }
      const double exact = table.derivatives[i * table.parameters.size() + j];
      const double floor = 0.01 * std::abs(table.values[i]) / size;
      const double scale = std::max({std::abs(quotient), std::abs(exact), floor});
      const double error = std::max(0.0, std::abs(quotient - exact) - resolution) / scale;
      worst.unresolved = std::max(worst.unresolved, resolution / scale);
      // Fast gates at the beat's end follow the length of its last step, which the period moves: bends on the
      // scale of a step, which differences resolve to their noise only.
      const bool event = is_event_time(name) || (name.starts_with("start.") && p.name == "period_ms");
      double& largest = event ? worst.events : worst.smooth;
      if (error > largest) {
        largest = error;
        (event ? worst.events_at : worst.smooth_at) = name + " by " + p.name;
      }
      ++worst.compared;
    }
  }
  return worst;
}

}  // namespace

TEST_CASE("steps that end at valve events keep the fourth order of Runge-Kutta") {
  const Loop loop = find_circulation_set("wiggers-healthy-0d").loop;
  CirculationValues start = loop.initial;
  const LoopSolver fine(loop, {"cvode", 1e-12, 1e-12, 1e-3});
  fine.to_limit_cycle(start, loop_cycle_settings(1e-9));
  CirculationValues exact = start;
  fine.beat(exact);
  const auto error = [&](double dt) {
    CirculationValues y = start;
    LoopSolver(loop, {"runge-kutta-4", 1e-9, 1e-9, dt}).beat(y);
    double largest = 0;
    for (int i = 0; i < n_circulation_states; ++i) largest = std::max(largest, std::abs(y[i] - exact[i]));
    return largest;
  };
  const double coarse = error(1e-3), half = error(5e-4), quarter = error(2.5e-4);
  INFO(coarse << " " << half << " " << quarter);
  CHECK(coarse < 3e-5);
  CHECK(std::log2(coarse / half) > 3.5);
  CHECK(std::log2(half / quarter) > 3.5);
}

TEST_CASE("loop sensitivities agree with differences") {
  const bool with_shunts = GENERATE(false, true);
  Loop loop = find_circulation_set("wiggers-healthy-0d").loop;
  if (with_shunts)
    for (ShuntParameters& shunt : loop.circulation.shunts) shunt = {true, 0.3, 5e-3};
  const std::size_t parameters = with_shunts ? 46 + n_shunts * shunt_quantities.size() : 46;
  // No two break points coincide: where they do, a parameter that moves one of them has one-sided
  // derivatives.
  set_loop_parameter(loop, "elastance.LA.tC", 0.6487);
  set_loop_parameter(loop, "elastance.LV.tC", 0.0127);
  set_loop_parameter(loop, "elastance.RV.tC", 0.0171);
  set_loop_parameter(loop, "elastance.RV.TC", 0.2757);
  const double dt = 0.97e-3;
  const auto cycle = [&](const Loop& changed, CirculationValues start) {
    hold_total_volume(changed.circulation, start.data(),
                      total_volume(changed.circulation, changed.initial.data()));
    LimitCycleSettings settings = loop_cycle_settings(1e-12);
    settings.map_noise = 1e-14;
    LoopSolver(changed, {"runge-kutta-4", 1e-9, 1e-9, dt}).to_limit_cycle(start, settings);
    return start;
  };
  const CirculationValues on_cycle = cycle(loop, loop.initial);
  const Sensitivities table = loop_sensitivities(loop, on_cycle, dt);
  REQUIRE(table.parameters.size() == parameters);
  REQUIRE(table.outputs.size() == (with_shunts ? 76u : 75u));
  const Worst worst =
      compare(table, loop_parameters(loop), {3e-4, 3e-5, 3e-6}, [&](const std::string& name, double value) {
        Loop changed = loop;
        set_loop_parameter(changed, name, value);
        Outputs outputs;
        for_each_index(
            loop_indexes(LoopSolver(changed, {"runge-kutta-4", 1e-9, 1e-9, dt}), cycle(changed, on_cycle)),
            [&](const std::string& index, const char*, double x) { outputs[index] = x; });
        return outputs;
      });
  INFO(worst.smooth_at << " " << worst.smooth << ", " << worst.events_at << " " << worst.events);
  CHECK(worst.compared == parameters * table.outputs.size());
  // An orifice's flow has another curvature on either side of zero: differences are then of first order only.
  CHECK(worst.smooth < (with_shunts ? 5e-5 : 1e-5));
  CHECK(worst.events < 1e-3);
  CHECK(worst.unresolved < 2e-3);
}

TEST_CASE("loop sensitivities converge with the step") {
  const Loop loop = find_circulation_set("wiggers-healthy-0d").loop;
  const auto at = [&](double dt) {
    CirculationValues y = loop.initial;
    LoopSolver(loop, {"runge-kutta-4", 1e-9, 1e-9, dt}).to_limit_cycle(y, loop_cycle_settings(1e-10));
    return loop_sensitivities(loop, y, dt);
  };
  const Sensitivities fine = at(1.25e-4);
  const auto distance = [&](const Sensitivities& other) {
    double largest = 0;
    for (std::size_t k = 0; k < fine.derivatives.size(); ++k) {
      const std::size_t i = k / fine.parameters.size();
      if (is_event_time(fine.outputs[i]) || fine.outputs[i].find("dpdt") != std::string::npos) continue;
      const double size = std::abs(fine.values[i]);
      const std::size_t j = k % fine.parameters.size();
      const double scale = size / std::max(0.05, std::abs(loop_parameters(loop)[j].value));
      largest = std::max(largest, std::abs(other.derivatives[k] - fine.derivatives[k]) / scale);
    }
    return largest;
  };
  // Elasticities: at 1 ms all are good to a hundredth, and the error falls at least linearly.
  const double coarse = distance(at(1e-3)), half = distance(at(5e-4));
  INFO(coarse << " " << half);
  CHECK(coarse < 0.02);
  CHECK(half < 0.6 * coarse);
}

TEST_CASE("loop sensitivities by dual numbers and by CVODES agree") {
  const auto compare_at = [](const char* set, double dt, double rtol, bool with_shunts) {
    Loop loop = find_circulation_set(set).loop;
    for (ShuntParameters& shunt : loop.circulation.shunts) shunt = {with_shunts, 0.3, 5e-3};
    CirculationValues steps = loop.initial, adaptive = loop.initial;
    LoopSolver(loop, {"runge-kutta-4", 1e-9, 1e-9, dt}).to_limit_cycle(steps, loop_cycle_settings(1e-10));
    LoopSolver(loop, {"cvode", rtol, rtol, 1e-3}).to_limit_cycle(adaptive, loop_cycle_settings(1e-9));
    const Sensitivities table = loop_sensitivities(loop, steps, dt);
    const std::vector<double> check = loop_cycle_derivatives_by_cvodes(loop, adaptive, rtol);
    REQUIRE(check.size() == table.state_derivatives.size());
    const auto parameters = loop_parameters(loop);
    const auto scales = circulation_scales();
    // Elasticities of the scaled state.
    double largest = 0;
    for (std::size_t k = 0; k < check.size(); ++k) {
      const double size = std::max(0.05, std::abs(parameters[k % parameters.size()].value));
      largest = std::max(
          largest, std::abs(check[k] - table.state_derivatives[k]) * size / scales[k / parameters.size()]);
    }
    return largest;
  };
  const double diode = compare_at("wiggers-healthy-0d", 2.5e-4, 1e-10, false);
  const double with_holes = compare_at("wiggers-healthy-0d", 2.5e-4, 1e-10, true);
  INFO(diode << " " << with_holes);
  CHECK(with_holes < 1e-5);
  CHECK(diode < 1e-5);
  // A smooth law that turns within microseconds: fixed steps see it late, their derivatives are rougher.
  const double smooth = compare_at("baseline75", 5e-5, 1e-9, false);
  INFO(smooth);
  CHECK(smooth < 1e-3);
}

namespace {
void check_cell(const char* name, double dt_ms, const std::vector<double>& steps) {
  CellStudy study = make_cell_study(find_model(name));
  study.dt_ms = dt_ms;
  std::vector<double> y = start_of(study);
  to_limit_cycle(study, y, LimitCycleSettings{});
  const FixedPointDerivatives newton = newton_at(study, y);
  y = refined_limit_cycle(study, y, newton);
  const Sensitivities table = cell_sensitivities(study, y);
  REQUIRE(table.outputs.size() >= 25);
  REQUIRE(table.parameters.size() + 1 == cell_study_parameters(study).size());
  // Differences of one set of parameters a thread of control: every cycle to rounding.
  const Worst worst =
      compare(table, cell_study_parameters(study), steps, [&](const std::string& name, double value) {
        CellStudy changed = study;
        set_cell_study_parameter(changed, name, value);
        Outputs outputs;
        for (const NamedValue& v : cell_indexes(changed, refined_limit_cycle(changed, y, newton)))
          outputs[v.name] = v.value;
        return outputs;
      });
  INFO(name << ": " << worst.smooth_at << " " << worst.smooth << ", " << worst.events_at << " "
            << worst.events);
  CHECK(worst.smooth < 1e-5);
  CHECK(worst.events < 1e-3);
  CHECK(worst.unresolved < 2e-3);
}
}  // namespace

TEST_CASE("cell sensitivities agree with differences") { check_cell("ttp06-endo", 0.0973, {1e-4, 1e-5}); }
TEST_CASE("atrial cell sensitivities agree with differences", "[.nightly]") {
  check_cell("crn", 0.0967, {1e-3, 1e-4, 1e-5});
}

TEST_CASE("a split step lands on the branch of the rates and changes little else") {
  // The study's beat against the plain steps of PacedCell.
  CellStudy study = make_cell_study(find_model("ttp06-epi"));
  study.dt_ms = 0.02;
  std::vector<double> start = start_of(study), plain = start;
  PacedCell cell(*study.model, study.parameters, study.protocol, {"rush-larsen-2", 1e-8, 1e-10, 0.02});
  cell.beat(plain);
  const PacedRows rows = paced_rows(study, start);
  double nearest = 1e9;
  for (double V : rows.potential_mV) nearest = std::min(nearest, std::abs(V + 40));
  CHECK(rows.t_ms.back() == Approx(1000));
  CHECK(rows.potential_mV.back() == Approx(plain[0]).margin(1e-3));
  CHECK(nearest < 10);
}

namespace {
// Two reduced walls driven by prescribed calcium, two elastances: every kind of parameter in a cheap heart.
const char* small_heart = R"(
title = "small heart"
[heart]
period_s = 0.8
[cells.muscle]
ionic = "transient"
parameters = "fedele2023-ventricles"
[walls.LV]
kind = "reduced"
cells = "muscle"
activation_ms = 160.3
unloaded_volume_mL = 95
wall_volume_mL = 130
a_XB_kPa = 3.75e5
viscosity_Pa_s = 20
n_f = 0.9
epicardial_stiffness_Pa_per_m = 1000
[walls.RV]
kind = "reduced"
cells = "muscle"
activation_ms = 165.4
unloaded_volume_mL = 105
wall_volume_mL = 45
a_XB_kPa = 2.625e5
n_f = 0.9
[walls.LA]
EA = 0.1
EB = 0.09
tC = 0.0217
TC = 0.136
TR = 0.136
[walls.RA]
EA = 0.06
EB = 0.07
tC = 0.0013
TC = 0.136
TR = 0.136
[circulation]
parameters = "fedele2023"
[pericardium]
pressure_mmHg = 2
reference_volume_mL = 350
[solver]
stretch_rate = "implicit"
dt_s = 2e-3
regulatory_substep_us = 100
)";
}  // namespace

namespace {
// A heart with one parameter changed, on its cycle to rounding.
auto changed_heart(const HeartStudy& heart, const HeartState& near, const FixedPointDerivatives& newton) {
  return [&](const std::string& name, double value) {
    HeartStudy changed = heart.copy();
    changed.set_parameter(name, value);
    Outputs outputs;
    for_each_index(changed.indexes(changed.refined(near, newton)),
                   [&](const std::string& index, const char*, double x) { outputs[index] = x; });
    return outputs;
  };
}
}  // namespace

TEST_CASE("heart sensitivities agree with differences") {
  // All of a heart without shunts; of one with holes what they bring.
  std::vector<std::string> holes, wanted;
  if (GENERATE(false, true))
    for (std::string_view name : shunt_names) {
      const std::string shunt = "circulation.shunts." + std::string(name);
      holes.push_back(shunt + ".area_cm2=0.3");
      for (const Quantity& q : shunt_quantities) wanted.push_back(shunt + "." + std::string(q.name));
    }
  if (!wanted.empty()) wanted.push_back("circulation.circuit.PUL.R_AR");
  HeartStudy heart(read_scene_text(small_heart, "small heart", holes));
  LimitCycleSettings settings;
  HeartState state = heart.to_limit_cycle(settings, nullptr);
  REQUIRE(state.certificate.verdict == LimitCycleVerdict::period_1);
  const FixedPointDerivatives newton = heart.newton_at(state);
  state = heart.refined(state, newton);
  const Sensitivities table = heart.sensitivities(state, wanted);
  REQUIRE(table.parameters.size() >= (holes.empty() ? 70 : wanted.size()));
  const Worst worst = compare(table, heart.parameters(), {1e-4, 1e-5}, changed_heart(heart, state, newton));
  INFO(worst.smooth_at << " " << worst.smooth << ", " << worst.events_at << " " << worst.events);
  CHECK(worst.smooth < 1e-5);
  CHECK(worst.events < 1e-3);
  CHECK(worst.unresolved < 2e-3);
}

TEST_CASE("heart sensitivities for every force model, scheme of regulation and stretch rate") {
  int n_models = 0;
  for (const CellModel* model : force_models()) {
    ++n_models;
    std::string text = small_heart;
    const std::string strength(model->strength_key.name);
    const auto replace = [&](const std::string& what, const std::string& by) {
      for (std::size_t at; (at = text.find(what)) != std::string::npos;) text.replace(at, what.size(), by);
    };
    if (model->name != "rdq20") {
      replace("parameters = \"fedele2023-ventricles\"",
              fmt::format("force = \"{}\"\ncalcium_peak_uM = 0.9", model->name));
      replace("a_XB_kPa = 3.75e5\n", "");
      replace("a_XB_kPa = 2.625e5\n", "");
    }
    for (const char* words :
         {"frozen-midpoint implicit", "frozen-midpoint lagged", "forward-euler implicit"}) {
      const std::string both = words, regulation = both.substr(0, both.find(' ')),
                        rate = both.substr(both.find(' ') + 1);
      if (model->name == "rdq20" && regulation == "forward-euler") continue;  // all parameters above
      HeartStudy heart(read_scene_text(text, "small heart",
                                       {"solver.regulation=" + regulation, "solver.stretch_rate=" + rate}));
      HeartState state = heart.to_limit_cycle({}, nullptr);
      INFO(model->name << " " << words << ": " << state.certificate.text() << " "
                       << state.certificate.reason);
      REQUIRE(state.certificate.good());
      const FixedPointDerivatives newton = heart.newton_at(state);
      state = heart.refined(state, newton);
      // Two numbers of the force model, its strength, and what is around it.
      std::vector<std::string> names = {"walls.LV." + strength, "walls.RV.stiffness_kPa",
                                        "cells.muscle.decay_ms", "heart.period_s"};
      for (const Quantity& q : model->parameters)
        if (q.name == "Kbasic" || q.name == "mu0_fP" || q.name == "k_ws" || q.name == "gamma_w")
          names.push_back("cells.muscle.force_changes." + std::string(q.name));
      const Sensitivities table = heart.sensitivities(state, names);
      REQUIRE(table.parameters.size() == names.size());
      const Worst worst =
          compare(table, heart.parameters(), {1e-4, 1e-5}, changed_heart(heart, state, newton));
      INFO(worst.smooth_at << " " << worst.smooth << ", " << worst.events_at << " " << worst.events);
      CHECK(worst.smooth < 1e-4);
      CHECK(worst.events < 1e-3);
    }
  }
  CHECK(n_models >= 2);
}

TEST_CASE("sensitivities of ventricles that share a septum") {
  HeartStudy heart(
      read_scene(std::string(WIGGERS_TEST_DATA) + "/../../scenes/triseg.toml", {"solver.dt_s=2e-3"}));
  HeartState state = heart.to_limit_cycle({}, nullptr);
  REQUIRE(state.certificate.good());
  const FixedPointDerivatives newton = heart.newton_at(state);
  state = heart.refined(state, newton);
  const Sensitivities table = heart.sensitivities(
      state,
      {"walls.ventricles.left.a_XB_kPa", "walls.ventricles.septum.activation_ms",
       "walls.ventricles.right.reference_area_cm2", "walls.ventricles.septum.stiffness_kPa",
       "walls.ventricles.left.wall_volume_mL", "walls.ventricles.n_n", "circulation.circuit.SYS.R_AR"});
  REQUIRE(table.parameters.size() == 7);
  const Worst worst = compare(table, heart.parameters(), {1e-4, 1e-5}, changed_heart(heart, state, newton));
  INFO(worst.smooth_at << " " << worst.smooth << ", " << worst.events_at << " " << worst.events);
  CHECK(worst.smooth < 1e-4);  // of what flows back between two events; all else 1e-5
  CHECK(worst.events < 1e-3);
}

TEST_CASE("every parameter of a heart's study is the scene's key") {
  const Scene scene = read_scene_text(small_heart, "small heart", {});
  HeartStudy heart(scene);
  const auto list = heart.parameters();
  // What a scene file with this key changed gives, the study gives after setting the parameter.
  for (const NamedParameter& p : list) {
    INFO(p.name);
    const double value = p.value == 0 ? 1e-3 : p.value * (1 + 1e-3);
    if (value > p.quantity.upper || p.name == "heart.period_s") continue;
    HeartStudy changed = heart.copy();
    changed.set_parameter(p.name, value);
    for (const NamedParameter& q : changed.parameters())
      CHECK(q.value == Approx(q.name == p.name
                                  ? value
                                  : std::find_if(list.begin(), list.end(),
                                                 [&](const NamedParameter& r) { return r.name == q.name; })
                                        ->value)
                           .epsilon(1e-12));
  }
}

TEST_CASE("a study's heart is the driver's with cells stepped along") {
  const Scene scene =
      read_scene(std::string(WIGGERS_TEST_DATA) + "/../../scenes/whole_heart.toml", {"run.distance=1e-7"});
  HeartRun run(scene);
  run.prepare(Progress::Style::quiet);
  run.advance(Progress::Style::quiet, {});
  HeartStudy study(scene);
  LimitCycleSettings settings;
  settings.distance = 1e-7;
  const BeatIndexes mine = study.indexes(study.to_limit_cycle(settings, nullptr)), driver = run.indexes();
  Outputs a, b;
  for_each_index(mine, [&](const std::string& name, const char*, double x) { a[name] = x; });
  for_each_index(driver, [&](const std::string& name, const char*, double x) { b[name] = x; });
  REQUIRE(a.size() == b.size());
  for (const auto& [name, value] : a) {
    INFO(name);
    CHECK(value ==
          Approx(b.at(name)).epsilon(name.find("dpdt") == std::string::npos ? 1e-3 : 3e-3).margin(1e-3));
  }
}

TEST_CASE("heart sensitivities reach the ionic cells") {
  HeartStudy heart(read_scene(std::string(WIGGERS_TEST_DATA) + "/../../scenes/whole_heart.toml",
                              {"solver.dt_s=2e-3", "solver.electrophysiology_substep_ms=0.0973"}));
  HeartState state = heart.to_limit_cycle({}, nullptr);
  const FixedPointDerivatives newton = heart.newton_at(state);
  state = heart.refined(state, newton);
  const Sensitivities table =
      heart.sensitivities(state, {"cells.ventricles.ionic_changes.g_CaL", "cells.ventricles.calcium_factor",
                                  "cells.atria.ionic_changes.g_CaL", "cells.atria.stimulus_ms"});
  REQUIRE(table.parameters.size() == 4);
  const Worst worst = compare(table, heart.parameters(), {3e-4, 3e-5}, changed_heart(heart, state, newton));
  INFO(worst.smooth_at << " " << worst.smooth << ", " << worst.events_at << " " << worst.events);
  CHECK(worst.smooth < 1e-5);
  CHECK(worst.events < 1e-3);
}

TEST_CASE("studies refuse what they have no text for") {
  CHECK_THROWS_WITH(make_cell_study(find_model("rdq20")), Catch::Contains("force model"));
  CellStudy study = make_cell_study(find_model("crn"));
  CHECK_THROWS_WITH(set_cell_study_parameter(study, "g_Nax", 1), Catch::Contains("did you mean 'g_Na'"));
  CHECK_THROWS_WITH(set_cell_study_parameter(study, "period_ms", 1), Catch::Contains("period_ms"));
  study.integrator = "cvode";
  CHECK_THROWS_WITH(cell_indexes(study, start_of(study)), Catch::Contains("rush-larsen"));
  Loop loop = find_circulation_set("wiggers-healthy-0d").loop;
  CHECK_THROWS_WITH(set_loop_parameter(loop, "elastance.LV.TC", 0.7),
                    Catch::Contains("longer than the period"));
  CHECK_THROWS_WITH(set_loop_parameter(loop, "valves.MV.Rmax", 1e-3), Catch::Contains("below Rmin"));
  CHECK(loop.elastance[LV].TC == 0.272);
}
