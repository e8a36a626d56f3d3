// Boxes of tetrahedra, without a mesher: for benchmarks and tests.
#pragma once

#include <array>
#include <vector>
#include <wiggers/tissue/mesh/mesh.hpp>

namespace wiggers {

// A box cut at the given coordinates (m, ascending, at least two in each direction) into bricks and each
// brick into six tetrahedra around its diagonal from the lowest to the highest corner (Kuhn, Freudenthal):
// neighbours fit, and refining by halves makes similar shapes. Points run fastest along x. Cell tag 1; facets
// tagged 1..6 for the sides x-, x+, y-, y+, z-, z+.
TetMesh box_mesh(const std::array<std::vector<double>, 3>& coordinates_m);

// n + 1 equidistant coordinates from 0 to length.
std::vector<double> uniform(double length, int n);

// n + 1 coordinates from 0 to length whose spacing grows geometrically from both ends towards the middle:
// `ratio_at_start` is the middle spacing over that at the start (4: four times finer there, 1: no grading),
// `ratio_at_end` likewise. Use even n where both are graded.
std::vector<double> graded(double length, int n, double ratio_at_start, double ratio_at_end);

}  // namespace wiggers
