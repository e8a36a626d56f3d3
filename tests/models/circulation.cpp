// The closed loop: reference traces, conservation, Jacobian, valve laws, elastance, refusals.
#include <fmt/format.h>

#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <random>
#include <wiggers/circulation/loop.hpp>
#include <wiggers/circulation/loop_beat.hpp>
#include <wiggers/circulation/stiffness.hpp>
#include <wiggers/core/dense.hpp>
#include <wiggers/core/dual.hpp>
#include <wiggers/core/errors.hpp>

#include "figures.hpp"

using namespace wiggers;

namespace {

Loop loop_of(const std::string& name) {
  if (name == "peer_default") return find_circulation_set("circulation-0.3.1").loop;
  Loop loop = find_circulation_set("baseline75").loop;
  if (name == "baseline75_diode") loop.circulation.valve_law = law_of<DiodeValve>;
  if (name == "seed_rlc") {
    const CirculationParameters paper = find_circulation_set("fedele2023").loop.circulation;
    loop.circulation.vessels = paper.vessels;
    loop.circulation.valves = paper.valves;
  }
  return loop;
}

LoopIntegrator tight() { return {"cvode", 1e-10, 1e-9, 1e-3}; }

// Every state within 1e-5 of its range; rows of the table are picked out of 1 ms samples.
void compare(const std::string& name, const Table& table, const Table& ranges_from, bool limit) {
  const LoopSolver solver(loop_of(name), tight());
  CirculationValues state = solver.loop().initial;
  if (limit) {
    LimitCycleSettings settings;
    settings.distance = 1e-9;
    const auto certificate = solver.to_limit_cycle(state, settings);
    CHECK(certificate.verdict == LimitCycleVerdict::period_1);
  }
  const double volume = total_volume(solver.loop().circulation, state.data());
  Table trace = circulation_table(solver.loop().circulation);
  solver.beat(state, 1e-3, &trace);
  REQUIRE(trace.n_rows() == 801);
  CHECK(std::abs(total_volume(solver.loop().circulation, state.data()) - volume) < 1e-9);
  for (const Quantity& q : circulation_state_quantities) {
    const auto& range = ranges_from.at(q.name).values;
    const auto [low, high] = std::minmax_element(range.begin(), range.end());
    for (std::size_t k = 0; k < table.n_rows(); ++k) {
      const auto row = static_cast<std::size_t>(std::lround(table.at("t_s").values[k] * 1e3));
      INFO(name << (limit ? " limit " : " beat 1 ") << q.name << " t " << row << " ms");
      CHECK(std::abs(trace.at(q.name).values[row] - table.at(q.name).values[k]) <= 1e-5 * (*high - *low));
    }
  }
}

}  // namespace

TEST_CASE("first beats and limit cycles against the reference") {
  for (const auto& [name, limit] : {std::pair<std::string, bool>{"baseline75", false},
                                    {"baseline75", true},
                                    {"peer_default", true},
                                    {"seed_rlc", true},
                                    {"baseline75_diode", true}}) {
    const std::string file = fmt::format("circulation/{}_{}.csv", name, limit ? "limit" : "beat1");
    const Table table = data_table(file);
    compare(name, table, table, limit);
    if (have_reference(file)) compare(name, reference_table(file), reference_table(file), limit);
  }
}

TEST_CASE("explicit Euler converges with order one") {
  double error[2];
  int k = 0;
  for (double dt : {1e-3, 1e-4}) {
    const LoopSolver exact(loop_of("baseline75"), tight()),
        euler(loop_of("baseline75"), {"forward-euler", 1e-9, 1e-9, dt});
    CirculationValues a = exact.loop().initial, b = a;
    exact.beat(a);
    euler.beat(b);
    error[k++] = std::abs(a[V_LV] - b[V_LV]);
  }
  CHECK(error[0] / error[1] == Approx(10).epsilon(0.15));
}

TEST_CASE("Runge-Kutta of order four agrees with CVODE") {
  const LoopSolver exact(loop_of("baseline75"), tight()),
      rk(loop_of("baseline75"), {"runge-kutta-4", 1e-9, 1e-9, 1e-4});
  CirculationValues a = exact.loop().initial, b = a;
  exact.beat(a);
  rk.beat(b);
  for (int i = 0; i < n_circulation_states; ++i) CHECK(a[i] == Approx(b[i]).epsilon(1e-6).margin(1e-5));
}

TEST_CASE("the leading multiplier of the loop is the reference's") {
  const LoopSolver solver(loop_of("baseline75"), tight());
  CirculationValues state = solver.loop().initial;
  LimitCycleSettings settings;
  settings.distance = 1e-8;
  const auto certificate = solver.to_limit_cycle(state, settings);
  CHECK(certificate.multiplier == Approx(0.8587).margin(2e-3));
  CHECK(certificate.beats <= 20);
}

TEST_CASE("valve laws: direction, limits, derivatives") {
  const ValveParameters valve{0.0075, 75000};
  for (int k = 0; k < n_valve_laws; ++k) {
    const ValveLaw law{k};
    INFO(valve_law_names[static_cast<int>(law)]);
    // Forward pressure opens: the founding paper's printed diode would close here.
    CHECK(valve_flow(law, valve, 20, 30.0, 10.0) ==
          Approx(20 / 0.0075).epsilon(law == law_of<LogArctanValve> ? 1e-2 : 1e-9));
    CHECK(std::abs(valve_flow(law, valve, 20, 10.0, 110.0)) < 2e-3);
    CHECK(valve_flow(law, valve, 20, 10.0, 110.0) <= 0);
    CHECK(valve_flow(law, valve, 20, 10.0, 10.0) == 0);
    for (double dp : {-3.0, -0.02, 0.013, 0.4, 5.0}) {
      using D = Dual<2>;
      const D q = valve_flow<D>(law, valve, 20, D::variable(10 + dp, 0), D::variable(10, 1));
      const double h = 1e-6;
      const double slope =
          (valve_flow(law, valve, 20, 10 + dp + h, 10.0) - valve_flow(law, valve, 20, 10 + dp - h, 10.0)) /
          (2 * h);
      CHECK(q.derivative[0] == Approx(slope).epsilon(1e-5).margin(1e-8));
      CHECK(q.derivative[1] == Approx(-q.derivative[0]).epsilon(1e-12).margin(1e-15));
      CHECK(q.derivative[0] >= -1e-12);
    }
  }
}

TEST_CASE("the fat tail of the log-arctan law is as specified") {
  const ValveParameters valve{0.0075, 75006.2};
  CHECK(1.0 / valve_flow(law_of<LogArctanValve>, valve, 20, 1.0, 0.0) / 0.0075 ==
        Approx(1.016).epsilon(2e-3));
  CHECK(0.1 / valve_flow(law_of<LogArctanValve>, valve, 20, 0.1, 0.0) / 0.0075 == Approx(1.18).epsilon(1e-2));
}

TEST_CASE("activation wraps round the period, before zero too") {
  const ElastanceParameters e{1, 0.1, 0.72, 0.136, 0.136, 4};
  for (double t : {0.0, 0.05, 0.72, 0.8, 0.856, 0.9}) {
    CHECK(elastance_activation(e, t, 0.8) == Approx(elastance_activation(e, t + 0.8, 0.8)).margin(1e-12));
    CHECK(elastance_activation(e, t, 0.8) == Approx(elastance_activation(e, t - 1.6, 0.8)).margin(1e-12));
  }
  CHECK(elastance_activation(e, 0.856, 0.8) == Approx(1));
  CHECK(elastance_activation(e, 0.056, 0.8) == Approx(1));
  CHECK(elastance_activation(e, 0.0, 0.8) > 0.5);  // the wrapped tail counts in the first beat
  CHECK(elastance_activation(e, 0.4, 0.8) == 0);
}

TEST_CASE("the total volume is an input and an invariant") {
  Loop loop = find_circulation_set("wiggers-healthy-0d").loop;
  CirculationValues y = loop.initial;
  hold_total_volume(loop.circulation, y.data(), 2700);
  CHECK(total_volume(loop.circulation, y.data()) == Approx(2700).epsilon(1e-14));
  SettingsReader reader(parse_settings_text("[initial]\ntotal_volume = 2700\n", "l.toml"), "l.toml");
  const Loop read = read_loop(reader);
  CHECK(total_volume(read.circulation, read.initial.data()) == Approx(2700).epsilon(1e-12));
}

TEST_CASE("wiggers-healthy-0d is physiological on its limit cycle") {
  const LoopSolver solver(find_circulation_set("wiggers-healthy-0d").loop, {});
  CirculationValues state = solver.loop().initial;
  LimitCycleSettings settings;
  settings.distance = 1e-8;
  solver.to_limit_cycle(state, settings);
  Table trace = circulation_table(solver.loop().circulation);
  solver.beat(state, 1e-3, &trace);
  const auto range = [&](const char* name) {
    const auto& v = trace.at(name).values;
    return std::pair(*std::min_element(v.begin(), v.end()), *std::max_element(v.begin(), v.end()));
  };
  const auto mean = [&](const char* name) {
    const auto& v = trace.at(name).values;
    double sum = 0;
    for (std::size_t k = 1; k < v.size(); ++k) sum += 0.5 * (v[k] + v[k - 1]);
    return sum / static_cast<double>(v.size() - 1);
  };
  const auto [diastolic, systolic] = range("p_AR_SYS");
  CHECK((systolic > 110 && systolic < 130));
  CHECK((diastolic > 65 && diastolic < 85));
  CHECK((mean("p_LA") > 6 && mean("p_LA") < 12));
  CHECK((mean("p_AR_PUL") > 10 && mean("p_AR_PUL") < 20));
  const auto [ESV, EDV] = range("V_LV");
  CHECK((100 * (EDV - ESV) / EDV > 50 && 100 * (EDV - ESV) / EDV < 70));
}

TEST_CASE("loop files: tables, names of sets for tables, and refusals") {
  const auto read = [](const std::string& text) {
    SettingsReader reader(parse_settings_text(text, "loop.toml"), "loop.toml");
    return read_loop(reader);
  };
  const Loop named =
      read("elastance = \"baseline75\"\ninitial = \"baseline75\"\n[circuit]\nSYS = \"fedele2023\"\n");
  CHECK(named.elastance[LV].EA == 3.35);
  CHECK(named.circulation.vessels[AR_SYS].R == 0.48);
  CHECK(named.initial[p_VEN_SYS] == 40);
  const Loop based = read("[elastance.LV]\nparameters = \"baseline75\"\nEA = 5.0\n");
  CHECK(based.elastance[LV].EA == 5);
  CHECK(based.elastance[LV].V0 == 42);
  CHECK_THROWS_WITH(read("[circuit.SYS]\nC_AR = -1.0\n"),
                    Catch::Contains("C_AR = -1") && Catch::Contains("circuit.SYS"));
  CHECK_THROWS_WITH(read("[elastance.LV]\nTC = 0.5\nTR = 0.4\n"), Catch::Contains("TC + TR"));
  CHECK_THROWS_WITH(read("[elastance.VL]\nEA = 1.0\n"), Catch::Contains("did you mean 'LV'"));
  const Loop steep = read("valve_law = \"tanh\"\ntanh_steepness = 35\n");
  CHECK(steep.circulation.tanh_steepness == 35);
  std::size_t steepnesses = 0;
  for (const Loop& loop : {steep, read("")})
    for_each_loop_parameter(loop, [&](const std::string& name, const Quantity&, double) {
      steepnesses += name == "tanh_steepness";
    });
  CHECK(steepnesses == 1);  // of the law that has one
  CHECK_THROWS_WITH(read("tanh_steepness = 35\n"), Catch::Contains("unknown key"));
  CHECK_THROWS_WITH(read("valve_law = \"diod\"\n"), Catch::Contains("did you mean 'diode'"));
  CHECK_THROWS_WITH(read("elastance = \"baseline\"\n"), Catch::Contains("baseline75"));
  CHECK_THROWS_WITH(read("[valves.AV]\nRmin = 1.0\nRmax = 0.5\n"), Catch::Contains("below Rmin"));
  CHECK_THROWS_WITH(read("[initial]\ntotal_volume = 2700\np_VEN_SYS = 30\n"), Catch::Contains("not both"));
  CHECK_THROWS_WITH(read("period_s = \"long\"\n"), Catch::Contains("must be a number"));
}

TEST_CASE("every set of the circulation, and a tenth and ten times it, is within the declared ranges") {
  for (const CirculationSet& set : circulation_sets()) {
    Loop loop = set.loop;
    const auto check = [&](const std::string& name, const Quantity& q, double value) {
      if (name.starts_with("elastance.") && !set.has_elastances) return;
      INFO(set.name << " " << name << " = " << value << ", " << q.lower << " to " << q.upper);
      CHECK((q.lower <= value && value <= q.upper));
      // What no heart has, whatever its set.
      if (q.unit == "s") return;
      if (q.name != "V0") CHECK((q.lower <= 0.1 * value && 10 * value <= q.upper));
    };
    for_each_loop_parameter(loop, check);
    if (set.has_elastances)
      for (std::size_t k = 0; k < circulation_state_quantities.size(); ++k)
        CHECK_NOTHROW(check_range(circulation_state_quantities[k], loop.initial[k], set.name));
  }
  for (const Quantity& q : circulation_state_quantities) {
    if (q.unit == "mmHg") CHECK((q.lower >= -100 && q.upper <= 500));
    if (q.unit == "mL") CHECK((q.lower == 0 && q.upper <= 2000));
  }
  for (const network::VesselEntry& vessel : network::vessels)
    for (const Quantity& q : vessel.quantities) CHECK(q.lower > 0);
}

TEST_CASE("random parameters end in a beat or in words, never in NaN") {
  std::mt19937 random(3);
  std::uniform_real_distribution<double> exponent(-1, 1);
  int good = 0;
  for (int draw = 0; draw < 60; ++draw) {
    Loop loop = find_circulation_set("wiggers-healthy-0d").loop;
    const auto scale = [&](double decades) { return std::pow(10, decades * exponent(random)); };
    for (ValveParameters& valve : loop.circulation.valves) valve.Rmin *= scale(1.5);
    for (int v : {AR_SYS, VEN_SYS, AR_PUL, VEN_PUL}) {
      loop.circulation.vessels[v].C *= scale(1);
      loop.circulation.vessels[v].R *= scale(1);
    }
    for (ElastanceParameters& e : loop.elastance) e.EA *= scale(1);
    const LoopSolver solver(loop, {});
    CirculationValues state = loop.initial;
    try {
      for (int beat = 0; beat < 2; ++beat) solver.beat(state);
      for (double value : state) REQUIRE(std::isfinite(value));
      ++good;
    } catch (const NumericalFailure& failure) {
      CHECK(std::string(failure.what()).size() > 40);
    }
  }
  CHECK(good >= 55);
}

TEST_CASE("half the step moves the cycle of a loop as the order says") {
  const Loop loop = find_circulation_set("wiggers-healthy-0d").loop;
  std::vector<double> shifts;
  for (double dt : {1e-3, 5e-4}) {
    const LoopSolver solver(loop, {"forward-euler", 1e-9, 1e-9, dt});
    CirculationValues state = loop.initial;
    LimitCycleSettings settings;
    settings.distance = 1e-9;
    REQUIRE(solver.to_limit_cycle(state, settings).verdict == LimitCycleVerdict::period_1);
    const auto shift = solver.integrator_shift(state);
    REQUIRE(shift);
    shifts.push_back(*shift);
  }
  CHECK(shifts[0] / shifts[1] == Approx(2).epsilon(0.1));
}

TEST_CASE("a stiff valve does not make runge-kutta-4 unstable: the steps are divided, or it is refused") {
  Loop loop = find_circulation_set("wiggers-healthy-0d").loop;
  loop.circulation.valves[AV].Rmin = 0.0012;
  for (const char* law : {"diode", "log-arctan"}) {
    loop.circulation.valve_law = law == std::string("diode") ? law_of<DiodeValve> : law_of<LogArctanValve>;
    CirculationValues by_rk = loop.initial, by_cvode = loop.initial;
    const auto rk = LoopSolver(loop, {"runge-kutta-4", 1e-9, 1e-9, 1e-3})
                        .to_limit_cycle(by_rk, loop_cycle_settings(1e-8));
    const auto cvode =
        LoopSolver(loop, {"cvode", 1e-9, 1e-9, 1e-3}).to_limit_cycle(by_cvode, loop_cycle_settings(1e-7));
    CHECK(rk.good());
    CHECK(cvode.good());
    for (int k = 0; k < n_circulation_states; ++k)
      CHECK(by_rk[k] == Approx(by_cvode[k]).epsilon(1e-3).margin(0.05));
  }
  loop.circulation.valve_law = law_of<DiodeValve>;
  loop.circulation.valves[AV].Rmin = 1e-6;
  CirculationValues state = loop.initial;
  CHECK_THROWS_WITH(
      LoopSolver(loop, {"runge-kutta-4", 1e-9, 1e-9, 1e-3}).to_limit_cycle(state, loop_cycle_settings(1e-8)),
      Catch::Contains("valve AV") && Catch::Contains("cvode"));
}

TEST_CASE("no eigenvalue of the loop is beyond the bound of its stiffness") {
  std::mt19937 random(5);
  std::uniform_real_distribution<double> log_factor(std::log(0.3), std::log(3));
  for (int draw = 0; draw < 50; ++draw) {
    Loop loop = find_circulation_set("wiggers-healthy-0d").loop;
    loop.circulation.valve_law = law_of<DiodeValve>;
    for (ShuntParameters& shunt : loop.circulation.shunts) shunt.present = draw % 2 == 1;
    for_each_loop_parameter(loop, [&](const std::string& name, const Quantity&, double& value) {
      if (name != "period_s" && name.find(".T") == std::string::npos) value *= std::exp(log_factor(random));
    });
    for (double t : {0.0, 0.15, 0.3}) {
      using Jet = Dual<n_circulation_states>;
      Jet y[n_circulation_states], dy[n_circulation_states], p[n_chambers];
      for (int k = 0; k < n_circulation_states; ++k) y[k] = Jet::variable(loop.initial[k], k);
      loop_pressures(loop, t, y, p);
      ValveConductances g;
      const auto drops = valve_drops(p, y);
      for (int v = 0; v < n_valves; ++v)
        g[v] = 1 / (drops[v].value > 0 ? loop.circulation.valves[v].Rmin : loop.circulation.valves[v].Rmax);
      circulation_rates<Jet>(loop.circulation, y, p, valve_flows(loop.circulation, p, y), dy);
      Eigen::Matrix<double, n_circulation_states, n_circulation_states> J;
      for (int i = 0; i < n_circulation_states; ++i)
        for (int k = 0; k < n_circulation_states; ++k) J(i, k) = dy[i].derivative[k];
      ChamberElastances E;
      for (int c = 0; c < n_chambers; ++c) E[c] = elastance(loop.elastance[c], t, loop.period_s);
      const double fastest = J.eigenvalues().cwiseAbs().maxCoeff(),
                   bound = fastest_rate(loop.circulation, E, g);
      CHECK(fastest <= bound * (1 + 1e-9));
      // A shunt counts with its steepest slope, wherever its pressure drop is.
      if (!loop.circulation.has_shunts()) CHECK(bound < 4 * fastest);
    }
  }
}

TEST_CASE("a cycle that no heart can be in is unphysical, whatever the integrator") {
  Loop loop = find_circulation_set("wiggers-healthy-0d").loop;
  loop.elastance[LV].V0 = -100;
  for (const char* integrator : {"runge-kutta-4", "cvode", "forward-euler"}) {
    CirculationValues state = loop.initial;
    const auto c =
        LoopSolver(loop, {integrator, 1e-9, 1e-9, 2e-4}).to_limit_cycle(state, loop_cycle_settings(1e-6));
    INFO(integrator << ": " << c.text() << " " << c.reason);
    CHECK(c.verdict == LimitCycleVerdict::unphysical);
    CHECK_THAT(c.reason,
               Catch::Contains("volume of LV") && Catch::Contains("no heart is outside 0 to 2000 mL"));
  }
}

TEST_CASE("forward-euler does not certify its own oscillation") {
  Loop loop = find_circulation_set("wiggers-healthy-0d").loop;
  loop.circulation.valve_law = law_of<LogArctanValve>;
  loop.circulation.valves[AV].Rmin = 0.0006;
  CirculationValues state = loop.initial;
  LimitCycleCertificate c;
  try {
    c = LoopSolver(loop, {"forward-euler", 1e-9, 1e-9, 1e-3})
            .to_limit_cycle(state, loop_cycle_settings(1e-6));
  } catch (const NumericalFailure& failure) {
    c.reason = failure.what();
  }
  INFO(c.text() << " " << c.reason);
  CHECK(!c.good());
  CHECK(!c.reason.empty());
}

TEST_CASE("beats on the way to a cycle may be what no heart can be in") {
  const Loop loop = find_circulation_set("wiggers-healthy-0d").loop;
  CirculationValues state = loop.initial;
  state[p_AR_SYS] = 1500;  // mmHg; the second beat still starts above 400
  // So coarse a distance that all beats but the first are looked at.
  const auto c =
      LoopSolver(loop, {"runge-kutta-4", 1e-9, 1e-9, 1e-3}).to_limit_cycle(state, loop_cycle_settings(0.1));
  INFO(c.text() << " " << c.reason);
  CHECK(c.good());
  CHECK(state[p_AR_SYS] < 400);
}
