// A circulation with a vessel, a shunt and a valve law that were added by the recipes alone
// (own_network.cmake).
#include <catch2/catch.hpp>
#include <cmath>
#include <string>
#include <wiggers/circulation/loop.hpp>

using namespace wiggers;

namespace {
Loop read(const std::string& text) {
  SettingsReader reader(parse_settings_text(text, "own.toml"), "own.toml");
  return read_loop(reader);
}
CirculationValues cycle_of(const LoopSolver& solver) {
  CirculationValues state = solver.loop().initial;
  REQUIRE(solver.to_limit_cycle(state, loop_cycle_settings(1e-7)).good());
  return state;
}
double mean(const Table& trace, const std::string& column) {
  const auto &t = trace.at("t_s").values, &x = trace.at(column).values;
  double sum = 0;
  for (std::size_t k = 1; k < t.size(); ++k) sum += 0.5 * (x[k] + x[k - 1]) * (t[k] - t[k - 1]);
  return sum / t.back();
}
}  // namespace

TEST_CASE("a vessel of one's own: state, file keys, sets, conservation") {
  CHECK(circulation_state_quantities[pressure_of(CAP_SYS)].name == "p_CAP_SYS");
  CHECK(n_circulation_states == 14);
  const Loop loop = read("[circuit.SYS]\nR_CAP = 0.1\n[initial]\np_CAP_SYS = 40\n");
  CHECK(loop.circulation.vessels[CAP_SYS].R == 0.1);
  CHECK(loop.initial[pressure_of(CAP_SYS)] == 40);
  int found = 0;
  for (const CirculationSet& set : circulation_sets()) {
    Loop of_set = set.loop;
    for_each_circulation_parameter(of_set.circulation,
                                   [&](const std::string& name, const Quantity&, double v) {
                                     if (name == "circuit.SYS.R_CAP") found += v == 0.05;
                                   });
  }
  CHECK(found == static_cast<int>(circulation_sets().size()));
  CHECK(find_circulation_set("circulation-0.3.1").loop.initial[Q_AR_SYS] == 71.104);

  const LoopSolver solver(loop, {"runge-kutta-4", 1e-9, 1e-9, 5e-4});
  CirculationValues state = cycle_of(solver),
                    exact = cycle_of(LoopSolver(loop, {"cvode", 1e-10, 1e-10, 1e-3}));
  for (int k = 0; k < n_circulation_states; ++k)
    CHECK(state[k] == Approx(exact[k]).epsilon(1e-4).margin(2e-3));
  Table trace = circulation_table(loop.circulation);
  const double volume = total_volume(loop.circulation, state.data());
  solver.beat(state, 1e-4, &trace);
  CHECK(std::abs(total_volume(loop.circulation, state.data()) - volume) < 1e-9);
  CHECK(mean(trace, "Q_CAP_SYS") == Approx(mean(trace, "Q_AR_SYS")).epsilon(1e-4));
  CHECK(mean(trace, "p_CAP_SYS") - mean(trace, "p_VEN_SYS") ==
        Approx(0.1 * mean(trace, "Q_CAP_SYS")).epsilon(1e-3));
}

TEST_CASE("a shunt of one's own: file, column, flow past the capillaries") {
  const Loop loop = read("[shunts.AVF]\narea_cm2 = 0.05\n");
  const LoopSolver solver(loop, {"runge-kutta-4", 1e-9, 1e-9, 5e-4});
  CirculationValues state = cycle_of(solver);
  Table trace = circulation_table(loop.circulation);
  solver.beat(state, 1e-4, &trace);
  CHECK(mean(trace, "Q_AVF") > 5);
  CHECK(mean(trace, "Q_AV") == Approx(mean(trace, "Q_AR_SYS") + mean(trace, "Q_AVF")).epsilon(1e-4));
}

TEST_CASE("a valve law of one's own: by name in files, in both kinds of solver") {
  const Loop loop = read("valve_law = \"blend\"\n");
  CHECK(loop.circulation.valve_law == law_of<BlendValve>);
  CHECK(valve_flow(loop.circulation.valve_law, loop.circulation.valves[MV], 20, 4.0, 1.0) ==
        Approx(3 / loop.circulation.valves[MV].Rmin).epsilon(1e-6));
  const CirculationValues steps = cycle_of(LoopSolver(loop, {"runge-kutta-4", 1e-9, 1e-9, 1e-4})),
                          exact = cycle_of(LoopSolver(loop, {"cvode", 1e-10, 1e-10, 1e-3}));
  for (int k = 0; k < n_circulation_states; ++k)
    CHECK(steps[k] == Approx(exact[k]).epsilon(1e-3).margin(0.02));
}
