// The circulation as a network: what flows in flows out at every node, and shunts are the same in every
// solver.
#include <fmt/format.h>
#include <unistd.h>

#include <catch2/catch.hpp>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <map>
#include <string>
#include <wiggers/circulation/loop.hpp>
#include <wiggers/circulation/stiffness.hpp>
#include <wiggers/core/dual.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/heart/run/monolithic.hpp>
#include <wiggers/heart/run/run.hpp>
#include <wiggers/heart/run/summary.hpp>
#include <wiggers/heart/study/loop_study.hpp>

using namespace wiggers;

namespace {
const std::string scenes = std::string(WIGGERS_TEST_DATA) + "/../../scenes/";

// One shunt alone, or all of them.
Loop loop_with(int shunt) {
  Loop loop = find_circulation_set("wiggers-healthy-0d").loop;
  for (int s = 0; s < n_shunts; ++s)
    loop.circulation.shunts[s] = {shunt == n_shunts || s == shunt, 0.4, 4e-3};
  return loop;
}
CirculationValues cycle_of(const LoopSolver& solver, double distance = 1e-8) {
  CirculationValues state = solver.loop().initial;
  const auto certificate = solver.to_limit_cycle(state, loop_cycle_settings(distance));
  INFO(certificate.text());
  REQUIRE(certificate.good());
  return state;
}
double mean(const Table& trace, const std::string& column) {
  const auto &t = trace.at("t_s").values, &x = trace.at(column).values;
  double sum = 0;
  for (std::size_t k = 1; k < t.size(); ++k) sum += 0.5 * (x[k] + x[k - 1]) * (t[k] - t[k - 1]);
  return sum / t.back();
}
}  // namespace

TEST_CASE("a shunt obeys its equation: a resistance and an orifice with a gradient of 4 v^2") {
  using D = Dual<2>;
  for (double area : {0.05, 1.0, 5.0})
    for (double R : {2e-4, 0.01, 1.0})
      for (double dp : {-100.0, -0.3, 0.0, 1e-6, 2.0, 80.0}) {
        const ShuntParameters shunt{true, area, R};
        const double Q = shunt_flow(shunt, 10 + dp, 10.0);
        const double v_m_per_s = Q / (100 * area);
        CHECK(R * Q + 4 * v_m_per_s * std::abs(v_m_per_s) == Approx(dp).margin(1e-12));
        const ShuntParametersOf<D> moving{true, D::variable(area, 0), D(R)};
        const D at = shunt_flow(moving, D::variable(10 + dp, 1), D(10));
        CHECK(at.derivative[1] <= 1 / R * (1 + 1e-12));
        CHECK(at.derivative[1] > 0);
        const double h = 1e-6 * area;
        const double slope = (shunt_flow(ShuntParameters{true, area + h, R}, 10 + dp, 10.0) -
                              shunt_flow(ShuntParameters{true, area - h, R}, 10 + dp, 10.0)) /
                             (2 * h);
        CHECK(at.derivative[0] == Approx(slope).epsilon(1e-6).margin(1e-9));
      }
}

TEST_CASE("on a limit cycle every node loses what it gains, with every shunt and without") {
  const int shunt = GENERATE(range(-1, n_shunts + 1));
  const Loop loop = loop_with(shunt);
  const LoopSolver solver(loop, {"runge-kutta-4", 1e-9, 1e-9, 5e-4});
  CirculationValues state = cycle_of(solver, 1e-9);
  Table trace = circulation_table(loop.circulation);
  solver.beat(state, 5e-5, &trace);
  REQUIRE(trace.columns.size() == circulation_columns(loop.circulation));
  std::array<double, n_nodes> gain{};
  std::array<int, n_nodes> branches{};
  const auto carries = [&](std::string_view name, int from, int to) {
    const double flow = mean(trace, "Q_" + std::string(name));
    gain[from] -= flow;
    gain[to] += flow;
    ++branches[from];
    ++branches[to];
    return flow;
  };
  // Where blood goes, written a second time.
  const double Qs = carries("AV", LV, n_chambers + AR_SYS), Qp = carries("PV", RV, n_chambers + AR_PUL);
  carries("MV", LA, LV);
  carries("TV", RA, RV);
  carries("AR_SYS", n_chambers + AR_SYS, n_chambers + VEN_SYS);
  carries("VEN_SYS", n_chambers + VEN_SYS, RA);
  carries("AR_PUL", n_chambers + AR_PUL, n_chambers + VEN_PUL);
  carries("VEN_PUL", n_chambers + VEN_PUL, LA);
  double shunted = 0;
  for (int s = 0; s < n_shunts; ++s) {
    if (!loop.circulation.shunts[s].present) continue;
    const double flow = carries(network::shunts[s].name, network::shunts[s].from, network::shunts[s].to);
    CHECK(flow > 1);  // left to right
    shunted += flow;
  }
  for (int n = 0; n < n_nodes; ++n) {
    INFO("node " << network::node_name(n));
    CHECK(branches[n] >= 2);
    CHECK(std::abs(gain[n]) < 2e-3);  // mL/s, of 70 to 100: rows of 50 us
  }
  // The body's flow is what the aorta does not lose through a duct.
  if (shunt == -1) CHECK(Qp == Approx(Qs).epsilon(1e-4));
  if (shunt >= 0) CHECK(mean(trace, "Q_AR_PUL") == Approx(mean(trace, "Q_AR_SYS") + shunted).epsilon(1e-4));
}

TEST_CASE("resistances are those of the vessels, whatever blood takes other ways") {
  const int shunt = GENERATE(range(-1, n_shunts + 1));
  const Loop loop = loop_with(shunt);
  const LoopSolver solver(loop, {"runge-kutta-4", 1e-9, 1e-9, 5e-4});
  const CirculationValues state = cycle_of(solver, 1e-9);
  for (const BeatIndexes& b :
       {loop_indexes(solver, state), loop_indexes(LoopSolver(loop, {"cvode", 1e-10, 1e-10, 1e-3}), state)}) {
    const auto& vessels = loop.circulation.vessels;
    CHECK(b.systemic_resistance_mmHg_s_per_mL ==
          Approx(vessels[AR_SYS].R + vessels[VEN_SYS].R).epsilon(1e-4));
    CHECK(b.pulmonary_resistance_mmHg_s_per_mL ==
          Approx(vessels[AR_PUL].R + vessels[VEN_PUL].R).epsilon(1e-4));
    std::map<std::string, double> all;
    for_each_index(b, [&](const std::string& name, const char*, double value) { all[name] = value; });
    CHECK(all.count("Qp_over_Qs") == (shunt >= 0));
    if (shunt >= 0) {
      Table trace = circulation_table(loop.circulation);
      CirculationValues again = state;
      solver.beat(again, 1e-4, &trace);
      CHECK(all.at("Qp_over_Qs") == Approx(mean(trace, "Q_AR_PUL") / mean(trace, "Q_AR_SYS")).epsilon(1e-3));
    }
  }
}

TEST_CASE("steps are bounded by all that fills a vessel, and the branch is named") {
  CirculationParameters c = find_circulation_set("fedele2023").loop.circulation;
  CHECK(largest_filling_step(c).step_s == Approx(2 * 0.0075 * 1.5));
  CHECK_THAT(largest_filling_step(c).branch, Catch::Contains("AV"));
  c.vessels[AR_PUL].C = 1.5;
  c.shunts[2] = {true, 20, 3.4e-4};
  REQUIRE(network::shunts[2].name == "PDA");
  // Two vessels joined by R swap with a rate of 2/(R C); the valve adds its own.
  CHECK(largest_filling_step(c).step_s == Approx(2 / (2 / (3.4e-4 * 1.5) + 1 / (0.0075 * 1.5))));
  CHECK_THAT(largest_filling_step(c).branch, Catch::Contains("PDA"));
  CHECK_THROWS_WITH(read_scene(scenes + "whole_heart.toml",
                               {"circulation.shunts.PDA.R=3.4e-4", "circulation.circuit.PUL.C_AR=1.5"}),
                    Catch::Contains("shunt PDA"));
}

TEST_CASE("a shunt of a base is closed by false") {
  const auto present = [](const std::vector<std::string>& words) {
    return read_scene(scenes + "elastance_healthy.toml", words).circulation.has_shunts();
  };
  const auto folder = std::filesystem::temp_directory_path() / fmt::format("wiggers-shunts-{}", getpid());
  std::filesystem::create_directories(folder);
  std::filesystem::copy_file(scenes + "elastance_healthy.toml", folder / "healthy.toml",
                             std::filesystem::copy_options::overwrite_existing);
  std::ofstream(folder / "open.toml") << "base = 'healthy.toml'\n[circulation.shunts.ASD]\narea_cm2 = 2\n";
  std::ofstream(folder / "closed.toml") << "base = 'open.toml'\n[circulation.shunts]\nASD = false\n";
  const Scene open = read_scene(folder / "open.toml", {}), closed = read_scene(folder / "closed.toml", {});
  CHECK(open.circulation.has_shunts());
  CHECK(!closed.circulation.has_shunts());
  CHECK(!read_scene_text(closed.text(), "again", {}).circulation.has_shunts());
  std::filesystem::remove_all(folder);
  CHECK(present({"circulation.shunts.ASD.area_cm2=1"}));
  CHECK(!present({"circulation.shunts.ASD=false"}));
  CHECK_THROWS_WITH(present({"circulation.shunts.ASD=true"}), Catch::Contains("must be a table"));
}

TEST_CASE("the numbers of every set lie within their ranges") {
  for (const CirculationSet& set : circulation_sets()) {
    Loop loop = set.loop;
    for_each_circulation_parameter(loop.circulation,
                                   [&](const std::string& name, const Quantity& q, double v) {
                                     CHECK_NOTHROW(check_range(q, v, std::string(set.name) + " " + name));
                                   });
  }
}

TEST_CASE("every valve law is finite with its derivative at any drop") {
  for (int k = 0; k < n_valve_laws; ++k)
    for (double dp : {-1e3, -10.0, -1e-6, 0.0, 1e-6, 10.0, 1e3}) {
      const ValveParametersOf<Dual<1>> valve;
      const auto Q = valve_flow<Dual<1>, Dual<1>>(ValveLaw{k}, valve, Dual<1>(20), Dual<1>::variable(dp, 0),
                                                  Dual<1>(0.0));
      INFO(valve_law_names[static_cast<std::size_t>(k)] << " " << dp);
      CHECK(std::isfinite(Q.value));
      CHECK(std::isfinite(Q.derivative[0]));
    }
}

TEST_CASE("shunts: every integrator, the monolithic heart and the staggered one agree") {
  const int shunt = GENERATE(range(0, n_shunts + 1));
  const Loop loop = loop_with(shunt);
  const CirculationValues exact = cycle_of(LoopSolver(loop, {"cvode", 1e-10, 1e-10, 1e-3}), 1e-7);
  const CirculationValues steps = cycle_of(LoopSolver(loop, {"runge-kutta-4", 1e-9, 1e-9, 1e-3}), 1e-7);
  for (int k = 0; k < n_circulation_states; ++k)
    CHECK(steps[k] == Approx(exact[k]).epsilon(1e-4).margin(2e-3));

  std::vector<std::string> words = {"run.until=beats", "run.beats=1"};
  for (int s = 0; s < n_shunts; ++s)
    if (loop.circulation.shunts[s].present)
      for (const char* number : {"area_cm2=0.4", "R=4e-3"})
        words.push_back(fmt::format("circulation.shunts.{}.{}", network::shunts[s].name, number));
  const LoopSolver solver(loop, {"cvode", 1e-10, 1e-10, 1e-3});
  CirculationValues end = loop.initial;
  solver.beat(end);
  std::vector<double> errors;
  for (const char* dt : {"1e-3", "1e-4"}) {
    std::vector<std::string> all = words;
    all.push_back(std::string("solver.dt_s=") + dt);
    HeartRun run(read_scene(scenes + "elastance_healthy.toml", all));
    run.prepare(Progress::Style::quiet);
    run.advance(Progress::Style::quiet, {});
    double error = 0;
    for (int n = 0; n < n_nodes; ++n) error = std::max(error, std::abs(run.driver().values()[n] - end[n]));
    errors.push_back(error);
    CHECK(run.blood_volume_drift_mL() < 1e-8);
    CHECK(run.audit().volume_mismatch_mL < 1e-8);
    CHECK(summarise(run)["shunts"].size() == words.size() / 2 - 1);
  }
  CHECK(errors[0] < 1.5);
  CHECK(errors[0] / errors[1] == Approx(10).epsilon(0.4));

  MonolithicHeart whole(read_scene(scenes + "elastance_healthy.toml", words), {1e-9, false});
  const Table beat = whole.beat(1e-3);
  CHECK(beat.at("V_LV").values.back() == Approx(end[V_LV]).epsilon(1e-5));
  CHECK(beat.at("p_AR_PUL").values.back() == Approx(end[p_AR_PUL]).epsilon(1e-5));
}

TEST_CASE("a loop with holes balances the chambers' work with what is lost, holes included") {
  const Loop loop = loop_with(n_shunts);
  const LoopSolver solver(loop, {"runge-kutta-4", 1e-9, 1e-9, 5e-4});
  CirculationValues state = cycle_of(solver);
  LoopSummary summary;
  summary.circulation = loop.circulation;
  summary.trace = circulation_table(loop.circulation);
  solver.beat(state, 1e-4, &summary.trace);
  CHECK(summarise(summary)["audits"]["energy_imbalance"].get<double>() < 1e-4);
}
