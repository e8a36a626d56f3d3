#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/files.hpp>
#include <wiggers/tissue/mesh/geometry.hpp>
#include <wiggers/tissue/mesh/raw.hpp>
#include <wiggers/tissue/mesh/read.hpp>

namespace wiggers {

namespace {

struct Unit {
  MeshUnit unit;
  std::string_view name;
  double metres;
};
// In the order in which they are tried.
constexpr Unit units[] = {{MeshUnit::millimetre, "mm", 1e-3},
                          {MeshUnit::centimetre, "cm", 1e-2},
                          {MeshUnit::metre, "m", 1},
                          {MeshUnit::micrometre, "um", 1e-6}};
constexpr double smallest_usual_m = 20e-3, largest_usual_m = 250e-3;

const Unit& unit_of(MeshUnit unit) {
  return *std::find_if(std::begin(units), std::end(units), [&](const Unit& u) { return u.unit == unit; });
}

Point3 extent_of(const TetMesh& mesh) {
  Point3 low = mesh.points.front(), high = low;
  for (const Point3& x : mesh.points)
    for (std::size_t k = 0; k < 3; ++k) {
      low[k] = std::min(low[k], x[k]);
      high[k] = std::max(high[k], x[k]);
    }
  return high - low;
}

void drop_unused_points(TetMesh& mesh, std::vector<std::string>& notes) {
  std::vector<int> place(mesh.points.size(), -1);
  for (const auto& cell : mesh.cells)
    for (const int p : cell) place[static_cast<std::size_t>(p)] = 0;
  // A facet on points of no cell is refused later, with its place.
  for (const auto& facet : mesh.facets)
    for (const int p : facet) place[static_cast<std::size_t>(p)] = 0;
  std::vector<Point3> kept;
  for (std::size_t p = 0; p < place.size(); ++p)
    if (place[p] == 0) {
      place[p] = static_cast<int>(kept.size());
      kept.push_back(mesh.points[p]);
    }
  if (kept.size() == mesh.points.size()) return;
  notes.push_back(
      fmt::format("{} points belong to no cell and are left out", mesh.points.size() - kept.size()));
  mesh.points = std::move(kept);
  for (auto& cell : mesh.cells)
    for (int& p : cell) p = place[static_cast<std::size_t>(p)];
  for (auto& facet : mesh.facets)
    for (int& p : facet) p = place[static_cast<std::size_t>(p)];
}

void choose_unit(RawMesh& raw, MeshUnit wanted, std::vector<std::string>& notes) {
  const Point3 extent = extent_of(raw.mesh);
  const double longest = *std::max_element(extent.begin(), extent.end());
  const auto usual = [&](const Unit& u) {
    return longest * u.metres >= smallest_usual_m && longest * u.metres <= largest_usual_m;
  };
  const Unit* unit = nullptr;
  if (wanted != MeshUnit::automatic) {
    unit = &unit_of(wanted);
  } else if (raw.stated != MeshUnit::automatic) {
    unit = &unit_of(raw.stated);
  } else {
    unit = &unit_of(raw.usual);
    if (!usual(*unit))
      if (const auto* fits = std::find_if(std::begin(units), std::end(units), usual); fits != std::end(units))
        unit = fits;
    notes.push_back(fmt::format("lengths taken as {}: the mesh measures {:.4g} x {:.4g} x {:.4g} mm",
                                unit->name, 1e3 * unit->metres * extent[0], 1e3 * unit->metres * extent[1],
                                1e3 * unit->metres * extent[2]));
  }
  for (Point3& x : raw.mesh.points) x = unit->metres * x;
}

void check_cells(TetMesh& mesh, const std::string& file, std::vector<std::string>& notes) {
  std::size_t flipped = 0;
  for (std::size_t c = 0; c < mesh.cells.size(); ++c) {
    auto& cell = mesh.cells[c];
    auto sorted = cell;
    std::sort(sorted.begin(), sorted.end());
    if (std::adjacent_find(sorted.begin(), sorted.end()) != sorted.end())
      throw InputError(
          fmt::format("{}: cell {} at {} uses a point twice", file, c, place_text(cell_centre(mesh, c))));
    double longest = 0;
    for (std::size_t i = 0; i < 4; ++i)
      for (std::size_t k = 0; k < i; ++k)
        longest = std::max(longest, norm(mesh.points[static_cast<std::size_t>(cell[i])] -
                                         mesh.points[static_cast<std::size_t>(cell[k])]));
    const double volume = cell_volume(mesh, c);
    if (!(std::abs(volume) > 1e-12 * longest * longest * longest))
      throw InputError(fmt::format(
          "{}: cell {} (tag {}) at {} has no volume: its corners lie in a plane. Remesh or optimise there",
          file, c, mesh.cell_tags[c], place_text(cell_centre(mesh, c))));
    if (volume < 0) {
      std::swap(cell[2], cell[3]);
      ++flipped;
    }
  }
  if (flipped > 0)
    notes.push_back(
        fmt::format("{} of {} cells were left-handed and are turned", flipped, mesh.cells.size()));
}

// Two cells on the same face may only lie on either side of it, and three cannot.
void check_faces(const TetMesh& mesh, const std::vector<CellFace>& faces, const std::string& file) {
  for (std::size_t i = 1; i < faces.size(); ++i) {
    if (faces[i].corners != faces[i - 1].corners) continue;
    const auto opposite = [&](const CellFace& face) {
      return mesh.cells[static_cast<std::size_t>(face.cell)][static_cast<std::size_t>(face.opposite)];
    };
    const std::string place = place_text(cell_centre(mesh, static_cast<std::size_t>(faces[i].cell)));
    if (opposite(faces[i]) == opposite(faces[i - 1]))
      throw InputError(fmt::format("{}: cells {} and {} at {} are the same tetrahedron", file,
                                   faces[i - 1].cell, faces[i].cell, place));
    if (i > 1 && faces[i].corners == faces[i - 2].corners)
      throw InputError(fmt::format("{}: cells {}, {} and {} at {} share one face; cells overlap", file,
                                   faces[i - 2].cell, faces[i - 1].cell, faces[i].cell, place));
  }
}

void attach_facets(TetMesh& mesh, const std::vector<CellFace>& faces, const std::string& file,
                   std::vector<std::string>& notes) {
  struct Side {
    std::array<int, 3> corners;  // ascending
    std::size_t facet;
  };
  std::vector<Side> sides;
  for (std::size_t f = 0; f < mesh.facets.size(); ++f) sides.push_back({ascending(mesh.facets[f]), f});
  std::sort(sides.begin(), sides.end(), [](const Side& a, const Side& b) {
    return a.corners != b.corners ? a.corners < b.corners : a.facet < b.facet;
  });
  std::vector<char> keep(mesh.facets.size(), 1);
  std::size_t twice = 0, inner = 0;
  for (std::size_t i = 0; i < sides.size(); ++i) {
    const std::size_t f = sides[i].facet;
    const int tag = mesh.facet_tags[f];
    const auto place = [&] { return place_text(facet_centre(mesh, f)); };
    if (i > 0 && sides[i].corners == sides[i - 1].corners) {
      if (mesh.facet_tags[sides[i - 1].facet] != tag)
        throw InputError(fmt::format("{}: the triangle at {} has two tags, {} and {}", file, place(),
                                     mesh.facet_tags[sides[i - 1].facet], tag));
      keep[f] = 0;
      ++twice;
      continue;
    }
    const auto [first, last] =
        std::equal_range(faces.begin(), faces.end(), CellFace{sides[i].corners, 0, 0},
                         [](const CellFace& a, const CellFace& b) { return a.corners < b.corners; });
    if (first == last)
      throw InputError(
          fmt::format("{}: the triangle with tag {} at {} is no side of any cell; surface and volume "
                      "meshes do not fit. Mesh both together",
                      file, tag, place()));
    if (last - first > 1) {
      keep[f] = 0;
      ++inner;
      continue;
    }
    const auto& cell = mesh.cells[static_cast<std::size_t>(first->cell)];
    for (std::size_t k = 0; k < 3; ++k)
      mesh.facets[f][k] = cell[static_cast<std::size_t>(opposite_face[first->opposite][k])];
  }
  if (twice > 0) notes.push_back(fmt::format("{} triangles stand twice and are used once", twice));
  if (inner > 0)
    notes.push_back(fmt::format("{} tagged triangles lie between two cells and are left out", inner));
  std::size_t kept = 0;
  for (std::size_t f = 0; f < keep.size(); ++f)
    if (keep[f]) {
      mesh.facets[kept] = mesh.facets[f];
      mesh.facet_tags[kept++] = mesh.facet_tags[f];
    }
  mesh.facets.resize(kept);
  mesh.facet_tags.resize(kept);
}

std::string ending_of(const std::filesystem::path& path) {
  std::string ending = path.extension().string();
  std::transform(ending.begin(), ending.end(), ending.begin(),
                 [](unsigned char c) { return std::tolower(c); });
  return ending;
}

bool is_carp(const std::filesystem::path& path) {
  const std::string ending = ending_of(path);
  return ending == ".pts" || ending == ".elem" || ending == ".lon" ||
         (!std::filesystem::exists(path) && std::filesystem::exists(path.string() + ".pts"));
}

RawMesh parse(const std::filesystem::path& path) {
  if (is_carp(path)) return parse_carp(path);
  const std::string ending = ending_of(path);
  if (ending != ".msh" && ending != ".vtk" && ending != ".vtu")
    throw InputError(
        fmt::format("{}: unknown kind of mesh file '{}'; known: .msh (gmsh), .vtk, .vtu, .pts with .elem "
                    "(CARP)",
                    path.string(), ending));
  if (!std::filesystem::exists(path))
    throw ResourceError(fmt::format("{}: no such mesh file", path.string()));
  const std::string text = read_file(path);
  if (ending == ".msh") return parse_gmsh(text, path.string());
  return ending == ".vtk" ? parse_vtk(text, path.string()) : parse_vtu(text, path.string());
}

}  // namespace

std::vector<std::filesystem::path> mesh_files(const std::filesystem::path& path) {
  if (!is_carp(path)) return {path};
  std::filesystem::path base = path;
  if (const std::string ending = ending_of(path); ending == ".pts" || ending == ".elem" || ending == ".lon")
    base.replace_extension();
  std::vector<std::filesystem::path> parts;
  for (const char* ending : {".pts", ".elem", ".lon"})
    if (std::filesystem::exists(base.string() + ending)) parts.emplace_back(base.string() + ending);
  return parts;
}

MeshUnit mesh_unit(std::string_view name) {
  if (name == "auto") return MeshUnit::automatic;
  std::vector<std::string> known = {"auto"};
  for (const Unit& u : units) {
    if (u.name == name) return u.unit;
    known.emplace_back(u.name);
  }
  refuse_unknown("unit of length", name, known);
}

TetMesh read_mesh(const std::filesystem::path& path, MeshUnit unit, std::vector<std::string>* notes) {
  const std::string file = path.string();
  RawMesh raw = parse(path);
  TetMesh& mesh = raw.mesh;
  std::vector<std::string> own = std::move(raw.notes);
  if (mesh.cells.empty())
    throw InputError(fmt::format("{}: no tetrahedra; a surface mesh must be filled first (gmsh -3)", file));
  for (const Point3& x : mesh.points)
    if (!std::isfinite(x[0] + x[1] + x[2])) throw InputError(fmt::format("{}: a point is not finite", file));
  drop_unused_points(mesh, own);
  choose_unit(raw, unit, own);
  check_cells(mesh, file, own);
  const auto faces = sorted_faces(mesh.cells);
  check_faces(mesh, faces, file);
  attach_facets(mesh, faces, file, own);
  if (notes) notes->insert(notes->end(), own.begin(), own.end());
  return std::move(raw.mesh);
}

}  // namespace wiggers
