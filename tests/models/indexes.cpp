// Phases, valve times, indexes and flips on traces whose answers are known.
#include <catch2/catch.hpp>
#include <cmath>
#include <wiggers/circulation/loop.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/units.hpp>
#include <wiggers/heart/indexes/indexes.hpp>
#include <wiggers/heart/scene/scene.hpp>

using namespace wiggers;

namespace {
// A made-up beat of 1 s: MV open 0.7 to 1.2 (wraps), AV open 0.3 to 0.6; the same on the right, 10 ms later.
Table made_up_beat() {
  Table table = circulation_table({});
  const auto set = [&](const char* name, double value) {
    for (Column& column : table.columns)
      if (column.name == name) column.values.push_back(value);
  };
  for (int k = 0; k <= 1000; ++k) {
    const double t = k * 1e-3;
    set("t_s", t);
    for (int side = 0; side < 2; ++side) {
      const double s = std::fmod(t - 0.01 * side + 1, 1.0);
      const bool inlet = s < 0.2 || s >= 0.7, outlet = s >= 0.3 && s < 0.6;
      const double V = s < 0.2   ? 110 + 50 * s
                       : s < 0.3 ? 120
                       : s < 0.6 ? 120 - 70 * (s - 0.3) / 0.3
                       : s < 0.7 ? 50
                                 : 50 + 60 * (s - 0.7) / 0.3;
      set(side == 0 ? "V_LV" : "V_RV", V);
      set(side == 0 ? "V_LA" : "V_RA", s < 0.2   ? 40 - 60 * s
                                       : s < 0.7 ? 28 + 64 * (s - 0.2)
                                                 : 60 - 66.7 * (s - 0.7));
      const double ventricle = outlet ? 101 : inlet ? 4 : 50;
      set(side == 0 ? "p_LV" : "p_RV", ventricle);
      set(side == 0 ? "p_LA" : "p_RA", 5);
      set(side == 0 ? "p_AR_SYS" : "p_AR_PUL", 100 - (outlet ? 0 : 1));
      set(side == 0 ? "Q_AV" : "Q_PV", outlet ? 70 / 0.3 : 0);
      set(side == 0 ? "Q_MV" : "Q_TV", s < 0.2 ? 50 : s >= 0.7 ? 200 : 0);
    }
    for (const char* name : {"p_VEN_SYS", "p_VEN_PUL", "Q_AR_SYS", "Q_VEN_SYS", "Q_AR_PUL", "Q_VEN_PUL"})
      set(name, 10);
  }
  return table;
}
}  // namespace

TEST_CASE("valve times, phases and indexes of a made-up beat") {
  const BeatIndexes b = compute_indexes(made_up_beat(), {0.05, 0.05});
  CHECK(*b.valve[MV].opens_s == Approx(0.7).margin(2e-3));
  CHECK(*b.valve[MV].closes_s == Approx(0.2).margin(2e-3));
  CHECK(*b.valve[AV].opens_s == Approx(0.3).margin(2e-3));
  CHECK(*b.valve[AV].closes_s == Approx(0.6).margin(2e-3));
  CHECK(*b.valve[PV].opens_s == Approx(0.31).margin(2e-3));
  CHECK(b.ventricle[0].EDV_mL == Approx(120).margin(0.2));
  CHECK(b.ventricle[0].ESV_mL == Approx(50).margin(0.2));
  CHECK(b.ventricle[0].EF_percent == Approx(100 * 70.0 / 120).margin(0.3));
  CHECK(*b.atrium[0].VpreAC_mL == Approx(37).margin(0.1));
  CHECK(*b.E_mL_per_s[0] == Approx(200));
  CHECK(*b.A_mL_per_s[0] == Approx(50));
  CHECK(*b.E_over_A[0] == Approx(4));
  CHECK(*b.atrial_kick_percent[0] == Approx(100 * 0.15 * 50 / (0.3 * 200 + 0.2 * 50)).margin(0.5));
  REQUIRE(b.phases[0].size() == 5);
  const char* order[] = {"AC", "IVC", "VE", "IVR", "VPF"};
  for (int k = 0; k < 5; ++k) {
    CHECK(b.phases[0][k].name == order[k]);
    CHECK(b.phases[0][k].ends_s == Approx(b.phases[0][(k + 1) % 5].begins_s).margin(1e-12));
  }
  CHECK(b.cardiac_output_L_per_min == Approx(70 * 60 / 1000.0).epsilon(0.01));
}

TEST_CASE("stroke work is the area of the loop") {
  Table table = made_up_beat();
  double work = 0;
  const auto& p = table.at("p_LV").values;
  const auto& V = table.at("V_LV").values;
  for (std::size_t k = 1; k < p.size(); ++k) work -= 0.5 * (p[k] + p[k - 1]) * (V[k] - V[k - 1]);
  CHECK(compute_indexes(table, {0.05, 0.05}).ventricle[0].stroke_work_J ==
        Approx(work * units::J_per_mmHg_mL));
  CHECK(work > 0);
}

TEST_CASE("a flip is a change back and forth - smooth curves have none") {
  CHECK(largest_flip({0, 1, 2, 3}) == 0);
  CHECK(largest_flip({0, 5, 2, 4}) == 3);
  CHECK(largest_flip({1, 1, 1}) == 0);
  std::vector<double> sine;
  for (int k = 0; k < 1000; ++k) sine.push_back(100 * std::sin(0.01 * k));
  CHECK(largest_flip(sine) < 0.01);
}

TEST_CASE("body surface area") {
  CHECK(body_surface_area_du_bois(178, 75) == Approx(1.92).margin(0.02));
  CHECK(body_surface_area_mosteller(178, 75) == Approx(1.926).margin(0.01));
}

TEST_CASE("scenes are refused before any work, naming key, value, range and nearest name") {
  const std::string scenes = std::string(WIGGERS_TEST_DATA) + "/../../scenes/";
  const auto refused = [&](const std::string& change, auto matcher) {
    INFO(change);
    CHECK_THROWS_AS(read_scene(scenes + "whole_heart.toml", {change}), InputError);
    CHECK_THROWS_WITH(read_scene(scenes + "whole_heart.toml", {change}), matcher);
  };
  using Catch::Contains;
  refused("walls.LV.activation=100", Contains("did you mean 'activation_ms'"));
  refused("walls.LV.kind=elastanc", Contains("did you mean 'elastance'"));
  refused("walls.LV.wall_volume_mL=0", Contains("wall_volume_mL = 0") && Contains("walls.LV"));
  refused("walls.LW.kind=reduced", Contains("cavity"));
  refused("walls.LV.cells=ventricle", Contains("did you mean 'ventricles'"));
  refused("walls.LV.activation_ms=900", Contains("not within the period"));
  refused("cells.ventricles.ionic=ttp06", Contains("ttp06-endo"));
  refused("cells.ventricles.parameters=fedele2023", Contains("fedele2023-"));
  refused("cells.ventricles.stimulus_ms=abc", Contains("must be a number"));
  refused("cells.ventricles.ionic_changes.g_na=3", Contains("did you mean 'g_Na'"));
  refused("cells.ventricles.force_changes.gamma=-3", Contains("outside its range"));
  refused("cells.ventricles.force_changes.alphaKd=2", Contains("dissociation constant"));
  refused("circulation.circuit.SYS.C_AR=-1", Contains("C_AR = -1"));
  refused("heart.period_s=0.001", Contains("period_s"));
  refused("solver.dt_s=3e-4", Contains("does not divide the period"));
  refused("solver.scheme=monolithic", Contains("staggered"));
  refused("solver.stabilise.volume=true", Contains("did you mean 'volumes'"));
  refused("run.beats=0", Contains("beats"));
  CHECK_NOTHROW(read_scene(scenes + "whole_heart.toml", {"run.beats=3"}));
  CHECK_THROWS_WITH(read_scene(scenes + "whole_heart.toml", {"run.beats=3", "run.until=limit-cycle"}),
                    Contains("not both"));
  refused("titel=x", Contains("did you mean 'title'"));
  CHECK_THROWS_WITH(read_scene_text("title = \"no walls\"\n", "s.toml", {}), Contains("walls.LA is missing"));
}

TEST_CASE("the full scene reads back to itself") {
  const std::string scenes = std::string(WIGGERS_TEST_DATA) + "/../../scenes/";
  for (const char* name :
       {"whole_heart", "mixed", "elastance_healthy", "no_rate_feedback", "no_volume_stabilisation"}) {
    const Scene scene = read_scene(scenes + name + ".toml", {});
    CHECK(read_scene_text(scene.text(), name, {}).text() == scene.text());
  }
}
