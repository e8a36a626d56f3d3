#include <fmt/format.h>

#include <iterator>
#include <set>
#include <string>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/files.hpp>
#include <wiggers/tissue/mesh/read.hpp>

namespace wiggers {

namespace {
template <class Tags>
std::string name_of(const Tags& tags, int tag, std::string_view otherwise) {
  for (const auto& t : tags)
    if (t.tag == tag) return std::string(t.name);
  return fmt::format("{}-{}", otherwise, tag);
}
}  // namespace

void write_msh(const TetMesh& mesh, const std::filesystem::path& path) {
  const std::set<int> volumes(mesh.cell_tags.begin(), mesh.cell_tags.end());
  const std::set<int> surfaces(mesh.facet_tags.begin(), mesh.facet_tags.end());
  std::string text = fmt::format(
      "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Comments\n{}; unit: mm\n$EndComments\n", mark_of_text);
  auto out = std::back_inserter(text);
  fmt::format_to(out, "$PhysicalNames\n{}\n", volumes.size() + surfaces.size());
  for (const int tag : surfaces)
    fmt::format_to(out, "2 {} \"{}\"\n", tag, name_of(mesh_tags::surfaces, tag, "surface"));
  for (const int tag : volumes)
    fmt::format_to(out, "3 {} \"{}\"\n", tag, name_of(mesh_tags::volumes, tag, "volume"));
  fmt::format_to(out, "$EndPhysicalNames\n$Nodes\n{}\n", mesh.points.size());
  for (std::size_t p = 0; p < mesh.points.size(); ++p) {
    const auto& x = mesh.points[p];
    fmt::format_to(out, "{} {:.17g} {:.17g} {:.17g}\n", p + 1, 1e3 * x[0], 1e3 * x[1], 1e3 * x[2]);
  }
  fmt::format_to(out, "$EndNodes\n$Elements\n{}\n", mesh.facets.size() + mesh.cells.size());
  std::size_t number = 0;
  for (std::size_t f = 0; f < mesh.facets.size(); ++f) {
    const auto& p = mesh.facets[f];
    const int tag = mesh.facet_tags[f];
    fmt::format_to(out, "{} 2 2 {} {} {} {} {}\n", ++number, tag, tag, p[0] + 1, p[1] + 1, p[2] + 1);
  }
  for (std::size_t c = 0; c < mesh.cells.size(); ++c) {
    const auto& p = mesh.cells[c];
    const int tag = mesh.cell_tags[c];
    fmt::format_to(out, "{} 4 2 {} {} {} {} {} {}\n", ++number, tag, tag, p[0] + 1, p[1] + 1, p[2] + 1,
                   p[3] + 1);
  }
  text += "$EndElements\n";
  write_file_atomically(path, text);
}

}  // namespace wiggers
