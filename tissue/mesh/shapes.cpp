#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <wiggers/core/errors.hpp>
#include <wiggers/tissue/mesh/geometry.hpp>
#include <wiggers/tissue/mesh/shapes.hpp>

namespace wiggers {

namespace {

void check_coordinates(const std::vector<double>& coordinates, char axis) {
  if (coordinates.size() < 2)
    throw InputError(
        fmt::format("box mesh: {} coordinates along {}; at least 2 needed", coordinates.size(), axis));
  for (std::size_t i = 1; i < coordinates.size(); ++i)
    if (!(coordinates[i] > coordinates[i - 1]))
      throw InputError(fmt::format("box mesh: coordinates along {} must ascend, but {} m follows {} m", axis,
                                   coordinates[i], coordinates[i - 1]));
}

void check_intervals(double length, int n) {
  if (!(length > 0) || !std::isfinite(length))
    throw InputError(fmt::format("box mesh: length {}; must be positive", length));
  if (n < 1) throw InputError(fmt::format("box mesh: {} elements along an edge; at least 1 needed", n));
}

}  // namespace

TetMesh box_mesh(const std::array<std::vector<double>, 3>& coordinates_m) {
  const auto& [x, y, z] = coordinates_m;
  check_coordinates(x, 'x');
  check_coordinates(y, 'y');
  check_coordinates(z, 'z');
  TetMesh mesh;
  for (const double c : z)
    for (const double b : y)
      for (const double a : x) mesh.points.push_back({a, b, c});
  const auto point = [nx = x.size(), ny = y.size()](std::size_t i, std::size_t j, std::size_t k) {
    return static_cast<int>((k * ny + j) * nx + i);
  };
  // One tetrahedron for each order in which the three axes are walked from corner to corner.
  constexpr int walks[6][3] = {{0, 1, 2}, {1, 2, 0}, {2, 0, 1}, {0, 2, 1}, {2, 1, 0}, {1, 0, 2}};
  for (std::size_t k = 0; k + 1 < z.size(); ++k)
    for (std::size_t j = 0; j + 1 < y.size(); ++j)
      for (std::size_t i = 0; i + 1 < x.size(); ++i)
        for (int w = 0; w < 6; ++w) {
          std::array<std::size_t, 3> at = {i, j, k};
          std::array<int, 4> cell{};
          cell[0] = point(at[0], at[1], at[2]);
          for (std::size_t s = 0; s < 3; ++s) {
            ++at[static_cast<std::size_t>(walks[w][s])];
            cell[s + 1] = point(at[0], at[1], at[2]);
          }
          if (w >= 3) std::swap(cell[1], cell[2]);  // the odd orders are left-handed
          mesh.cells.push_back(cell);
        }
  mesh.cell_tags.assign(mesh.cells.size(), 1);
  for (const OuterTriangle& outer : outer_triangles(mesh.cells)) mesh.facets.push_back(outer.corners);
  for (const auto& facet : mesh.facets) {
    int tag = 0;
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const auto all_at = [&](double value) {
        return std::all_of(facet.begin(), facet.end(),
                           [&](int p) { return mesh.points[static_cast<std::size_t>(p)][axis] == value; });
      };
      if (all_at(coordinates_m[axis].front())) tag = 2 * static_cast<int>(axis) + 1;
      if (all_at(coordinates_m[axis].back())) tag = 2 * static_cast<int>(axis) + 2;
    }
    mesh.facet_tags.push_back(tag);
  }
  return mesh;
}

std::vector<double> uniform(double length, int n) { return graded(length, n, 1, 1); }

std::vector<double> graded(double length, int n, double ratio_at_start, double ratio_at_end) {
  check_intervals(length, n);
  if (!(ratio_at_start > 0) || !(ratio_at_end > 0))
    throw InputError(
        fmt::format("box mesh: grading ratios {} and {}; must be positive", ratio_at_start, ratio_at_end));
  // The logarithm of the spacing is linear from each end to the middle.
  std::vector<double> at(static_cast<std::size_t>(n) + 1, 0.0);
  for (int i = 0; i < n; ++i) {
    const double s = n == 1 ? 0.0 : 2.0 * i / (n - 1) - 1;  // -1 at the first element, +1 at the last
    const double ratio = s < 0 ? ratio_at_start : ratio_at_end;
    at[static_cast<std::size_t>(i) + 1] = at[static_cast<std::size_t>(i)] + std::pow(ratio, -std::abs(s));
  }
  const double scale = length / at.back();
  for (double& a : at) a *= scale;
  at.back() = length;
  return at;
}

}  // namespace wiggers
