// What some runs cost in steps and iterations. These counts repeat, times do not: lost efficiency fails here.
// A count that falls by a lot is to be written down anew.
#include <catch2/catch.hpp>
#include <wiggers/cellmodels/pacing/pacing.hpp>
#include <wiggers/circulation/loop.hpp>
#include <wiggers/heart/run/run.hpp>

using namespace wiggers;

namespace {

// Within a few per cent above what was recorded; below, within what another compiler may do.
void costs(const char* what, long count, long recorded) {
  INFO(what << ": " << count << ", recorded " << recorded);
  CHECK(count <= recorded + std::max(1L, recorded / 25));
  CHECK(count >= recorded - std::max(1L, recorded / 8));
}

}  // namespace

TEST_CASE("a beat of a cell takes the steps it took") {
  struct Case {
    const char *model, *integrator;
    double tolerance;
    long steps, evaluations;
  };
  for (const Case& c :
       {Case{"ttp06-endo", "cvode", 1e-8, 2033, 2766}, Case{"crn", "cvode", 1e-8, 1814, 2396},
        Case{"ttp06-endo", "rosenbrock", 1e-6, 1600, 4950}, Case{"crn", "rosenbrock", 1e-6, 1386, 4316},
        Case{"aliev-panfilov", "rosenbrock", 1e-6, 426, 1300}}) {
    const CellModel& model = find_model(c.model);
    PacedCell cell(model, model.parameter_values("default"), {1000, model.default_stimulus},
                   {c.integrator, c.tolerance, 0.01 * c.tolerance, 0});
    std::vector<double> state = model.default_state();
    cell.beat(state);
    INFO(c.model << " " << c.integrator);
    costs("steps", cell.counts().steps, c.steps);
    costs("evaluations", cell.counts().evaluations, c.evaluations);
  }
}

TEST_CASE("limit cycles take the beats they took") {
  for (const auto& [name, beats] : {std::pair{"ttp06-endo", 15L}, {"crn", 29L}, {"aliev-panfilov", 6L}}) {
    const CellModel& model = find_model(name);
    PacedCell cell(model, model.parameter_values("default"), {1000, model.default_stimulus},
                   {"rush-larsen-2", 0, 0, 0.05});
    std::vector<double> state = model.default_state();
    INFO(name);
    costs("beats", cell.to_limit_cycle(state, {}).beats, beats);
  }
  for (const auto& [name, beats] : {std::pair{"runge-kutta-4", 9L}, {"cvode", 9L}}) {
    const Loop& loop = find_circulation_set("wiggers-healthy-0d").loop;
    CirculationValues state = loop.initial;
    INFO(name);
    costs("beats",
          LoopSolver(loop, {name, 1e-9, 1e-9, 1e-3}).to_limit_cycle(state, loop_cycle_settings(1e-6)).beats,
          beats);
  }
}

TEST_CASE("hearts take the beats and Newton iterations they took") {
  struct Case {
    const char* scene;
    long beats, newton;
  };
  for (const Case& c :
       {Case{"whole_heart", 13, 2876}, Case{"triseg", 15, 3027}, Case{"whole_heart_land2017", 15, 2772}}) {
    HeartRun run(read_scene(std::string(WIGGERS_TEST_DATA) + "/../../scenes/" + c.scene + ".toml", {}));
    run.prepare(Progress::Style::quiet);
    run.advance(Progress::Style::quiet, {});
    INFO(c.scene);
    costs("beats", run.certificate().beats, c.beats);
    costs("Newton iterations of the last beat", run.audit().newton_iterations, c.newton);
  }
}
