// Fibres of a file, lines without angles: where they turn too far from cell to cell to be averaged.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <wiggers/tissue/fibres/fibres.hpp>
#include <wiggers/tissue/mesh/geometry.hpp>

namespace wiggers {

AmbiguousTurns ambiguous_turns(const TetMesh& mesh, const FibreField& field) {
  AmbiguousTurns turns;
  if (field.cell_frames.empty()) return turns;
  // The wall's own turns, about its corners and the apex, are no turns of the fibres within it, nor those of
  // the wall around straight fibres: they must turn both in the wall's axes and in space.
  FibreField wall;
  wall.frames = field.axes;
  const std::size_t n = mesh.cells.size();
  std::vector<Frame> axes(n);
  std::vector<double> angle_deg(n);
  for (std::size_t c = 0; c < n; ++c) {
    if (!mesh_tags::conductive(mesh.cell_tags[c])) continue;
    axes[c] = frame_at(wall, mesh, static_cast<int>(c), {0.25, 0.25, 0.25, 0.25});
    const Point3& fibre = field.cell_frames[c][0];
    angle_deg[c] = std::atan2(dot(fibre, axes[c][1]), dot(fibre, axes[c][0])) * 180 / std::numbers::pi;
  }
  std::vector<char> ambiguous(n, 0);
  const auto faces = sorted_faces(mesh.cells);
  for (std::size_t i = 1; i < faces.size(); ++i) {
    const auto a = static_cast<std::size_t>(faces[i - 1].cell), b = static_cast<std::size_t>(faces[i].cell);
    if (faces[i].corners != faces[i - 1].corners || !mesh_tags::conductive(mesh.cell_tags[a]) ||
        !mesh_tags::conductive(mesh.cell_tags[b]))
      continue;
    // Axes have no sign either: with e_l or e_n alone the other way round, the angle changes its sign.
    const double sign = dot(axes[a][2], axes[b][2]) < 0 ? -1 : 1;
    const double within_wall = std::abs(std::remainder(angle_deg[a] - sign * angle_deg[b], 180.0));
    const double cosine = std::abs(dot(field.cell_frames[a][0], field.cell_frames[b][0]));
    const double in_space = std::acos(std::min(1.0, cosine)) * 180 / std::numbers::pi;
    if (std::min(within_wall, in_space) >= AmbiguousTurns::from_deg) ambiguous[a] = ambiguous[b] = 1;
  }
  for (std::size_t c = 0; c < n; ++c)
    if (ambiguous[c] && turns.cells++ == 0) turns.first = static_cast<int>(c);
  return turns;
}

std::string turns_text(const TetMesh& mesh, const AmbiguousTurns& turns) {
  return fmt::format(
      "in {} of {} cells the file's fibres turn by {:g} degrees or more to a neighbour, the first is cell {} "
      "at "
      "{}. They are lines: which way round they turn is not known, and their mean at vertices may be at a "
      "right "
      "angle to them. Remedy: give fibres on a mesh with more cells across the wall, or use a rule (bayer, "
      "doste), which knows its angles",
      turns.cells, mesh.cells.size(), AmbiguousTurns::from_deg, turns.first,
      place_text(cell_centre(mesh, static_cast<std::size_t>(turns.first))));
}

}  // namespace wiggers
