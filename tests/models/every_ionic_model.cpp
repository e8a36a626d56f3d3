// What every ionic model of the list must do, without a line about it: a new model is tested by being listed.
#include <fmt/format.h>

#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <random>
#include <wiggers/cellmodels/models/ionic_models.hpp>
#include <wiggers/cellmodels/pacing/cell_study.hpp>
#include <wiggers/cellmodels/pacing/paced_beat.hpp>
#include <wiggers/cellmodels/population/population.hpp>
#include <wiggers/cellmodels/schemes/rosenbrock.hpp>
#include <wiggers/core/fixed_step.hpp>

using namespace wiggers;

namespace {

template <class Test>
void with_every_model(Test test) {
  int n = 0;
  IonicModels::each([&]<class Model>() {
    INFO(Model::name);
    test.template operator()<Model>(find_model(Model::name));
    ++n;
  });
  CHECK(n >= 4);
}

std::vector<double> random_state(const CellModel& model, std::mt19937& random) {
  std::uniform_real_distribution<double> unit(0.02, 0.98);
  std::vector<double> y;
  for (const Quantity& q : model.states)
    y.push_back(q.unit == "mV"   ? -95 + 150 * unit(random)
                : q.unit == "mM" ? q.default_value * (0.5 + unit(random))
                                 : unit(random));
  return y;
}

// Differences of states in the limit cycle's scales.
double distance(const CellModel& model, const std::vector<double>& a, const std::vector<double>& b) {
  double largest = 0;
  for (std::size_t i = 0; i < a.size(); ++i) {
    const double scale = static_cast<int>(i) == model.membrane_potential ? 10 : std::abs(b[i]) + 1e-3;
    largest = std::max(largest, std::abs(a[i] - b[i]) / scale);
  }
  return largest;
}

}  // namespace

namespace {
// The potential rises, or falls, at a speed that jumps at two potentials: what becomes of it is known.
struct Stairs {
  static constexpr std::string_view name = "stairs", title = "a test", source = "none", time_unit = "ms";
  static constexpr StimulusPulse default_stimulus{};
  enum State { ticks, V };  // the potential is not the first state
  static constexpr std::array states = {Quantity{"ticks", "1", 0, -1e9, 1e9, "time"},
                                        facts::membrane_potential(-80)};
  static_assert(named_as<State>(states));
  static constexpr std::array parameters = {Quantity{"speed", "mV/ms", 2, 0, 10, "below the first"},
                                            Quantity{"direction", "1", 1, -1, 1, "1: rises, -1: falls"}};
  static constexpr std::array inputs = {facts::stimulus};
  static constexpr std::array observables = {facts::output("rise", "mV/ms", "speed of the potential")};
  static constexpr std::array parameter_sets = {ParameterSet{"default", "none", "1"}};
  static constexpr std::array branch_potentials = {-50.0, -20.0};
  static constexpr std::string_view no_invariants = "a test";
  template <class P>
  struct Constants {
    P speed, direction;
    P branch[2];
  };
  template <class P>
  static Constants<P> constants(const P* p) {
    return {p[0], p[1], {P(branch_potentials[0]), P(branch_potentials[1])}};
  }
  template <class N, class P>
  static Evaluation<N, 2, 1> evaluate(const N* y, const N*, const Constants<P>& c) {
    Evaluation<N, 2, 1> e;
    const N above = select(y[V] < c.branch[1], N(10.0), N(5.0));
    e.derivative[V] = c.direction * select(y[V] < c.branch[0], N(c.speed), above);
    e.derivative[ticks] = 1.0;
    e.observable = {e.derivative[V]};
    return e;
  }
};
static_assert(require_ionic_model<Stairs>());
}  // namespace

TEST_CASE("rates that jump at several potentials are kept to their intervals") {
  // Below the first branch at `speed`, between them at 10 mV/ms, above at 5. A beat is one step; how far its
  // end moves with the speed is by when the branches are crossed.
  struct Way {
    double speed, direction, start, end, end_by_speed;
  };
  const auto way = GENERATE(Way{2, 1, -80, -10, 5 * 30 / 4.0},  // 15 ms, 3 ms, 2 ms
                            Way{5, 1, -80, 35, 5 * 30 / 25.0},  // 6 ms, 3 ms, 11 ms: over both at once
                            Way{7.3, 1, -80, -20 + 5 * (17 - 30 / 7.3), 5 * 30 / (7.3 * 7.3)},
                            Way{5, -1, -10, -125, -15},           // 2 ms, 3 ms, 15 ms: down over both
                            Way{0.25, -1, 27.5, -51.875, -7.5});  // 9.5 ms, 3 ms, 7.5 ms
  INFO("from " << way.start << " mV at " << way.speed << " mV/ms, direction " << way.direction);
  const double parameters[] = {way.speed, way.direction}, none[1] = {0};
  double y[2] = {0, way.start};
  Rosenbrock4<Stairs>(Stairs::constants(parameters), 1e-8, {1e-10, 1e-10}).advance(20, y, none);
  CHECK(y[Stairs::V] == Approx(way.end).margin(1e-7));
  CHECK(y[Stairs::ticks] == Approx(20).margin(1e-9));
  PacedBeatInputs<Tangent> in;
  in.parameters = {way.speed, way.direction};
  in.parameters[0].derivative[0] = 1;
  in.period_ms = 20.0;
  Tangent z[2] = {0.0, way.start};
  PacedBeat<Stairs, Tangent>(in, 0, 20, false).run(z, [](const Tangent&, const Tangent*) {});
  CHECK(z[Stairs::V].value == Approx(way.end).margin(1e-9));
  CHECK(z[Stairs::V].derivative[0] == Approx(way.end_by_speed).epsilon(1e-9));
}

TEST_CASE("every ionic model: SIMD lanes take the scalar step, with tables nearly so") {
  with_every_model([&]<class Model>(const CellModel& model) {
    std::mt19937 random(5);
    const auto parameters = defaults_of(Model::parameters);
    const auto constants = Model::constants(parameters.data());
    const double h = 0.01, stimulus[1] = {-20};
    for (const bool second : {false, true})
      for (const double spacing : {0.0, 0.01}) {
        if (spacing > 0 && !model.has_voltage_table) continue;
        PopulationSettings settings;
        settings.integrator = second ? "rush-larsen-2" : "rush-larsen";
        settings.table_spacing_mV = spacing;
        CellPopulation cells(model, 19, settings);
        cells.set_input("i_stim", stimulus[0]);
        std::vector<std::vector<double>> wanted;
        for (std::size_t cell = 0; cell < cells.size(); ++cell) {
          std::vector<double> y = random_state(model, random);
          cells.set_state_of(cell, y);
          if (second)
            RushLarsen2<Model, double>().step(h, y.data(), stimulus, constants);
          else
            RushLarsen1<Model, double>().step(h, y.data(), stimulus, constants);
          wanted.push_back(y);
        }
        cells.step(h);
        for (std::size_t cell = 0; cell < cells.size(); ++cell) {
          INFO("cell " << cell << " second " << second << " spacing " << spacing);
          CHECK(distance(model, cells.state_of(cell), wanted[cell]) < (spacing > 0 ? 1e-5 : 1e-12));
        }
      }
  });
}

TEST_CASE("every ionic model: the tissue's step gives the rate of the potential and second order") {
  with_every_model([&]<class Model>(const CellModel& model) {
    const auto V = static_cast<std::size_t>(model.membrane_potential);
    // No change of the potential: the step then solves the other states alone.
    const auto state_after = [&](double h, double span) {
      PopulationSettings settings;
      settings.integrator = "bdf2-imex";
      CellPopulation cells(model, 1, settings);
      std::vector<double> rate(1), y = model.default_state();
      const std::vector<double> clamp = {-20};
      y[V] = clamp[0];
      cells.assign_states(0, y);
      cells.assign_states(1, y);
      const auto steps = std::lround(span / h);
      for (long k = 0; k < steps; ++k) cells.step_under(clamp, h, k == 0, rate);
      return cells.state_of(0);
    };
    std::vector<double> rates(model.states.size());
    const auto parameters = model.parameter_values("default");
    const double none[1] = {0};
    PopulationSettings settings;
    settings.integrator = "bdf2-imex";
    CellPopulation cells(model, 1, settings);
    std::vector<double> rate(1), y = model.default_state();
    cells.step_under({&y[V], 1}, 1e-12, true, rate);
    model.evaluate(y.data(), none, parameters.data(), rates.data(), nullptr);
    CHECK(rate[0] == Approx(rates[V]).epsilon(1e-6).margin(1e-9));
    const auto coarse = state_after(0.02, 1), fine = state_after(0.01, 1), exact = state_after(0.00125, 1);
    const double e1 = distance(model, coarse, exact), e2 = distance(model, fine, exact);
    INFO("errors " << e1 << " " << e2);
    CHECK((e1 < 1e-9 || e1 / e2 > 3));
  });
}

TEST_CASE("every ionic model: all integrators agree on a beat") {
  with_every_model([&]<class Model>(const CellModel& model) {
    const auto beat = [&](const std::string& name, double dt_ms) {
      PacedCell cell(model, model.parameter_values("default"), {400, model.default_stimulus},
                     {name, 1e-7, 1e-9, dt_ms});
      std::vector<double> state = model.default_state();
      cell.beat(state);
      return state;
    };
    const auto exact = beat("cvode", 0);
    CHECK(distance(model, beat("rosenbrock", 0), exact) < 1e-4);
    for (std::string_view name : fixed_step_integrators()) {
      const bool crude = name == "forward-euler";  // the fastest gates need steps of a few us
      INFO(name);
      CHECK(distance(model, beat(std::string(name), crude ? 0.0005 : 0.005), exact) < 0.05);
    }
  });
}

TEST_CASE("Aliev-Panfilov: its states' ranges hold what its parameters and strong stimuli make of it") {
  const CellModel& model = find_model("aliev-panfilov");
  const auto beat = [&](std::string_view name, double value, double stimulus_A_per_F) {
    auto parameters = model.parameter_values("default");
    if (!name.empty()) parameters[require_index(model.parameters, "parameter", name)] = value;
    PacedCell cell(model, parameters, {400, {stimulus_A_per_F, 2, 0}}, {"cvode", 1e-7, 1e-9, 0});
    std::vector<double> y = model.default_state();
    double highest = 0, lowest = 0;
    cell.beat(y, 1, [&](double, const double* state, double) {
      highest = std::max(highest, state[AlievPanfilov::v]);
      lowest = std::min(lowest, state[AlievPanfilov::v]);
    });
    return std::array{lowest, highest};
  };
  CHECK(beat("k", 80, -20)[1] > 10);
  CHECK(beat("", 0, -100)[0] < -1e-4);
  CHECK(beat("V_amplitude", 50, -50)[0] < -1e-4);
}

TEST_CASE("every ionic model: a limit cycle and its derivatives") {
  with_every_model([&]<class Model>(const CellModel& model) {
    CellStudy study = make_cell_study(model);
    study.dt_ms = 0.05;
    LimitCycleSettings settings;
    settings.distance = 1e-5;
    std::vector<double> state = start_of(study);
    const auto certificate = to_limit_cycle(study, state, settings);
    INFO(certificate.text() << " " << certificate.reason);
    REQUIRE(certificate.good());
    state = refined_limit_cycle(study, state, newton_at(study, state));
    const Sensitivities table = cell_sensitivities(study, state);
    const auto index = [](const std::vector<std::string>& names, std::string_view name) {
      return static_cast<std::size_t>(std::find(names.begin(), names.end(), name) - names.begin());
    };
    const std::size_t apd = index(table.outputs, "APD90_ms"), m = table.parameters.size();
    REQUIRE(apd < table.outputs.size());
    const auto parameter_value = [&](std::size_t p) {
      for (const NamedParameter& named : cell_study_parameters(study))
        if (named.name == table.parameters[p]) return named.value;
      return 0.0;
    };
    // By the period, and by the parameter of the largest elasticity.
    std::size_t largest = 0;
    const auto elasticity = [&](std::size_t p) {
      return std::abs(table.derivatives[apd * m + p] * parameter_value(p));
    };
    for (std::size_t p = 0; p < m; ++p)
      if (elasticity(p) > elasticity(largest)) largest = p;
    for (std::size_t p : {largest, index(table.parameters, "period_ms")}) {
      const double value = parameter_value(p), step = 2e-4 * value;
      double ends[2];
      for (int side = 0; side < 2; ++side) {
        CellStudy moved = study;
        set_cell_study_parameter(moved, table.parameters[p], value + (side == 0 ? -step : step));
        const auto at = refined_limit_cycle(moved, state, newton_at(moved, state));
        const auto indexes = cell_indexes(moved, refined_limit_cycle(moved, at, newton_at(moved, at)));
        ends[side] = std::find_if(indexes.begin(), indexes.end(), [](const NamedValue& v) {
                       return v.name == "APD90_ms";
                     })->value;
      }
      INFO(table.parameters[p]);
      CHECK(table.derivatives[apd * m + p] ==
            Approx((ends[1] - ends[0]) / (2 * step)).epsilon(2e-3).margin(1e-6));
    }
  });
}
