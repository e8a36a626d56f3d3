// Limit cycles of the ionic cells, and the charge they keep.
#include <fmt/format.h>

#include <catch2/catch.hpp>
#include <cmath>
#include <wiggers/cellmodels/pacing.hpp>
#include <wiggers/core/errors.hpp>

#include "figures.hpp"

using namespace wiggers;

namespace {
std::vector<double> cycle(const char* name, const CellIntegrator& integrator, StimulusPulse pulse,
                          LimitCycleCertificate& certificate, double sodium_shift = 0) {
  const CellModel& model = find_model(name);
  const auto parameters = model.parameter_values("default");
  PacedCell cell(model, parameters, {800, pulse}, integrator);
  std::vector<double> state = model.default_state();
  const double charge = model.invariant(state.data(), parameters.data());
  for (std::size_t i = 0; i < state.size(); ++i)
    if (model.states[i].name == "Na_i") state[i] += sodium_shift;
  model.hold_invariant(state.data(), parameters.data(), charge);
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
    const double charge = model.invariant(state.data(), parameters.data());
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
    CHECK(std::abs(model.invariant(state.data(), parameters.data()) - charge) < 1e-6 * turnover);
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
  for (const Case& c : {Case{"ttp06-endo", "ttp06_endo/ttp06_endo_limitcycle_800ms_3000beats_states", 1e-5},
                        Case{"crn", "crn/crn_limitcycle_800ms_5000beats_states", 1e-4}}) {
    const std::string path = fmt::format("cell/{}.csv", c.file);
    if (!have_reference(path)) {
      WARN("full reference not at hand: skipped");
      continue;
    }
    LimitCycleCertificate certificate;
    const auto state =
        cycle(c.model, {"cvode", 1e-9, 1e-11, 0.02}, find_model(c.model).default_stimulus, certificate);
    CHECK(certificate.verdict == LimitCycleVerdict::period_1);
    const Table table = reference_table(path);
    CHECK(std::abs(value(c.model, state, "Na_i") - table.at("Na_i").values.back()) < c.sodium);
    CHECK(std::abs(value(c.model, state, "V") - table.at("V").values.back()) < 1e-3);
  }
}

TEST_CASE("plain beats after the cycle move the state by no more than its residual") {
  const CellModel& model = find_model("crn");
  const auto parameters = model.parameter_values("default");
  PacedCell cell(model, parameters, {800, {-25.71, 3, 0}}, {"rush-larsen", 1e-8, 1e-10, 0.05});
  std::vector<double> state = model.default_state();
  const double charge = model.invariant(state.data(), parameters.data());
  const auto scales = cell.scales(state);
  const auto certificate = cell.to_limit_cycle(state, {});
  REQUIRE(certificate.verdict == LimitCycleVerdict::period_1);
  CHECK(certificate.beats <= 80);
  for (int beat = 0; beat < 5; ++beat) {
    const std::vector<double> before = state;
    cell.beat(state);
    model.hold_invariant(state.data(), parameters.data(), charge);
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
