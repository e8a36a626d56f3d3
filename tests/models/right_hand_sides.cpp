// Every derivative, current, tension and stiffness against independent evaluations; Jacobians; invariants.
#include <fmt/format.h>

#include <catch2/catch.hpp>
#include <cmath>
#include <limits>
#include <random>
#include <set>
#include <wiggers/cellmodels/catalogue/catalogue.hpp>
#include <wiggers/cellmodels/models/force_models.hpp>
#include <wiggers/cellmodels/models/ionic_models.hpp>
#include <wiggers/cellmodels/pacing/cell_sense.hpp>
#include <wiggers/core/dual.hpp>
#include <wiggers/core/errors.hpp>

#include "figures.hpp"

using namespace wiggers;

namespace {

struct Case {
  const char* model;
  const char* set;
  const char* file;
};
const Case ionic_cases[] = {{"crn", "default", "crn"},
                            {"ttp06-endo", "default", "ttp06_endo"},
                            {"ttp06-mid", "default", "ttp06_mid"},
                            {"ttp06-epi", "default", "ttp06_epi"}};
const Case force_cases[] = {{"rdq20", "human37", "human37"},
                            {"rdq20", "fedele2023-ventricles", "ventricle"},
                            {"rdq20", "fedele2023-atria", "atrium"}};

struct Row {
  std::vector<double> y, in;
};
Row row_of(const CellModel& model, const Table& table, std::size_t row) {
  Row r;
  for (const Quantity& q : model.states) r.y.push_back(table.at(q.name).values[row]);
  for (const Quantity& q : model.inputs) r.in.push_back(table.at(q.name).values[row]);
  return r;
}

}  // namespace

TEST_CASE("derivatives of the ionic models at every reference state") {
  for (const Case& c : ionic_cases) {
    const CellModel& model = find_model(c.model);
    const Table table = data_table(fmt::format("cell/{}_rhs.csv", c.file));
    REQUIRE(table.n_rows() >= 32);
    const auto parameters = model.parameter_values(c.set);
    std::vector<double> rates(model.states.size()), currents(model.observables.size());
    for (std::size_t k = 0; k < table.n_rows(); ++k) {
      const Row row = row_of(model, table, k);
      model.evaluate(row.y.data(), row.in.data(), parameters.data(), rates.data(), currents.data());
      for (std::size_t i = 0; i < rates.size(); ++i) {
        const double reference = table.at(fmt::format("d{}/dt", model.states[i].name)).values[k];
        INFO(c.model << " row " << k << " state " << model.states[i].name);
        CHECK(std::abs(rates[i] - reference) <= 1e-9 * std::abs(reference) + 1e-13);
      }
    }
  }
}

TEST_CASE("currents and fluxes of the ionic models at every reference state") {
  for (const Case& c : ionic_cases) {
    const CellModel& model = find_model(c.model);
    const Table states = data_table(fmt::format("cell/{}_rhs.csv", c.file));
    const Table table = data_table(fmt::format("cell/{}_rhs_currents.csv", c.file));
    REQUIRE(table.n_rows() == states.n_rows());
    const auto parameters = model.parameter_values(c.set);
    std::vector<double> rates(model.states.size()), currents(model.observables.size());
    for (std::size_t k = 0; k < table.n_rows(); ++k) {
      const Row row = row_of(model, states, k);
      model.evaluate(row.y.data(), row.in.data(), parameters.data(), rates.data(), currents.data());
      for (std::size_t i = 0; i < currents.size(); ++i) {
        const double reference = table.at(model.observables[i].name).values[k];
        INFO(c.model << " row " << k << " " << model.observables[i].name);
        CHECK(std::abs(currents[i] - reference) <= 1e-9 * std::abs(reference) + 1e-300);
      }
    }
  }
}

TEST_CASE("derivatives, tension and stiffness of RDQ20 at every reference state") {
  const CellModel& model = find_model("rdq20");
  for (const Case& c : force_cases) {
    const Table table = data_table(fmt::format("cell/rdq20_{}_rhs.csv", c.file));
    const auto parameters = model.parameter_values(c.set);
    std::vector<double> rates(model.states.size()), outputs(model.observables.size());
    for (std::size_t k = 0; k < table.n_rows(); ++k) {
      const Row row = row_of(model, table, k);
      model.evaluate(row.y.data(), row.in.data(), parameters.data(), rates.data(), outputs.data());
      double largest = 0;
      for (const Quantity& q : model.states)
        largest = std::max(largest, std::abs(table.at(fmt::format("d{}/dt", q.name)).values[k]));
      // Row 1 is a steady state: its derivative is rounding noise.
      const double bound = k == 1 ? 1e-11 : 1e-12 * largest;
      for (std::size_t i = 0; i < rates.size(); ++i) {
        INFO(c.set << " row " << k << " state " << model.states[i].name);
        CHECK(std::abs(rates[i] - table.at(fmt::format("d{}/dt", model.states[i].name)).values[k]) <= bound);
      }
      for (std::size_t i = 0; i < outputs.size(); ++i) {
        INFO(c.set << " row " << k << " " << model.observables[i].name);
        CHECK(outputs[i] == Approx(table.at(model.observables[i].name).values[k]).epsilon(1e-9));
      }
    }
  }
}

TEST_CASE("filament overlap against the reference table, kinks included") {
  const Table table = data_table("cell/rdq20_overlap.csv");
  REQUIRE(table.n_rows() >= 60);
  const auto p = defaults_of(Rdq20::parameters);
  for (std::size_t k = 0; k < table.n_rows(); ++k)
    CHECK(Rdq20::overlap(table.columns[0].values[k], p.data()) ==
          Approx(table.columns[1].values[k]).margin(1e-12));
}

TEST_CASE("exact Jacobians agree with differences") {
  for (const CellModel* model : catalogue()) {
    const auto parameters = model->parameter_values(model->parameter_sets.front().name);
    std::vector<double> y = model->default_state();
    if (!model->is_ionic())
      for (std::size_t i = 0; i < y.size(); ++i)
        y[i] = 0.04 + 0.0025 * static_cast<double>(i);  // no symmetry
    if (model->is_ionic()) y[static_cast<std::size_t>(model->membrane_potential)] = -22.3;
    const std::size_t n = y.size();
    std::vector<double> in;
    for (const Quantity& q : model->inputs) in.push_back(q.default_value);
    if (!model->is_ionic()) in[2] = -0.7;
    std::vector<double> jacobian(n * n), up(n), down(n);
    model->jacobian(y.data(), in.data(), parameters.data(), jacobian.data());
    for (std::size_t column = 0; column < n; ++column) {
      const double h = 1e-5 * std::max(1e-3, std::abs(y[column]));
      std::vector<double> yp = y, ym = y;
      yp[column] += h;
      ym[column] -= h;
      model->evaluate(yp.data(), in.data(), parameters.data(), up.data(), nullptr);
      model->evaluate(ym.data(), in.data(), parameters.data(), down.data(), nullptr);
      double scale = 1e-6;
      for (std::size_t row = 0; row < n; ++row) scale = std::max(scale, std::abs(jacobian[row + n * column]));
      for (std::size_t row = 0; row < n; ++row) {
        INFO(model->name << " d(" << model->states[row].name << ")/d(" << model->states[column].name << ")");
        CHECK(jacobian[row + n * column] ==
              Approx((up[row] - down[row]) / (2 * h)).epsilon(1e-5).margin(1e-6 * scale));
      }
    }
  }
}

namespace {
// The largest d(invariant)/dt along the flow, over the largest of its terms; and how far the slope by the
// balancing state is from the derivative.
template <class Model>
std::pair<double, double> invariants_along(const std::vector<double>& at, const std::vector<double>& in) {
  using D = Dual<static_cast<int>(Model::states.size())>;
  const auto parameters = defaults_of(Model::parameters);
  const auto constants = Model::constants(parameters.data());
  std::vector<double> rates(at.size());
  find_model(Model::name).evaluate(at.data(), in.data(), parameters.data(), rates.data(), nullptr);
  std::vector<D> y;
  for (std::size_t i = 0; i < at.size(); ++i) y.push_back(D::variable(at[i], static_cast<int>(i)));
  const auto values = Model::invariant_values(y.data(), constants);
  const auto slopes = Model::invariant_slopes(constants);
  double worst = 0, wrong_slope = 0;
  for (std::size_t k = 0; k < Model::invariants.size(); ++k) {
    double sum = 0, largest = 1e-300;
    for (std::size_t i = 0; i < at.size(); ++i) {
      sum += values[k].derivative[i] * rates[i];
      largest = std::max(largest, std::abs(values[k].derivative[i] * rates[i]));
    }
    worst = std::max(worst, std::abs(sum) / largest);
    const double slope = values[k].derivative[static_cast<std::size_t>(Model::invariants[k].balance)];
    wrong_slope = std::max(wrong_slope, std::abs(slopes[k] / slope - 1));
  }
  return {worst, wrong_slope};
}
}  // namespace

TEST_CASE("invariants are exact, with and without stimulus") {
  std::mt19937 random(11);
  std::uniform_real_distribution<double> unit(0.02, 0.98);
  int n_models = 0;
  const auto check = [&]<class Model>() {
    for (int draw = 0; draw < 40; ++draw) {
      std::vector<double> y, in;
      for (const Quantity& q : Model::states)
        y.push_back(q.unit == "mV"   ? -95 + 150 * unit(random)
                    : q.unit == "mM" ? q.default_value * (0.5 + unit(random))
                                     : unit(random));
      for (const Quantity& q : Model::inputs)
        in.push_back(q.role == Role::stimulus ? (draw % 2 ? -30.0 : 0.0) : q.default_value);
      const auto [rate, slope] = invariants_along<Model>(y, in);
      INFO(Model::name << " draw " << draw);
      CHECK(rate < 1e-13);
      CHECK(slope < 1e-12);
    }
    ++n_models;
  };
  const auto check_if_any = [&]<class Model>() {
    if constexpr (HasInvariants<Model>) check.template operator()<Model>();
  };
  IonicModels::each(check_if_any);
  ForceModels::each(check_if_any);
  CHECK(n_models >= 5);
}

TEST_CASE("a state of other sums than its model keeps is refused, of another charge only where that counts") {
  const CellModel& force = find_model("rdq20");
  CHECK_THROWS_WITH(require_invariants(force, {1.7}, {1}, false, "there"),
                    Catch::Contains("there: its conserved probability"));
  CHECK_NOTHROW(require_invariants(force, {1 + 1e-9}, {1}, true, "there"));
  const CellModel& cell = find_model("crn");
  CHECK_NOTHROW(require_invariants(cell, {2e6}, {1e6}, false, "there"));
  CHECK_THROWS_WITH(require_invariants(cell, {2e6}, {1e6}, true, "there"), Catch::Contains("charge"));
  // Where no ion carries the stimulus the charge is not kept.
  CHECK(cell.keeps_invariants(cell.parameter_values("default").data()));
  CHECK_FALSE(cell.keeps_invariants(cell.parameter_values("stimulus-uncarried").data()));
  CHECK(force.keeps_invariants(force.parameter_values("human37").data()));
}

TEST_CASE("right-hand sides are finite at every corner of the state space") {
  for (const CellModel* model : catalogue()) {
    if (!model->is_ionic()) continue;
    const auto parameters = model->parameter_values("default");
    std::vector<double> rates(model->states.size());
    const double no_stimulus[1] = {0};
    for (double V : {-120.0, -47.13, -40.0, -14.1, -10.0, 0.0, 3.3328, 7.9, 15.0, 19.9, 80.0})
      for (double gates : {0.0, 1.0})
        for (double concentration : {0.01, 1.0, 20.0}) {
          std::vector<double> y = model->default_state();
          for (std::size_t i = 0; i < y.size(); ++i) {
            if (model->states[i].unit == "1") y[i] = gates;
            if (model->states[i].unit == "mM") y[i] *= concentration;
          }
          y[model->membrane_potential] = V;
          model->evaluate(y.data(), no_stimulus, parameters.data(), rates.data(), nullptr);
          for (std::size_t i = 0; i < y.size(); ++i) {
            INFO(model->name << " " << model->states[i].name << " V " << V << " gates " << gates);
            CHECK(std::isfinite(rates[i]));
          }
        }
  }
}

TEST_CASE("declared ranges hold what can be and nothing else") {
  // Bounded by sense, not by multiples of the default.
  const std::set<std::string_view> bounded = {
      "R", "T", "F", "Na_o", "gamma", "k_sat", "stimulus_K_fraction", "LA", "LM", "LB", "SL0",
      // Of Land 2017: shares, exponents, and what stays positive at every stretch with them.
      "r_w", "r_s", "TRPN50", "n_TRPN", "n_Tm", "beta_0", "k_ws"};
  for (const CellModel* model : catalogue()) {
    for (const Quantity& q : model->parameters) {
      INFO(model->name << " " << q.name << " " << q.lower << " to " << q.upper);
      CHECK(std::isfinite(q.lower));
      CHECK(std::isfinite(q.upper));
      if (q.unit == "mM") CHECK((q.lower >= 0 && q.upper < 1000));
      if (q.name == "R") CHECK((q.lower > 0.998 * 8.314462618 && q.upper < 1.002 * 8.314462618));
      if (q.name == "F") CHECK((q.lower > 0.998 * 96.48533212 && q.upper < 1.002 * 96.48533212));
      if (q.name == "T") CHECK((q.lower == 273.15 && q.upper == 323.15));
      if (q.name == "Na_o") CHECK(q.upper == 300);
      if (bounded.contains(q.name) || q.default_value <= 0 || q.upper == 1 || q.unit == "mV") continue;
      CHECK(q.lower <= 0.1 * q.default_value);
      CHECK(q.upper >= 10 * q.default_value);
      CHECK(q.upper <= 1000 * q.default_value);
    }
    for (const Quantity& q : model->states)
      if (q.unit == "mM") CHECK((q.lower > 0 && q.upper <= 300));
    for (const ParameterSet& set : model->parameter_sets) {
      const auto values = model->parameter_values(set.name);
      for (std::size_t k = 0; k < values.size(); ++k)
        CHECK_NOTHROW(check_range(model->parameters[k], values[k], set.name));
    }
  }
}

TEST_CASE("the catalogue refuses unknown names with the nearest") {
  CHECK_THROWS_WITH(find_model("ttp06_endo"), Catch::Contains("did you mean 'ttp06-endo'"));
  CHECK_THROWS_WITH(find_model("rdq20").parameter_values("fedele2023"), Catch::Contains("fedele2023-"));
}
