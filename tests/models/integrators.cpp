// Integrators on the cell models: reference action potentials, orders, stimulus edges, failures.
#include <fmt/format.h>

#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <wiggers/cellmodels/pacing/pacing.hpp>
#include <wiggers/core/cvode.hpp>
#include <wiggers/core/errors.hpp>

#include "figures.hpp"

using namespace wiggers;

namespace {
struct Trace {
  std::vector<double> t;
  std::vector<std::vector<double>> y;
};
Trace one_beat(const CellModel& model, const PacingProtocol& protocol, const CellIntegrator& integrator,
               double sample_ms) {
  PacedCell cell(model, model.parameter_values("default"), protocol, integrator);
  std::vector<double> state = model.default_state();
  Trace trace;
  cell.beat(state, sample_ms, [&](double t, const double* y, double) {
    trace.t.push_back(t);
    trace.y.emplace_back(y, y + state.size());
  });
  return trace;
}
void compare(const char* name, const Table& table) {
  const CellModel& model = find_model(name);
  const Trace trace = one_beat(model, {1000, model.default_stimulus}, {"cvode", 1e-8, 1e-10, 0.02}, 1);
  REQUIRE(trace.t.size() == 1001);
  for (std::size_t k = 0; k < table.n_rows(); ++k) {
    const auto row = static_cast<std::size_t>(std::lround(table.at("t").values[k]));
    INFO(name << " t " << row << " ms");
    CHECK(std::abs(trace.y[row][model.membrane_potential] - table.at("V").values[k]) <= 1e-3);
    const double calcium = table.at("Ca_i").values[k];
    CHECK(std::abs(trace.y[row][model.cytosolic_calcium] - calcium) <= 1e-5 * calcium);
  }
}
}  // namespace

TEST_CASE("first action potentials against the reference") {
  for (const auto& [name, file] : {std::pair{"crn", "crn"},
                                   {"ttp06-endo", "ttp06_endo"},
                                   {"ttp06-mid", "ttp06_mid"},
                                   {"ttp06-epi", "ttp06_epi"}}) {
    compare(name, data_table(fmt::format("cell/{}_ap.csv", file)));
    const std::string full = fmt::format("cell/{0}/{0}_ap_1hz_beat1.csv", file);
    if (have_reference(full)) compare(name, reference_table(full));
  }
}

TEST_CASE("fixed-step schemes have their order on a smooth window and on the whole beat") {
  struct Scheme {
    const char* name;
    double order;
  };
  // Nominal orders; TTP06 after the upstroke (t > 50 ms) at 1 Hz. The bound is 0.2 of the order.
  const CellModel& model = find_model("ttp06-endo");
  const PacingProtocol protocol{400, model.default_stimulus};
  const Trace exact = one_beat(model, protocol, {"cvode", 1e-11, 1e-13, 0.02}, 10);
  for (const Scheme& scheme : {Scheme{"rush-larsen", 1},
                               {"rush-larsen-2", 2},
                               {"bdf2-imex", 2},
                               {"generalised-rush-larsen", 1},
                               {"generalised-rush-larsen-2", 2}}) {
    std::vector<double> errors;
    for (double dt : {0.02, 0.01, 0.005}) {
      const Trace trace = one_beat(model, protocol, {scheme.name, 1e-8, 1e-10, dt}, 10);
      double error = 0;
      for (std::size_t k = 5; k < trace.t.size(); ++k)
        error = std::max(error, std::abs(trace.y[k][0] - exact.y[k][0]));
      errors.push_back(error);
    }
    INFO(scheme.name << " errors " << errors[0] << " " << errors[1] << " " << errors[2]);
    CHECK(std::log2(errors[1] / errors[2]) == Approx(scheme.order).margin(0.2));
  }
}

TEST_CASE("forward Euler is stable where it should be and fails in words where it should not") {
  const CellModel& model = find_model("ttp06-endo");
  const PacingProtocol protocol{100, model.default_stimulus};
  CHECK_NOTHROW(one_beat(model, protocol, {"forward-euler", 1e-8, 1e-10, 0.001}, 1));
  CHECK_THROWS_WITH(one_beat(model, protocol, {"forward-euler", 1e-8, 1e-10, 0.02}, 1),
                    Catch::Contains("left its physical range") && Catch::Contains("forward-euler"));
}

TEST_CASE("the stimulus delivers its charge for any step and sampling") {
  // With all conductances off, V rises by the charge of the pulse alone.
  const CellModel& model = find_model("ttp06-endo");
  std::vector<double> parameters = model.parameter_values("default");
  for (std::size_t i = 0; i < parameters.size(); ++i)
    for (const char* name : {"g_Na", "g_K1", "g_to", "g_Kr", "g_Ks", "g_CaL", "g_bNa", "g_bCa", "g_pK",
                             "g_pCa", "P_NaK", "k_NaCa"})
      if (model.parameters[i].name == name) parameters[i] = 0;
  for (double dt : {0.05, 0.03, 0.37})
    for (double onset : {0.0, 10.123}) {
      PacedCell cell(model, parameters, {100, {-25.71, 3, onset}}, {"rush-larsen", 1e-8, 1e-10, dt});
      std::vector<double> state = model.default_state();
      const double before = state[0];
      cell.beat(state, 1, [](double, const double*, double) {});
      CHECK(state[0] - before == Approx(3 * 25.71).epsilon(1e-10));
    }
}

TEST_CASE("protocols that make no sense are refused before any work") {
  const CellModel& model = find_model("crn");
  const auto make = [&](PacingProtocol protocol, CellIntegrator integrator) {
    PacedCell(model, model.parameter_values("default"), protocol, integrator);
  };
  CHECK_THROWS_WITH(make({2, {-20, 2, 0}}, {}), Catch::Contains("not longer than the stimulus"));
  CHECK_THROWS_AS(make({-5, {-20, 2, 0}}, {}), InputError);
  CHECK_THROWS_AS(make({1000, {-20, -2, 0}}, {}), InputError);
  CHECK_THROWS_AS(make({1000, {std::nan(""), 2, 0}}, {}), InputError);
  CHECK_THROWS_WITH(make({1000, {-20, 2, 0}}, {"rush-larson", 1e-8, 1e-10, 0.02}),
                    Catch::Contains("did you mean 'rush-larsen'"));
  CHECK_THROWS_AS(make({1000, {-20, 2, 0}}, {"rush-larsen", 1e-8, 1e-10, 0}), InputError);
  CHECK_THROWS_AS(make({1000, {-20, 2, 0}}, {"cvode", 0, 1e-10, 0}), InputError);
}

TEST_CASE("every adaptive integrator gives the same beat, nearer with tighter tolerances") {
  for (const char* name : {"crn", "ttp06-epi"}) {
    const CellModel& model = find_model(name);
    const PacingProtocol protocol{350, {-25.71, 3, 5}};
    const Trace exact = one_beat(model, protocol, {"cvode", 1e-12, 1e-14, 0}, 0.5);
    const auto error = [&](const char* integrator, double rtol) {
      const Trace trace = one_beat(model, protocol, {integrator, rtol, 0.01 * rtol, 0}, 0.5);
      REQUIRE(trace.t.size() == exact.t.size());
      double largest = 0;
      for (std::size_t k = 0; k < trace.t.size(); ++k)
        largest = std::max(largest, std::abs(trace.y[k][0] - exact.y[k][0]));
      return largest;
    };
    for (const char* integrator : {"cvode", "rosenbrock", "odeint-rosenbrock4"}) {
      INFO(name << " " << integrator);
      const double coarse = error(integrator, 1e-5), fine = error(integrator, 1e-8);
      CHECK(coarse < 0.5);
      CHECK(fine < 1e-3);
      CHECK(fine < 0.1 * coarse);
    }
    CHECK(error("odeint-dopri5", 1e-6) < 0.02);
  }
}

TEST_CASE("Rosenbrock: order four, its steps grow with the tolerance, output does not shorten them") {
  const CellModel& model = find_model("ttp06-endo");
  const auto steps = [&](double rtol, double sample_ms) {
    PacedCell cell(model, model.parameter_values("default"), {800, {-25.71, 3, 0}},
                   {"rosenbrock", rtol, 0.01 * rtol, 0});
    std::vector<double> state = model.default_state();
    cell.beat(state, sample_ms, [](double, const double*, double) {});
    return cell.counts().steps;
  };
  CHECK(steps(1e-5, 0.1) == steps(1e-5, 100));
  CHECK(steps(1e-8, 100) > 5 * steps(1e-5, 100));
  CHECK(steps(1e-4, 100) < 500);
}

TEST_CASE("rates keep to one side of their branch and the crossing is an end of a step") {
  // With the branch hit exactly, halving tolerances keeps converging through the jump at -40 mV.
  const CellModel& model = find_model("crn");
  std::vector<double> ends;
  for (double rtol : {1e-6, 1e-8, 1e-10}) {
    PacedCell cell(model, model.parameter_values("default"), {400, {-25.71, 3, 0}},
                   {"rosenbrock", rtol, 0.01 * rtol, 0});
    std::vector<double> state = model.default_state();
    cell.beat(state);
    ends.push_back(state[0]);
    CHECK(cell.counts().rejected < 0.2 * static_cast<double>(cell.counts().steps) + 60);
  }
  CHECK(std::abs(ends[1] - ends[2]) < 0.05 * std::abs(ends[0] - ends[2]) + 1e-9);
}

TEST_CASE("a Jacobian in parts is the Jacobian of the whole") {
  for (const CellModel* each : catalogue()) {
    const CellModel& model = *each;
    const auto parameters = model.parameter_values(model.parameter_sets.front().name);
    const auto equations = model.equations(parameters);
    std::vector<double> y = model.default_state(), in, rates(y.size()), other(y.size()),
                        jacobian(y.size() * y.size());
    for (const Quantity& q : model.inputs) in.push_back(q.default_value);
    if (model.is_ionic()) y[static_cast<std::size_t>(model.membrane_potential)] = -33.3;
    if (!model.is_ionic()) {
      for (std::size_t i = 0; i < y.size(); ++i) y[i] = (1.0 + static_cast<double>(i)) / 136.0;
      model.normalise(y.data());
    }
    equations->jacobian(y.data(), in.data(), jacobian.data());
    equations->evaluate(y.data(), in.data(), rates.data(), nullptr);
    for (std::size_t column = 0; column < y.size(); ++column) {
      const double h = 1e-7 * std::max(1e-3, std::abs(y[column]));
      std::vector<double> up = y, down = y;
      up[column] += h;
      down[column] -= h;
      equations->evaluate(up.data(), in.data(), rates.data(), nullptr);
      equations->evaluate(down.data(), in.data(), other.data(), nullptr);
      for (std::size_t row = 0; row < y.size(); ++row) {
        INFO(model.name << " d" << model.states[row].name << "/d" << model.states[column].name);
        const double difference = (rates[row] - other[row]) / (2 * h);
        CHECK(jacobian[row + y.size() * column] ==
              Approx(difference).epsilon(2e-4).margin(1e-5 * (1 + std::abs(rates[row]) / h * 1e-9)));
      }
    }
  }
}

TEST_CASE("a start on the branch potential itself goes either way") {
  for (const char* name : {"crn", "ttp06-endo"})
    for (double stimulus : {0.0, -25.71})
      for (const char* integrator : {"rosenbrock", "cvode"}) {
        const CellModel& model = find_model(name);
        const auto run = [&](const char* by, double rtol) {
          PacedCell cell(model, model.parameter_values("default"), {300, {stimulus, 3, 0}},
                         {by, rtol, 0.01 * rtol, 0});
          std::vector<double> state = model.default_state();
          state[0] = -40.0;
          cell.beat(state);
          return state[0];
        };
        INFO(name << " " << integrator << " " << stimulus);
        CHECK(run(integrator, 1e-7) == Approx(run("cvode", 1e-10)).margin(0.01));
      }
}

TEST_CASE("a failure names its model once") {
  const CellModel& model = find_model("crn");
  PacedCell cell(model, model.parameter_values("default"), {1000, {-1000, 20, 0}}, {"cvode", 1e-8, 1e-10, 0});
  std::vector<double> state = model.default_state();
  std::string text;
  try {
    cell.beat(state, 0.1, [](double, const double*, double) {});
  } catch (const NumericalFailure& failure) {
    text = failure.what();
  }
  INFO(text);
  CHECK(text.starts_with("crn: "));
  CHECK(text.find("crn: ", 1) == std::string::npos);
}
