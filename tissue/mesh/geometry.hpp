// Volumes, normals, shapes and neighbours of the elements of a tetrahedral mesh.
#pragma once

#include <cstddef>
#include <string>
#include <vector>
#include <wiggers/tissue/laws/tensor.hpp>
#include <wiggers/tissue/mesh/mesh.hpp>

namespace wiggers {

// Signed volume of the tetrahedron a b c d, in the cube of the unit of the points.
inline double tetrahedron_volume(const Point3& a, const Point3& b, const Point3& c, const Point3& d) {
  return dot(cross(b - a, c - a), d - a) / 6;
}

// Area times normal of the triangle a b c, right-handed.
inline Point3 triangle_area_vector(const Point3& a, const Point3& b, const Point3& c) {
  return 0.5 * cross(b - a, c - a);
}

double cell_volume(const TetMesh& mesh, std::size_t cell);
Point3 cell_centre(const TetMesh& mesh, std::size_t cell);
Point3 facet_area_vector(const TetMesh& mesh, std::size_t facet);
Point3 facet_centre(const TetMesh& mesh, std::size_t facet);

// Three times the radius of the inscribed sphere over the radius of the circumscribed one: gmsh's "gamma".
// 1 for the regular tetrahedron, 0 for a flat one, negative for an inverted one.
double tetrahedron_quality(const Point3& a, const Point3& b, const Point3& c, const Point3& d);
double cell_quality(const TetMesh& mesh, std::size_t cell);

// The smallest of the six angles between the faces, degrees.
double smallest_dihedral_angle_deg(const TetMesh& mesh, std::size_t cell);

// The volume that a closed surface cuts out of the space beside the tissue: with the tissue's outward normal
// n, which points into the cavity, V = -(1/3) sum over the facets of x . n dA. m3.
double enclosed_volume(const TetMesh& mesh, int surface_tag);

// The face opposite to corner k of a positively oriented cell, right-handed about its outward normal.
inline constexpr int opposite_face[4][3] = {{1, 2, 3}, {0, 3, 2}, {0, 1, 3}, {0, 2, 1}};

struct CellFace {
  std::array<int, 3> corners;  // ascending
  int cell = 0;
  int opposite = 0;  // the corner of the cell that is not in the face
};
// Every face of every cell, in the order of its corners: the two sides of an inner face stand side by side.
std::vector<CellFace> sorted_faces(const std::vector<std::array<int, 4>>& cells);

struct OuterTriangle {
  std::array<int, 3> corners;  // normal outward
  int cell = 0;
};
// The triangles that belong to one cell only, in the order of sorted_faces.
std::vector<OuterTriangle> outer_triangles(const std::vector<std::array<int, 4>>& cells);

// Numbers the pieces of a set of triangles that hang together by edges: one number a triangle, from 0.
std::vector<int> connected_pieces(const std::vector<std::array<int, 3>>& triangles);

std::array<int, 3> ascending(std::array<int, 3> corners);

// "(12.3, -4.5, 67.8) mm" for a point in metres.
std::string place_text(const Point3& point_m);

}  // namespace wiggers
