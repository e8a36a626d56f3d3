// VTK: legacy text files (.vtk) and XML files (.vtu: text, base64 or raw, not compressed). The tag is the
// cell array with one of tag_names; cell vectors "fibre" (and "sheet") give frames.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <wiggers/tissue/mesh/raw.hpp>

namespace wiggers {

namespace {

constexpr std::string_view tag_names[] = {"tag",      "tags",       "cell_tags",     "elemTag",      "region",
                                          "material", "MaterialID", "CellEntityIds", "gmsh:physical"};
constexpr std::string_view fibre_names[] = {"fibre", "fibres", "fiber", "fibers", "f0"};
constexpr std::string_view sheet_names[] = {"sheet", "sheets", "s0"};

template <std::size_t N>
const std::vector<double>* pick(const std::map<std::string, std::vector<double>>& arrays,
                                const std::string_view (&names)[N], std::size_t size) {
  for (const std::string_view name : names)
    if (const auto found = arrays.find(std::string(name));
        found != arrays.end() && found->second.size() == size)
      return &found->second;
  return nullptr;
}

struct VtkCells {
  std::vector<long long> connectivity, ends;  // ends[c]: one past the last corner of cell c
  std::vector<long long> types;
  std::map<std::string, std::vector<double>> arrays;  // by cell
};

std::string type_name(long long type) {
  constexpr std::string_view names[] = {"empty",      "vertex",        "poly vertex",    "line",
                                        "poly line",  "triangle",      "triangle strip", "polygon",
                                        "pixel",      "quadrangle",    "tetrahedron",    "voxel",
                                        "hexahedron", "wedge (prism)", "pyramid"};
  if (type >= 0 && type < static_cast<long long>(std::size(names))) return std::string(names[type]);
  return type == 24 ? "tetrahedron of order 2" : fmt::format("number {} of VTK", type);
}

void take_cells(const MeshScanner& in, const VtkCells& cells, RawMesh& raw) {
  constexpr int triangle = 5, tetrahedron = 10;
  const std::size_t n = cells.types.size();
  if (cells.ends.size() != n) in.fail(fmt::format("{} cells but {} types of cells", cells.ends.size(), n));
  const auto* tags = pick(cells.arrays, tag_names, n);
  const auto* fibre = pick(cells.arrays, fibre_names, 3 * n);
  const auto* sheet = pick(cells.arrays, sheet_names, 3 * n);
  if (!tags)
    raw.notes.push_back(
        "no cell array named tag, region, material or alike: all cells have tag 1, no surfaces are tagged");
  long long start = 0;
  for (std::size_t c = 0; c < n; ++c) {
    const long long end = cells.ends[c], type = cells.types[c];
    if (end < start || end > static_cast<long long>(cells.connectivity.size()))
      in.fail(fmt::format("cell {} ends at corner {} of {}", c, end, cells.connectivity.size()));
    if (type != triangle && type != tetrahedron) {
      if (type > 4) refuse_element(in, type_name(type));
      start = end;
      continue;
    }
    const long long corners = type == triangle ? 3 : 4;
    if (end - start != corners)
      in.fail(fmt::format("cell {} ({}) has {} corners", c, type_name(type), end - start));
    std::array<int, 4> cell{};
    for (long long k = 0; k < corners; ++k) {
      const long long p = cells.connectivity[static_cast<std::size_t>(start + k)];
      if (p < 0 || p >= static_cast<long long>(raw.mesh.points.size()))
        in.fail(fmt::format("cell {} uses point {}; allowed 0 to {}", c, p,
                            static_cast<long long>(raw.mesh.points.size()) - 1));
      cell[static_cast<std::size_t>(k)] = static_cast<int>(p);
    }
    start = end;
    if (tags && !(std::abs((*tags)[c]) < 1e9)) in.fail(fmt::format("cell {} has the tag {}", c, (*tags)[c]));
    const int tag = tags ? static_cast<int>((*tags)[c]) : 1;
    if (type == triangle) {
      if (!tags || tag == 0) continue;
      raw.mesh.facets.push_back({cell[0], cell[1], cell[2]});
      raw.mesh.facet_tags.push_back(tag);
      continue;
    }
    raw.mesh.cells.push_back(cell);
    raw.mesh.cell_tags.push_back(tag);
    if (fibre) {
      const auto vector = [&](const std::vector<double>& v) {
        return Point3{v[3 * c], v[3 * c + 1], v[3 * c + 2]};
      };
      raw.mesh.cell_frames.push_back(completed_frame(vector(*fibre), sheet ? vector(*sheet) : Point3{}));
    }
  }
}

void take_points(const std::vector<double>& x, RawMesh& raw) {
  for (std::size_t i = 0; i + 2 < x.size(); i += 3) raw.mesh.points.push_back({x[i], x[i + 1], x[i + 2]});
}

// --- legacy
// ---------------------------------------------------------------------------------------------------

std::vector<double> reals(MeshScanner& in, std::size_t n, std::string_view what) {
  std::vector<double> values(n);
  for (double& v : values) v = in.real(what);
  return values;
}
std::vector<long long> integers(MeshScanner& in, std::size_t n, std::string_view what) {
  std::vector<long long> values(n);
  for (long long& v : values) v = in.integer(what);
  return values;
}

void legacy_cells(MeshScanner& in, VtkCells& cells) {
  const std::size_t first = in.count("number of cells"), second = in.count("size of the cell list");
  if (in.peek() == "OFFSETS") {  // version 5: first counts the offsets, second the connectivity
    in.line();
    cells.ends = integers(in, first, "offset");
    if (!cells.ends.empty()) cells.ends.erase(cells.ends.begin());
    if (in.word("CONNECTIVITY") != "CONNECTIVITY") in.fail("CONNECTIVITY expected after OFFSETS");
    in.line();
    cells.connectivity = integers(in, second, "corner of a cell");
    return;
  }
  for (std::size_t c = 0; c < first; ++c) {
    const std::size_t corners = in.count("number of corners");
    for (std::size_t k = 0; k < corners; ++k) cells.connectivity.push_back(in.integer("corner of a cell"));
    cells.ends.push_back(static_cast<long long>(cells.connectivity.size()));
  }
}

}  // namespace

RawMesh parse_vtk(std::string_view text, const std::string& file) {
  MeshScanner in(text, file);
  RawMesh raw;
  VtkCells cells;
  if (in.line().substr(0, 14) != "# vtk DataFile")
    in.fail("no VTK file: it must begin with '# vtk DataFile'");
  in.line();
  if (const auto form = in.word("ASCII"); form != "ASCII")
    in.fail(fmt::format("{} data; save as ASCII, or as .vtu without compression", form));
  std::size_t size = 0;  // of the current attribute section
  bool of_cells = false;
  const auto keep = [&](std::string_view name, std::vector<double> values) {
    if (of_cells) cells.arrays[std::string(name)] = std::move(values);
  };
  while (!in.at_end()) {
    const std::string key(in.word("a keyword"));
    if (key == "DATASET") {
      if (const auto kind = in.word("kind of data"); kind != "UNSTRUCTURED_GRID")
        in.fail(fmt::format("{}; only UNSTRUCTURED_GRID holds tetrahedra", kind));
    } else if (key == "POINTS") {
      const std::size_t n = in.count("number of points");
      in.word("type of numbers");
      take_points(reals(in, 3 * n, "coordinate"), raw);
    } else if (key == "CELLS") {
      legacy_cells(in, cells);
    } else if (key == "CELL_TYPES") {
      const std::size_t n = in.count("number of cell types");
      cells.types = integers(in, n, "cell type");
    } else if (key == "CELL_DATA" || key == "POINT_DATA") {
      of_cells = key == "CELL_DATA";
      size = in.count("number of values");
    } else if (key == "SCALARS") {
      const std::string name(in.word("name of an array"));
      in.word("type of numbers");
      std::size_t components = 1;
      if (in.peek() != "LOOKUP_TABLE") components = in.count("number of components");
      if (in.peek() == "LOOKUP_TABLE") in.line();
      keep(name, reals(in, components * size, name));
    } else if (key == "VECTORS" || key == "NORMALS") {
      const std::string name(in.word("name of an array"));
      in.word("type of numbers");
      keep(name, reals(in, 3 * size, name));
    } else if (key == "FIELD") {
      in.word("name of the field");
      const std::size_t arrays = in.count("number of arrays");
      for (std::size_t a = 0; a < arrays; ++a) {
        const std::string name(in.word("name of an array"));
        const std::size_t components = in.count("number of components"),
                          tuples = in.count("number of tuples");
        in.word("type of numbers");
        keep(name, reals(in, components * tuples, name));
      }
    } else if (key == "METADATA") {
      in.line();
      while (!in.rest().empty() && !in.line().empty()) {  // ends at an empty line
      }
    } else {
      in.fail(fmt::format(
          "'{}' is not understood; known: POINTS, CELLS, CELL_TYPES, CELL_DATA and POINT_DATA with "
          "SCALARS, VECTORS, FIELD",
          key));
    }
  }
  if (cells.types.empty()) in.fail("no CELL_TYPES; is the file whole?");
  take_cells(in, cells, raw);
  return raw;
}

// --- XML
// ------------------------------------------------------------------------------------------------------

namespace {

std::string attribute(std::string_view tag, std::string_view name) {
  const std::string key = fmt::format(" {}=\"", name);
  const std::size_t at = tag.find(key);
  if (at == std::string_view::npos) return {};
  const std::size_t start = at + key.size();
  return std::string(tag.substr(start, tag.find('"', start) - start));
}

std::string decoded_base64(std::string_view text, std::size_t most) {
  std::string bytes;
  unsigned bits = 0;
  int held = 0;
  for (const char c : text) {
    int value = -1;
    if (c >= 'A' && c <= 'Z') value = c - 'A';
    if (c >= 'a' && c <= 'z') value = c - 'a' + 26;
    if (c >= '0' && c <= '9') value = c - '0' + 52;
    if (c == '+') value = 62;
    if (c == '/') value = 63;
    if (c == '=') {  // the length before the data may be closed on its own
      bits = 0, held = 0;
      continue;
    }
    if (value < 0) continue;
    bits = (bits << 6) | static_cast<unsigned>(value);
    held += 6;
    if (held >= 8) {
      held -= 8;
      bytes.push_back(static_cast<char>((bits >> held) & 0xFF));
      if (bytes.size() == most) break;
    }
  }
  return bytes;
}

class Vtu {
 public:
  Vtu(std::string_view text, const std::string& file) : text_(text), in_(text, file) {}

  RawMesh parse() {
    const std::string_view root = tag_at(text_.find("<VTKFile"), "VTKFile");
    if (attribute(root, "type") != "UnstructuredGrid")
      in_.fail(fmt::format("a VTK file of type '{}'; only UnstructuredGrid holds tetrahedra",
                           attribute(root, "type")));
    if (!attribute(root, "compressor").empty())
      in_.fail("compressed data; save without (ParaView: Compressor Type None, or meshio: compression=None)");
    if (attribute(root, "byte_order") == "BigEndian") in_.fail("big-endian data; save as text (ASCII)");
    long_header_ = attribute(root, "header_type") == "UInt64";
    const std::size_t appended = text_.find("<AppendedData");
    if (appended != std::string_view::npos) {
      base64_ = attribute(tag_at(appended, "AppendedData"), "encoding") == "base64";
      appended_ = text_.find('_', text_.find('>', appended)) + 1;
    }
    const std::size_t piece_at = text_.find("<Piece");
    const std::string_view piece = tag_at(piece_at, "Piece");
    if (const auto more = text_.find("<Piece", piece_at + 1); more < std::min(appended, text_.size()))
      in_.fail("several pieces; merge them first (ParaView: Merge Blocks)");
    const std::size_t points = number(piece, "NumberOfPoints"), cells = number(piece, "NumberOfCells");

    RawMesh raw;
    const auto coordinates = arrays_of("Points");
    if (coordinates.empty() || coordinates.begin()->second.size() != 3 * points)
      in_.fail(fmt::format("Points holds not 3 x {} numbers; is the file whole?", points));
    take_points(coordinates.begin()->second, raw);
    const auto topology = arrays_of("Cells");
    const auto whole = [&](const char* name) {
      const auto found = topology.find(name);
      if (found == topology.end()) in_.fail(fmt::format("Cells has no array '{}'", name));
      return std::vector<long long>(found->second.begin(), found->second.end());
    };
    VtkCells list{whole("connectivity"), whole("offsets"), whole("types"), arrays_of("CellData")};
    if (list.types.size() != cells)
      in_.fail(fmt::format("{} cell types for {} cells", list.types.size(), cells));
    take_cells(in_, list, raw);
    return raw;
  }

 private:
  std::string_view tag_at(std::size_t at, std::string_view name) {
    if (at == std::string_view::npos) in_.fail(fmt::format("no <{}>; is this a whole VTU file?", name));
    const std::size_t end = text_.find('>', at);
    if (end == std::string_view::npos) in_.fail(fmt::format("<{}> does not end", name));
    return text_.substr(at, end - at);
  }

  std::size_t number(std::string_view tag, std::string_view name) {
    const std::string text = attribute(tag, name);
    MeshScanner scanner(text, in_.file());
    const long long n = scanner.integer(name);
    if (n < 0 || static_cast<std::size_t>(n) > text_.size()) in_.fail(fmt::format("{} is {}", name, n));
    return static_cast<std::size_t>(n);
  }

  std::map<std::string, std::vector<double>> arrays_of(const std::string& section) {
    std::map<std::string, std::vector<double>> arrays;
    const std::size_t start = text_.find("<" + section + ">");
    const std::size_t begin = start == std::string_view::npos ? text_.find("<" + section + " ") : start;
    if (begin == std::string_view::npos) return arrays;
    const std::size_t end = text_.find("</" + section + ">", begin);
    if (end == std::string_view::npos) {
      if (text_.substr(begin, text_.find('>', begin) - begin).back() == '/') return arrays;
      in_.fail(fmt::format("<{}> does not end; is the file whole?", section));
    }
    for (std::size_t at = text_.find("<DataArray", begin); at < end; at = text_.find("<DataArray", at + 1)) {
      const std::string_view tag = tag_at(at, "DataArray");
      const std::size_t inside = at + tag.size() + 1;
      const std::string_view content =
          tag.back() == '/' ? std::string_view() : text_.substr(inside, text_.find('<', inside) - inside);
      const std::string type = attribute(tag, "type");
      if (type == "String") continue;
      arrays[attribute(tag, "Name")] = values(tag, type, content);
    }
    return arrays;
  }

  std::vector<double> values(std::string_view tag, const std::string& type, std::string_view content) {
    const std::string format = attribute(tag, "format");
    if (format == "ascii") {
      MeshScanner scanner(content, in_.file() + ": " + attribute(tag, "Name"));
      std::vector<double> numbers;
      while (!scanner.at_end()) numbers.push_back(scanner.real("number"));
      return numbers;
    }
    const std::size_t header = long_header_ ? 8 : 4;
    std::string_view source = content;
    const bool raw = format == "appended" && !base64_;
    if (format == "appended")
      source = text_.substr(std::min(text_.size(), appended_ + number(tag, "offset")));
    std::string bytes = raw ? std::string(source.substr(0, header)) : decoded_base64(source, header);
    if (bytes.size() < header) in_.fail("the data of an array are missing; is the file whole?");
    std::uint64_t size = 0;
    std::memcpy(&size, bytes.data(), header);
    if (size > text_.size()) in_.fail(fmt::format("an array of {} bytes, more than this file holds", size));
    bytes = raw ? std::string(source.substr(0, header + size)) : decoded_base64(source, header + size);
    if (bytes.size() < header + size) in_.fail("the data of an array end too early; is the file whole?");
    return numbers_of(type, std::string_view(bytes).substr(header, size));
  }

  template <class T>
  static std::vector<double> numbers_as(std::string_view bytes) {
    std::vector<double> numbers(bytes.size() / sizeof(T));
    for (std::size_t i = 0; i < numbers.size(); ++i) {
      T value;
      std::memcpy(&value, bytes.data() + i * sizeof(T), sizeof(T));
      numbers[i] = static_cast<double>(value);
    }
    return numbers;
  }

  std::vector<double> numbers_of(const std::string& type, std::string_view bytes) {
    if (type == "Float64") return numbers_as<double>(bytes);
    if (type == "Float32") return numbers_as<float>(bytes);
    if (type == "Int64") return numbers_as<std::int64_t>(bytes);
    if (type == "UInt64") return numbers_as<std::uint64_t>(bytes);
    if (type == "Int32") return numbers_as<std::int32_t>(bytes);
    if (type == "UInt32") return numbers_as<std::uint32_t>(bytes);
    if (type == "Int16") return numbers_as<std::int16_t>(bytes);
    if (type == "UInt16") return numbers_as<std::uint16_t>(bytes);
    if (type == "Int8") return numbers_as<std::int8_t>(bytes);
    if (type == "UInt8") return numbers_as<std::uint8_t>(bytes);
    in_.fail(fmt::format("numbers of type '{}'", type));
  }

  std::string_view text_;
  MeshScanner in_;
  bool long_header_ = false, base64_ = true;
  std::size_t appended_ = 0;
};

}  // namespace

RawMesh parse_vtu(std::string_view text, const std::string& file) { return Vtu(text, file).parse(); }

}  // namespace wiggers
