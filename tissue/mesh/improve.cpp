#include <algorithm>
#include <cmath>
#include <vector>
#include <wiggers/core/progress.hpp>
#include <wiggers/tissue/mesh/geometry.hpp>
#include <wiggers/tissue/mesh/improve.hpp>

namespace wiggers {

namespace {

// What a point may do: move in space, slide in a plane, or stay.
struct Freedom {
  int faces = 0;  // which two tags the outer and inner boundary faces at the point lie between; 0: none
  Point3 normal{};
  bool planar = true;
};

std::vector<Freedom> freedom_of_points(const TetMesh& mesh) {
  std::vector<Freedom> freedom(mesh.points.size());
  const auto faces = sorted_faces(mesh.cells);
  for (std::size_t i = 0; i < faces.size(); ++i) {
    const bool paired = i + 1 < faces.size() && faces[i].corners == faces[i + 1].corners;
    const bool inner = paired && mesh.cell_tags[static_cast<std::size_t>(faces[i].cell)] ==
                                     mesh.cell_tags[static_cast<std::size_t>(faces[i + 1].cell)];
    const int tag_behind = paired ? mesh.cell_tags[static_cast<std::size_t>(faces[i + 1].cell)] : -1;
    const int tag = mesh.cell_tags[static_cast<std::size_t>(faces[i].cell)];
    if (paired) ++i;
    if (inner) continue;
    const auto at = [&](std::size_t k) { return mesh.points[static_cast<std::size_t>(faces[i].corners[k])]; };
    const Point3 area = triangle_area_vector(at(0), at(1), at(2));
    const Point3 normal = (1 / norm(area)) * area;
    // The rim where a plane changes from one pair of neighbours to another must stay as well.
    const int kind = std::min(tag, tag_behind) * 1000 + std::max(tag, tag_behind);
    for (const int p : faces[i].corners) {
      Freedom& f = freedom[static_cast<std::size_t>(p)];
      if (f.faces == 0) {
        f.normal = normal;
        f.faces = kind;
      } else if (f.faces != kind || std::abs(std::abs(dot(f.normal, normal)) - 1) > 1e-9) {
        f.planar = false;
      }
    }
  }
  return freedom;
}

}  // namespace

void improve_shapes(TetMesh& mesh, double enough, int passes) {
  const auto freedom = freedom_of_points(mesh);
  std::vector<std::vector<std::size_t>> cells_at(mesh.points.size());
  for (std::size_t c = 0; c < mesh.cells.size(); ++c)
    for (const int p : mesh.cells[c]) cells_at[static_cast<std::size_t>(p)].push_back(c);
  for (int pass = 0; pass < passes; ++pass) {
    bool moved = false;
    for (std::size_t p = 0; p < mesh.points.size(); ++p) {
      check_interrupt();
      const Freedom& may = freedom[p];
      if (may.faces != 0 && !may.planar) continue;
      const auto worst_here = [&] {
        double worst = 1;
        for (const std::size_t c : cells_at[p]) worst = std::min(worst, cell_quality(mesh, c));
        return worst;
      };
      double best = worst_here();
      if (best >= enough) continue;
      // Mean edge length sets the first step; the search halves it when no direction helps.
      double step = 0;
      for (const std::size_t c : cells_at[p])
        step += std::cbrt(std::abs(cell_volume(mesh, c))) / static_cast<double>(cells_at[p].size());
      for (int halving = 0; halving < 6; step *= 0.5, ++halving)
        for (int direction = 0; direction < 26; ++direction) {
          const int code = direction < 13 ? direction : direction + 1;  // 3 x 3 x 3 without the centre
          const Point3 before = mesh.points[p];
          Point3 way = {code % 3 - 1.0, code / 3 % 3 - 1.0, code / 9 - 1.0};
          if (may.faces != 0) way = way - dot(way, may.normal) * may.normal;
          mesh.points[p] = before + step * way;
          const double now = worst_here();
          if (now > best + 1e-6) {
            best = now;
            moved = true;
          } else {
            mesh.points[p] = before;
          }
        }
    }
    if (!moved) break;
  }
}

double lowest_quality(const TetMesh& mesh) {
  double lowest = 1;
  for (std::size_t c = 0; c < mesh.cells.size(); ++c) lowest = std::min(lowest, cell_quality(mesh, c));
  return lowest;
}

}  // namespace wiggers
