#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <wiggers/core/errors.hpp>
#include <wiggers/tissue/mesh/make.hpp>
#include <wiggers/tissue/physics/equilibrium.hpp>
#include <wiggers/tissue/verification/self_check.hpp>

namespace wiggers {

namespace {

Point3 moved(const Point3& p) {
  return {0.04 * p[0] + 0.02 * p[1], -0.03 * p[1] + 0.01 * p[2], 0.02 * p[0] + 0.03 * p[2]};
}

}  // namespace

std::string check_tissue() {
  const auto mesh = std::make_shared<TetMesh>(make_sphere_octant(10, 24, 5));
  const Partition partition(mesh, MPI_COMM_SELF);
  MechanicsSettings settings;
  settings.materials = {{mesh_tags::ventricles, NeoHookean{}}};
  for (int tag : {24, 31, 41, 42, 43}) {
    Support held;
    held.tag = tag;
    held.fixed = {true, true, true};
    settings.supports.push_back(held);
  }
  Mechanics mechanics(partition, nullptr, settings);
  const NodeSpace& space = mechanics.nodes();
  std::vector<char> inside(mesh->points.size(), 1);
  for (const auto& facet : mesh->facets)
    for (int vertex : facet) inside[static_cast<std::size_t>(vertex)] = 0;
  // The boundary as it shall be, the inside where it was.
  int n_inside = 0;
  for (int node = 0; node < space.n_local; ++node) {
    const Point3 u = moved(space.points[static_cast<std::size_t>(node)]);
    const bool free = inside[static_cast<std::size_t>(space.vertex[static_cast<std::size_t>(node)])];
    n_inside += free;
    for (std::size_t k = 0; k < 3; ++k)
      mechanics.displacement()[3 * static_cast<std::size_t>(node) + k] = free ? 0 : u[k];
  }
  EquilibriumSettings at_once;
  at_once.first_step = 1;  // there is no load to ramp
  find_equilibrium(
      mechanics, [](double) { return std::vector<double>{}; }, at_once);
  double error_m = 0, size_m = 0;
  for (int node = 0; node < space.n_local; ++node) {
    const Point3 u = moved(space.points[static_cast<std::size_t>(node)]);
    for (std::size_t k = 0; k < 3; ++k) {
      error_m = std::max(error_m,
                         std::abs(mechanics.displacement()[3 * static_cast<std::size_t>(node) + k] - u[k]));
      size_m = std::max(size_m, std::abs(u[k]));
    }
  }
  const std::string found =
      fmt::format("affine patch test on {} tetrahedra, {} vertices inside: off by {:.0e}", mesh->cells.size(),
                  n_inside, error_m / size_m);
  if (n_inside == 0 || !(error_m < 1e-8 * size_m)) throw NumericalFailure(found);
  return found;
}

}  // namespace wiggers
