// Places named by anatomy: on made hearts, turned ones, and meshes that lack what a site is found by.
#include <catch2/catch.hpp>
#include <cmath>
#include <wiggers/core/errors.hpp>
#include <wiggers/tissue/mesh/geometry.hpp>
#include <wiggers/tissue/mesh/make.hpp>
#include <wiggers/tissue/mesh/sites.hpp>

using namespace wiggers;
using Catch::Contains;

namespace {

// The made hearts stand with their long axis along z, base up; the right ventricle lies at larger x, and the
// great arteries in front, at larger y.
const TetMesh& heart() {
  static const TetMesh mesh = make_heart(7);
  return mesh;
}
Point3 at(const TetMesh& mesh, const std::string& name, double height = 0.5) {
  const Point3 p = find_site(mesh, named_site(name, height));
  return {1e3 * p[0], 1e3 * p[1], 1e3 * p[2]};
}
double distance_to_surface(const TetMesh& mesh, const Point3& p_mm, int tag) {
  double least = 1e9;
  for (std::size_t f = 0; f < mesh.facets.size(); ++f)
    if (mesh.facet_tags[f] == tag)
      for (int v : mesh.facets[f]) {
        double sum = 0;
        for (int i = 0; i < 3; ++i) sum += std::pow(1e3 * mesh.points[v][i] - p_mm[i], 2);
        least = std::min(least, std::sqrt(sum));
      }
  return least;
}
TetMesh turned(TetMesh mesh, double angle, double scale) {
  const double c = std::cos(angle), s = std::sin(angle);
  for (Point3& p : mesh.points)
    p = {scale * (c * p[0] - s * p[2]) + 0.1, scale * p[1] - 0.2, scale * (s * p[0] + c * p[2])};
  return mesh;
}

}  // namespace

TEST_CASE("sites lie where anatomy has them") {
  const TetMesh& mesh = heart();
  SECTION("ventricular sites lie where anatomy has them") {
    for (const char* ventricle : {"LV", "RV"}) {
      const std::string v = ventricle;
      const bool right = v == "RV";
      INFO(v);
      const Point3 septum = at(mesh, v + "-septum"), wall = at(mesh, v + "-free-wall"),
                   front = at(mesh, v + "-anterior"), back = at(mesh, v + "-posterior"),
                   apex = at(mesh, v + "-apex");
      const int own = right ? mesh_tags::endocardium_RV : mesh_tags::endocardium_LV,
                other = right ? mesh_tags::endocardium_LV : mesh_tags::endocardium_RV;
      for (const Point3& p : {septum, wall, front, back, apex})
        CHECK(distance_to_surface(mesh, p, own) < 1e-6);
      // The septum is one wall from the other cavity; the free wall is across.
      CHECK(distance_to_surface(mesh, septum, other) < 14);
      CHECK(distance_to_surface(mesh, wall, other) > 30);
      CHECK((right ? wall[0] - septum[0] : septum[0] - wall[0]) > 15);
      CHECK(front[1] > 8);
      CHECK(back[1] < -8);
      CHECK(apex[2] < septum[2] - 15);
      CHECK(at(mesh, v + "-septum", 0.8)[2] > at(mesh, v + "-septum", 0.2)[2] + 15);
      // Between them.
      const Point3 between = at(mesh, v + "-anterior-septum");
      CHECK(between[1] > septum[1] + 3);
      CHECK(between[1] < front[1] + 5);
    }
  }
  SECTION(
      "the sinus node lies where the superior caval vein meets the right atrium, away from the left one") {
    const Point3 node = at(mesh, "sinus-node");
    // The vein goes up from (40.5, -10.75) mm; the left atrium lies at smaller x.
    CHECK(node[2] > 40);
    CHECK(node[0] > 43);
    CHECK(std::hypot(node[0] - 40.5, node[1] + 10.75) < 13);
  }
  SECTION("sites turn, move and grow with the mesh") {
    const double angle = 0.9, scale = 1.3;
    const TetMesh other = turned(mesh, angle, scale);
    TetMesh one = mesh;
    int seen = 0;
    for (const std::string& name : site_names()) {
      one.points = {find_site(mesh, named_site(name, 0.4))};
      const Point3 expected = turned(one, angle, scale).points.front(),
                   found = find_site(other, named_site(name, 0.4));
      INFO(name);
      for (int i = 0; i < 3; ++i) CHECK(found[i] == Approx(expected[i]).margin(1e-9));
      ++seen;
    }
    CHECK(seen == 19);
  }
}

TEST_CASE("what a mesh does not have is said") {
  const TetMesh left = make_ellipsoid(10);
  CHECK_THROWS_WITH(find_site(left, named_site("LV-septum", 0.5)),
                    Contains("one ventricle alone") && Contains("LV-apex"));
  CHECK_THROWS_WITH(find_site(left, named_site("RV-apex", 0.5)),
                    Contains("no endocardium of the right ventricle"));
  CHECK_THROWS_WITH(find_site(left, named_site("sinus-node", 0)), Contains("no right atrium"));
  // The ellipsoid's apex is its lowest point within.
  const Point3 apex = at(left, "LV-apex");
  CHECK(std::hypot(apex[0], apex[1]) < 6);
  CHECK(apex[2] < -50);
}

TEST_CASE("a ventricle without a cap has its base at the open rim") {
  TetMesh open = make_ellipsoid(10);
  // Its cap taken away: the endocardium then ends at the rim.
  std::vector<std::array<int, 4>> cells;
  std::vector<int> tags, muscle(open.points.size(), 0);
  for (std::size_t c = 0; c < open.cells.size(); ++c)
    if (open.cell_tags[c] == mesh_tags::ventricles) {
      cells.push_back(open.cells[c]);
      tags.push_back(open.cell_tags[c]);
      for (int v : open.cells[c]) muscle[v] = 1;
    }
  std::vector<std::array<int, 3>> facets;
  std::vector<int> facet_tags;
  for (std::size_t f = 0; f < open.facets.size(); ++f) {
    const auto& corners = open.facets[f];
    if (!(muscle[corners[0]] && muscle[corners[1]] && muscle[corners[2]])) continue;
    facets.push_back(corners);
    facet_tags.push_back(open.facet_tags[f]);
  }
  const auto with_cap = long_axis(open, false);
  open.cells = cells;
  open.cell_tags = tags;
  open.facets = facets;
  open.facet_tags = facet_tags;
  const auto without = long_axis(open, false);
  REQUIRE(with_cap);
  REQUIRE(without);
  CHECK(without->apex_vertex == with_cap->apex_vertex);
  CHECK(1e3 * std::abs(without->base[2] - with_cap->base[2]) < 2);
}
