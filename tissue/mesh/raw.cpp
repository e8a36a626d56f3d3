#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <wiggers/core/errors.hpp>
#include <wiggers/tissue/mesh/geometry.hpp>
#include <wiggers/tissue/mesh/raw.hpp>

namespace wiggers {

namespace {
bool is_space(char c) { return c == ' ' || c == '\n' || c == '\t' || c == '\r'; }
}  // namespace

bool MeshScanner::at_end() {
  while (at_ < text_.size() && is_space(text_[at_])) ++at_;
  return at_ == text_.size();
}

std::string_view MeshScanner::peek() {
  at_end();
  std::size_t end = at_;
  while (end < text_.size() && !is_space(text_[end])) ++end;
  return text_.substr(at_, end - at_);
}

std::string_view MeshScanner::word(std::string_view what) {
  const std::string_view found = peek();
  if (found.empty()) fail(fmt::format("the file ends where {} should stand; is it whole?", what));
  at_ += found.size();
  return found;
}

std::string_view MeshScanner::line() {
  const std::size_t end = std::min(text_.find('\n', at_), text_.size());
  std::string_view found = text_.substr(at_, end - at_);
  at_ = std::min(end + 1, text_.size());
  if (!found.empty() && found.back() == '\r') found.remove_suffix(1);
  return found;
}

long long MeshScanner::integer(std::string_view what) {
  const std::string_view found = word(what);
  long long value = 0;
  const auto [end, error] = std::from_chars(found.data(), found.data() + found.size(), value);
  if (error != std::errc() || end != found.data() + found.size())
    fail(fmt::format("{}: '{}' is no whole number", what, found.substr(0, 40)));
  return value;
}

double MeshScanner::real(std::string_view what) {
  std::string_view found = word(what);
  const std::string_view whole = found;
  if (found.front() == '+') found.remove_prefix(1);
  double value = 0;
  const auto [end, error] = std::from_chars(found.data(), found.data() + found.size(), value);
  const bool tiny = error == std::errc::result_out_of_range;  // 1e-320: as good as zero, or absurd
  if ((error != std::errc() && !tiny) || end != found.data() + found.size() || !std::isfinite(value))
    fail(fmt::format("{}: '{}' is no finite number", what, whole.substr(0, 40)));
  return tiny ? 0.0 : value;
}

std::size_t MeshScanner::count(std::string_view what) {
  const long long value = integer(what);
  if (value < 0 || static_cast<std::size_t>(value) > text_.size())
    fail(fmt::format("{} is {}, more than this file can hold", what, value));
  return static_cast<std::size_t>(value);
}

bool MeshScanner::skip_past(std::string_view mark) {
  const std::size_t found = text_.find(mark, at_);
  if (found == std::string_view::npos) return false;
  at_ = found + mark.size();
  return true;
}

void MeshScanner::fail(std::string_view message) const {
  if (at_ == 0) throw InputError(fmt::format("{}: {}", file_, message));
  const auto lines = std::count(text_.begin(), text_.begin() + static_cast<std::ptrdiff_t>(at_), '\n');
  throw InputError(fmt::format("{}: line {}: {}", file_, lines + 1, message));
}

void refuse_element(const MeshScanner& at, std::string_view element) {
  at.fail(fmt::format(
      "element of type {}; only linear tetrahedra (and their triangles, lines, points) are allowed. In gmsh: "
      "Mesh.ElementOrder = 1, Mesh.SubdivisionAlgorithm = 0, no Recombine; in ParaView: filter "
      "Tetrahedralize",
      element));
}

std::array<Point3, 3> completed_frame(const Point3& fibre, const Point3& sheet) {
  const double length = norm(fibre);
  if (!(length > 1e-12)) return {{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}};
  const Point3 f = (1 / length) * fibre;
  Point3 s = sheet - dot(sheet, f) * f;
  if (!(norm(s) > 1e-6 * norm(sheet))) {  // none given, or along the fibre: any direction across it
    const auto least = static_cast<std::size_t>(
        std::min_element(f.begin(), f.end(), [](double a, double b) { return std::abs(a) < std::abs(b); }) -
        f.begin());
    Point3 axis{};
    axis[least] = 1;
    s = axis - dot(axis, f) * f;
  }
  s = (1 / norm(s)) * s;
  return {f, s, cross(f, s)};
}

}  // namespace wiggers
