#include <fmt/format.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <set>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/files.hpp>
#include <wiggers/tissue/body/field_file.hpp>

namespace wiggers {

namespace fs = std::filesystem;

namespace {

std::string escaped(std::string_view text) {
  std::string result;
  for (char c : text) {
    if (c == '&')
      result += "&amp;";
    else if (c == '<')
      result += "&lt;";
    else if (c == '>')
      result += "&gt;";
    else if (c == '"')
      result += "&quot;";
    else
      result += c;
  }
  return result;
}

// The appended part of a VTU file: each array is preceded by its number of bytes.
class Appended {
 public:
  template <class T, class Source>
  std::string array(std::string_view type, std::string_view name, int components, std::size_t n,
                    Source source) {
    const std::size_t offset = bytes_.size();
    const std::uint64_t n_bytes = n * sizeof(T);
    bytes_.resize(offset + sizeof n_bytes + n_bytes);
    char* to = bytes_.data() + offset;
    std::memcpy(to, &n_bytes, sizeof n_bytes);
    to += sizeof n_bytes;
    for (std::size_t i = 0; i < n; ++i, to += sizeof(T)) {
      const T value = source(i);
      std::memcpy(to, &value, sizeof(T));
    }
    return fmt::format(
        "        <DataArray type=\"{}\" Name=\"{}\" NumberOfComponents=\"{}\" format=\"appended\" "
        "offset=\"{}\"/>\n",
        type, escaped(name), components, offset);
  }
  const std::string& bytes() const { return bytes_; }

 private:
  std::string bytes_;
};

template <class Field>
std::string field_arrays(Appended& appended, const std::vector<Field>& fields, std::size_t n,
                         std::string_view where, std::set<std::string> names) {
  std::string text;
  for (const Field& field : fields) {
    if (field.components != 1 && field.components != 3)
      throw InputError(
          fmt::format("field '{}' has {} components; it must have 1 or 3", field.name, field.components));
    const std::size_t expected = static_cast<std::size_t>(field.components) * n;
    if (field.values.size() != expected)
      throw InputError(fmt::format("field '{}' has {} values; {} {} with {} component{} need {}", field.name,
                                   field.values.size(), n, where, field.components,
                                   field.components == 1 ? "" : "s", expected));
    if (field.name.empty() || !names.insert(field.name).second)
      throw InputError(
          fmt::format("field name '{}' is {}", field.name, field.name.empty() ? "empty" : "used twice"));
    text += appended.array<float>("Float32", field.name, field.components, expected,
                                  [&](std::size_t i) { return static_cast<float>(field.values[i]); });
  }
  return text;
}

// Value of an attribute in a line of XML; empty if it is not there.
std::string attribute(std::string_view line, std::string_view name) {
  const std::string opening = fmt::format(" {}=\"", name);
  const auto begin = line.find(opening);
  if (begin == std::string_view::npos) return {};
  const auto end = line.find('"', begin + opening.size());
  if (end == std::string_view::npos) return {};
  return std::string(line.substr(begin + opening.size(), end - begin - opening.size()));
}

bool is_frame_name(std::string_view name) {
  constexpr std::string_view head = "frame_", tail = ".vtu";
  if (name.size() <= head.size() + tail.size() || !name.starts_with(head) || !name.ends_with(tail))
    return false;
  return std::all_of(name.begin() + head.size(), name.end() - tail.size(),
                     [](char c) { return c >= '0' && c <= '9'; });
}

}  // namespace

void write_vtu(const fs::path& path, const TetMesh& mesh, const std::vector<PointField>& point_fields,
               const std::vector<CellField>& cell_fields) {
  const std::size_t n_points = mesh.points.size(), n_cells = mesh.cells.size();
  Appended appended;
  std::string text = fmt::format("<?xml version=\"1.0\"?>\n<!-- {} -->\n", mark_of_text);
  text += fmt::format(
      "<VTKFile type=\"UnstructuredGrid\" version=\"1.0\" byte_order=\"{}\" header_type=\"UInt64\">\n"
      "  <UnstructuredGrid>\n    <Piece NumberOfPoints=\"{}\" NumberOfCells=\"{}\">\n",
      std::endian::native == std::endian::little ? "LittleEndian" : "BigEndian", n_points, n_cells);
  text += "      <PointData>\n";
  text += field_arrays(appended, point_fields, n_points, "points", {});
  text += "      </PointData>\n      <CellData>\n";
  text += appended.array<std::int32_t>("Int32", "tag", 1, n_cells,
                                       [&](std::size_t c) { return mesh.cell_tags[c]; });
  text += field_arrays(appended, cell_fields, n_cells, "cells", {"tag"});
  text += "      </CellData>\n      <Points>\n";
  text += appended.array<double>("Float64", "Points", 3, 3 * n_points,
                                 [&](std::size_t i) { return mesh.points[i / 3][i % 3]; });
  text += "      </Points>\n      <Cells>\n";
  text += appended.array<std::int32_t>("Int32", "connectivity", 1, 4 * n_cells,
                                       [&](std::size_t i) { return mesh.cells[i / 4][i % 4]; });
  text += appended.array<std::int32_t>("Int32", "offsets", 1, n_cells,
                                       [](std::size_t c) { return static_cast<std::int32_t>(4 * (c + 1)); });
  constexpr std::uint8_t vtk_tetrahedron = 10;
  text +=
      appended.array<std::uint8_t>("UInt8", "types", 1, n_cells, [](std::size_t) { return vtk_tetrahedron; });
  text += "      </Cells>\n    </Piece>\n  </UnstructuredGrid>\n  <AppendedData encoding=\"raw\">\n_";
  text += appended.bytes();
  text += "\n  </AppendedData>\n</VTKFile>\n";
  write_file_atomically(path, text);
}

FieldSeries::FieldSeries(fs::path path, const TetMesh& mesh, std::optional<double> resume_time_s)
    : folder_(std::move(path)), mesh_(mesh) {
  if (!folder_.has_filename()) folder_ = folder_.parent_path();  // "name.fields/"
  if (folder_.extension() != ".fields") folder_ += ".fields";
  std::error_code error;
  fs::create_directories(folder_, error);
  if (error || !fs::is_directory(folder_))
    throw ResourceError(fmt::format("cannot make the folder '{}': {}", folder_.string(),
                                    error ? error.message() : "a file of this name is in the way"));
  if (resume_time_s && fs::exists(index())) {
    const std::string text = read_own_file(index());
    if (text.find("</VTKFile>") == std::string::npos)
      throw InputError(fmt::format("'{}' is no index of a field series", index().string()));
    if (text.find(mesh_line()) == std::string::npos)
      throw InputError(fmt::format("'{}' belongs to another mesh; this one has {} points and {} cells",
                                   index().string(), mesh_.points.size(), mesh_.cells.size()));
    // Times that went through a file and back may differ in the last digits.
    const double last = *resume_time_s + 1e-9 * std::max(1.0, std::abs(*resume_time_s));
    for (std::size_t begin = 0; begin < text.size();) {
      const std::size_t end = std::min(text.find('\n', begin), text.size());
      const std::string_view line = std::string_view(text).substr(begin, end - begin);
      begin = end + 1;
      if (line.find("<DataSet ") == std::string_view::npos) continue;
      const Frame frame{parse_number(attribute(line, "timestep"), index().string()), attribute(line, "file")};
      if (frame.time_s <= last && is_frame_name(frame.file) && fs::exists(folder_ / frame.file))
        frames_.push_back(frame);
    }
  }
  // First the index, then the frames: at no moment does it name a file that is gone.
  write_index();
  remove_unlisted_frames();
}

void FieldSeries::write(double time_s, const std::vector<PointField>& point_fields,
                        const std::vector<CellField>& cell_fields) {
  if (!std::isfinite(time_s) || (!frames_.empty() && time_s <= frames_.back().time_s))
    throw InputError(fmt::format("field series '{}': time {} s does not follow the last frame's, {} s",
                                 folder_.string(), to_text(time_s),
                                 frames_.empty() ? "none" : to_text(frames_.back().time_s)));
  const Frame frame{time_s, fmt::format("frame_{:06}.vtu", frames_.size())};
  write_vtu(folder_ / frame.file, mesh_, point_fields, cell_fields);
  frames_.push_back(frame);
  write_index();
}

std::string FieldSeries::mesh_line() const {
  return fmt::format("{}{} points, {} cells -->", mark_of_series, mesh_.points.size(), mesh_.cells.size());
}

void FieldSeries::write_index() const {
  std::string text =
      "<?xml version=\"1.0\"?>\n" + mesh_line() +
      "\n<VTKFile type=\"Collection\" version=\"1.0\" byte_order=\"LittleEndian\">\n  <Collection>\n";
  for (const Frame& frame : frames_)
    text += fmt::format("    <DataSet timestep=\"{}\" part=\"0\" file=\"{}\"/>\n", to_text(frame.time_s),
                        frame.file);
  write_file_atomically(index(), text + "  </Collection>\n</VTKFile>\n");
}

void FieldSeries::remove_unlisted_frames() const {
  std::set<std::string> listed;
  for (const Frame& frame : frames_) listed.insert(frame.file);
  std::vector<fs::path> superfluous;
  for (const auto& entry : fs::directory_iterator(folder_)) {
    const std::string name = entry.path().filename().string();
    // A kill in the middle of a frame leaves its unfinished neighbour (see write_file_atomically).
    const bool unfinished =
        (name.starts_with("frame_") || name.starts_with("index.pvd.")) && name.ends_with(".partial");
    if (unfinished || (is_frame_name(name) && !listed.contains(name))) superfluous.push_back(entry.path());
  }
  for (const fs::path& path : superfluous) fs::remove(path);
}

std::string series_beside(const std::filesystem::path& result, const std::string& name) {
  std::string base = result.string();
  if (base.ends_with(".h5")) base.resize(base.size() - 3);
  return base + "." + name;
}

}  // namespace wiggers
