// CARP: points, elements and fibres in three text files of one name, lengths in micrometres.
#include <fmt/format.h>

#include <wiggers/core/errors.hpp>
#include <wiggers/core/files.hpp>
#include <wiggers/tissue/mesh/raw.hpp>

namespace wiggers {

namespace {

void parse_points(MeshScanner& in, TetMesh& mesh) {
  const std::size_t n = in.count("number of points");
  for (std::size_t i = 0; i < n; ++i) {
    Point3 x;
    for (double& c : x) c = in.real("coordinate");
    mesh.points.push_back(x);
  }
}

void parse_elements(MeshScanner& in, TetMesh& mesh) {
  const std::size_t n = in.count("number of elements");
  in.line();
  for (std::size_t i = 0; i < n; ++i) {
    const std::string_view type = in.word("element type");
    if (type != "Tt") refuse_element(in, type);
    std::array<int, 4> cell;
    for (int& p : cell) {
      const long long index = in.integer("point of an element");
      if (index < 0 || index >= static_cast<long long>(mesh.points.size()))
        in.fail(fmt::format("an element uses point {}; allowed 0 to {}", index, mesh.points.size() - 1));
      p = static_cast<int>(index);
    }
    const std::string_view rest = in.line();
    int tag = 0;
    if (rest.find_first_not_of(" \t") != std::string_view::npos) {
      MeshScanner end(rest, in.file());
      tag = static_cast<int>(end.integer("region of an element"));
    }
    mesh.cells.push_back(cell);
    mesh.cell_tags.push_back(tag);
  }
}

// Returns how many cells had no fibre.
std::size_t parse_fibres(MeshScanner& in, TetMesh& mesh) {
  const long long axes = in.integer("number of axes");
  if (axes != 1 && axes != 2)
    in.fail(fmt::format("{} axes an element; allowed 1 (fibre) or 2 (fibre, sheet)", axes));
  std::size_t without = 0;
  for (std::size_t c = 0; c < mesh.cells.size(); ++c) {
    Point3 fibre{}, sheet{};
    for (double& x : fibre) x = in.real("fibre of an element");
    if (axes == 2)
      for (double& x : sheet) x = in.real("sheet of an element");
    if (fibre == Point3{}) ++without;
    mesh.cell_frames.push_back(completed_frame(fibre, sheet));
  }
  if (!in.at_end()) in.fail(fmt::format("more fibres than the {} elements", mesh.cells.size()));
  return without;
}

}  // namespace

RawMesh parse_carp(const std::filesystem::path& path) {
  std::filesystem::path base = path;
  if (path.extension() == ".pts" || path.extension() == ".elem" || path.extension() == ".lon")
    base.replace_extension();
  const auto part = [&](const char* ending) { return base.string() + ending; };
  RawMesh raw;
  raw.usual = MeshUnit::micrometre;
  const std::string points = read_file(part(".pts")), elements = read_file(part(".elem"));
  MeshScanner point_file(points, part(".pts")), element_file(elements, part(".elem"));
  parse_points(point_file, raw.mesh);
  parse_elements(element_file, raw.mesh);
  if (std::filesystem::exists(part(".lon"))) {
    const std::string fibres = read_file(part(".lon"));
    MeshScanner fibre_file(fibres, part(".lon"));
    const std::size_t without = parse_fibres(fibre_file, raw.mesh);
    if (without > 0)
      raw.notes.push_back(fmt::format("{} cells have no fibre; their frame is the axes", without));
  }
  return raw;
}

}  // namespace wiggers
