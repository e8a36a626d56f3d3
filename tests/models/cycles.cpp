// Limit cycles of the ionic cells, and the charge they keep.
#include <fmt/format.h>

#include <catch2/catch.hpp>
#include <cmath>
#include <wiggers/cellmodels/pacing/pacing.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/rhythm.hpp>

#include "figures.hpp"

using namespace wiggers;

namespace {
std::vector<double> cycle(const char* name, const CellIntegrator& integrator, StimulusPulse pulse,
                          LimitCycleCertificate& certificate, double sodium_shift = 0) {
  const CellModel& model = find_model(name);
  const auto parameters = model.parameter_values("default");
  PacedCell cell(model, parameters, {800, pulse}, integrator);
  std::vector<double> state = model.default_state();
  const double charge = model.charge(state.data(), parameters.data());
  for (std::size_t i = 0; i < state.size(); ++i)
    if (model.states[i].name == "Na_i") state[i] += sodium_shift;
  model.hold_invariants(state.data(), parameters.data(), {charge});
  certificate = cell.to_limit_cycle(state, {});
  return state;
}
double value(const char* name, const std::vector<double>& state, std::string_view quantity) {
  const CellModel& model = find_model(name);
  for (std::size_t i = 0; i < state.size(); ++i)
    if (model.states[i].name == quantity) return state[i];
  return NAN;
}
}  // namespace

TEST_CASE("charge drifts by less than 1e-6 of a beat's turnover in 100 beats with CVODE at 1e-10") {
  for (const char* name : {"crn", "ttp06-endo", "ttp06-mid", "ttp06-epi"}) {
    const CellModel& model = find_model(name);
    const auto parameters = model.parameter_values("default");
    PacedCell cell(model, parameters, {800, model.default_stimulus}, {"cvode", 1e-10, 1e-12, 0.02});
    std::vector<double> state = model.default_state();
    const double charge = model.charge(state.data(), parameters.data());
    // Turnover: the charge that all membrane currents move in one beat.
    double turnover = 0;
    std::vector<double> rates(model.states.size()), observables(model.observables.size());
    cell.beat(state, 1, [&](double, const double* y, double stimulus) {
      model.evaluate(y, &stimulus, parameters.data(), rates.data(), observables.data());
      for (std::size_t i = 0; i < observables.size(); ++i)
        if (model.observables[i].unit == "A/F") turnover += std::abs(observables[i]);
    });
    for (int beat = 1; beat < 100; ++beat) cell.beat(state);
    INFO(name << " turnover " << turnover << " mV");
    CHECK(std::abs(model.charge(state.data(), parameters.data()) - charge) < 1e-6 * turnover);
  }
}

TEST_CASE("TTP06 reaches its limit cycle in at most 16 beats - other starts on the leaf give the same") {
  LimitCycleCertificate certificate;
  const StimulusPulse pulse{-25.71, 3, 0};
  const CellIntegrator tight{"cvode", 1e-10, 1e-12, 0.02};
  const auto state = cycle("ttp06-endo", tight, pulse, certificate);
  CHECK(certificate.verdict == LimitCycleVerdict::period_1);
  CHECK(certificate.distance <= 1e-6);
  CHECK(certificate.beats <= 16);
  CHECK(certificate.multiplier == Approx(0.9934).margin(5e-4));
  const auto other = cycle("ttp06-endo", tight, pulse, certificate, 3);
  for (std::size_t i = 0; i < state.size(); ++i)
    CHECK(std::abs(state[i] - other[i]) <= 1e-5 * (std::abs(state[i]) + 1e-3));
}

TEST_CASE("the limit cycles agree with thousands of plain beats of the reference") {
  struct Case {
    const char* model;
    const char* file;
    double sodium;  // how far the reference's last beat still is from its cycle, in Na_i (mM)
  };
  for (const Case& c : {Case{"ttp06-endo", "ttp06_endo_cycle", 1e-5}, Case{"crn", "crn_cycle", 1e-4}}) {
    LimitCycleCertificate certificate;
    const auto state =
        cycle(c.model, {"cvode", 1e-9, 1e-11, 0.02}, find_model(c.model).default_stimulus, certificate);
    CHECK(certificate.verdict == LimitCycleVerdict::period_1);
    const Table table = data_table(fmt::format("cell/{}.csv", c.file));
    CHECK(std::abs(value(c.model, state, "Na_i") - table.at("Na_i").values.back()) < c.sodium);
    CHECK(std::abs(value(c.model, state, "V") - table.at("V").values.back()) < 1e-3);
  }
}

TEST_CASE("a cycle's slowest multiplier does not depend on when in the beat the stimulus comes") {
  const CellModel& model = find_model("crn");
  for (const double onset : {0.0, 500.0}) {
    StimulusPulse pulse = model.default_stimulus;
    pulse.onset_ms = onset;
    PacedCell cell(model, model.parameter_values("default"), {800, pulse}, {"cvode", 1e-8, 1e-10, 0.02});
    std::vector<double> state = model.default_state();
    LimitCycleSettings settings;
    settings.attractor = Attractor::paced;
    const auto certificate = cell.to_limit_cycle(state, settings);
    INFO("stimulus at " << onset << " ms");
    REQUIRE(certificate.good());
    // The last of Na_i goes so slowly; a short way to the cycle hardly shows it.
    CHECK(certificate.multiplier == Approx(0.9975).margin(5e-4));
    CHECK(certificate.distance <= settings.distance);
    CHECK(certificate.distance >= 0.99 * certificate.residual / (1 - certificate.multiplier));
  }
}

TEST_CASE("a coarse search does not state its distance too small") {
  struct Row {
    const char* model;
    double period_ms, distance;
  };
  for (const Row row : {Row{"ttp06-endo", 800, 1e-2}, Row{"ttp06-endo", 1000, 1e-2},
                        Row{"ttp06-mid", 800, 1e-3}, Row{"crn", 2000, 1e-2}}) {
    const CellModel& model = find_model(row.model);
    PacedCell cell(model, model.parameter_values("default"), {row.period_ms, model.default_stimulus}, {});
    LimitCycleSettings settings;
    settings.attractor = Attractor::paced;
    std::vector<double> exact = model.default_state(), coarse = exact;
    const auto scales = cell.scales(exact);
    REQUIRE(cell.to_limit_cycle(exact, settings).good());
    settings.distance = row.distance;
    const auto certificate = cell.to_limit_cycle(coarse, settings);
    INFO(row.model << " at " << row.period_ms << " ms, distance stated " << certificate.distance);
    CHECK(certificate.good());
    CHECK(scaled_distance(coarse, exact, scales) < 3 * certificate.distance);
  }
}

TEST_CASE("plain beats after the cycle move the state by no more than its residual") {
  const CellModel& model = find_model("crn");
  const auto parameters = model.parameter_values("default");
  PacedCell cell(model, parameters, {800, {-25.71, 3, 0}}, {"rush-larsen", 1e-8, 1e-10, 0.05});
  std::vector<double> state = model.default_state();
  const double charge = model.charge(state.data(), parameters.data());
  const auto scales = cell.scales(state);
  const auto certificate = cell.to_limit_cycle(state, {});
  REQUIRE(certificate.verdict == LimitCycleVerdict::period_1);
  CHECK(certificate.beats <= 80);
  for (int beat = 0; beat < 5; ++beat) {
    const std::vector<double> before = state;
    cell.beat(state);
    model.hold_invariants(state.data(), parameters.data(), {charge});
    for (std::size_t i = 0; i < state.size(); ++i)
      CHECK(std::abs(state[i] - before[i]) / scales[i] <= std::max(2 * certificate.residual, 1e-10));
  }
}

TEST_CASE("a cell whose stimulus no ion carries has no cycle, and is refused with the reason") {
  const CellModel& model = find_model("crn");
  PacedCell cell(model, model.parameter_values("stimulus-uncarried"), {800, model.default_stimulus}, {});
  std::vector<double> state = model.default_state();
  CHECK_THROWS_WITH(cell.to_limit_cycle(state, {}),
                    Catch::Contains("no limit cycle") && Catch::Contains("stimulus_K_fraction"));
}

TEST_CASE("cycles from the published start: few beats, one cycle by every method and from other starts") {
  struct Case {
    const char* model;
    int most_beats;
    double Na_shift, Ca_shift;
    const char* store;
  };
  for (const Case& c : {Case{"ttp06-endo", 16, 3, -2, "Ca_SR"}, Case{"crn", 40, 3, -0.5, "Ca_up"}}) {
    const CellModel& model = find_model(c.model);
    const auto parameters = model.parameter_values("default");
    const PacingProtocol protocol{800, {-25.71, 3, 0}};
    const CellIntegrator integrator{"rush-larsen-2", 1e-8, 1e-10, 0.1};
    const auto scales = PacedCell(model, parameters, protocol, integrator).scales(model.default_state());
    const double charge = model.charge(model.default_state().data(), parameters.data());
    const auto cycle = [&](LimitCycleMethod method, std::vector<double> start, int& beats) {
      PacedCell cell(model, parameters, protocol, integrator);
      LimitCycleSettings settings;
      settings.method = method;
      settings.max_beats = 400;
      const auto certificate = cell.to_limit_cycle(start, settings);
      CHECK(certificate.verdict == LimitCycleVerdict::period_1);
      CHECK(certificate.distance <= 1e-6);
      beats = certificate.beats;
      return start;
    };
    int beats = 0;
    const auto found = cycle(LimitCycleMethod::anderson, model.default_state(), beats);
    INFO(c.model << " " << beats << " beats");
    CHECK(beats <= c.most_beats);
    const auto same = [&](const std::vector<double>& other) {
      double distance = 0;
      for (std::size_t i = 0; i < found.size(); ++i)
        distance = std::max(distance, std::abs(found[i] - other[i]) / scales[i]);
      return distance;
    };
    CHECK(same(cycle(LimitCycleMethod::newton, model.default_state(), beats)) < 1e-5);
    CHECK(same(cycle(LimitCycleMethod::kinsol, model.default_state(), beats)) < 1e-5);
    // Further plain beats stay.
    std::vector<double> paced = found;
    PacedCell cell(model, parameters, protocol, integrator);
    for (int beat = 0; beat < 5; ++beat) {
      cell.beat(paced);
      model.hold_invariants(paced.data(), parameters.data(), {charge});
    }
    CHECK(same(paced) < 2e-6);
    // Other starts on the same leaf lead to the same cycle, another charge to another.
    const std::size_t Na = require_index(model.states, "state", "Na_i");
    for (double sign : {1.0, -1.0}) {
      std::vector<double> start = model.default_state();
      start[Na] += sign * c.Na_shift;
      model.hold_invariants(start.data(), parameters.data(), {charge});
      CHECK(same(cycle(LimitCycleMethod::anderson, start, beats)) < 1e-5);
    }
    std::vector<double> start = model.default_state();
    start[require_index(model.states, "state", c.store)] += c.Ca_shift;
    model.hold_invariants(start.data(), parameters.data(), {charge});
    CHECK(same(cycle(LimitCycleMethod::anderson, start, beats)) < 1e-5);
    start = model.default_state();
    start[Na] += 1;  // and its charge
    CHECK(same(cycle(LimitCycleMethod::anderson, start, beats)) > 1e-3);
    // Half the step moves the cycle, by a quarter of what it moves at twice the step.
    const auto shift = PacedCell(model, parameters, protocol, integrator).integrator_shift(found);
    REQUIRE(shift);
    CHECK((*shift > 1e-5 && *shift < 0.05));
  }
}

TEST_CASE("a slow cell is not left to its integrator's noise") {
  // CRN's noise is some sixty tolerances, and its distance three hundred changes over a beat.
  const CellModel& model = find_model("crn");
  PacedCell cell(model, model.parameter_values("default"), {1000, model.default_stimulus}, {});
  std::vector<double> state = model.default_state();
  LimitCycleSettings settings;
  settings.attractor = Attractor::paced;
  const auto certificate = cell.to_limit_cycle(state, settings);
  CHECK(certificate.good());
  CHECK(certificate.distance <= 1e-6);
  CHECK(certificate.beats <= 36);
}

TEST_CASE("a cycle found after a rhythm that was none is believed where beats beside it come back") {
  // Long looks end in rounding, which must not pass for alternation.
  const CellModel& model = find_model("crn");
  PacedCell cell(model, model.parameter_values("default"), {400, {-20, 2, 0}},
                 {"rush-larsen-2", 1e-8, 1e-10, 0.1});
  std::vector<double> state = model.default_state();
  LimitCycleSettings settings;
  settings.attractor = Attractor::paced;
  const auto certificate = cell.to_limit_cycle(state, settings);
  INFO(certificate.reason);
  CHECK(certificate.good());
  CHECK(certificate.beats < 1000);
}
