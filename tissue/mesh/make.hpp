// Idealised geometries by gmsh: every mesh has the tags of mesh.hpp, closed cavities and the same shape at
// every call. All lengths in mm; z points from the apex to the base.
#pragma once

#include <array>
#include <wiggers/core/quantity.hpp>
#include <wiggers/tissue/mesh/mesh.hpp>

namespace wiggers {

inline constexpr Quantity mesh_size_quantity = {"size-mm", "mm", 4, 0.3, 20, "edge length of the tetrahedra"};

// A left ventricle: ellipsoids cut at a base plane and closed by a flat cap within the base.
// Volumes: 1 wall, 9 cap. Surfaces: 24 cavity (with the cap's lower face), 31 epicardium, 32 base.
inline constexpr std::array<Quantity, 5> ellipsoid_quantities = {{
    {"inner-radius-mm", "mm", 25.5, 5, 60, "half the greatest width of the cavity"},
    {"inner-length-mm", "mm", 66, 10, 120, "centre to endocardial apex"},
    {"wall-mm", "mm", 9.5, 1, 30, "wall thickness at apex and equator"},
    {"base-height-mm", "mm", 20, 0, 60, "base plane above the centre"},
    {"cap-mm", "mm", 3, 0.5, 10, "thickness of the cap that closes the cavity"},
}};
static_assert(well_formed(ellipsoid_quantities));
using EllipsoidShape = std::array<double, ellipsoid_quantities.size()>;
TetMesh make_ellipsoid(double size_mm, const EllipsoidShape& shape = defaults_of(ellipsoid_quantities));

// Both ventricles: half ellipsoids cut at z = 0 under a fibrous plate with four closed valve discs.
// Volumes: 1 wall, 5 plate, 6 discs. Surfaces: 23 and 24 cavities, 31 epicardium, 32 plate.
inline constexpr std::array<Quantity, 9> biventricular_quantities = {{
    {"lv-radius-mm", "mm", 23, 15, 35, "radius of the left cavity at the base"},
    {"lv-length-mm", "mm", 70, 40, 110, "base to left endocardial apex"},
    {"lv-wall-mm", "mm", 10, 4, 20, "thickness of left wall and septum"},
    {"rv-radius-x-mm", "mm", 32, 24, 45, "right cavity: half width from septum to free wall"},
    {"rv-radius-y-mm", "mm", 28, 20, 40, "right cavity: half width along the septum"},
    {"rv-length-mm", "mm", 64, 35, 100, "base to right endocardial apex"},
    {"rv-wall-mm", "mm", 4, 2, 12, "thickness of the right free wall"},
    {"rv-offset-mm", "mm", 28, 15, 45, "distance between the axes of the ventricles"},
    {"plate-mm", "mm", 3, 1, 10, "thickness of the fibrous plate"},
}};
static_assert(well_formed(biventricular_quantities));
using BiventricularShape = std::array<double, biventricular_quantities.size()>;
TetMesh make_biventricular(double size_mm,
                           const BiventricularShape& shape = defaults_of(biventricular_quantities));

// The heart with four chambers, aorta, pulmonary trunk, and veins closed by caps; its size is fixed.
// All tags of mesh.hpp. Fat (32) covers the plate and the atria below `fat-height-mm`.
inline constexpr std::array<Quantity, 1> heart_quantities = {{
    {"fat-height-mm", "mm", 12, 3, 40, "the outside of the atria below this height faces fat"},
}};
static_assert(well_formed(heart_quantities));
using HeartShape = std::array<double, heart_quantities.size()>;
TetMesh make_heart(double size_mm, const HeartShape& shape = defaults_of(heart_quantities));

// An eighth of a thick sphere, x, y, z >= 0. Surfaces: 24 inner, 31 outer, 41, 42, 43 the planes x, y, z = 0.
TetMesh make_sphere_octant(double inner_radius_mm, double outer_radius_mm, double size_mm);
// The whole sphere, eight mirror images of the octant. Surfaces: 24 inner, 31 outer.
TetMesh make_sphere(double inner_radius_mm, double outer_radius_mm, double size_mm);

// The truncated ellipsoid of Land et al. 2015 (radii 7 and 17 mm inside, 10 and 20 mm outside, base z = 5
// mm). Finer at both apices (edge apex_size_mm) and at the rims of the clamped base (half of size_mm).
// Surfaces: 24 inside, 31 outside, 40 base; of a quarter (x, y >= 0) also 41 x = 0 and 42 y = 0.
TetMesh make_benchmark_ellipsoid(double size_mm, double apex_size_mm, bool quarter);

}  // namespace wiggers
