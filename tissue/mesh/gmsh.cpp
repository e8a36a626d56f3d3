#include <fmt/format.h>
#include <gmsh.h>

#include <algorithm>
#include <cmath>
#include <csignal>
#include <limits>
#include <string>
#include <unordered_map>
#include <wiggers/core/errors.hpp>
#include <wiggers/tissue/mesh/geometry.hpp>
#include <wiggers/tissue/mesh/gmsh.hpp>
#include <wiggers/tissue/mesh/improve.hpp>

namespace wiggers {

namespace {

namespace occ = gmsh::model::occ;

class Session {
 public:
  Session() {
    // gmsh takes over Ctrl-C; the command's own handling is put back at once.
    auto* const interrupt = std::signal(SIGINT, SIG_DFL);
    gmsh::initialize(0, nullptr, false);
    std::signal(SIGINT, interrupt == SIG_ERR ? SIG_DFL : interrupt);
    gmsh::option::setNumber("General.Terminal", 0);
    gmsh::option::setNumber("General.NumThreads", 1);  // more would make the mesh depend on their number
    gmsh::logger::start();
    gmsh::model::add("wiggers");
  }
  ~Session() {
    try {
      gmsh::finalize();
    } catch (...) {  // nothing left to save
    }
  }
  Session(const Session&) = delete;
  Session& operator=(const Session&) = delete;
};

std::string last_words() {
  std::vector<std::string> log;
  gmsh::logger::get(log);
  for (auto line = log.rbegin(); line != log.rend(); ++line)
    if (line->rfind("Error", 0) == 0) return *line;
  return "no message";
}

// A mesher's luck: a size a little off meets the same geometry with other triangles. The first of these that
// gives good shapes is taken, else the best.
struct Attempt {
  double factor;
  int algorithm;  // gmsh's number: 1 Delaunay, 10 parallel Delaunay (here in one thread)
};
constexpr Attempt attempts[] = {{1, 1},     {1, 10},   {0.97, 1},  {1.03, 1},
                                {0.97, 10}, {0.94, 1}, {1.05, 10}, {0.91, 1}};
constexpr double good_quality = 0.2;

// gmsh does not ask whether it should stop, and there is nothing to be saved yet: an interrupt ends the
// process at once while it works.
class InterruptsEnd {
 public:
  InterruptsEnd() : interrupt_(std::signal(SIGINT, SIG_DFL)), terminate_(std::signal(SIGTERM, SIG_DFL)) {}
  ~InterruptsEnd() {
    std::signal(SIGINT, interrupt_);
    std::signal(SIGTERM, terminate_);
  }
  InterruptsEnd(const InterruptsEnd&) = delete;
  InterruptsEnd& operator=(const InterruptsEnd&) = delete;

 private:
  void (*interrupt_)(int);
  void (*terminate_)(int);
};

void generate(double size_mm, const Attempt& attempt,
              const std::function<double(double, double, double)>& field) {
  const auto set = gmsh::option::setNumber;
  const double factor = attempt.factor;
  set("Mesh.RandomSeed", 1);
  set("Mesh.Algorithm", 6);  // frontal Delaunay on surfaces: the most regular triangles
  set("Mesh.Algorithm3D", attempt.algorithm);
  set("Mesh.Optimize", 1);
  set("Mesh.OptimizeNetgen", 0);
  set("Mesh.OptimizeThreshold", 0.4);
  set("Mesh.CharacteristicLengthFromPoints", 0);
  set("Mesh.CharacteristicLengthExtendFromBoundary", field ? 0 : 1);
  set("Mesh.CharacteristicLengthMax", field ? 1e22 : factor * size_mm);
  set("Mesh.CharacteristicLengthMin", field ? 0 : factor * size_mm / 2);
  if (field)
    gmsh::model::mesh::setSizeCallback(
        [&](int, int, double x, double y, double z) { return factor * field(x, y, z); });
  const InterruptsEnd at_once;
  gmsh::model::mesh::clear();
  gmsh::model::mesh::generate(3);
  for (int pass = 0; pass < 3; ++pass) gmsh::model::mesh::optimize("", true);
  if (field) gmsh::model::mesh::removeSizeCallback();
}

// gmsh throws plain strings and numbers; its own words are in its log.
template <class Step>
void attempted(const Step& step) {
  try {
    step();
  } catch (const InputError&) {
    throw;
  } catch (...) {
    throw NumericalFailure("gmsh: " + last_words());
  }
}

TetMesh taken(const std::map<int, int>& tag_of_solid) {
  constexpr int tetrahedron = 4;
  TetMesh mesh;
  std::vector<std::size_t> corners;
  for (const auto& [solid, tag] : tag_of_solid) {
    std::vector<std::size_t> numbers, nodes;
    gmsh::model::mesh::getElementsByType(tetrahedron, numbers, nodes, solid);
    corners.insert(corners.end(), nodes.begin(), nodes.end());
    mesh.cell_tags.insert(mesh.cell_tags.end(), numbers.size(), tag);
  }
  std::vector<std::size_t> used = corners;
  std::sort(used.begin(), used.end());
  used.erase(std::unique(used.begin(), used.end()), used.end());
  std::vector<std::size_t> numbers;
  std::vector<double> coordinates, parameters;
  gmsh::model::mesh::getNodes(numbers, coordinates, parameters, -1, -1, false, false);
  std::unordered_map<std::size_t, std::size_t> row;
  for (std::size_t i = 0; i < numbers.size(); ++i) row[numbers[i]] = i;
  const auto position = [&](std::size_t node) {
    return static_cast<int>(std::lower_bound(used.begin(), used.end(), node) - used.begin());
  };
  for (const std::size_t node : used) {
    const double* x = &coordinates[3 * row.at(node)];
    mesh.points.push_back({1e-3 * x[0], 1e-3 * x[1], 1e-3 * x[2]});
  }
  for (std::size_t c = 0; c < mesh.cell_tags.size(); ++c) {
    mesh.cells.push_back({position(corners[4 * c]), position(corners[4 * c + 1]),
                          position(corners[4 * c + 2]), position(corners[4 * c + 3])});
    if (cell_volume(mesh, c) < 0) std::swap(mesh.cells[c][2], mesh.cells[c][3]);
  }
  return mesh;
}

}  // namespace

TetMesh mesh_solids(double size_mm, const std::function<std::map<int, int>()>& build,
                    const std::function<double(double, double, double)>& field) {
  const Session session;
  std::map<int, int> tags;
  attempted([&] { tags = build(); });
  TetMesh best;
  double best_quality = -1;
  std::string failure = "it made no sound tetrahedra";
  for (const Attempt& attempt : attempts) {
    TetMesh mesh;
    try {
      attempted([&] {
        generate(size_mm, attempt, field);
        mesh = taken(tags);
      });
    } catch (const NumericalFailure& error) {
      failure = error.what();
      continue;
    }
    if (mesh.cells.empty()) continue;
    improve_shapes(mesh);
    const double quality = lowest_quality(mesh);
    if (quality > best_quality) {
      best_quality = quality;
      best = std::move(mesh);
    }
    if (best_quality >= good_quality) break;
  }
  if (!(best_quality > 0))
    throw NumericalFailure(
        fmt::format("no mesh of this shape with size {} mm: {}; try another size", size_mm, failure));
  return best;
}

void stretch(const Solids& solids, const Point3& centre, const Point3& factors) {
  occ::dilate(solids, centre[0], centre[1], centre[2], factors[0], factors[1], factors[2]);
}

Solids solid_ellipsoid(const Point3& centre, const Point3& radii, double seam_deg) {
  const Solids solid = {{3, occ::addSphere(centre[0], centre[1], centre[2], 1)}};
  if (seam_deg != 0) occ::rotate(solid, centre[0], centre[1], centre[2], 0, 0, 1, seam_deg * M_PI / 180);
  stretch(solid, centre, radii);
  return solid;
}

Solids solid_cylinder(const Point3& foot, const Point3& axis, double radius) {
  return {{3, occ::addCylinder(foot[0], foot[1], foot[2], axis[0], axis[1], axis[2], radius)}};
}

Solids solid_box(const Point3& lowest, const Point3& extent) {
  return {{3, occ::addBox(lowest[0], lowest[1], lowest[2], extent[0], extent[1], extent[2])}};
}

Solids copy_of(const Solids& solids) {
  Solids copy;
  occ::copy(solids, copy);
  return copy;
}

Solids united(const Solids& a, const Solids& b) {
  Solids result;
  std::vector<Solids> map;
  occ::fuse(a, b, result, map);
  return result;
}

Solids difference(const Solids& a, const Solids& b) {
  Solids result;
  std::vector<Solids> map;
  occ::cut(a, b, result, map, -1, true, false);
  return result;
}

Solids intersection(const Solids& a, const Solids& b) {
  Solids result;
  std::vector<Solids> map;
  occ::intersect(a, b, result, map);
  return result;
}

std::map<int, int> assemble(const std::vector<std::pair<Solids, int>>& parts) {
  Solids all;
  std::vector<int> tag;
  for (const auto& [solids, part_tag] : parts)
    for (const auto& solid : solids) {
      all.push_back(solid);
      tag.push_back(part_tag);
    }
  Solids result;
  std::vector<Solids> map;
  if (all.size() == 1)
    map = {all};
  else
    occ::fragment({all.front()}, {all.begin() + 1, all.end()}, result, map);
  // Helper solids that were only cut with must not be meshed.
  occ::synchronize();
  std::map<int, int> tag_of_solid;
  for (std::size_t i = 0; i < map.size(); ++i)
    for (const auto& [dimension, number] : map[i])
      if (dimension == 3) tag_of_solid.emplace(number, tag[i]);
  Solids existing, spare;
  gmsh::model::getEntities(existing, 3);
  for (const auto& solid : existing)
    if (!tag_of_solid.count(solid.second)) spare.push_back(solid);
  if (!spare.empty()) {
    occ::remove(spare, true);
    occ::synchronize();
  }
  return tag_of_solid;
}

}  // namespace wiggers
