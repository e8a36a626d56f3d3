// Published problems on meshes small enough for every day; the long ones are of the nightly set. Numbers and
// their sources: tissue_benchmarks.md.
#include <catch2/catch.hpp>
#include <cmath>
#include <wiggers/tissue/verification/benchmarks.hpp>

using namespace wiggers::benchmarks;

namespace {

// Probes in the order in which the front must reach them: along the fibres first.
void check_order(const SlabResult& r) {
  for (double t : r.activation_ms) {
    CHECK(t > 0);
    CHECK(t < 130);
  }
  const auto& [p1, p2, p3, p4, p5, p6, p7, p8, p9] = r.activation_ms;
  CHECK(p1 < 2);
  CHECK(p1 < p3);
  CHECK(p3 < p9);
  CHECK(p9 < p2);
  CHECK(p2 < p6);
  CHECK(p5 < p6);
  CHECK(p4 < p8);
  CHECK(p7 < p8);
}

}  // namespace

TEST_CASE("slab: a coarse quadratic mesh activates all probes in order") {
  SlabSettings settings;
  settings.dx_mm = 1;
  settings.end_ms = 130;
  check_order(slab(settings, MPI_COMM_SELF));
}

TEST_CASE("slab: the far corner at half a millimetre", "[.nightly]") {
  SlabSettings settings;
  const SlabResult half = slab(settings, MPI_COMM_SELF);
  check_order(half);
  CHECK(half.activation_ms[7] == Approx(42.8).epsilon(0.1));
  settings.table_spacing_mV = 0;
  const SlabResult without = slab(settings, MPI_COMM_SELF);
  for (int k = 0; k < SlabResult::n_probes; ++k)
    CHECK(without.activation_ms[k] == Approx(half.activation_ms[k]).epsilon(2e-3));
}

TEST_CASE("slab: every probe at a quarter of a millimetre", "[.nightly]") {
  // Mean and standard deviation of eleven codes at 0.1 mm.
  constexpr double published_ms[9][2] = {{1.04, 0.38},  {32.23, 0.56}, {8.95, 0.56},
                                         {33.70, 1.00}, {29.76, 1.65}, {43.97, 2.83},
                                         {31.32, 2.12}, {44.93, 3.22}, {20.50, 1.30}};
  SlabSettings settings;
  settings.dx_mm = 0.25;
  const SlabResult r = slab(settings, MPI_COMM_SELF);
  for (int k = 0; k < SlabResult::n_probes; ++k) {
    INFO("P" << k + 1);
    CHECK(std::abs(r.activation_ms[k] - published_ms[k][0]) <= 2 * published_ms[k][1]);
  }
}

TEST_CASE("beam: quadratic tetrahedra give the values of an independent code") {
  BeamSettings settings;
  settings.quadrature_degree = 5;
  const BeamResult stiff = beam(settings, MPI_COMM_SELF);
  CHECK(stiff.n_tetrahedra == 480);
  CHECK(stiff.tip_mm[2] == Approx(4.0428).epsilon(5e-3));
  settings.bulk_kPa = 50;
  const BeamResult soft = beam(settings, MPI_COMM_SELF);
  CHECK(soft.tip_mm[2] == Approx(4.1361).epsilon(5e-3));   // the same mesh
  CHECK(soft.tip_mm[2] == Approx(4.194).epsilon(1.4e-2));  // converged
  for (const BeamResult& r : {stiff, soft}) {
    // The tetrahedra have no plane of symmetry y = 0.5; the beam has.
    CHECK(r.tip_mm[1] == Approx(0.5).margin(0.02));
    CHECK(r.tip_mm[0] == Approx(9.1765).margin(0.1));
    CHECK(r.centre_mm[2] == Approx(3.716).epsilon(0.04));
    CHECK(r.report.smallest_J > 0.9);
  }
}

TEST_CASE("beam: linear tetrahedra lock and mean dilatation frees quadratic ones") {
  BeamSettings settings;
  settings.bulk_kPa = 50;
  settings.order = 1;
  const double linear = beam(settings, MPI_COMM_SELF).tip_mm[2];
  CHECK(linear < 3.1);
  settings.order = 2;
  settings.bulk_kPa = 1e3;
  settings.quadrature_degree = 5;
  const double plain = beam(settings, MPI_COMM_SELF).tip_mm[2];
  settings.mean_dilatation = true;
  const double mean = beam(settings, MPI_COMM_SELF).tip_mm[2];
  CHECK(plain < mean);
  CHECK(std::abs(mean / 4.171 - 1) < std::abs(plain / 4.171 - 1));
  CHECK(mean == Approx(4.171).epsilon(2e-2));
}

TEST_CASE("beam: a mesh graded to the clamp", "[.nightly]") {
  BeamSettings settings;
  settings.bricks = {20, 2, 4};
  settings.grading = 4;
  settings.mean_dilatation = true;
  CHECK(beam(settings, MPI_COMM_SELF).tip_mm[2] == Approx(4.1695).epsilon(5e-3));
}

TEST_CASE("beam: four bricks across the thickness", "[.nightly]") {
  BeamSettings settings;
  settings.bricks = {40, 4, 4};
  settings.quadrature_degree = 5;
  settings.bulk_kPa = 50;
  const double soft = beam(settings, MPI_COMM_SELF).tip_mm[2];
  CHECK(soft == Approx(4.1749).epsilon(2e-3));
  CHECK(soft == Approx(4.194).epsilon(1.5e-2));
  settings.bulk_kPa = 1e3;
  const double stiff = beam(settings, MPI_COMM_SELF).tip_mm[2];
  CHECK(stiff == Approx(4.1294).epsilon(2e-3));
  CHECK(stiff == Approx(4.171).epsilon(1.5e-2));
}

namespace {

void check_ellipsoid(const EllipsoidResult& r) {
  CHECK(r.monotone);
  CHECK(r.wall_ratio == Approx(1).margin(5e-3));
  CHECK(r.report.smallest_J > 0);
}

// Far enough from each other to judge the trend, and the figures of the limit within `share`.
void check_ellipsoids(double coarse_mm, double fine_mm) {
  // Edges follow the surface; the mesh is twice as fine at the apices.
  EllipsoidSettings settings;
  settings.size_mm = coarse_mm;
  settings.apex_size_mm = 0.5 * coarse_mm;
  const EllipsoidResult coarse = ellipsoid(settings, MPI_COMM_SELF);
  settings.size_mm = fine_mm;
  settings.apex_size_mm = 0.5 * fine_mm;
  const EllipsoidResult fine = ellipsoid(settings, MPI_COMM_SELF);
  check_ellipsoid(coarse);
  check_ellipsoid(fine);
  CHECK(fine.endo_z_mm == Approx(-26.612).epsilon(5e-3));
  CHECK(fine.epi_z_mm == Approx(-28.280).epsilon(5e-3));
  CHECK(fine.endo_z_mm == Approx(coarse.endo_z_mm).epsilon(5e-3));
  CHECK(fine.epi_z_mm == Approx(coarse.epi_z_mm).epsilon(5e-3));
  CHECK(fine.cavity_before_mm3 == Approx(2492.13).epsilon(2e-3));
  CHECK(fine.cavity_mm3 == Approx(10734.3).epsilon(2e-3));
}

}  // namespace

TEST_CASE("ellipsoid: coarse meshes come near the published apices") { check_ellipsoids(3, 2.5); }

TEST_CASE("ellipsoid: successive meshes agree", "[.nightly]") { check_ellipsoids(2, 1.6); }

TEST_CASE("sphere: the three-dimensional law follows the reduced wall") {
  SphereSettings settings;
  settings.size_mm = 8;
  const SphereResult r = sphere(settings, MPI_COMM_SELF);
  settings.curved = false;
  const SphereResult straight = sphere(settings, MPI_COMM_SELF);
  constexpr double at_50_kPa[] = {114.0317, 142.5032, 174.9138}, wall_ratio[] = {1.00633, 1.01101, 1.01743};
  for (int k = 0; k < 3; ++k) {
    CHECK(r.volume_mL[k] == Approx(at_50_kPa[k]).epsilon(2e-3));
    // Straight edges cut the cavity short.
    CHECK(straight.volume_mL[k] < 0.98 * at_50_kPa[k]);
    CHECK(r.wall_ratio[k] - 1 == Approx(wall_ratio[k] - 1).epsilon(2e-2));
    CHECK(r.radius_spread[k] < 2e-3);
  }
}

TEST_CASE("sphere: nearly incompressible", "[.nightly]") {
  SphereSettings settings;
  settings.bulk_kPa = 1e3;
  const SphereResult r = sphere(settings, MPI_COMM_SELF);
  constexpr double at_1000_kPa[] = {113.5774, 141.9576, 174.3031},
                   incompressible[] = {113.5527, 141.9279, 174.2699};
  for (int k = 0; k < 3; ++k) {
    CHECK(r.volume_mL[k] == Approx(at_1000_kPa[k]).epsilon(2e-3));
    CHECK(r.volume_mL[k] == Approx(incompressible[k]).epsilon(2e-3));
  }
}

TEST_CASE("sphere: fine tetrahedra", "[.nightly]") {
  SphereSettings settings;
  settings.size_mm = 3;
  settings.mean_dilatation = true;
  const SphereResult r = sphere(settings, MPI_COMM_SELF);
  constexpr double at_50_kPa[] = {114.0317, 142.5032, 174.9138};
  for (int k = 0; k < 3; ++k) {
    CHECK(r.volume_mL[k] == Approx(at_50_kPa[k]).epsilon(1e-3));
    CHECK(r.radius_spread[k] < 1e-3);
  }
}
