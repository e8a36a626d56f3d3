// Linear and quadratic tetrahedra and triangles on the reference cell: shape functions, quadrature, and the
// reference matrices of mass and stiffness. Edge nodes follow the vertices: 01 12 20 03 13 23; on triangles
// 01 12 20.
#pragma once

#include <array>
#include <vector>

namespace wiggers {

inline constexpr int tetrahedron_edges[6][2] = {{0, 1}, {1, 2}, {2, 0}, {0, 3}, {1, 3}, {2, 3}};
inline constexpr int triangle_edges[3][2] = {{0, 1}, {1, 2}, {2, 0}};

// A point by barycentric coordinates, and its weight as a share of the volume (or area).
template <int corners>
struct QuadraturePoint {
  std::array<double, corners> at;
  double weight;
};

// Values and derivatives by the barycentric coordinates of all shape functions at a point.
template <int corners>
struct ShapeValues {
  static constexpr int n_edges = corners == 4 ? 6 : 3;
  static constexpr int most = corners + n_edges;
  std::array<double, most> value{};
  std::array<std::array<double, corners>, most> slope{};
};

template <int corners>
ShapeValues<corners> shape_values(int order, const std::array<double, corners>& at) {
  ShapeValues<corners> shape;
  for (int a = 0; a < corners; ++a) {
    shape.value[a] = order == 1 ? at[a] : at[a] * (2 * at[a] - 1);
    shape.slope[a][a] = order == 1 ? 1 : 4 * at[a] - 1;
  }
  if (order == 2)
    for (int e = 0; e < ShapeValues<corners>::n_edges; ++e) {
      const auto& ends = corners == 4 ? tetrahedron_edges[e] : triangle_edges[e % 3];
      const int i = ends[0], j = ends[1];
      shape.value[corners + e] = 4 * at[i] * at[j];
      shape.slope[corners + e][i] = 4 * at[j];
      shape.slope[corners + e][j] = 4 * at[i];
    }
  return shape;
}

// Exact for polynomials of the degree: tetrahedra 1, 2, 3, 5; triangles 1, 2, 4, 5.
const std::vector<QuadraturePoint<4>>& tetrahedron_quadrature(int degree);
const std::vector<QuadraturePoint<3>>& triangle_quadrature(int degree);

}  // namespace wiggers
