// The whole heart: the specification's tables, the two stabilisations, mixed walls, conservation.
#include <catch2/catch.hpp>
#include <cmath>
#include <fstream>
#include <sstream>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/units.hpp>
#include <wiggers/heart/run/run.hpp>
#include <wiggers/heart/run/summary.hpp>
#include <wiggers/heart/scene/accuracy.hpp>

using namespace wiggers;

namespace {

constexpr auto quiet = Progress::Style::quiet;
const std::string scenes = std::string(WIGGERS_TEST_DATA) + "/../../scenes/";

// The whole-heart paper's scheme (lagged rate), with more changes on top: what the specification's figures
// are of.
std::vector<std::string> founding(const std::vector<std::string>& changes = {}) {
  std::vector<std::string> all = heart_accuracy("founding").overrides;
  all.insert(all.end(), changes.begin(), changes.end());
  return all;
}

std::unique_ptr<HeartRun> finished(const std::string& scene, const std::vector<std::string>& changes = {}) {
  auto run = std::make_unique<HeartRun>(read_scene(scenes + scene + ".toml", changes));
  run->prepare(quiet);
  run->advance(quiet, {});
  return run;
}

// One beat with other switches, from the limit cycle of the main scene: flips of p_LV and Q_AV.
std::pair<double, double> flips_from_cycle(HeartRun& cycle, const std::vector<std::string>& changes) {
  std::vector<std::string> all = founding(changes);
  all.push_back("run.until=beats");
  all.push_back("run.beats=1");
  HeartRun other(read_scene(scenes + "whole_heart.toml", all));
  other.prepare(quiet);
  other.driver().restore(cycle.driver().save());
  Table trace = other.driver().trace();
  other.driver().beat(&trace);
  return {largest_flip(trace.at("p_LV").values), largest_flip(trace.at("Q_AV").values)};
}

// The main scene on its cycle, computed once for all tests of this file.
HeartRun& main_job() {
  static const auto run = finished("whole_heart");
  return *run;
}

HeartRun& founding_job() {
  static const auto run = finished("whole_heart", founding());
  return *run;
}

}  // namespace

TEST_CASE("main job: on its limit cycle, inside the clinical bars") {
  HeartRun& run = main_job();
  CHECK(run.certificate().verdict == LimitCycleVerdict::period_1);
  CHECK(run.certificate().distance <= 1e-6);
  for (const auto& [name, cell] : run.cells()) CHECK(cell.certificate.distance <= 1e-6);
  const BeatIndexes b = run.indexes();
  CHECK((b.ventricle[0].pressure_max_mmHg > 105 && b.ventricle[0].pressure_max_mmHg < 130));
  CHECK((b.ventricle[0].EF_percent > 50 && b.ventricle[0].EF_percent < 70));
  CHECK((b.aorta.pressure_max_mmHg > 100 && b.aorta.pressure_max_mmHg < 130));
  CHECK((b.aorta.pressure_min_mmHg > 60 && b.aorta.pressure_min_mmHg < 85));
  CHECK(std::abs(b.ventricle[0].SV_mL - b.ventricle[1].SV_mL) < 0.1);
  CHECK(run.blood_volume_drift_mL() < 1e-8);
  CHECK(run.audit().volume_mismatch_mL < 1e-8);  // stabilised volumes equal the circulation's
  // Newton stays Newton: a wrong derivative or update would still converge, but slowly.
  CHECK(run.audit().newton_iterations < 4 * run.driver().steps_per_beat());
  CHECK(std::abs(run.audit().chamber_work_mmHg_mL / run.audit().dissipated_mmHg_mL - 1) < 0.01);
  // All twenty volumetric indexes inside their reference ranges.
  for (double bsa : {1.8, 1.9, 2.0})
    for (const ReferenceRange& range : reference_ranges()) {
      INFO(range.index << " BSA " << bsa);
      const double value = *indexed_value(b, range.index, bsa);
      CHECK((value >= range.lower && value <= range.upper));
    }
}

TEST_CASE("the specification's results of the recommended set, with cells stepped finely") {
  // The specification's cells are converged in time; 50 us Rush-Larsen shifts peak flow by 2 %.
  const auto run = finished("whole_heart", founding({"solver.electrophysiology_integrator=rush-larsen-2"}));
  const BeatIndexes b = run->indexes();
  CHECK(b.ventricle[0].pressure_max_mmHg == Approx(110.4).margin(0.15));
  CHECK(b.ventricle[0].EDV_mL == Approx(138.2).margin(0.15));
  CHECK(b.ventricle[0].ESV_mL == Approx(51.3).margin(0.15));
  CHECK(b.ventricle[0].SV_mL == Approx(86.96).margin(0.1));
  CHECK(b.ventricle[0].EF_percent == Approx(62.9).margin(0.1));
  CHECK(b.ventricle[0].stroke_work_J == Approx(1.010).margin(0.003));
  CHECK(b.ventricle[1].EDV_mL == Approx(148.0).margin(0.15));
  CHECK(b.ventricle[1].ESV_mL == Approx(61.0).margin(0.15));
  CHECK(b.ventricle[1].pressure_max_mmHg == Approx(23.4).margin(0.1));
  CHECK(b.aorta.pressure_max_mmHg == Approx(109.0).margin(0.15));
  CHECK(b.aorta.pressure_min_mmHg == Approx(66.1).margin(0.1));
  CHECK(b.pulmonary_artery.pressure_mean_mmHg == Approx(17.1).margin(0.1));
  CHECK(b.atrium[0].pressure_mean_mmHg == Approx(9.7).margin(0.1));
  CHECK(b.atrium[1].pressure_mean_mmHg == Approx(5.6).margin(0.1));
  CHECK(b.atrium[0].Vmax_mL == Approx(65.1).margin(0.15));
  CHECK(*b.atrium[0].VpreAC_mL == Approx(50.8).margin(0.15));  // at its own activation
  CHECK(b.atrium[0].Vmin_mL == Approx(29.7).margin(0.15));
  CHECK(b.atrium[1].Vmax_mL == Approx(83.8).margin(0.15));
  CHECK(b.valve[AV].peak_flow_mL_per_s == Approx(600).margin(2));
  CHECK(b.valve[PV].peak_flow_mL_per_s == Approx(604).margin(2));
  CHECK(*b.E_over_A[0] == Approx(0.60).margin(0.01));
  CHECK(*b.valve[MV].closes_s == Approx(0.183).margin(0.0015));
  CHECK(*b.valve[AV].opens_s == Approx(0.259).margin(0.0015));
  CHECK(*b.valve[AV].closes_s == Approx(0.490).margin(0.0015));
  CHECK(*b.valve[MV].opens_s == Approx(0.591).margin(0.0015));
  // A-loop and V-loop have opposite signs: the net atrial work is small against both.
  CHECK(b.atrium[0].work_J / units::J_per_mmHg_mL == Approx(13.1 - 35.8).margin(1.5));
  CHECK(b.atrium[1].work_J / units::J_per_mmHg_mL == Approx(47.0 - 20.6).margin(1.5));
}

TEST_CASE("the two stabilisations: together clean, each alone and neither oscillate at 1 ms") {
  HeartRun& cycle = founding_job();
  const auto flips = [&](bool stress, bool volumes) {
    return flips_from_cycle(cycle,
                            {std::string("solver.stabilise.active_stress=") + (stress ? "true" : "false"),
                             std::string("solver.stabilise.volumes=") + (volumes ? "true" : "false")});
  };
  const auto both = flips(true, true);
  CHECK(both.first < 0.1);
  CHECK(both.second < 1);
  // In the specification's table, whose cells are converged: 10.0, 17.2, 21.3 mmHg and 1088, 1948, 1683 mL/s.
  for (const auto& [stress, volumes, p, Q] :
       {std::tuple{true, false, 8.9, 869.0}, {false, true, 16.3, 1764.0}, {false, false, 20.6, 1544.0}}) {
    const auto one = flips(stress, volumes);
    INFO("S1 " << stress << " S2 " << volumes);
    CHECK(one.first > 5);
    // As recorded, from the founding job's cycle; oscillations amplify what compilers round.
    CHECK(one.first == Approx(p).epsilon(0.05));
    CHECK(one.second == Approx(Q).epsilon(0.05));
  }
  // At 0.1 ms all four are clean.
  for (const auto& [stress, volumes] : {std::pair{true, false}, {false, true}, {false, false}}) {
    const auto fine =
        flips_from_cycle(cycle, {"solver.dt_s=1e-4",
                                 std::string("solver.stabilise.active_stress=") + (stress ? "true" : "false"),
                                 std::string("solver.stabilise.volumes=") + (volumes ? "true" : "false")});
    INFO("S1 " << stress << " S2 " << volumes);
    CHECK(fine.first < 0.1);
    CHECK(fine.second < 1);
  }
}

TEST_CASE(
    "a wall dashpot makes the plain volume constraint oscillate at any step - the stabilised one carries "
    "it") {
  for (double dt : {1e-3, 2.5e-4}) {
    const std::string step = "solver.dt_s=" + std::to_string(dt);
    const std::vector<std::string> viscous = {step,
                                              "walls.LA.viscosity_Pa_s=2000",
                                              "walls.LV.viscosity_Pa_s=2000",
                                              "walls.RA.viscosity_Pa_s=2000",
                                              "walls.RV.viscosity_Pa_s=2000",
                                              "run.until=beats",
                                              "run.beats=1"};
    std::vector<std::string> plain = viscous;
    plain.push_back("solver.stabilise.volumes=false");
    INFO("dt " << dt);
    // On this heart the plain constraint oscillates through the beat, or breaks down, by chance of rounding;
    // the prototype's surrogate heart broke down.
    double flip = 1e9;
    try {
      flip = largest_flip(finished("whole_heart", plain)->trace().at("Q_AV").values);
    } catch (const NumericalFailure&) {
      // broke down
    }
    CHECK(flip > 1000);
    const auto run = finished("whole_heart", viscous);
    const auto& Q = run->trace().at("Q_AV").values;
    CHECK(largest_flip({Q.begin() + 5, Q.end()}) <= 1);
  }
}

TEST_CASE("step error: first order for the lagged rate, nearly none for the implicit rate, one limit") {
  const auto indexes = [](const char* rate, const char* dt) {
    return finished("whole_heart",
                    founding({std::string("solver.stretch_rate=") + rate, std::string("solver.dt_s=") + dt,
                              "solver.electrophysiology_integrator=rush-larsen-2"}))
        ->indexes();
  };
  const BeatIndexes lagged2 = indexes("lagged", "2e-3"), lagged1 = indexes("lagged", "1e-3"),
                    lagged_half = indexes("lagged", "5e-4"), fine = indexes("lagged", "5e-5");
  const auto error = [&](const BeatIndexes& b, auto value) { return value(b) - value(fine); };
  const auto peak = [](const BeatIndexes& b) { return b.ventricle[0].pressure_max_mmHg; };
  const auto flow = [](const BeatIndexes& b) { return b.valve[AV].peak_flow_mL_per_s; };
  const auto ESV = [](const BeatIndexes& b) { return b.ventricle[0].ESV_mL; };
  CHECK(peak(fine) == Approx(111.23).margin(0.15));
  CHECK(flow(fine) == Approx(643).margin(3));
  // The specification's error table at 2, 1 and 0.5 ms.
  CHECK(error(lagged2, peak) == Approx(-1.64).epsilon(0.1));
  CHECK(error(lagged1, peak) == Approx(-0.79).epsilon(0.1));
  CHECK(error(lagged_half, peak) == Approx(-0.37).epsilon(0.1));
  CHECK(error(lagged2, flow) == Approx(-83).epsilon(0.1));
  CHECK(error(lagged1, flow) == Approx(-43).epsilon(0.1));
  CHECK(error(lagged_half, flow) == Approx(-21).epsilon(0.1));
  CHECK(error(lagged1, ESV) == Approx(0.15).epsilon(0.15));
  // Implicit rate: an order of magnitude closer at 1 ms.
  const BeatIndexes implicit1 = indexes("implicit", "1e-3"), implicit_half = indexes("implicit", "5e-4");
  const auto limit = [](auto value, const BeatIndexes& one, const BeatIndexes& half) {
    return 2 * value(half) - value(one);
  };
  CHECK(std::abs(peak(implicit1) - limit(peak, lagged1, lagged_half)) < 0.1);
  CHECK(std::abs(flow(implicit1) - limit(flow, lagged1, lagged_half)) < 6);
  // Richardson limits of both schemes agree.
  CHECK(limit(peak, lagged1, lagged_half) == Approx(limit(peak, implicit1, implicit_half)).epsilon(1e-3));
  CHECK(limit(ESV, lagged1, lagged_half) == Approx(limit(ESV, implicit1, implicit_half)).epsilon(1e-3));
  CHECK(limit(flow, lagged1, lagged_half) == Approx(limit(flow, implicit1, implicit_half)).epsilon(1e-2));
}

TEST_CASE("all four variants of the scheme have one limit") {
  std::vector<double> peaks;
  for (const char* stress : {"true", "false"})
    for (const char* volumes : {"true", "false"})
      peaks.push_back(finished("whole_heart", {std::string("solver.stabilise.active_stress=") + stress,
                                               std::string("solver.stabilise.volumes=") + volumes,
                                               "solver.dt_s=1e-4", "run.until=beats", "run.beats=2"})
                          ->indexes()
                          .ventricle[0]
                          .pressure_max_mmHg);
  for (double peak : peaks) CHECK(peak == Approx(peaks[0]).margin(0.15));
}

TEST_CASE("every scene shows what its name says") {
  const BeatIndexes whole = main_job().indexes();
  SECTION("no rate feedback: peak ejection flow at least doubles") {
    const BeatIndexes b = finished("no_rate_feedback")->indexes();
    CHECK(b.valve[AV].peak_flow_mL_per_s > 2 * whole.valve[AV].peak_flow_mL_per_s);
    CHECK(b.valve[PV].peak_flow_mL_per_s > 2 * whole.valve[PV].peak_flow_mL_per_s);
    CHECK(b.ventricle[0].EDV_mL == Approx(whole.ventricle[0].EDV_mL).margin(1.5));
  }
  SECTION("passive atria: no A-loop, less filling, less stroke volume") {
    const BeatIndexes b = finished("atria_passive")->indexes();
    CHECK(b.atrium[0].ActEF_percent < 6);
    CHECK(whole.atrium[0].ActEF_percent > 35);
    CHECK(b.ventricle[0].SV_mL == Approx(79.0).margin(0.7));
    CHECK(b.atrium[0].work_J <= 0);
  }
  SECTION("no stabilisation of the stress, of the volumes: oscillation") {
    for (const char* scene : {"no_stress_stabilisation", "no_volume_stabilisation"}) {
      const auto run = finished(scene);
      CHECK(largest_flip(run->trace().at("p_LV").values) > 5);
      CHECK(summarise(*run)["warnings"].size() >= 1);
    }
  }
  SECTION("elastance heart: the project's healthy set") {
    const auto run = finished("elastance_healthy");
    const BeatIndexes b = run->indexes();
    CHECK(run->cells().empty());
    CHECK((b.aorta.pressure_max_mmHg > 110 && b.aorta.pressure_max_mmHg < 130));
    CHECK((b.aorta.pressure_min_mmHg > 65 && b.aorta.pressure_min_mmHg < 85));
    CHECK((b.ventricle[0].EF_percent > 50 && b.ventricle[0].EF_percent < 70));
  }
  SECTION("mixed: kinds of wall in one heart; only the named cells are paced") {
    const auto run = finished("mixed");
    CHECK(run->cells().size() == 1);
    CHECK(run->certificate().verdict == LimitCycleVerdict::period_1);
    const BeatIndexes b = run->indexes();
    CHECK((b.ventricle[0].EF_percent > 50 && b.ventricle[0].EF_percent < 70));
    CHECK(b.ventricle[0].SV_mL == Approx(b.ventricle[1].SV_mL).margin(0.1));
  }
}

TEST_CASE("variants of the recommended set move the indexes as the specification says") {
  const BeatIndexes base = founding_job().indexes();
  const BeatIndexes rest =
      finished("whole_heart",
               founding({"walls.LA.subtract_rest_tension=false", "walls.LV.subtract_rest_tension=false",
                         "walls.RA.subtract_rest_tension=false", "walls.RV.subtract_rest_tension=false"}))
          ->indexes();
  CHECK(rest.ventricle[0].pressure_max_mmHg == Approx(104.7).margin(0.5));
  CHECK(rest.atrium[0].pressure_mean_mmHg == Approx(13.3).margin(0.3));
  const BeatIndexes peak =
      finished("whole_heart", founding({"cells.ventricles.calcium_reading=peak",
                                        "solver.electrophysiology_integrator=rush-larsen-2"}))
          ->indexes();
  CHECK(peak.ventricle[0].pressure_max_mmHg == Approx(99.0).margin(0.7));
  CHECK(peak.atrium[0].pressure_mean_mmHg == Approx(18.0).margin(0.5));
  const BeatIndexes volume =
      finished("whole_heart", founding({"circulation.initial.total_volume=3141.6"}))->indexes();
  CHECK(volume.ventricle[0].pressure_max_mmHg - base.ventricle[0].pressure_max_mmHg ==
        Approx(9.5).margin(0.4));
  std::vector<std::string> robin;
  for (const char* wall : {"LA", "LV", "RA", "RV"}) {
    robin.push_back(std::string("walls.") + wall + ".epicardial_stiffness_Pa_per_m=1e5");
    robin.push_back(std::string("walls.") + wall + ".epicardial_damping_Pa_s_per_m=1e3");
  }
  const BeatIndexes surrounded = finished("whole_heart", founding(robin))->indexes();
  CHECK(surrounded.ventricle[0].pressure_max_mmHg == Approx(107.2).margin(0.5));
  CHECK(surrounded.ventricle[0].EF_percent == Approx(61.8).margin(0.4));
}

TEST_CASE("a staggered elastance heart converges to the ODE loop with order one") {
  const LoopSolver solver(find_circulation_set("wiggers-healthy-0d").loop, {"cvode", 1e-10, 1e-9, 1e-3});
  CirculationValues exact = solver.loop().initial;
  solver.beat(exact);
  std::vector<double> errors;
  for (const char* dt : {"1e-3", "1e-4"}) {
    HeartRun run(read_scene(scenes + "elastance_healthy.toml",
                            {std::string("solver.dt_s=") + dt, "run.until=beats", "run.beats=1"}));
    run.prepare(quiet);
    run.advance(quiet, {});
    double error = 0;
    for (int k = 0; k < 8; ++k) error = std::max(error, std::abs(run.driver().values()[k] - exact[k]));
    errors.push_back(error);
  }
  CHECK(errors[0] < 1);
  CHECK(errors[0] / errors[1] == Approx(10).epsilon(0.3));
}

TEST_CASE("steps, pulses and activations that share no grid still reach the cycle") {
  for (const char* change :
       {"solver.dt_s=0.00032", "cells.ventricles.stimulus_ms=1.03", "walls.LV.activation_ms=160.37",
        "walls.RV.activation_ms=799.9", "solver.electrophysiology_substep_ms=0.03"}) {
    const auto run = finished("whole_heart", {change});
    INFO(change);
    CHECK(run->certificate().verdict == LimitCycleVerdict::period_1);
    CHECK(run->certificate().beats < 30);
  }
}

TEST_CASE("calcium between two points of the cell's grid is interpolated") {
  // A coarse cell grid under a fine heart step: the same cell read every 1 ms and every 0.0625 ms gives a
  // trace without stairs.
  const auto run =
      finished("whole_heart", {"solver.dt_s=6.25e-5", "solver.electrophysiology_substep_ms=0.25",
                               "solver.electrophysiology_integrator=rush-larsen-2", "run.beats=1"});
  const auto& calcium = run->trace().at("LV.calcium").values;
  double largest = 0;
  int still = 0;
  for (std::size_t k = 3000; k < 5000; ++k) {  // 187 to 312 ms: calcium moves all the time
    largest = std::max(largest, std::abs(calcium[k] - calcium[k - 1]));
    still += calcium[k] == calcium[k - 1];
  }
  CHECK(still == 0);
  CHECK(largest < 2e-3);
}

TEST_CASE("too large a step ends in words that name the bound") {
  CHECK_THROWS_WITH(finished("elastance_healthy", {"solver.dt_s=8e-3", "run.until=beats", "run.beats=3"}),
                    Catch::Contains("3.85 ms"));
}

TEST_CASE("the surrogate heart with prescribed calcium (no ionic cells)") {
  // Section 7 of the specification: other unloaded volumes, the founding paper's a_XB, a surrogate transient.
  std::ostringstream text;
  text << "[cells.atria]\nionic = \"transient\"\nparameters = \"fedele2023-atria\"\ncalcium_rest_uM = 0.1\n"
          "calcium_peak_uM = 0.6\nrise_ms = 15\ndecay_ms = 80\n"
          "[cells.ventricles]\nionic = \"transient\"\nparameters = \"fedele2023-ventricles\"\n";
  const auto wall = [&](const char* name, const char* cells, double activation, double V0, double Vw,
                        double C, double a_XB) {
    text << "[walls." << name << "]\nkind = \"reduced\"\ncells = \"" << cells
         << "\"\nactivation_ms = " << activation << "\nunloaded_volume_mL = " << V0
         << "\nwall_volume_mL = " << Vw << "\nstiffness_kPa = " << C << "\na_XB_kPa = " << a_XB << "\n";
  };
  wall("LA", "atria", 20, 32, 22, 1.76, 3e5);
  wall("LV", "ventricles", 160, 85, 130, 0.88, 15e5);
  wall("RA", "atria", 0, 42, 20, 1.47, 3e5);
  wall("RV", "ventricles", 165, 100, 45, 0.88, 10.5e5);
  HeartRun run(read_scene_text(text.str(), "surrogate", founding()));
  run.prepare(quiet);
  run.advance(quiet, {});
  const BeatIndexes b = run.indexes();
  CHECK((b.ventricle[0].pressure_max_mmHg > 105 && b.ventricle[0].pressure_max_mmHg < 130));
  CHECK((b.ventricle[0].EF_percent > 50 && b.ventricle[0].EF_percent < 70));
  CHECK(std::abs(b.ventricle[0].SV_mL - b.ventricle[1].SV_mL) < 0.1);
  CHECK(run.blood_volume_drift_mL() < 1e-8);
  // The specification's figures (116.9 mmHg, 148/54 mL, 711 mL/s) within 5 %: what differs is in
  // docs/notes.md.
  CHECK(b.ventricle[0].pressure_max_mmHg == Approx(116.9).epsilon(0.05));
  CHECK(b.ventricle[0].EDV_mL == Approx(148).epsilon(0.05));
  CHECK(b.ventricle[0].ESV_mL == Approx(54).epsilon(0.05));
  CHECK(b.valve[AV].peak_flow_mL_per_s == Approx(711).epsilon(0.05));
}
