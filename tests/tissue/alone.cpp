// Bodies of tissue as scenes have them: the unloaded shape, arteries under pressure, what is refused, and the
// two physics run alone.
#include <catch2/catch.hpp>
#include <cmath>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/result_file.hpp>
#include <wiggers/core/units.hpp>
#include <wiggers/tissue/body/body.hpp>
#include <wiggers/tissue/body/body_run.hpp>
#include <wiggers/tissue/body/register.hpp>
#include <wiggers/tissue/physics/equilibrium.hpp>

#include "bodies.hpp"

using namespace wiggers;
using namespace wiggers::bodies;
using Catch::Contains;

namespace {

const char* const passive = R"(
[body]
physics = "mechanics"
shape = "ellipsoid"
size_mm = 10
fields = false
[body.load.LV]
pressure_mmHg = 15
[body.materials.ventricles]
bulk_Pa = 2e5
[body.supports.base]
full_stiffness_Pa_per_m = 1e5
[run]
load_steps = 3
)";

Scene scene(const std::string& text, const std::vector<std::string>& overrides = {}) {
  register_tissue();
  return read_scene_text(text, "scene.toml", overrides);
}

const TissuePlan& plan_of(const Scene& s) { return tissue_plan(s.walls.front()); }

nlohmann::json run(const Scene& s, const BodyRequest& request = {{}, {}, true}) {
  const BodyOutcome outcome = s.physics == Physics::mechanics
                                  ? run_body_mechanics(s, request, MPI_COMM_WORLD)
                                  : run_body_electrophysiology(s, request, MPI_COMM_WORLD);
  return nlohmann::json::parse(outcome.json);
}

}  // namespace

TEST_CASE("recovery: the unloaded shape under the image's load is the image", "[ranks]") {
  const Scene s = scene(passive);
  const TissuePlan& plan = plan_of(s);
  const auto image = make_mesh(plan, {LV}, "body", MPI_COMM_WORLD);
  RecoveryReport report;
  const auto unloaded =
      unloaded_shape(plan, {LV}, image, "body", Progress::Style::quiet, MPI_COMM_WORLD, report);
  CHECK(report.residual_m <= 1e-6);
  // The plain fixed point, or a mixing that does not help, takes more.
  CHECK(report.fixed_point_iterations <= 25);
  CHECK(report.smallest_volume_ratio > 0.5);
  CHECK(report.smallest_volume_ratio < 1.0);
  CHECK(report.smallest_dihedral_deg > 5);
  // Loaded from rest by other means than those of the recovery.
  const FibreField fibres = make_fibres(plan, *unloaded);
  const Partition partition(unloaded, MPI_COMM_WORLD);
  Mechanics mechanics(partition, &fibres, mechanics_of(plan, {LV}, *image));
  const double pressure = plan.image_pressure_mmHg[LV] * units::Pa_per_mmHg;
  CHECK(pressure == Approx(1150).epsilon(5e-3));
  find_equilibrium(
      mechanics, [&](double share) { return std::vector<double>{share * pressure}; },
      static_settings(mechanics.nodes()));
  const auto d = partition.gather_at_vertices(mechanics.nodes(), mechanics.displacement().data(), 3, 0);
  double off = 0, moved = 0;
  for (std::size_t k = 0; k < d.size(); ++k) {
    off = std::max(off, std::abs(unloaded->points[k / 3][k % 3] + d[k] - image->points[k / 3][k % 3]));
    moved = std::max(moved, std::abs(d[k]));
  }
  CHECK(off < 3e-6);
  CHECK(moved > 1e-3);
}

TEST_CASE("recovery: a load that the tissue cannot have carried is said") {
  const Scene s = scene(passive, {"body.reference.image_pressure_LV_mmHg=95", "body.size_mm=16",
                                  "body.materials.ventricles.C_Pa=300"});
  const auto image = make_mesh(plan_of(s), {LV}, "body", MPI_COMM_SELF);
  RecoveryReport report;
  CHECK_THROWS_WITH(
      unloaded_shape(plan_of(s), {LV}, image, "body", Progress::Style::quiet, MPI_COMM_SELF, report),
      Contains("recovery of the reference configuration") && Contains("% of the image's load") &&
          Contains("image_pressure_"));
}

TEST_CASE("a body alone: passive filling is monotone and as the pressure says", "[ranks]") {
  const Scene s = scene(passive, {"body.reference.recover=false"});
  const auto by_pressure = run(s);
  const auto& cavity = by_pressure["cavities"]["LV"];
  CHECK(cavity["pressure_mmHg"].get<double>() == Approx(15));
  const double volume = cavity["volume_mL"];
  CHECK(volume > 1.1 * cavity["unloaded_volume_mL"].get<double>());
  // The volume that came out leads back to the pressure that went in.
  std::string text = passive;
  text.replace(text.find("pressure_mmHg = 15"), 18, "volume_mL = " + std::to_string(volume));
  const auto by_volume = run(scene(text, {"body.reference.recover=false"}));
  CHECK(by_volume["cavities"]["LV"]["pressure_mmHg"].get<double>() == Approx(15).epsilon(1e-4));
  // Tension at a prescribed volume raises the pressure.
  const auto active = run(scene(text, {"body.reference.recover=false", "body.load.active_tension_kPa=10"}));
  CHECK(active["cavities"]["LV"]["pressure_mmHg"].get<double>() > 20);
}

namespace {

const std::vector<std::string> contraction = {
    "body.reference.recover=false", "body.load.active_tension_kPa=80", "body.load.LV.pressure_mmHg=90"};

Scene contracting(std::vector<std::string> more) {
  more.insert(more.begin(), contraction.begin(), contraction.end());
  return scene(passive, more);
}

}  // namespace

TEST_CASE("a body alone: one element across the wall contracts as two do") {
  const auto coarse = run(contracting({"body.size_mm=10"})), fine = run(contracting({"body.size_mm=5"}));
  const double volume = coarse["cavities"]["LV"]["volume_mL"];
  CHECK(volume < 0.6 * coarse["cavities"]["LV"]["unloaded_volume_mL"].get<double>());
  CHECK(volume == Approx(fine["cavities"]["LV"]["volume_mL"].get<double>()).epsilon(0.06));
}

TEST_CASE("a body alone: tissue squeezed beyond what it can be is no result", "[ranks]") {
  CHECK_THROWS_WITH(run(contracting({"body.materials.ventricles.bulk_Pa=2e4"})),
                    Contains("unphysical") && Contains("squeezed to J = 0.") && Contains("in tetrahedron") &&
                        Contains("bulk_Pa") && Contains("% of the load"));
}

TEST_CASE("a body alone: electrophysiology without any mechanics") {
  const char* const text = R"(
[cells.ventricles]
ionic = "ttp06-endo"
start = "published"
[body]
physics = "electrophysiology"
cells = "ventricles"
shape = "ellipsoid"
size_mm = 12
fields_every_ms = 0
[body.electrophysiology]
order = 1
tau_ms = 0.1
[body.electrophysiology.conductivity]
fibre_mm2_per_ms = 2
sheet_mm2_per_ms = 2
normal_mm2_per_ms = 2
[body.stimuli.apex]
z_mm = -66
radius_mm = 15
start_ms = 0
[body.electrodes.foot]
z_mm = -300
[run]
end_ms = 90
checkpoint_every_ms = 30
)";
  const auto folder = std::filesystem::temp_directory_path() / "wiggers_test_alone";
  std::filesystem::create_directories(folder);
  const auto file = folder / "activation.h5";
  const auto summary = run(scene(text), {file, {}, true});
  CHECK(summary["activation"]["share"].get<double>() == Approx(1));
  CHECK(summary["activation"]["last_ms"].get<double>() > summary["activation"]["first_ms"].get<double>() + 5);
  const ResultReader result(file);
  CHECK(result.dataset("/time").size() == 91);
  CHECK(result.text("/provenance/status") == "complete");
  CHECK(result.has("/body/lead_1"));
  CHECK_FALSE(result.has("/cavities"));
  // Faster tissue is activated earlier.
  const auto faster = run(scene(text, {"body.electrophysiology.conductivity.normal_mm2_per_ms=4",
                                       "body.electrophysiology.conductivity.fibre_mm2_per_ms=4",
                                       "body.electrophysiology.conductivity.sheet_mm2_per_ms=4"}));
  CHECK(faster["activation"]["last_ms"].get<double>() < summary["activation"]["last_ms"].get<double>());
  // From a file that was written on the way, the same rows again.
  run(scene(text, {"run.end_ms=30"}), {folder / "half.h5", {}, true});
  run(scene(text), {folder / "half.h5", folder / "half.h5", true});
  const ResultReader resumed(folder / "half.h5");
  CHECK((resumed.dataset("/body/membrane_potential") == result.dataset("/body/membrane_potential")));
  CHECK((resumed.dataset("/body/activation") == result.dataset("/body/activation")));
  std::filesystem::remove_all(folder);
}

TEST_CASE("arteries of the heart's shape carry their pressure") {
  const char* const text = R"(
[body]
physics = "mechanics"
shape = "heart"
size_mm = 10
fields = false
[body.load.AO]
pressure_mmHg = 75
[body.reference]
recover = false
)";
  const Scene s = scene(text);
  const TissuePlan& plan = plan_of(s);
  const std::vector<int> chambers = s.walls.front().cavities;
  CHECK(chambers == std::vector<int>{LA, LV, RA, RV});
  const auto mesh = make_mesh(plan, chambers, "body", MPI_COMM_SELF);
  CHECK(arteries_of(*mesh) == std::vector<int>{0, 1});
  CHECK(plan.artery_image_pressure_mmHg[0] * units::Pa_per_mmHg == Approx(9500).epsilon(5e-3));
  CHECK(plan.artery_image_pressure_mmHg[1] * units::Pa_per_mmHg == Approx(1700).epsilon(5e-3));
  const FibreField fibres = make_fibres(plan, *mesh);
  // Every muscle has a frame, the atria and the outflow tracts, too.
  for (std::size_t c = 0; c < mesh->cells.size(); ++c)
    if (mesh_tags::conductive(mesh->cell_tags[c]))
      for (int vertex : mesh->cells[c]) {
        const auto& [f, sheet, n] = fibres.frames[vertex];
        REQUIRE(norm(f) == Approx(1).margin(1e-9));
        REQUIRE(norm(cross(f, sheet) - n) < 1e-9);
        REQUIRE(std::abs(dot(f, sheet)) < 1e-9);
      }
  const Partition partition(mesh, MPI_COMM_SELF);
  Mechanics mechanics(partition, &fibres, mechanics_of(plan, chambers, *mesh));
  REQUIRE(mechanics.settings().surfaces.size() == 6);
  std::vector<double> loads(6, 0.0);
  loads[4] = 75 * units::Pa_per_mmHg;
  find_equilibrium(
      mechanics,
      [&](double share) {
        std::vector<double> p = loads;
        for (double& value : p) value *= share;
        return p;
      },
      static_settings(mechanics.nodes()));
  // Work of the pressure: along the displacement the loaded surface moves outwards.
  mechanics.assemble(loads, false);
  double work = 0;
  for (std::size_t k = 0; k < mechanics.load(4).size(); ++k)
    work -= mechanics.load(4)[k] * mechanics.displacement()[k];
  CHECK(work > 1e-7);
}

TEST_CASE("a body alone: bad input is refused before any work") {
  const auto refused = [](const std::string& text, const std::vector<std::string>& overrides = {}) {
    try {
      scene(text, overrides);
    } catch (const InputError& error) {
      return std::string(error.what());
    }
    return std::string("accepted");
  };
  CHECK_THAT(refused("[body]\nshape = \"ellipsoid\"\n"), Contains("body.physics") && Contains("mechanics"));
  CHECK_THAT(refused("[body]\nphysics = \"mechanic\"\n"), Contains("did you mean 'mechanics'"));
  CHECK_THAT(refused(std::string(passive) + "[walls.LV]\nkind = \"elastance\"\n"),
             Contains("walls") && Contains("not both"));
  CHECK_THAT(refused(passive, {"body.load.VL.pressure_mmHg=3"}),
             Contains("unknown load 'VL'") && Contains("LV"));
  CHECK_THAT(refused(passive, {"body.load.RV.pressure_mmHg=3"}), Contains("no such cavity"));
  CHECK_THAT(refused(passive, {"body.load.PT.pressure_mmHg=3"}), Contains("no such artery"));
  CHECK_THAT(refused("[body]\nphysics = \"mechanics\"\n"), Contains("nothing is loaded"));
  CHECK_THAT(refused(passive, {"body.load.LV.volume_mL=100"}), Contains("not both"));
  CHECK_THAT(refused(passive, {"body.stimuli.apex.z_mm=-66"}), Contains("stimuli"));
  CHECK_THAT(refused(passive, {"body.load.LV.pressure_mmHg=5000"}), Contains("5000"));
  const Scene s = scene(passive, {"body.materials.aorta.mu_Pa=1e5", "body.reference.recover=false"});
  CHECK_THROWS_WITH(run(s), Contains("aorta") && Contains("volume tag 7"));
}
