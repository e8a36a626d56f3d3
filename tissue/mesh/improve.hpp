// Better shapes without changing the body: what a mesher leaves as slivers is opened by moving inner points
// and by sliding points within plane faces.
#pragma once

#include <wiggers/tissue/mesh/mesh.hpp>

namespace wiggers {

// Moves points, one after the other and in order, each to a place where the worst of its cells is better.
// Only cells below `enough` call for it. Points of curved faces and of edges stay.
void improve_shapes(TetMesh& mesh, double enough = 0.35, int passes = 12);

// The lowest quality of all cells (geometry.hpp).
double lowest_quality(const TetMesh& mesh);

}  // namespace wiggers
