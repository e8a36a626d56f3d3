#include <algorithm>
#include <cstdlib>
#include <fstream>
#include <string>
#include <system_error>
#include <wiggers/core/file_kind.hpp>

namespace wiggers {

namespace {

constexpr std::size_t beginning_bytes = 1 << 14;  // all marks but that of a result stand in it

std::string next_part(std::ifstream& in, std::size_t bytes) {
  std::string part(bytes, '\0');
  in.read(part.data(), static_cast<std::streamsize>(bytes));
  part.resize(static_cast<std::size_t>(in.gcount()));
  return part;
}

bool has(std::string_view text, std::string_view part) { return text.find(part) != std::string_view::npos; }

// A result's group of provenance and its list of checksums. Where HDF5 keeps the names of entries depends on
// its version: the whole file is looked through.
bool holds_provenance(std::ifstream& in, std::string part) {
  constexpr std::string_view group = "provenance", list = "checksums";
  bool has_group = false, has_list = false;
  while (!part.empty()) {
    has_group = has_group || has(part, group);
    has_list = has_list || has(part, list);
    if (has_group && has_list) return true;
    const std::string end = part.substr(part.size() - std::min(part.size(), group.size() - 1));
    const std::string next = next_part(in, 1 << 20);
    part = next.empty() ? std::string() : end + next;
  }
  return false;
}

std::size_t commas(std::string_view line) {
  return static_cast<std::size_t>(std::count(line.begin(), line.end(), ','));
}

bool is_number(std::string text) {
  while (!text.empty() && (text.back() == ' ' || text.back() == '\r')) text.pop_back();
  char* end = nullptr;
  (void)std::strtod(text.c_str(), &end);
  return !text.empty() && *end == '\0';
}

// A row of so many numbers; `whole`: its end is there.
bool is_row(std::string_view row, std::size_t n_commas, bool whole) {
  if (whole ? commas(row) != n_commas : commas(row) > n_commas) return false;
  while (true) {
    const std::size_t comma = row.find(',');
    const bool last = comma == std::string_view::npos;
    if (last && !whole) return true;
    if (!is_number(std::string(row.substr(0, comma)))) return false;
    if (last) return true;
    row.remove_prefix(comma + 1);
  }
}

// Names in the first line and as many numbers in each of the others, the last of which may be cut off where
// the beginning ends.
bool is_table(std::string_view text) {
  if (has(text, std::string_view("\0", 1))) return false;
  const std::size_t end = text.find('\n');
  if (end == std::string_view::npos) return false;
  const std::string_view names = text.substr(0, end);
  std::string_view rest = text.substr(end + 1);
  if (names.find_first_not_of(" \r,") == std::string_view::npos || rest.empty()) return false;
  while (!rest.empty()) {
    const std::size_t line = rest.find('\n');
    const bool whole = line != std::string_view::npos;
    if (!is_row(rest.substr(0, line), commas(names), whole)) return false;
    rest.remove_prefix(whole ? line + 1 : rest.size());
  }
  return true;
}

// A saved cycle: the number of its format, and its model.
bool is_saved_cycle(std::string_view text) {
  constexpr std::string_view format = "\"format\":";
  const std::size_t at = text.find(format);
  if (!text.starts_with("{") || at == std::string_view::npos || !has(text, "\"model\":")) return false;
  const std::size_t value = text.find_first_not_of(" ", at + format.size());
  return value != std::string_view::npos && text[value] >= '0' && text[value] <= '9';
}

bool is_of_kind(std::ifstream& in, const std::string& text, FileKind kind) {
  const std::string_view view = text;
  switch (kind) {
    case FileKind::result:
      return view.starts_with("\x89HDF\r\n\x1a\n") && holds_provenance(in, text);
    case FileKind::table:
      return is_table(view);
    case FileKind::mesh:
      return view.starts_with("$MeshFormat") && has(view, mark_of_text);
    case FileKind::fields:
      return has(view.substr(0, 200), mark_of_text) && has(view, "<VTKFile type=\"UnstructuredGrid\"");
    case FileKind::series:
      return has(view.substr(0, 200), mark_of_series) && has(view, "<VTKFile type=\"Collection\"");
    case FileKind::state:
      return is_saved_cycle(view.substr(0, 200));
    case FileKind::study:
      return view.starts_with("{\n \"subject\":") || has(view, "\n| | method | setting | cost of ");
    case FileKind::picture:
      return (view.starts_with("\x89PNG") || has(view.substr(0, 1000), "<svg ")) && has(view, "Matplotlib");
    case FileKind::page:
      return view.starts_with("<!doctype html>") && has(view.substr(0, 300), mark_of_text);
  }
  return false;
}

}  // namespace

std::string_view name_of(FileKind kind) {
  switch (kind) {
    case FileKind::result:
      return "a result of wiggers (HDF5)";
    case FileKind::table:
      return "a table of numbers (CSV)";
    case FileKind::mesh:
      return "a mesh written by wiggers (.msh)";
    case FileKind::fields:
      return "fields written by wiggers (.vtu)";
    case FileKind::series:
      return "an index of fields written by wiggers (.pvd)";
    case FileKind::state:
      return "a saved limit cycle (JSON)";
    case FileKind::study:
      return "a study of wiggers";
    case FileKind::picture:
      return "a picture of a report";
    case FileKind::page:
      return "a report of wiggers (HTML)";
  }
  return {};
}

bool is_replaceable(const std::filesystem::path& path, FileKind kind) {
  std::error_code failed;
  if (!std::filesystem::is_regular_file(path, failed)) return true;
  std::ifstream in(path, std::ios::binary);
  if (!in) return false;  // what cannot be read cannot be told to be ours
  const std::string beginning = next_part(in, beginning_bytes);
  return beginning.empty() || is_of_kind(in, beginning, kind);
}

}  // namespace wiggers
