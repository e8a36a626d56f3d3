// What kind of file stands somewhere, by its content: a file is replaced only by one of its own kind.
//
// Names say little: a scene, a mesh or a picture under the name of an output is somebody's work and would be
// lost. Every kind of output therefore carries a mark by which it is known again.
#pragma once

#include <filesystem>
#include <string_view>

namespace wiggers {

enum class FileKind {
  result,   // HDF5, written by ResultWriter
  table,    // CSV: names, then rows of numbers
  mesh,     // gmsh, written by write_msh
  fields,   // VTU, written by write_vtu
  series,   // the index of a field series (PVD)
  state,    // JSON, a saved limit cycle
  study,    // JSON or Markdown of trade and extremes
  picture,  // PNG or SVG, drawn for a report
  page,     // HTML, a report
};

// "a result of wiggers (HDF5)", for messages.
std::string_view name_of(FileKind kind);

// Of a file of a report, by its name.
inline FileKind kind_of_report_file(std::string_view name) {
  return name.ends_with(".html") ? FileKind::page : FileKind::picture;
}

// Whether the file may be replaced by one of that kind: it is of that kind, or there is nothing to be lost
// (no file, an empty one, a device).
bool is_replaceable(const std::filesystem::path& path, FileKind kind);

// Marks that writers put into their files, and by which these are known again.
inline constexpr std::string_view mark_of_text = "written by wiggers";
inline constexpr std::string_view mark_of_series = "<!-- mesh: ";

}  // namespace wiggers
