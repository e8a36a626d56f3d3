// Does a mesh fit its purpose? Figures and findings, each finding with what to do.
#pragma once

#include <cstddef>
#include <span>
#include <string>
#include <string_view>
#include <vector>
#include <wiggers/tissue/mesh/mesh.hpp>

namespace wiggers {

struct MeshVolume {
  int tag = 0;
  std::size_t cells = 0;
  double volume_mL = 0;
};

struct MeshSurface {
  int tag = 0;
  std::size_t facets = 0;
  double area_cm2 = 0;
  double gap = 0;               // |sum of N dA| over the area; 0 if closed
  std::size_t open_edges = 0;   // edges that do not belong to exactly two of its facets
  Point3 first_open_edge_mm{};  // middle
  bool closed = false;          // no open edge and gap <= 1e-10
  double enclosed_mL = 0;       // the cavity, if closed; negative for an outer surface
};

struct MeshFinding {
  enum class Severity { error, warning };
  Severity severity = Severity::warning;
  std::string text;
  std::string remedy;
};

struct MeshReport {
  std::size_t points = 0, cells = 0, facets = 0;
  Point3 extent_mm{};
  std::vector<MeshVolume> volumes;    // ascending tags
  std::vector<MeshSurface> surfaces;  // ascending tags
  // Quality: gmsh's gamma, 3 x inscribed / circumscribed radius; 1 for the regular tetrahedron.
  double lowest_quality = 1, quality_of_worst_percent = 1, mean_quality = 1;
  std::size_t worst_cell = 0;
  int worst_tag = 0;
  Point3 worst_place_mm{};
  double smallest_angle_deg = 0;  // between two faces of a cell
  std::size_t untagged_triangles = 0;
  std::size_t hinges = 0;             // edges with more than two outer triangles
  std::size_t coincident_points = 0;  // at the place of another point: the parts do not hang together there
  int ventricular_pieces = 0, atrial_pieces = 0;
  // Share of the conductive cells with an edge straight through a wall, from one surface to the other.
  double thin_share = 0;
  std::vector<MeshFinding> findings;  // errors first
};

MeshReport check_mesh(const TetMesh& mesh);

// The report as text, one finding a line at the end.
std::string report_text(const MeshReport& report);

// Throws InputError with the first errors unless the mesh has none and has each of the closed cavities
// (mesh_tags::endocardium_LV ...). `place` names the file or the scene's key. Returns the warnings.
std::vector<std::string> require_sound(const TetMesh& mesh, std::span<const int> closed_cavities,
                                       std::string_view place);

}  // namespace wiggers
