// Published verification problems, each as one function from its discretisation to its figures.
//
//   slab       monodomain, Niederer et al. 2011 (eleven codes)
//   beam       Land et al. 2015, problem 1
//   ellipsoid  Land et al. 2015, problem 2
//   sphere     thick sphere: the reduced wall's formula against the three-dimensional law
#pragma once

#include <mpi.h>

#include <array>
#include <string>
#include <vector>
#include <wiggers/tissue/physics/equilibrium.hpp>
#include <wiggers/tissue/physics/monodomain.hpp>

namespace wiggers::benchmarks {

struct SlabSettings {
  double dx_mm = 0.5, dt_ms = 0.05, end_ms = 60;
  int order = 2;
  bool svi = false;
  double table_spacing_mV = 0.1;
  SolverKind solver = SolverKind::cg_ilu;
};
struct SlabResult {
  static constexpr int n_probes = 9;
  std::array<double, n_probes> activation_ms{};  // P1 .. P9; -1: not activated
  std::size_t n_tetrahedra = 0;
  int n_nodes = 0;
  MonodomainCost cost;
};
// Positions of the probes P1 .. P9, mm.
extern const std::array<Point3, SlabResult::n_probes> slab_probes_mm;
SlabResult slab(const SlabSettings& settings, MPI_Comm communicator);

struct BeamSettings {
  std::array<int, 3> bricks = {20, 2, 2};
  double grading = 1;  // towards the clamp: spacing at the free end over that at the clamp
  int order = 2;
  bool mean_dilatation = false;
  double bulk_kPa = 1e3;
  int quadrature_degree = 0;
};
struct BeamResult {
  Point3 tip_mm{}, centre_mm{};  // deformed (10, 0.5, 1) and (10, 0.5, 0.5)
  std::size_t n_tetrahedra = 0;
  EquilibriumReport report;
  double seconds = 0;
};
BeamResult beam(const BeamSettings& settings, MPI_Comm communicator);

struct EllipsoidSettings {
  double size_mm = 2.5, apex_size_mm = 2.5;
  int order = 2;
  bool mean_dilatation = false;
  double bulk_kPa = 1e3;
  int quadrature_degree = 0;
  bool quarter = true;
  bool curved = true;  // edges of quadratic tetrahedra follow the surface
};
struct EllipsoidResult {
  double endo_z_mm = 0, epi_z_mm = 0;
  double cavity_mm3 = 0, cavity_before_mm3 = 0, wall_ratio = 0;
  bool monotone = true;  // cavity volume in pressure
  std::size_t n_tetrahedra = 0;
  EquilibriumReport report;
  double seconds = 0;
};
EllipsoidResult ellipsoid(const EllipsoidSettings& settings, MPI_Comm communicator);

struct SphereSettings {
  double size_mm = 4;
  int order = 2;
  bool mean_dilatation = false;
  double bulk_kPa = 50;
  int quadrature_degree = 0;
  bool curved = true;
  bool project_coefficients = false;  // 8, 6, 3, 12, 3, 3 with the helix +60 to -60 degrees
};
struct SphereResult {
  std::array<double, 3> pressure_kPa = {0.5, 1.0, 2.0};
  std::array<double, 3> volume_mL{}, radius_spread{}, wall_ratio{};
  std::size_t n_tetrahedra = 0;
  double seconds = 0;
};
SphereResult sphere(const SphereSettings& settings, MPI_Comm communicator);

}  // namespace wiggers::benchmarks
