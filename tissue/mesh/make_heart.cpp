#include <algorithm>
#include <array>
#include <cmath>
#include <wiggers/tissue/mesh/geometry.hpp>
#include <wiggers/tissue/mesh/make_parts.hpp>

namespace wiggers {

namespace {

// Placed so that no two surfaces come nearer than about 1.3 mm without meeting, nor meet at a small angle:
// both leave slivers, and nearly tangent surfaces make the booleans hang.
constexpr double plate_mm = 3;

struct Atrium {
  int tag;
  Point3 centre, outer, inner;  // mm; the radii along the axes
  std::array<Point3, 2> veins;  // directions, length 1
};
const std::array<Atrium, 2> atria = {{
    {mesh_tags::left_atrium,
     {-10.5, -10.75, 20},
     {23, 22, 24},
     {20, 19, 21},
     {{{-0.96, 0, 0.28}, {-0.28, -0.96, 0}}}},
    {mesh_tags::right_atrium,
     {40.5, -10.75, 20},
     {24, 20, 25},
     {21, 17, 22},
     {{{0, 0, 1}, {0.28, -0.96, 0}}}},
}};
constexpr double vein_outer_mm = 8, vein_inner_mm = 5.5, vein_length_mm = 31, vein_cap_mm = 3;
constexpr double bridge_radius_mm = 7, bridge_height_mm = 26, bridge_cut_mm = 14.5, bridge_y_mm = -10.75;

struct Artery {
  int tag, endothelium;
  double x, y, outer, inner, length;  // mm
};
constexpr std::array<Artery, 2> arteries = {{
    {mesh_tags::aorta, mesh_tags::endothelium_aorta, 10.5, 10.9, 8.7, 6.2, 60},
    {mesh_tags::pulmonary_trunk, mesh_tags::endothelium_pulmonary_trunk, 38, 18.3, 8, 6, 45},
}};

void append(Solids& to, const Solids& more) { to.insert(to.end(), more.begin(), more.end()); }

// From the centre of the atrium along a vein, between two distances.
Solids vein_piece(const Atrium& atrium, const Point3& way, double from, double to, double radius) {
  return solid_cylinder(atrium.centre + from * way, (to - from) * way, radius);
}

std::map<int, int> heart_parts() {
  auto parts = ventricle_parts(defaults_of(biventricular_quantities));
  Solids artery_bodies, lumina;
  for (const Artery& a : arteries) {
    append(artery_bodies, solid_cylinder({a.x, a.y, plate_mm}, {0, 0, a.length}, a.outer));
    append(lumina, solid_cylinder({a.x, a.y, plate_mm}, {0, 0, a.length}, a.inner));
  }
  std::array<Solids, 2> shells, caps;
  Solids cavities;
  for (std::size_t k = 0; k < 2; ++k) {
    const Atrium& atrium = atria[k];
    const Solids above = solid_box({-300, -300, plate_mm}, {600, 600, 600});
    constexpr double seam_deg = 60;  // between bridge, veins and arteries
    Solids cavity = solid_ellipsoid(atrium.centre, atrium.inner, seam_deg);
    Solids body = solid_ellipsoid(atrium.centre, atrium.outer, seam_deg);
    for (const Point3& way : atrium.veins) {
      body = united(body, vein_piece(atrium, way, 0, vein_length_mm, vein_outer_mm));
      cavity = united(cavity, vein_piece(atrium, way, 0, vein_length_mm - vein_cap_mm, vein_inner_mm));
      append(caps[k], vein_piece(atrium, way, vein_length_mm - vein_cap_mm, vein_length_mm, vein_inner_mm));
    }
    // Half of the bridge to the other atrium.
    const double x = atrium.centre[0];
    body = united(body, solid_cylinder({x, bridge_y_mm, bridge_height_mm}, {bridge_cut_mm - x, 0, 0},
                                       bridge_radius_mm));
    shells[k] = intersection(body, above);
    append(cavities, cavity);
  }
  for (std::size_t k = 0; k < 2; ++k) {
    Solids shell = difference(shells[k], cavities);
    shell = difference(shell, caps[k]);
    shell = difference(shell, artery_bodies);
    parts.emplace_back(shell, atria[k].tag);
    parts.emplace_back(caps[k], mesh_tags::caps);
  }
  for (std::size_t k = 0; k < 2; ++k)
    parts.emplace_back(difference({artery_bodies[k]}, {lumina[k]}), arteries[k].tag);
  return assemble(parts);
}

int cavity_tag(const OuterSide& side) {
  const bool right = side.centre_of_piece[0] > bridge_cut_mm;
  const bool atrial = side.centre_of_piece[2] > plate_mm;
  if (atrial) return right ? mesh_tags::endocardium_RA : mesh_tags::endocardium_LA;
  return right ? mesh_tags::endocardium_RV : mesh_tags::endocardium_LV;
}

int outside_tag(const OuterSide& side, double fat_height_mm) {
  for (const Artery& a : arteries) {
    const double distance = std::hypot(side.centre[0] - a.x, side.centre[1] - a.y);
    if (side.cell_tag == a.tag) {
      if (side.normal[2] > 0.99 && side.centre[2] > plate_mm + a.length - 1e-5) return mesh_tags::rings;
      return distance < 0.5 * (a.inner + a.outer) ? a.endothelium : mesh_tags::arterial_outside;
    }
    // The arterial side of the closed semilunar valve.
    if (side.cell_tag == mesh_tags::valves && distance < a.inner) return a.endothelium;
  }
  for (const Atrium& atrium : atria)
    for (const Point3& way : atrium.veins)
      if (dot(side.normal, way) > 0.999 && dot(side.centre - atrium.centre, way) > vein_length_mm - 1e-5)
        return mesh_tags::rings;
  if (side.cell_tag == mesh_tags::ventricles) return mesh_tags::epicardium;
  if (side.cell_tag == mesh_tags::annuli) return mesh_tags::epicardium_fat;
  return side.centre[2] < fat_height_mm ? mesh_tags::epicardium_fat : mesh_tags::epicardium;
}

}  // namespace

TetMesh make_heart(double size_mm, const HeartShape& shape) {
  check_size(size_mm, "heart");
  check_shape(heart_quantities, shape, "heart");
  TetMesh mesh = mesh_solids(size_mm, heart_parts);
  add_facets(mesh, [&](const OuterSide& side) {
    return side.in_cavity ? cavity_tag(side) : outside_tag(side, shape[0]);
  });
  return mesh;
}

}  // namespace wiggers
