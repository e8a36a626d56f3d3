#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <set>
#include <wiggers/core/errors.hpp>
#include <wiggers/tissue/laws/tensor.hpp>
#include <wiggers/tissue/mesh/geometry.hpp>
#include <wiggers/tissue/mesh/sites.hpp>

namespace wiggers {

namespace {

struct WallName {
  std::string_view name;
  double angle_deg;
};
constexpr std::array walls = {WallName{"septum", 0},      WallName{"anterior-septum", 45},
                              WallName{"anterior", 90},   WallName{"anterior-free-wall", 135},
                              WallName{"free-wall", 180}, WallName{"posterior-free-wall", 225},
                              WallName{"posterior", 270}, WallName{"posterior-septum", 315}};

using Vertices = std::vector<int>;

Vertices of_cells(const TetMesh& mesh, auto wanted) {
  std::set<int> found;
  for (std::size_t c = 0; c < mesh.cells.size(); ++c)
    if (wanted(mesh.cell_tags[c])) found.insert(mesh.cells[c].begin(), mesh.cells[c].end());
  return {found.begin(), found.end()};
}
Vertices of_surface(const TetMesh& mesh, int tag) {
  std::set<int> found;
  for (std::size_t f = 0; f < mesh.facets.size(); ++f)
    if (mesh.facet_tags[f] == tag) found.insert(mesh.facets[f].begin(), mesh.facets[f].end());
  return {found.begin(), found.end()};
}
Vertices common(const Vertices& a, const Vertices& b) {
  Vertices both;
  std::set_intersection(a.begin(), a.end(), b.begin(), b.end(), std::back_inserter(both));
  return both;
}
Point3 centroid(const TetMesh& mesh, const Vertices& vertices) {
  Point3 sum{};
  for (int v : vertices) sum = sum + mesh.points[v];
  return (1.0 / static_cast<double>(vertices.size())) * sum;
}
Point3 unit(const Point3& a) { return (1.0 / norm(a)) * a; }
int nearest(const TetMesh& mesh, const Vertices& vertices, const Point3& to) {
  return *std::min_element(vertices.begin(), vertices.end(), [&](int a, int b) {
    return norm(mesh.points[a] - to) < norm(mesh.points[b] - to);
  });
}

// Vertices on open edges of a surface.
Vertices rim_of(const TetMesh& mesh, int tag) {
  std::vector<std::pair<int, int>> edges;
  for (std::size_t f = 0; f < mesh.facets.size(); ++f)
    if (mesh.facet_tags[f] == tag)
      for (int k = 0; k < 3; ++k)
        edges.push_back(std::minmax(mesh.facets[f][k], mesh.facets[f][(k + 1) % 3]));
  std::sort(edges.begin(), edges.end());
  std::set<int> rim;
  for (std::size_t k = 0; k < edges.size();) {
    std::size_t end = k;
    while (end < edges.size() && edges[end] == edges[k]) ++end;
    if (end - k == 1) rim.insert({edges[k].first, edges[k].second});
    k = end;
  }
  return {rim.begin(), rim.end()};
}

struct Ventricle : LongAxis {
  Vertices inside;  // endocardium of the muscle
  Point3 axis() const { return unit(base - apex); }
};

std::optional<Ventricle> ventricle_of(const TetMesh& mesh, bool right) {
  const int tag = right ? mesh_tags::endocardium_RV : mesh_tags::endocardium_LV;
  const Vertices muscle = of_cells(mesh, [](int t) { return t == mesh_tags::ventricles; });
  Ventricle v;
  v.inside = common(of_surface(mesh, tag), muscle);
  if (v.inside.empty()) return {};
  v.ring = common(v.inside, of_cells(mesh, [](int t) { return t != mesh_tags::ventricles; }));
  if (v.ring.empty()) v.ring = rim_of(mesh, tag);
  if (v.ring.empty()) return {};
  v.base = centroid(mesh, v.ring);
  v.apex_vertex = *std::max_element(v.inside.begin(), v.inside.end(), [&](int a, int b) {
    return norm(mesh.points[a] - v.base) < norm(mesh.points[b] - v.base);
  });
  v.apex = mesh.points[v.apex_vertex];
  return v;
}

Point3 across(const Point3& a, const Point3& axis) { return a - dot(a, axis) * axis; }

Point3 wall_site(const TetMesh& mesh, const Site& site) {
  const char* name = site.right ? "right" : "left";
  const auto here = ventricle_of(mesh, site.right);
  if (!here)
    throw InputError(fmt::format("the mesh has no endocardium of the {} ventricle with a base", name));
  if (site.kind == Site::Kind::apex) return here->apex;
  const auto other = ventricle_of(mesh, !site.right);
  if (!other)
    throw InputError(fmt::format(
        "the mesh has one ventricle alone: where its septum is cannot be known. Name the place by "
        "x_mm, y_mm, z_mm, or take {}V-apex",
        site.right ? 'R' : 'L'));
  const Point3 axis = here->axis();
  // Anterior is that of the left ventricle for both.
  const Point3 to_right = unit(across(centroid(mesh, (site.right ? *here : *other).inside) -
                                          centroid(mesh, (site.right ? *other : *here).inside),
                                      axis));
  const Point3 septal = (site.right ? -1.0 : 1.0) * to_right, anterior = cross(axis, to_right);
  const double length = norm(here->base - here->apex);
  double radius = 0;
  for (int v : here->inside) radius += norm(across(mesh.points[v] - here->apex, axis));
  radius /= static_cast<double>(here->inside.size());
  // Around the axis through the middle of the cavity.
  const Point3 middle = centroid(mesh, here->inside);
  double best = std::numeric_limits<double>::infinity();
  int found = here->inside.front();
  for (int v : here->inside) {
    const Point3 from_axis = across(mesh.points[v] - middle, axis);
    const double height = dot(mesh.points[v] - here->apex, axis) / length;
    double turn = std::atan2(dot(from_axis, anterior), dot(from_axis, septal)) - site.angle_deg * M_PI / 180;
    turn = std::remainder(turn, 2 * M_PI);
    const double off = std::hypot(length * (height - site.height), radius * turn);
    if (off < best) {
      best = off;
      found = v;
    }
  }
  return mesh.points[found];
}

// Pieces of a set of vertices that hang together by cells.
std::vector<Vertices> pieces_of(const TetMesh& mesh, const Vertices& vertices) {
  std::vector<int> place(mesh.points.size(), -1), parent(vertices.size());
  for (std::size_t k = 0; k < vertices.size(); ++k) place[vertices[k]] = static_cast<int>(k);
  std::iota(parent.begin(), parent.end(), 0);
  const auto root = [&](int k) {
    while (parent[k] != k) k = parent[k] = parent[parent[k]];
    return k;
  };
  for (const auto& cell : mesh.cells)
    for (int a : cell)
      for (int b : cell)
        if (place[a] >= 0 && place[b] >= 0) parent[root(place[a])] = root(place[b]);
  std::vector<Vertices> pieces(vertices.size());
  for (std::size_t k = 0; k < vertices.size(); ++k) pieces[root(static_cast<int>(k))].push_back(vertices[k]);
  std::erase_if(pieces, [](const Vertices& piece) { return piece.empty(); });
  return pieces;
}

Point3 sinus_node(const TetMesh& mesh) {
  const auto right_atrium = [](int t) { return t == mesh_tags::right_atrium; };
  const Vertices muscle = of_cells(mesh, right_atrium),
                 inside = common(of_surface(mesh, mesh_tags::endocardium_RA), muscle);
  if (muscle.empty() || inside.empty())
    throw InputError("the mesh has no right atrium with an endocardium, where the sinus node would be");
  // Mouths of veins: where the muscle meets a cap or the cut end of a vein.
  Vertices ends = of_surface(mesh, mesh_tags::rings);
  const Vertices caps = of_cells(mesh, [](int t) { return t == mesh_tags::caps; });
  ends.insert(ends.end(), caps.begin(), caps.end());
  std::sort(ends.begin(), ends.end());
  ends.erase(std::unique(ends.begin(), ends.end()), ends.end());
  const std::vector<Vertices> veins = pieces_of(mesh, common(muscle, ends));
  if (veins.empty())
    throw InputError("the right atrium has no vein: neither a cap nor a cut end touches its muscle");
  // Up: from the ventricles to the atria.
  const Vertices below = of_cells(mesh, [](int t) { return t == mesh_tags::ventricles; });
  const Point3 middle = centroid(mesh, inside);
  const auto left = ventricle_of(mesh, false);
  // Without ventricles from the tricuspid ring, where the muscle meets valves or annuli.
  const Vertices tricuspid =
      common(muscle, of_cells(mesh, [](int t) { return t == mesh_tags::annuli || t == mesh_tags::valves; }));
  if (!left && below.empty() && tricuspid.empty() && veins.size() > 1)
    throw InputError(
        "the mesh has neither ventricles nor valves: which vein is the superior one cannot be known. Name "
        "the place by "
        "x_mm, y_mm, z_mm");
  const Point3 up = left                 ? left->axis()
                    : !below.empty()     ? unit(middle - centroid(mesh, below))
                    : !tricuspid.empty() ? unit(middle - centroid(mesh, tricuspid))
                                         : unit(centroid(mesh, veins.front()) - middle);
  const Vertices& superior = *std::max_element(veins.begin(), veins.end(), [&](const auto& a, const auto& b) {
    return dot(centroid(mesh, a), up) < dot(centroid(mesh, b), up);
  });
  const Point3 mouth = centroid(mesh, superior);
  double radius = 0;
  for (int v : superior) radius += norm(mesh.points[v] - mouth);
  radius /= static_cast<double>(superior.size());
  const Point3 inwards = unit(middle - mouth);
  Point3 aside{};
  const Vertices other = of_cells(mesh, [](int t) { return t == mesh_tags::left_atrium; });
  if (!other.empty()) aside = unit(across(mouth - centroid(mesh, other), inwards));
  return mesh.points[nearest(mesh, muscle, mouth + radius * (aside + 0.5 * inwards))];
}

}  // namespace

std::optional<LongAxis> long_axis(const TetMesh& mesh, bool right) {
  const auto ventricle = ventricle_of(mesh, right);
  return ventricle ? std::optional<LongAxis>(*ventricle) : std::nullopt;
}

const std::vector<std::string>& site_names() {
  static const std::vector<std::string> names = [] {
    std::vector<std::string> list = {"sinus-node"};
    for (const char* ventricle : {"LV", "RV"}) {
      list.push_back(fmt::format("{}-apex", ventricle));
      for (const WallName& wall : walls) list.push_back(fmt::format("{}-{}", ventricle, wall.name));
    }
    return list;
  }();
  return names;
}

Site named_site(std::string_view name, double height) {
  Site site;
  if (name == "sinus-node") return site;
  site.right = name.front() == 'R';
  site.height = height;
  const std::string_view wall = name.substr(3);
  site.kind = wall == "apex" ? Site::Kind::apex : Site::Kind::wall;
  for (const WallName& known : walls)
    if (known.name == wall) site.angle_deg = known.angle_deg;
  return site;
}

bool has_height(const Site& site) { return site.kind == Site::Kind::wall; }

Point3 find_site(const TetMesh& mesh, const Site& site) {
  return site.kind == Site::Kind::sinus_node ? sinus_node(mesh) : wall_site(mesh, site);
}

}  // namespace wiggers
