// What the makers of geometries share.
#pragma once

#include <functional>
#include <span>
#include <string_view>
#include <utility>
#include <vector>
#include <wiggers/tissue/mesh/gmsh.hpp>
#include <wiggers/tissue/mesh/make.hpp>

namespace wiggers {

void check_shape(std::span<const Quantity> quantities, std::span<const double> values, std::string_view what);
void check_size(double size_mm, std::string_view what);

// An outer triangle and what decides its tag; mm.
struct OuterSide {
  std::array<int, 3> corners;
  int cell_tag = 0;
  bool in_cavity = false;  // its connected surface looks inwards
  Point3 centre_of_piece{};
  Point3 centre{};
  Point3 normal{};  // out of the tissue, length 1
};
// Tags every outer triangle.
void add_facets(TetMesh& mesh, const std::function<int(const OuterSide&)>& tag_of);

// Wall, plate and discs of the two ventricles.
std::vector<std::pair<Solids, int>> ventricle_parts(const BiventricularShape& shape);

}  // namespace wiggers
