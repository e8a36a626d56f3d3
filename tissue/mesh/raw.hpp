// What the parsers of mesh files share: a mesh as it stands in a file, and a reader of words.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstring>
#include <filesystem>
#include <map>
#include <string>
#include <string_view>
#include <vector>
#include <wiggers/tissue/mesh/read.hpp>

namespace wiggers {

struct RawMesh {
  TetMesh mesh;                           // in the file's unit, unchecked
  MeshUnit usual = MeshUnit::millimetre;  // of the format
  MeshUnit stated = MeshUnit::automatic;  // of the file itself, if it says
  std::vector<std::string> notes;
};

// Walks through a text (with binary stretches); every failure names file and line.
class MeshScanner {
 public:
  MeshScanner(std::string_view text, std::string file) : text_(text), file_(std::move(file)) {}

  bool at_end();  // after white space
  std::string_view word(std::string_view what);
  std::string_view peek();  // the next word, empty at the end
  std::string_view line();  // the rest of the line, without its end
  long long integer(std::string_view what);
  double real(std::string_view what);
  // A count that cannot exceed what is left of the file.
  std::size_t count(std::string_view what);
  template <class T>
  T binary(std::string_view what);  // little-endian
  std::string_view rest() const { return text_.substr(at_); }
  void skip(std::size_t bytes) { at_ = std::min(at_ + bytes, text_.size()); }
  bool skip_past(std::string_view mark);
  [[noreturn]] void fail(std::string_view message) const;
  const std::string& file() const { return file_; }

 private:
  std::string_view text_;
  std::string file_;
  std::size_t at_ = 0;
};

// "hexahedron", with how to get rid of it.
[[noreturn]] void refuse_element(const MeshScanner& at, std::string_view element);

RawMesh parse_gmsh(std::string_view text, const std::string& file);
RawMesh parse_vtk(std::string_view text, const std::string& file);
RawMesh parse_vtu(std::string_view text, const std::string& file);
RawMesh parse_carp(const std::filesystem::path& path);

// Right-handed orthonormal frame from a fibre and, if given, a sheet direction (Gram-Schmidt). A zero fibre
// gives the axes.
std::array<Point3, 3> completed_frame(const Point3& fibre, const Point3& sheet);

template <class T>
T MeshScanner::binary(std::string_view what) {
  if (text_.size() - at_ < sizeof(T)) fail("the file ends within " + std::string(what));
  T value;
  std::memcpy(&value, text_.data() + at_, sizeof(T));
  at_ += sizeof(T);
  return value;
}
}  // namespace wiggers
