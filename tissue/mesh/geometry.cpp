#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numeric>
#include <wiggers/core/errors.hpp>
#include <wiggers/tissue/mesh/geometry.hpp>

namespace wiggers {

namespace {
const Point3& corner(const TetMesh& mesh, std::size_t cell, int k) {
  return mesh.points[static_cast<std::size_t>(mesh.cells[cell][static_cast<std::size_t>(k)])];
}
const Point3& facet_corner(const TetMesh& mesh, std::size_t facet, int k) {
  return mesh.points[static_cast<std::size_t>(mesh.facets[facet][static_cast<std::size_t>(k)])];
}
}  // namespace

double cell_volume(const TetMesh& mesh, std::size_t cell) {
  return tetrahedron_volume(corner(mesh, cell, 0), corner(mesh, cell, 1), corner(mesh, cell, 2),
                            corner(mesh, cell, 3));
}

Point3 cell_centre(const TetMesh& mesh, std::size_t cell) {
  return 0.25 *
         (corner(mesh, cell, 0) + corner(mesh, cell, 1) + corner(mesh, cell, 2) + corner(mesh, cell, 3));
}

Point3 facet_area_vector(const TetMesh& mesh, std::size_t facet) {
  return triangle_area_vector(facet_corner(mesh, facet, 0), facet_corner(mesh, facet, 1),
                              facet_corner(mesh, facet, 2));
}

Point3 facet_centre(const TetMesh& mesh, std::size_t facet) {
  return (1.0 / 3) *
         (facet_corner(mesh, facet, 0) + facet_corner(mesh, facet, 1) + facet_corner(mesh, facet, 2));
}

double tetrahedron_quality(const Point3& a, const Point3& b, const Point3& c, const Point3& d) {
  const double volume = tetrahedron_volume(a, b, c, d);
  const double surface = norm(triangle_area_vector(a, b, c)) + norm(triangle_area_vector(a, b, d)) +
                         norm(triangle_area_vector(a, c, d)) + norm(triangle_area_vector(b, c, d));
  // Products of opposite edges; a triangle with these sides has the area 6 V R, R the outer radius.
  const double p = norm(b - a) * norm(d - c), q = norm(c - a) * norm(d - b), r = norm(d - a) * norm(c - b);
  const double heron = std::max(0.0, (p + q + r) * (p + q - r) * (p - q + r) * (q + r - p));
  const double denominator = surface * std::sqrt(heron);
  if (!(denominator > 0)) return 0;
  return std::copysign(216 * volume * volume / denominator, volume);
}

double cell_quality(const TetMesh& mesh, std::size_t cell) {
  return tetrahedron_quality(corner(mesh, cell, 0), corner(mesh, cell, 1), corner(mesh, cell, 2),
                             corner(mesh, cell, 3));
}

double smallest_dihedral_angle_deg(const TetMesh& mesh, std::size_t cell) {
  std::array<Point3, 4> normal;
  for (int k = 0; k < 4; ++k)
    normal[static_cast<std::size_t>(k)] =
        triangle_area_vector(corner(mesh, cell, opposite_face[k][0]), corner(mesh, cell, opposite_face[k][1]),
                             corner(mesh, cell, opposite_face[k][2]));
  double largest_cosine = -1;
  for (std::size_t i = 0; i < 4; ++i)
    for (std::size_t k = i + 1; k < 4; ++k)
      largest_cosine =
          std::max(largest_cosine, -dot(normal[i], normal[k]) / (norm(normal[i]) * norm(normal[k])));
  return std::acos(std::clamp(largest_cosine, -1.0, 1.0)) * 180 / M_PI;
}

double enclosed_volume(const TetMesh& mesh, int surface_tag) {
  if (mesh.points.empty()) return 0;
  const Point3 origin = mesh.points.front();  // any does on a closed surface; a near one loses no digits
  double sum = 0;
  for (std::size_t f = 0; f < mesh.facets.size(); ++f)
    if (mesh.facet_tags[f] == surface_tag)
      sum += dot(facet_centre(mesh, f) - origin, facet_area_vector(mesh, f));
  return -sum / 3;
}

std::array<int, 3> ascending(std::array<int, 3> corners) {
  std::sort(corners.begin(), corners.end());
  return corners;
}

std::vector<CellFace> sorted_faces(const std::vector<std::array<int, 4>>& cells) {
  std::vector<CellFace> faces;
  faces.reserve(4 * cells.size());
  for (std::size_t c = 0; c < cells.size(); ++c)
    for (int k = 0; k < 4; ++k) {
      const auto at = [&](int i) { return cells[c][static_cast<std::size_t>(opposite_face[k][i])]; };
      faces.push_back({ascending({at(0), at(1), at(2)}), static_cast<int>(c), k});
    }
  std::sort(faces.begin(), faces.end(), [](const CellFace& a, const CellFace& b) {
    return a.corners != b.corners ? a.corners < b.corners : a.cell < b.cell;
  });
  return faces;
}

std::vector<OuterTriangle> outer_triangles(const std::vector<std::array<int, 4>>& cells) {
  std::vector<OuterTriangle> triangles;
  const auto faces = sorted_faces(cells);
  for (std::size_t i = 0; i < faces.size(); ++i) {
    if ((i > 0 && faces[i].corners == faces[i - 1].corners) ||
        (i + 1 < faces.size() && faces[i].corners == faces[i + 1].corners))
      continue;
    const auto& cell = cells[static_cast<std::size_t>(faces[i].cell)];
    const auto at = [&](int k) {
      return cell[static_cast<std::size_t>(opposite_face[faces[i].opposite][k])];
    };
    triangles.push_back({{at(0), at(1), at(2)}, faces[i].cell});
  }
  return triangles;
}

std::vector<int> connected_pieces(const std::vector<std::array<int, 3>>& triangles) {
  std::vector<std::array<int, 3>> edges;  // lower end, upper end, triangle
  for (std::size_t t = 0; t < triangles.size(); ++t)
    for (std::size_t k = 0; k < 3; ++k) {
      const auto [a, b] = std::minmax(triangles[t][k], triangles[t][(k + 1) % 3]);
      edges.push_back({a, b, static_cast<int>(t)});
    }
  std::sort(edges.begin(), edges.end());
  std::vector<int> root(triangles.size());
  std::iota(root.begin(), root.end(), 0);
  const auto find = [&](int t) {
    while (root[static_cast<std::size_t>(t)] != t)
      t = root[static_cast<std::size_t>(t)] =
          root[static_cast<std::size_t>(root[static_cast<std::size_t>(t)])];
    return t;
  };
  for (std::size_t e = 1; e < edges.size(); ++e)
    if (edges[e][0] == edges[e - 1][0] && edges[e][1] == edges[e - 1][1]) {
      const int here = find(edges[e][2]), there = find(edges[e - 1][2]);
      root[static_cast<std::size_t>(std::max(here, there))] = std::min(here, there);
    }
  std::vector<int> number(triangles.size(), -1), piece(triangles.size());
  int count = 0;
  for (std::size_t t = 0; t < triangles.size(); ++t) {
    int& n = number[static_cast<std::size_t>(find(static_cast<int>(t)))];
    if (n < 0) n = count++;
    piece[t] = n;
  }
  return piece;
}

std::string place_text(const Point3& point_m) {
  return fmt::format("({}, {}, {}) mm", figure_text(1e3 * point_m[0], 2), figure_text(1e3 * point_m[1], 2),
                     figure_text(1e3 * point_m[2], 2));
}

}  // namespace wiggers
