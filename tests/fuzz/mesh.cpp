// Meshes: the first byte says which kind of file the rest is; of CARP the three files are divided by a line
// "%%". What is read is sound in itself and can be checked.
#include <array>
#include <cmath>
#include <string>
#include <vector>
#include <wiggers/tissue/mesh/check.hpp>
#include <wiggers/tissue/mesh/read.hpp>

#include "fuzzing.hpp"

namespace {

std::filesystem::path put(char kind, std::string_view bytes) {
  switch (kind) {
    case 'k':
      return fuzzing::file("mesh.vtk", bytes);
    case 'u':
      return fuzzing::file("mesh.vtu", bytes);
    case 'c': {
      static constexpr std::array<const char*, 3> endings = {".pts", ".elem", ".lon"};
      for (const char* ending : endings)
        std::filesystem::remove(fuzzing::folder() / (std::string("mesh") + ending));
      for (const char* ending : endings) {
        const std::size_t end = bytes.find("%%\n");
        fuzzing::file(std::string("mesh") + ending, bytes.substr(0, end));
        if (end == std::string_view::npos) break;
        bytes.remove_prefix(end + 3);
      }
      return fuzzing::folder() / "mesh.pts";
    }
    default:
      return fuzzing::file("mesh.msh", bytes);
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  fuzzing::must_end_in_words([&] {
    const std::filesystem::path path =
        put(static_cast<char>(data[0]), {reinterpret_cast<const char*>(data) + 1, size - 1});
    std::vector<std::string> notes;
    const wiggers::TetMesh mesh = wiggers::read_mesh(path, wiggers::MeshUnit::automatic, &notes);
    fuzzing::require(!mesh.cells.empty() && mesh.cells.size() == mesh.cell_tags.size(), "tags of cells");
    fuzzing::require(mesh.facets.size() == mesh.facet_tags.size(), "tags of facets");
    const int n = static_cast<int>(mesh.points.size());
    for (const auto& point : mesh.points)
      for (const double x : point) fuzzing::require(std::isfinite(x), "a point");
    for (const auto& cell : mesh.cells)
      for (const int p : cell) fuzzing::require(p >= 0 && p < n, "a cell's point");
    for (const auto& facet : mesh.facets)
      for (const int p : facet) fuzzing::require(p >= 0 && p < n, "a facet's point");
    fuzzing::require(mesh.cell_frames.empty() || mesh.cell_frames.size() == mesh.cells.size(),
                     "frames of cells");
    const wiggers::MeshReport report = wiggers::check_mesh(mesh);
    const std::string text = wiggers::report_text(report);
    fuzzing::require(text.find("nan") == std::string::npos, "a report with nan");
  });
  return 0;
}
