// The mesher gmsh (with OpenCASCADE) behind a narrow door: geometry is built by its own functions between the
// opening and the closing of a session; what comes out is a TetMesh.
//
// gmsh is one global machine: a process has one session at a time, in one thread.
#pragma once

#include <functional>
#include <map>
#include <utility>
#include <vector>
#include <wiggers/tissue/mesh/mesh.hpp>

namespace wiggers {

using Solids = std::vector<std::pair<int, int>>;  // gmsh's (dimension, number)

// Runs `build` in a fresh session; it returns the tag of every solid. Meshes at `size_mm` (or by the field of
// sizes, mm at a place in mm), improves the shapes, and returns points in metres, positive cells, no facets.
// The same call gives the same mesh. Throws NumericalFailure with gmsh's words.
TetMesh mesh_solids(double size_mm, const std::function<std::map<int, int>()>& build,
                    const std::function<double(double, double, double)>& field = {});

// Building blocks, mm.
// `seam_deg` turns the meridian where OpenCASCADE sews the surface together (0: towards +x): keep it off
// cuts.
Solids solid_ellipsoid(const Point3& centre, const Point3& radii, double seam_deg = 0);
Solids solid_cylinder(const Point3& foot, const Point3& axis, double radius);
Solids solid_box(const Point3& lowest, const Point3& extent);
void stretch(const Solids& solids, const Point3& centre, const Point3& factors);
Solids copy_of(const Solids& solids);
Solids united(const Solids& a, const Solids& b);
Solids difference(const Solids& a, const Solids& b);    // keeps b
Solids intersection(const Solids& a, const Solids& b);  // keeps neither

// Makes touching parts share their faces; each part's pieces get its tag. Where parts overlap the first wins.
std::map<int, int> assemble(const std::vector<std::pair<Solids, int>>& parts);

}  // namespace wiggers
