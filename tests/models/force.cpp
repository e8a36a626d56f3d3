// RDQ20: steady force, twitches, ramps, the stepper used by heart and tissue.
#include <fmt/format.h>

#include <catch2/catch.hpp>
#include <cmath>
#include <wiggers/cellmodels/catalogue/catalogue.hpp>
#include <wiggers/cellmodels/catalogue/force_stepper.hpp>
#include <wiggers/cellmodels/models/rdq20.hpp>
#include <wiggers/core/cvode.hpp>
#include <wiggers/core/errors.hpp>

#include "figures.hpp"

using namespace wiggers;

namespace {
struct Set {
  const char* name;
  const char* file;
};
const Set sets[] = {
    {"human37", "human37"}, {"fedele2023-ventricles", "ventricle"}, {"fedele2023-atria", "atrium"}};

double steady_tension(const std::vector<double>& parameters, double calcium, double length) {
  const CellModel& model = find_model("rdq20");
  const auto y = steady_force_state(model, parameters, calcium, length);
  return make_force_stepper<double>(model, parameters)->forces(y.data(), length).tension_kPa;
}

// Calcium of the twitch protocol: rest 0.1, peak 0.9 uM, 20 and 50 ms, from 10 ms on.
double twitch_calcium(double t) {
  if (t < 0.01) return 0.1;
  const double q = 0.02 / 0.05;
  const double peak = std::pow(q, -1 / (q - 1)) - std::pow(q, -1 / (1 - 1 / q));
  return 0.1 + 0.8 / peak * (std::exp((0.01 - t) / 0.02) - std::exp((0.01 - t) / 0.05));
}

// Largest error of the tension along a reference series, over its peak: CVODE on the series' own inputs.
// With `analytic`, calcium is the transient of the protocol itself, not its 1 ms samples joined by lines.
double series_error(const char* set, const Table& table, bool analytic) {
  const CellModel& model = find_model("rdq20");
  const auto parameters = model.parameter_values(set);
  const auto& t = table.at("t").values;
  const auto& calcium = table.at("Ca").values;
  const auto& length = table.at("SL").values;
  std::vector<double> y;
  for (const Quantity& q : model.states) y.push_back(table.at(q.name).values[0]);
  std::size_t k = 1;
  double in[3];
  const auto inputs = [&](double when) {
    const double share = (when - t[k - 1]) / (t[k] - t[k - 1]);
    in[0] = analytic ? twitch_calcium(when) : calcium[k - 1] + share * (calcium[k] - calcium[k - 1]);
    in[1] = length[k - 1] + share * (length[k] - length[k - 1]);
    in[2] = (length[k] - length[k - 1]) / (t[k] - t[k - 1]);
  };
  OdeSystem system;
  system.size = y.size();
  system.derivative = [&](double when, const double* state, double* dy) {
    inputs(when);
    model.evaluate(state, in, parameters.data(), dy, nullptr);
  };
  Cvode solver(system, {1e-9, std::vector<double>(y.size(), 1e-14)});
  const auto stepper = make_force_stepper<double>(model, parameters);
  double error = 0, peak = 0;
  bool fresh = true;
  double slope_before = 0;
  for (k = 1; k < t.size(); ++k) {
    const double slope = (length[k] - length[k - 1]) / (t[k] - t[k - 1]);
    const bool onset = analytic && std::abs(t[k - 1] - 0.01) < 1e-9;
    if (fresh || onset || std::abs(slope - slope_before) > 1e-9) solver.restart(t[k - 1], y);
    fresh = false;
    slope_before = slope;
    y = solver.advance(t[k]);
    error = std::max(error,
                     std::abs(stepper->forces(y.data(), length[k]).tension_kPa - table.at("Ta").values[k]));
    peak = std::max(peak, table.at("Ta").values[k]);
  }
  return error / peak;
}
}  // namespace

TEST_CASE("steady force-calcium curves against the reference") {
  for (const Set& set : sets) {
    const auto parameters = find_model("rdq20").parameter_values(set.name);
    const Table table = data_table(fmt::format("cell/rdq20_{}_force_calcium.csv", set.file));
    double peak = 0;
    for (double tension : table.at("Ta").values) peak = std::max(peak, tension);
    for (std::size_t k = 0; k < table.n_rows(); k += 3) {
      const double tension = steady_tension(parameters, table.at("Ca").values[k], table.at("SL").values[k]);
      INFO(set.name << " Ca " << table.at("Ca").values[k] << " SL " << table.at("SL").values[k]);
      CHECK(std::abs(tension - table.at("Ta").values[k]) <= 1e-4 * peak);
      // The curve's foot too, relatively.
      CHECK(tension == Approx(table.at("Ta").values[k]).epsilon(1e-4));
    }
  }
}

TEST_CASE("resting tension of the whole-heart sets") {
  const CellModel& model = find_model("rdq20");
  const auto rest = [&](const char* set, double calcium) {
    const auto y = steady_force_state(model, model.parameter_values(set), calcium, 1.9);
    return y[Rdq20::mu1_P] + y[Rdq20::mu1_N];
  };
  CHECK(rest("fedele2023-ventricles", 0.05444) == Approx(7.457e-6).epsilon(1e-3));
  CHECK(rest("fedele2023-atria", 0.13276) == Approx(1.4223e-5).epsilon(1e-3));
}

TEST_CASE("twitches and ramps against the reference") {
  int n_full = 0;
  for (const Set& set : sets) {
    INFO(set.name);
    CHECK(series_error(set.name, data_table(fmt::format("cell/rdq20_{}_ramp.csv", set.file)), false) <= 1e-4);
    for (const char* protocol : {"twitch_isometric_SL2p2", "twitch_ionic_SL1p9", "twitch_ionic_SL2p2",
                                 "ramp_m0p3", "ramp_m1p0", "ramp_m2p0", "ramp_p0p5"}) {
      const std::string path = fmt::format("cell/rdq20mf/rdq20mf_{}_{}.csv", set.file, protocol);
      if (!have_reference(path)) continue;
      ++n_full;
      INFO(path);
      CHECK(series_error(set.name, reference_table(path),
                         std::string(protocol) == "twitch_isometric_SL2p2") <= 1e-4);
    }
  }
  // All of the full reference, or none where there is none.
  CHECK(n_full == (have_reference("cell") ? 21 : 0));
}

TEST_CASE("the stepper converges to the equations - crossbridges are exact for frozen regulation") {
  const CellModel& model = find_model("rdq20");
  const auto parameters = model.parameter_values("fedele2023-ventricles");
  const auto stepper = make_force_stepper<double>(model, parameters);
  const double in[3] = {0.6, 2.0, -3.0};
  OdeSystem system;
  system.size = model.states.size();
  system.derivative = [&](double, const double* y, double* dy) {
    model.evaluate(y, in, parameters.data(), dy, nullptr);
  };
  const auto start = steady_force_state(model, parameters, 0.1, 2.0);
  Cvode solver(system, {1e-11, std::vector<double>(system.size, 1e-16)});
  solver.restart(0, start);
  const double exact = stepper->forces(solver.advance(0.05).data(), in[1]).tension_kPa;
  std::vector<double> errors;
  for (double dt : {1e-3, 5e-4, 2.5e-4}) {
    std::vector<double> y = start;
    ForcesOf<double> forces;
    const ForceScheme scheme = {RegulationScheme::forward_euler, static_cast<int>(std::lround(dt / 2.5e-5)),
                                RateScheme::lagged};
    for (double t = 0; t < 0.05 - 1e-9; t += dt)
      REQUIRE(stepper->begin(scheme, dt, y.data(), in[0], in[1], -in[2] / stepper->reference_length_um(),
                             forces));
    double sum = 0;
    for (int i = 0; i < Rdq20::n_probabilities; ++i) sum += y[i];
    CHECK(sum == Approx(1).epsilon(1e-12));
    errors.push_back(std::abs(forces.tension_kPa / exact - 1));
  }
  CHECK(errors[0] < 0.02);
  CHECK(errors[2] < 0.6 * errors[1]);

  // Frozen regulation: one large step equals many small ones to rounding.
  std::vector<double> once = start, often = start;
  const auto constants = Rdq20::constants(parameters.data());
  const auto ru = Rdq20::regulation(start.data(), 0.6, 2.0, constants);
  Rdq20::cycle(8e-3, once.data(), ru, 1.7, 1.7, constants);
  for (int k = 0; k < 64; ++k) Rdq20::cycle(1.25e-4, often.data(), ru, 1.7, 1.7, constants);
  for (std::size_t i = Rdq20::n_probabilities; i < once.size(); ++i)
    CHECK(once[i] == Approx(often[i]).epsilon(1e-11));
}

TEST_CASE("a twitch keeps probability, symmetry and positivity") {
  const CellModel& model = find_model("rdq20");
  const auto parameters = model.parameter_values("fedele2023-atria");
  const auto stepper = make_force_stepper<double>(model, parameters);
  for (const RegulationScheme regulation : {RegulationScheme::forward_euler, RegulationScheme::midpoint}) {
    auto y = steady_force_state(model, parameters, 0.1, 1.9);
    ForcesOf<double> forces;
    for (int n = 0; n < 400; ++n) {
      const double calcium = 0.1 + 0.7 * std::exp(-n / 80.0) * (1 - std::exp(-n / 15.0));
      REQUIRE(stepper->begin({regulation, 40, RateScheme::lagged}, 1e-3, y.data(), calcium, 1.9, 0, forces));
      double sum = 0;
      for (int a = 0; a < 2; ++a)
        for (int b = 0; b < 2; ++b)
          for (int c = 0; c < 2; ++c)
            for (int B = 0; B < 2; ++B) {
              sum += y[Rdq20::P(a, b, c, B)];
              REQUIRE(y[Rdq20::P(a, b, c, B)] > -1e-12);
              REQUIRE(y[Rdq20::P(a, b, c, B)] == Approx(y[Rdq20::P(c, b, a, B)]).margin(1e-12));
            }
      REQUIRE(sum == Approx(1).epsilon(1e-12));
    }
  }
}

TEST_CASE("a sarcomere length beyond the force model is refused with the bound") {
  const CellModel& model = find_model("rdq20");
  const auto parameters = model.parameter_values("human37");
  CHECK_THROWS_WITH(steady_force_state(model, parameters, 0.3, 2.9),
                    Catch::Contains("SL must stay below 2.817"));
  CHECK_THROWS_AS(steady_force_state(model, parameters, -0.1, 2.0), InputError);
}
