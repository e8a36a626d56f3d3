// Populations of cells: every instruction set, precision and table gives the scalar model's step.
#include <array>
#include <catch2/catch.hpp>
#include <cmath>
#include <random>
#include <wiggers/cellmodels/models/crn.hpp>
#include <wiggers/cellmodels/models/force_models.hpp>
#include <wiggers/cellmodels/models/ttp06.hpp>
#include <wiggers/cellmodels/pacing/pacing.hpp>
#include <wiggers/cellmodels/population/population.hpp>
#include <wiggers/cellmodels/schemes/force_step.hpp>
#include <wiggers/core/dual.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/fixed_step.hpp>

using namespace wiggers;

namespace {

std::vector<double> random_state(const CellModel& model, std::mt19937& random, bool singular) {
  std::uniform_real_distribution<double> unit(0.02, 0.98);
  std::vector<double> y;
  for (const Quantity& q : model.states) {
    double value = unit(random);
    if (q.unit == "mV") value = singular ? (random() % 2 ? -47.13 : 15.0) : -95 + 150 * value;
    if (q.unit == "mM") value = q.default_value * (0.5 + value);
    if (!model.is_ionic()) value *= q.upper > 1 ? 0.01 : 0.2;  // moments and distortions; shares of one
    y.push_back(value);
  }
  model.normalise(y.data());
  return y;
}

// One step of the scalar text, and of the same text on dual numbers.
template <class Model>
std::vector<double> scalar_step(bool second_order, double h, std::vector<double> y, double input) {
  const auto parameters = defaults_of(Model::parameters);
  const auto constants = Model::constants(parameters.data());
  const double in[1] = {input};
  if (second_order)
    RushLarsen2<Model, double>().step(h, y.data(), in, constants);
  else
    RushLarsen1<Model, double>().step(h, y.data(), in, constants);
  return y;
}
template <class Model>
std::vector<double> dual_step(double h, const std::vector<double>& y, double input) {
  using D = Dual<2>;
  const auto parameters = defaults_of(Model::parameters);
  const auto constants = Model::constants(parameters.data());
  std::vector<D> yd(y.begin(), y.end());
  const D in[1] = {D(input)};
  RushLarsen1<Model, D>().step(h, yd.data(), in, constants);
  std::vector<double> values;
  for (const D& d : yd) values.push_back(d.value);
  return values;
}

constexpr std::size_t n_cells = 37;  // no multiple of any lane count

template <class Model>
void compare_steps() {
  const CellModel& model = find_model(Model::name);
  std::mt19937 random(11);
  std::vector<std::vector<double>> states;
  for (std::size_t cell = 0; cell < n_cells; ++cell) states.push_back(random_state(model, random, cell < 4));
  for (InstructionSet set : usable_instruction_sets())
    for (const char* integrator : {"rush-larsen", "rush-larsen-2"}) {
      PopulationSettings settings;
      settings.integrator = integrator;
      settings.instruction_set = to_string(set);
      CellPopulation cells(model, n_cells, settings);
      for (std::size_t cell = 0; cell < n_cells; ++cell) cells.set_state_of(cell, states[cell]);
      cells.set_input("i_stim", -7);
      cells.step(0.01);
      const bool second = std::string(integrator) == "rush-larsen-2";
      for (std::size_t cell = 0; cell < n_cells; ++cell) {
        const auto lane = cells.state_of(cell);
        const auto scalar = scalar_step<Model>(second, 0.01, states[cell], -7);
        const auto dual = dual_step<Model>(0.01, states[cell], -7);
        for (std::size_t i = 0; i < lane.size(); ++i) {
          INFO(model.name << " " << to_string(set) << " " << integrator << " cell " << cell << " state "
                          << model.states[i].name);
          // Relative to the state's scale: V may pass zero.
          const double scale = static_cast<int>(i) == model.membrane_potential ? 10.0 : 0.0;
          CHECK(std::abs(lane[i] - scalar[i]) <= 1e-12 * std::max(scale, std::abs(scalar[i])));
          if (!second) CHECK(std::abs(dual[i] - scalar[i]) <= 1e-12 * std::max(scale, std::abs(scalar[i])));
        }
      }
    }
}

struct Beat {
  double apd90_ms = 0;
  std::vector<double> end;
};
// 400 ms at 0.02 ms, APD90 by linear interpolation.
Beat beat(const char* name, PopulationSettings settings) {
  CellPopulation cell(find_model(name), 1, std::move(settings));
  std::vector<double> V(1), trace;
  const double h = 0.02;
  for (int k = 0; k < 20000; ++k) {
    cell.set_input("i_stim", k < 150 ? -25.71 : 0);
    cell.step(h);
    cell.read_state("V", V);
    trace.push_back(V[0]);
  }
  const double top = *std::max_element(trace.begin(), trace.end());
  const double threshold = top - 0.9 * (top - trace.back());
  double up = 0, down = 0;
  for (std::size_t k = 1; k < trace.size(); ++k) {
    const double at = h * (static_cast<double>(k) + (threshold - trace[k - 1]) / (trace[k] - trace[k - 1]));
    if (trace[k - 1] < threshold && trace[k] >= threshold && up == 0) up = at;
    if (trace[k - 1] >= threshold && trace[k] < threshold) down = at;
  }
  return {down - up, cell.state_of(0)};
}

}  // namespace

TEST_CASE("one step of a population is the scalar and the dual step, lane by lane") {
  compare_steps<Crn>();
  compare_steps<Ttp06<Ttp06Type::endo>>();
  compare_steps<Ttp06<Ttp06Type::mid>>();
  compare_steps<Ttp06<Ttp06Type::epi>>();
}

TEST_CASE("tables of functions of V change the action potential by less than stated") {
  for (const char* name : {"ttp06-endo", "crn"}) {
    const Beat exact = beat(name, {});
    REQUIRE(exact.apd90_ms > 200);
    PopulationSettings tables;
    tables.table_spacing_mV = 0.1;
    const double change = std::abs(beat(name, tables).apd90_ms - exact.apd90_ms);
    INFO(name << " " << change);
    CHECK(change < 1e-3);
    CHECK(change > 0);  // the tables were used
    tables.table_spacing_mV = 0.2;
    CHECK(std::abs(beat(name, tables).apd90_ms - exact.apd90_ms) >
          2.5 * change);  // second order in the spacing
    tables.table_spacing_mV = 0.1;
    tables.single_precision = true;
    CHECK(std::abs(beat(name, tables).apd90_ms - exact.apd90_ms) < 0.02);
    PopulationSettings second, second_tables;
    second.integrator = second_tables.integrator = "rush-larsen-2";
    second_tables.table_spacing_mV = 0.1;
    CHECK(std::abs(beat(name, second_tables).apd90_ms - beat(name, second).apd90_ms) < 1e-3);
  }
}

TEST_CASE("threads and instruction sets change nothing but time") {
  std::mt19937 random(5);
  std::uniform_real_distribution<double> potential(-90, 20);
  std::vector<double> start(1000), one(1000), other(1000);
  for (double& v : start) v = potential(random);
  const auto run = [&](PopulationSettings settings, std::vector<double>& end) {
    CellPopulation cells(find_model("crn"), start.size(), std::move(settings));
    cells.write_state("V", start);
    cells.step(0.02, 100);
    cells.read_state("V", end);
  };
  PopulationSettings settings;
  run(settings, one);
  settings.threads = 3;
  run(settings, other);
  CHECK(one == other);
  for (InstructionSet set : usable_instruction_sets()) {
    settings.instruction_set = to_string(set);
    run(settings, other);
    double worst = 0;
    for (std::size_t i = 0; i < one.size(); ++i) worst = std::max(worst, std::abs(one[i] - other[i]));
    CHECK(worst < 1e-9);
  }
}

TEST_CASE("cells with parameters of their own step like populations with those parameters") {
  const CellModel& model = find_model("ttp06-epi");
  std::vector<double> conductance(20);
  for (std::size_t k = 0; k < conductance.size(); ++k) conductance[k] = 0.2 + 0.01 * static_cast<double>(k);
  for (double spacing : {0.0, 0.1}) {
    PopulationSettings settings;
    settings.table_spacing_mV = spacing;
    CellPopulation mixed(model, conductance.size(), settings);
    mixed.set_parameters("g_Ks", conductance);
    mixed.set_input("i_stim", -52);
    mixed.step(0.02, 50);
    mixed.set_input("i_stim", 0);
    mixed.step(0.02, 5000);
    for (std::size_t k : {std::size_t(0), std::size_t(13), std::size_t(19)}) {
      auto parameters = model.parameter_values("default");
      parameters[require_index(model.parameters, "parameter", "g_Ks")] = conductance[k];
      CellPopulation uniform(model, 1, settings, parameters);
      uniform.set_input("i_stim", -52);
      uniform.step(0.02, 50);
      uniform.set_input("i_stim", 0);
      uniform.step(0.02, 5000);
      const auto a = mixed.state_of(k), b = uniform.state_of(0);
      for (std::size_t i = 0; i < a.size(); ++i) CHECK(a[i] == Approx(b[i]).epsilon(1e-9));
    }
  }
  PopulationSettings settings;
  settings.table_spacing_mV = 0.1;
  CellPopulation cells(model, 2, settings);
  const double slow[2] = {80, 100};
  CHECK_THROWS_WITH(cells.set_parameters("f2_slow", slow), Catch::Contains("tables"));
}

TEST_CASE("inputs may differ from cell to cell") {
  CellPopulation cells(find_model("ttp06-endo"), 3);
  const double stimuli[3] = {0, -30, -52};
  cells.set_inputs("i_stim", stimuli);
  cells.step(0.02, 50);
  CHECK(cells.state_of(0)[0] < -80);
  CHECK(cells.state_of(2)[0] > -20);
  cells.set_input("i_stim", 0);
  CHECK_NOTHROW(cells.step(0.02, 50));
}

TEST_CASE("a population refuses what it cannot do and explains what went wrong") {
  const CellModel& model = find_model("ttp06-endo");
  const auto make = [&](PopulationSettings settings) { CellPopulation(model, 4, settings); };
  PopulationSettings s;
  s.integrator = "rush-larson";
  CHECK_THROWS_WITH(make(s), Catch::Contains("rush-larson") && Catch::Contains("rush-larsen-2"));
  s = {};
  s.table_spacing_mV = 3;
  CHECK_THROWS_WITH(make(s), Catch::Contains("0.01 to 1"));
  s = {};
  s.threads = 0;
  CHECK_THROWS_AS(make(s), InputError);
  s = {};
  s.instruction_set = "avx-512";
  CHECK_THROWS_WITH(make(s), Catch::Contains("did you mean 'avx512'"));
  CHECK_THROWS_AS(CellPopulation(model, 0), InputError);
  CellPopulation cells(model, 4);
  CHECK_THROWS_AS(cells.step(-1), InputError);
  CHECK_THROWS_WITH(cells.set_input("stim", 0), Catch::Contains("i_stim"));
  const double three[3] = {0, 0, 0};
  CHECK_THROWS_AS(cells.write_state("V", three), InputError);
  // An explosion names cell, state and step, whatever the kernel.
  for (double spacing : {0.0, 0.1}) {
    s = {};
    s.table_spacing_mV = spacing;
    CellPopulation wild(model, 40, s);
    const std::vector<double> pulse = [] {
      std::vector<double> values(40, 0.0);
      values[21] = -1000;
      return values;
    }();
    wild.set_inputs("i_stim", pulse);
    CHECK_THROWS_WITH(wild.step(0.5, 40), Catch::Contains("cell 21") && Catch::Contains("state") &&
                                              Catch::Contains("step 0.5 ms"));
  }
}

TEST_CASE("every force model: lanes take the scalar step, outside and inside of walls") {
  std::mt19937 random(2);
  int n_models = 0;
  ForceModels::each([&]<class Model>() {
    ++n_models;
    const CellModel& model = find_model(Model::name);
    for (const ParameterSet& parameter_set : model.parameter_sets)
      for (InstructionSet set : usable_instruction_sets()) {
        const auto parameters = model.parameter_values(parameter_set.name);
        const auto constants = Model::constants(parameters.data());
        INFO(Model::name << " " << parameter_set.name << " " << to_string(set));
        PopulationSettings settings;
        settings.instruction_set = to_string(set);
        CellPopulation cells(model, n_cells, settings, parameters);
        settings.integrator = "in-wall";
        CellPopulation in_wall(model, n_cells, settings, parameters);
        std::vector<std::vector<double>> states;
        std::vector<double> calcium;
        for (std::size_t cell = 0; cell < n_cells; ++cell) {
          states.push_back(random_state(model, random, false));
          calcium.push_back(0.05 + 0.1 * static_cast<double>(cell));
        }
        const auto near = [](const std::vector<double>& lane, const std::vector<double>& wanted) {
          for (std::size_t i = 0; i < lane.size(); ++i)
            CHECK(std::abs(lane[i] - wanted[i]) <= 1e-12 * std::max(1e-3, std::abs(wanted[i])));
        };
        for (CellPopulation* many : {&cells, &in_wall}) {
          for (std::size_t cell = 0; cell < n_cells; ++cell) many->set_state_of(cell, states[cell]);
          many->set_inputs("Ca", calcium);
          many->set_input("SL", 2.0);
          many->set_input("dSL/dt", -1.5);
        }
        cells.step(1e-3);
        for (std::size_t cell = 0; cell < n_cells; ++cell) {
          const double in[3] = {calcium[cell], 2.0, -1.5};
          std::vector<double> y = states[cell];
          REQUIRE(force_midpoint_step<Model>(1e-3, y.data(), in, constants));
          near(cells.state_of(cell), y);
        }
        for (const RegulationScheme regulation :
             {RegulationScheme::midpoint, RegulationScheme::forward_euler})
          for (const RateScheme rate : {RateScheme::lagged, RateScheme::implicit, RateScheme::none}) {
            const ForceScheme scheme = {regulation, 60, rate};
            for (std::size_t cell = 0; cell < n_cells; ++cell) in_wall.set_state_of(cell, states[cell]);
            std::vector<double> T(n_cells), K(n_cells);
            in_wall.force_step(1e-3, scheme, T, K);
            for (std::size_t cell = 0; cell < n_cells; ++cell) {
              ForceStep<Model, double> step;
              std::vector<double> y = states[cell];
              const double velocity =
                  1.5 / parameters[static_cast<std::size_t>(model.parameter(Role::reference_length))];
              REQUIRE(step.begin(scheme, 1e-3, y.data(), calcium[cell], 2.0, velocity, constants));
              near(in_wall.state_of(cell), y);
              CHECK(T[cell] == Approx(step.tension_kPa).epsilon(1e-11).margin(1e-11));
              CHECK(K[cell] == Approx(step.stiffness_kPa).epsilon(1e-11).margin(1e-11 * std::abs(T[cell])));
            }
          }
      }
  });
  CHECK(n_models >= 2);
}

TEST_CASE("a population recovers once its cells are put right") {
  CellPopulation cells(find_model("crn"), 3);  // the other lanes of the block are no cells
  cells.set_input("i_stim", -1000);
  CHECK_THROWS_AS(cells.step(1.0, 50), NumericalFailure);
  cells.set_input("i_stim", 0);
  const std::vector<double> start = find_model("crn").default_state();
  for (std::size_t cell = 0; cell < 3; ++cell) cells.set_state_of(cell, start);
  CHECK_NOTHROW(cells.step(0.02, 100));
  // What was read can be written.
  cells.set_state_of(1, cells.state_of(1));
  CHECK_NOTHROW(cells.step(0.02));
}
