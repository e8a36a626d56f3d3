#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/units.hpp>
#include <wiggers/tissue/mesh/geometry.hpp>
#include <wiggers/tissue/mesh/gmsh.hpp>
#include <wiggers/tissue/mesh/make.hpp>
#include <wiggers/tissue/mesh/make_parts.hpp>

namespace wiggers {

namespace {

// All corners of a triangle satisfy a condition on their place in mm.
template <class Condition>
bool all_corners(const TetMesh& mesh, const std::array<int, 3>& corners, const Condition& condition) {
  return std::all_of(corners.begin(), corners.end(),
                     [&](int p) { return condition(1e3 * mesh.points[static_cast<std::size_t>(p)]); });
}

constexpr double on_plane_mm = 1e-5;

}  // namespace

void check_shape(std::span<const Quantity> quantities, std::span<const double> values,
                 std::string_view what) {
  for (std::size_t k = 0; k < quantities.size(); ++k) check_range(quantities[k], values[k], what);
}

void check_size(double size_mm, std::string_view what) { check_range(mesh_size_quantity, size_mm, what); }

void add_facets(TetMesh& mesh, const std::function<int(const OuterSide&)>& tag_of) {
  const auto outer = outer_triangles(mesh.cells);
  std::vector<std::array<int, 3>> triangles;
  for (const OuterTriangle& t : outer) triangles.push_back(t.corners);
  const std::vector<int> piece = connected_pieces(triangles);
  // A cavity's surface has a negative volume about any origin: its normals point inwards.
  std::vector<double> volume(triangles.size(), 0.0);
  for (std::size_t t = 0; t < triangles.size(); ++t) {
    const auto at = [&](std::size_t k) { return mesh.points[static_cast<std::size_t>(triangles[t][k])]; };
    volume[static_cast<std::size_t>(piece[t])] += dot(at(0), cross(at(1), at(2)));
  }
  std::vector<Point3> centre(triangles.size(), Point3{});
  std::vector<double> area(triangles.size(), 0.0);
  for (std::size_t t = 0; t < triangles.size(); ++t) {
    const auto at = [&](std::size_t k) {
      return 1e3 * mesh.points[static_cast<std::size_t>(triangles[t][k])];
    };
    const double a = norm(triangle_area_vector(at(0), at(1), at(2)));
    const auto p = static_cast<std::size_t>(piece[t]);
    centre[p] = centre[p] + (a / 3) * (at(0) + at(1) + at(2));
    area[p] += a;
  }
  for (std::size_t t = 0; t < triangles.size(); ++t) {
    const auto p = static_cast<std::size_t>(piece[t]);
    const auto at = [&](std::size_t k) {
      return 1e3 * mesh.points[static_cast<std::size_t>(triangles[t][k])];
    };
    OuterSide side{triangles[t],
                   mesh.cell_tags[static_cast<std::size_t>(outer[t].cell)],
                   volume[p] < 0,
                   (1 / area[p]) * centre[p],
                   (1.0 / 3) * (at(0) + at(1) + at(2)),
                   triangle_area_vector(at(0), at(1), at(2))};
    side.normal = (1 / norm(side.normal)) * side.normal;
    const int tag = tag_of(side);
    mesh.facets.push_back(triangles[t]);
    mesh.facet_tags.push_back(tag);
  }
}

TetMesh make_ellipsoid(double size_mm, const EllipsoidShape& shape) {
  check_size(size_mm, "ellipsoid");
  check_shape(ellipsoid_quantities, shape, "ellipsoid");
  const auto [radius, length, wall, base, cap] = shape;
  const double r = radius, l = length, w = wall, b = base, c = cap;
  if (b > 0.8 * l)
    throw InputError(
        fmt::format("ellipsoid: base-height-mm = {} must be at most 0.8 of inner-length-mm = {}", b, l));
  TetMesh mesh = mesh_solids(size_mm, [&] {
    const double reach = 2 * (r + l + w);
    const auto below = [&](double z) {
      return solid_box({-reach, -reach, z - 2 * reach}, {2 * reach, 2 * reach, 2 * reach});
    };
    const Solids outside = intersection(solid_ellipsoid({0, 0, 0}, {r + w, r + w, l + w}), below(b));
    const Solids inside = intersection(solid_ellipsoid({0, 0, 0}, {r, r, l}), below(b));
    const Solids myocardium = difference(outside, inside);
    const Solids disc = difference(inside, below(b - c));
    return assemble({{myocardium, mesh_tags::ventricles}, {disc, mesh_tags::caps}});
  });
  add_facets(mesh, [&](const OuterSide& side) {
    if (side.in_cavity) return mesh_tags::endocardium_LV;
    const bool top = all_corners(mesh, side.corners, [&](const Point3& x) { return x[2] > b - on_plane_mm; });
    return top ? mesh_tags::epicardium_fat : mesh_tags::epicardium;
  });
  return mesh;
}

TetMesh make_biventricular(double size_mm, const BiventricularShape& shape) {
  check_size(size_mm, "biventricular");
  check_shape(biventricular_quantities, shape, "biventricular");
  TetMesh mesh = mesh_solids(size_mm, [&] { return assemble(ventricle_parts(shape)); });
  const double between_mm = 0.5 * shape[7];
  add_facets(mesh, [&](const OuterSide& side) {
    if (side.in_cavity)
      return side.centre_of_piece[0] > between_mm ? mesh_tags::endocardium_RV : mesh_tags::endocardium_LV;
    return side.cell_tag == mesh_tags::ventricles ? mesh_tags::epicardium : mesh_tags::epicardium_fat;
  });
  return mesh;
}

std::vector<std::pair<Solids, int>> ventricle_parts(const BiventricularShape& shape) {
  const auto [lv_radius, lv_length, lv_wall, rv_x, rv_y, rv_length, rv_wall, offset, plate_height] = shape;
  const double R = lv_radius + lv_wall, h = plate_height;
  if (offset + rv_x < R + 10 || offset - rv_x > R - 4 || rv_y + rv_wall > R + 20)
    throw InputError(fmt::format(
        "biventricular: with these radii the right cavity (x from {} to {} mm) does not clasp the left "
        "ventricle (radius {} mm); change rv-offset-mm or rv-radius-x-mm",
        offset - rv_x, offset + rv_x, R));
  const Point3 left = {0, 0, 0}, right = {offset, 0, 0};
  const auto half = [](const Point3& centre, const Point3& radii) {
    return intersection(solid_ellipsoid(centre, radii), solid_box({-300, -300, -600}, {600, 600, 600}));
  };
  const Solids lv_outer = half(left, {R, R, lv_length + lv_wall});
  const Solids lv_inner = half(left, {lv_radius, lv_radius, lv_length});
  const Solids rv_outer = half(right, {rv_x + rv_wall, rv_y + rv_wall, rv_length + rv_wall});
  const Solids rv_inner = difference(half(right, {rv_x, rv_y, rv_length}), lv_outer);
  Solids wall = united(lv_outer, rv_outer);
  wall = difference(wall, lv_inner);
  wall = difference(wall, rv_inner);

  const auto prism = [&](const Point3& centre, double a, double b) {
    const Solids solid = solid_cylinder({centre[0], centre[1], 0}, {0, 0, h}, 1);
    stretch(solid, centre, {a, b, 1});
    return solid;
  };
  Solids plate = united(prism(left, R, R), prism(right, rv_x + rv_wall, rv_y + rv_wall));
  Solids discs;
  const auto disc = [&](double x, double y, double radius) {
    const Solids solid = solid_cylinder({x, y, 0}, {0, 0, h}, radius);
    discs.insert(discs.end(), solid.begin(), solid.end());
  };
  // Mitral, aortic, tricuspid, pulmonary: placed in the default ventricles, moved and sized with them.
  const double s = lv_radius / 23, sx = rv_x / 32, sy = rv_y / 28, sr = std::min(sx, sy);
  // Nearer than 1.5 mm to the chamber's edge they would leave needles of tissue.
  disc(-9.4 * s, -9.4 * s, 8.2 * s);
  disc(10.5 * s, 10.9 * s, 6.2 * s);
  const auto right_disc = [&, rv_x = rv_x, rv_y = rv_y, offset = offset](const char* name, double x, double y,
                                                                         double r) {
    for (int k = 0; k < 72; ++k) {
      const double px = x + (r + 0.5) * std::cos(k * M_PI / 36), py = y + (r + 0.5) * std::sin(k * M_PI / 36);
      if (std::hypot((px - offset) / rv_x, py / rv_y) > 1 || std::hypot(px, py) < R)
        throw InputError(fmt::format(
            "biventricular: the {} valve (radius {:.1f} mm) has no room in the right ventricle at "
            "({:.1f}, {:.1f}) mm; raise rv-offset-mm (now {}) or rv-radius-x-mm (now {}), or lower "
            "lv-radius-mm or lv-wall-mm",
            name, r, px, py, offset, rv_x));
    }
    disc(x, y, r);
  };
  right_disc("tricuspid", offset + 14.5 * sx, -10.6 * sy, 9 * sr);
  right_disc("pulmonary", offset + 10 * sx, 18.3 * sy, 6 * sr);
  plate = difference(plate, discs);
  return {{wall, mesh_tags::ventricles}, {plate, mesh_tags::annuli}, {discs, mesh_tags::valves}};
}

TetMesh make_sphere_octant(double inner_radius_mm, double outer_radius_mm, double size_mm) {
  check_size(size_mm, "sphere octant");
  if (!(inner_radius_mm > 0) || !(outer_radius_mm > inner_radius_mm) || !std::isfinite(outer_radius_mm))
    throw InputError(fmt::format("sphere octant: inner radius {} mm, outer {} mm; needed: 0 < inner < outer",
                                 inner_radius_mm, outer_radius_mm));
  TetMesh mesh = mesh_solids(size_mm, [&] {
    const double R = outer_radius_mm, r = inner_radius_mm;
    const Solids shell =
        difference(solid_ellipsoid({0, 0, 0}, {R, R, R}), solid_ellipsoid({0, 0, 0}, {r, r, r}));
    return assemble(
        {{intersection(shell, solid_box({0, 0, 0}, {2 * R, 2 * R, 2 * R})), mesh_tags::ventricles}});
  });
  const double middle = 0.5 * (inner_radius_mm + outer_radius_mm);
  add_facets(mesh, [&](const OuterSide& side) {
    for (std::size_t axis = 0; axis < 3; ++axis)
      if (all_corners(mesh, side.corners, [&](const Point3& x) { return std::abs(x[axis]) < on_plane_mm; }))
        return 41 + static_cast<int>(axis);
    return norm(side.centre) < middle ? mesh_tags::endocardium_LV : mesh_tags::epicardium;
  });
  return mesh;
}

TetMesh make_sphere(double inner_radius_mm, double outer_radius_mm, double size_mm) {
  const TetMesh octant = make_sphere_octant(inner_radius_mm, outer_radius_mm, size_mm);
  constexpr double on_plane_m = units::m_per_mm * on_plane_mm;
  TetMesh sphere;
  std::map<Point3, int> points;
  for (int image = 0; image < 8; ++image) {
    std::vector<int> index;
    for (Point3 p : octant.points) {
      for (int axis = 0; axis < 3; ++axis)
        p[axis] = std::abs(p[axis]) < on_plane_m ? 0.0 : image >> axis & 1 ? -p[axis] : p[axis];
      const auto [at, is_new] = points.emplace(p, static_cast<int>(sphere.points.size()));
      if (is_new) sphere.points.push_back(p);
      index.push_back(at->second);
    }
    // An odd number of mirrors turns the elements over.
    const bool turned = ((image & 1) + (image >> 1 & 1) + (image >> 2 & 1)) % 2 == 1;
    for (std::size_t c = 0; c < octant.cells.size(); ++c) {
      auto cell = octant.cells[c];
      for (int& v : cell) v = index[v];
      if (turned) std::swap(cell[2], cell[3]);
      sphere.cells.push_back(cell);
      sphere.cell_tags.push_back(octant.cell_tags[c]);
    }
    for (std::size_t f = 0; f < octant.facets.size(); ++f) {
      if (octant.facet_tags[f] > 40) continue;  // planes of symmetry
      auto facet = octant.facets[f];
      for (int& v : facet) v = index[v];
      if (turned) std::swap(facet[1], facet[2]);
      sphere.facets.push_back(facet);
      sphere.facet_tags.push_back(octant.facet_tags[f]);
    }
  }
  return sphere;
}

TetMesh make_benchmark_ellipsoid(double size_mm, double apex_size_mm, bool quarter) {
  check_size(size_mm, "benchmark ellipsoid");
  if (!(apex_size_mm > 0) || apex_size_mm > size_mm)
    throw InputError(
        fmt::format("benchmark ellipsoid: apex size {} mm; must be positive and at most the size {} mm",
                    apex_size_mm, size_mm));
  const double base = 5;
  const auto field = [&](double x, double y, double z) {
    const double apex = std::min(std::hypot(x, y, z + 17), std::hypot(x, y, z + 20));
    const double r = std::hypot(x, y);
    const double rim = std::min(std::hypot(r - 7 * std::sqrt(1 - base * base / (17 * 17)), z - base),
                                std::hypot(r - 10 * std::sqrt(1 - base * base / (20 * 20)), z - base));
    // Sizes grow by 30 % of the distance: neighbours differ little.
    return std::min({size_mm, apex_size_mm + 0.3 * apex, 0.5 * size_mm + 0.3 * rim});
  };
  TetMesh mesh = mesh_solids(
      size_mm,
      [&] {
        const Solids shell =
            difference(solid_ellipsoid({0, 0, 0}, {10, 10, 20}), solid_ellipsoid({0, 0, 0}, {7, 7, 17}));
        const double low = quarter ? 0 : -50;
        return assemble({{intersection(shell, solid_box({low, low, -50}, {50 - low, 50 - low, 50 + base})),
                          mesh_tags::ventricles}});
      },
      field);
  add_facets(mesh, [&](const OuterSide& side) {
    const auto on = [&](std::size_t axis, double value) {
      return all_corners(mesh, side.corners,
                         [&](const Point3& x) { return std::abs(x[axis] - value) < on_plane_mm; });
    };
    if (on(2, base)) return mesh_tags::rings;
    if (quarter && on(0, 0)) return 41;
    if (quarter && on(1, 0)) return 42;
    const auto& x = side.centre;
    const double level = (x[0] * x[0] + x[1] * x[1]) / (8.5 * 8.5) + x[2] * x[2] / (18.5 * 18.5);
    return level < 1 ? mesh_tags::endocardium_LV : mesh_tags::epicardium;
  });
  return mesh;
}

}  // namespace wiggers
