#include <fmt/format.h>
#include <hdf5.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <bit>
#include <cmath>
#include <sstream>
#include <utility>
#include <wiggers/core/checksum.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/files.hpp>
#include <wiggers/core/memory.hpp>
#include <wiggers/core/result_file.hpp>

namespace wiggers {

namespace {

template <class Code>
Code check(Code code, const char* what) {
  if (code < 0) throw ResourceError(fmt::format("result file: {} failed", what));
  return code;
}

// Closes an HDF5 handle when it goes out of scope.
struct Handle {
  hid_t id;
  herr_t (*close)(hid_t);
  Handle(hid_t handle, herr_t (*closer)(hid_t), const char* what) : id(check(handle, what)), close(closer) {}
  ~Handle() {
    if (id >= 0) close(id);
  }
  Handle(Handle&& other) noexcept : id(std::exchange(other.id, -1)), close(other.close) {}
  Handle(const Handle&) = delete;
  Handle& operator=(const Handle&) = delete;
  operator hid_t() const { return id; }  // NOLINT: used wherever HDF5 wants the handle
};

void put_text_attribute(hid_t object, const char* name, const std::string& value) {
  const Handle type(H5Tcopy(H5T_C_S1), H5Tclose, "H5Tcopy");
  check(H5Tset_size(type, value.empty() ? 1 : value.size()), "H5Tset_size");
  check(H5Tset_cset(type, H5T_CSET_UTF8), "H5Tset_cset");
  const Handle space(H5Screate(H5S_SCALAR), H5Sclose, "H5Screate");
  const Handle attribute(H5Acreate2(object, name, type, space, H5P_DEFAULT, H5P_DEFAULT), H5Aclose,
                         "H5Acreate");
  check(H5Awrite(attribute, type, value.empty() ? "" : value.data()), "H5Awrite");
}

// Jenkins' lookup3 of whole 32-bit words, with which HDF5 protects its own structure.
template <std::size_t n_words>
std::uint32_t lookup3(const std::array<std::uint32_t, n_words>& words) {
  static_assert(n_words % 3 != 0 && n_words > 3);
  std::uint32_t a = 0xdeadbeef + 4 * n_words, b = a, c = a;
  const auto word = [&](std::size_t k) { return k < n_words ? words[k] : 0; };
  std::size_t at = 0;
  for (; at + 3 < n_words; at += 3) {
    a += word(at), b += word(at + 1), c += word(at + 2);
    a -= c, a ^= std::rotl(c, 4), c += b;
    b -= a, b ^= std::rotl(a, 6), a += c;
    c -= b, c ^= std::rotl(b, 8), b += a;
    a -= c, a ^= std::rotl(c, 16), c += b;
    b -= a, b ^= std::rotl(a, 19), a += c;
    c -= b, c ^= std::rotl(b, 4), b += a;
  }
  a += word(at), b += word(at + 1), c += word(at + 2);
  c ^= b, c -= std::rotl(b, 14);
  a ^= c, a -= std::rotl(c, 11);
  b ^= a, b -= std::rotl(a, 25);
  c ^= b, c -= std::rotl(b, 16);
  a ^= c, a -= std::rotl(c, 4);
  b ^= a, b -= std::rotl(a, 14);
  c ^= b, c -= std::rotl(b, 24);
  return c;
}

// HDF5 takes the mark of an open file out of an image's first block and leaves the block's checksum as it was
// with the mark: readers would call the file damaged.
void mend_first_block(std::string& image) {
  constexpr std::size_t version_at = 8, checksum_at = 44;
  if (image.size() < checksum_at + 4 || image[version_at] != 2) return;
  std::array<std::uint32_t, checksum_at / 4> words;
  for (std::size_t k = 0; k < checksum_at; ++k) {
    if (k % 4 == 0) words[k / 4] = 0;
    words[k / 4] |= std::uint32_t{static_cast<unsigned char>(image[k])} << (8 * (k % 4));
  }
  const std::uint32_t sum = lookup3(words);
  for (std::size_t k = 0; k < 4; ++k) image[checksum_at + k] = static_cast<char>(sum >> (8 * k) & 0xFF);
}

// A name for a file in memory: none of a file on the disk, and of no other in memory, which HDF5 would take
// for the same.
std::string name_in_memory() {
  static std::atomic<unsigned long> count{0};
  return fmt::format("/dev/null/wiggers-result-{}", count++);
}

constexpr const char* checksums_path = "/provenance/checksums";

std::uint64_t checksum_of(const double* values, std::size_t n) {
  return checksum({reinterpret_cast<const char*>(values), n * sizeof(double)});
}

// Errors are reported by check(); the library's own printing would only repeat them.
void silence() { H5Eset_auto2(H5E_DEFAULT, nullptr, nullptr); }

}  // namespace

struct ResultWriter::Implementation {
  hid_t file = -1;
  std::map<std::string, std::uint64_t> checksums;
  ~Implementation() {
    if (file >= 0) H5Fclose(file);
  }
  void describe(const std::string& path, const std::string& unit, const std::string& meaning) {
    const Handle object(H5Oopen(file, path.c_str(), H5P_DEFAULT), H5Oclose, "H5Oopen");
    put_text_attribute(object, "unit", unit);
    put_text_attribute(object, "meaning", meaning);
  }
  void put(const std::string& path, hid_t type, hid_t space, const void* data) {
    const Handle links(H5Pcreate(H5P_LINK_CREATE), H5Pclose, "H5Pcreate");
    check(H5Pset_create_intermediate_group(links, 1), "H5Pset_create_intermediate_group");
    const Handle creation(H5Pcreate(H5P_DATASET_CREATE), H5Pclose, "H5Pcreate");
    check(H5Pset_obj_track_times(creation, 0), "H5Pset_obj_track_times");
    const Handle set(H5Dcreate2(file, path.c_str(), type, space, links, creation, H5P_DEFAULT), H5Dclose,
                     path.c_str());
    check(H5Dwrite(set, type, H5S_ALL, H5S_ALL, H5P_DEFAULT, data), path.c_str());
  }
};

ResultWriter::ResultWriter() : implementation_(std::make_unique<Implementation>()) {
  silence();
  const Handle access(H5Pcreate(H5P_FILE_ACCESS), H5Pclose, "H5Pcreate");
  check(H5Pset_fapl_core(access, 1 << 20, 0), "H5Pset_fapl_core");
  // The younger format has checksums in its own structure: the library sees damage before it follows it.
  check(H5Pset_libver_bounds(access, H5F_LIBVER_V18, H5F_LIBVER_LATEST), "H5Pset_libver_bounds");
  // No times inside: equal results are equal files.
  const Handle creation(H5Pcreate(H5P_FILE_CREATE), H5Pclose, "H5Pcreate");
  implementation_->file =
      check(H5Fcreate(name_in_memory().c_str(), H5F_ACC_TRUNC, creation, access), "H5Fcreate");
}
ResultWriter::~ResultWriter() = default;

void ResultWriter::dataset(const std::string& path, const std::vector<double>& values,
                           const std::string& unit, const std::string& meaning) {
  const hsize_t size[] = {values.size()};
  const Handle space(H5Screate_simple(1, size, nullptr), H5Sclose, "H5Screate_simple");
  implementation_->put(path, H5T_NATIVE_DOUBLE, space, values.data());
  implementation_->checksums[path] = checksum_of(values.data(), values.size());
  implementation_->describe(path, unit, meaning);
}

void ResultWriter::scalar(const std::string& path, double value, const std::string& unit,
                          const std::string& meaning) {
  const Handle space(H5Screate(H5S_SCALAR), H5Sclose, "H5Screate");
  implementation_->put(path, H5T_NATIVE_DOUBLE, space, &value);
  implementation_->checksums[path] = checksum_of(&value, 1);
  implementation_->describe(path, unit, meaning);
}

void ResultWriter::text(const std::string& path, const std::string& value) {
  const Handle type(H5Tcopy(H5T_C_S1), H5Tclose, "H5Tcopy");
  check(H5Tset_size(type, value.empty() ? 1 : value.size()), "H5Tset_size");
  check(H5Tset_cset(type, H5T_CSET_UTF8), "H5Tset_cset");
  const Handle space(H5Screate(H5S_SCALAR), H5Sclose, "H5Screate");
  implementation_->put(path, type, space, value.empty() ? "" : value.data());
  implementation_->checksums[path] = checksum(value);
}

void ResultWriter::write(const std::filesystem::path& path) {
  std::string list;
  for (const auto& [entry, sum] : implementation_->checksums) list += fmt::format("{:016x} {}\n", sum, entry);
  text(checksums_path, fmt::format("{:016x}\n{}", checksum(list), list));
  check(H5Fflush(implementation_->file, H5F_SCOPE_GLOBAL), "H5Fflush");
  const ssize_t size = check(H5Fget_file_image(implementation_->file, nullptr, 0), "H5Fget_file_image");
  std::string image(static_cast<std::size_t>(size), '\0');
  check(H5Fget_file_image(implementation_->file, image.data(), image.size()), "H5Fget_file_image");
  mend_first_block(image);
  write_file_atomically(path, image);
}

struct ResultReader::Implementation {
  hid_t file = -1;
  std::string name;
  double file_bytes = 0;
  ~Implementation() {
    if (file >= 0) H5Fclose(file);
  }

  [[noreturn]] void refuse(const std::string& path, const std::string& why) const {
    throw InputError(fmt::format("{} {}", place(path), why));
  }
  // A handle of what was asked for; a failure is the file's, not the machine's.
  Handle open(hid_t id, herr_t (*close)(hid_t), const std::string& path) const {
    if (id < 0) refuse(path, "cannot be read: the file is damaged");
    return {id, close, path.c_str()};
  }

  // Whether the entry is there. Links to other places and files are not followed: what they lead to is no
  // part of this file.
  bool has(const std::string& path) const {
    for (std::size_t at = path.find('/', 1);; at = path.find('/', at + 1)) {
      const std::string part = path.substr(0, at);
      H5L_info_t link;
      if (H5Lexists(file, part.c_str(), H5P_DEFAULT) <= 0) return false;
      if (H5Lget_info(file, part.c_str(), &link, H5P_DEFAULT) < 0 || link.type != H5L_TYPE_HARD) return false;
      if (at == std::string::npos) return true;
    }
  }

  H5I_type_t kind_of(const std::string& path) const {
    return H5Iget_type(open(H5Oopen(file, path.c_str(), H5P_DEFAULT), H5Oclose, path));
  }
  bool is_group(const std::string& path) const { return kind_of(path) == H5I_GROUP; }
  std::string place(const std::string& path) const { return fmt::format("'{}': entry {}", name, path); }

  // An entry with its kind of numbers or text, looked at before it is read.
  struct Entry {
    Handle set, type, space;
    std::size_t n;  // how many
  };
  Entry entry(const std::string& path) const {
    if (!has(path))
      throw InputError(
          fmt::format("'{}' has no entry {}: it is no wiggers result, or of another version", name, path));
    if (kind_of(path) != H5I_DATASET) refuse(path, "is no row of numbers and no text");
    Handle set = open(H5Dopen2(file, path.c_str(), H5P_DEFAULT), H5Dclose, path);
    Handle type = open(H5Dget_type(set), H5Tclose, path);
    Handle space = open(H5Dget_space(set), H5Sclose, path);
    const H5S_class_t kind = H5Sget_simple_extent_type(space);
    const hssize_t n = H5Sget_simple_extent_npoints(space);
    if (kind != H5S_SCALAR && kind != H5S_SIMPLE) refuse(path, "is empty");
    if (n < 0) refuse(path, "has no sensible size");
    // Numbers that stand in no file, in another one, or in more than this one can hold.
    const Handle creation = open(H5Dget_create_plist(set), H5Pclose, path);
    const H5D_layout_t layout = H5Pget_layout(creation);
    const bool packed = layout == H5D_CHUNKED;
    if ((layout != H5D_CONTIGUOUS && layout != H5D_COMPACT && !packed) ||
        H5Pget_external_count(creation) != 0)
      refuse(path, "is stored outside the file");
    const double bytes = static_cast<double>(n) * static_cast<double>(H5Tget_size(type));
    if (bytes > (packed ? most_compression : 1) * file_bytes)
      refuse(path, fmt::format("claims {} values, more than a file of {:.0f} bytes can hold", n, file_bytes));
    return {std::move(set), std::move(type), std::move(space), static_cast<std::size_t>(n)};
  }
  static constexpr double most_compression = 200;

  std::vector<double> numbers(const std::string& path, int rank) const {
    const Entry e = entry(path);
    const H5T_class_t kind = H5Tget_class(e.type);
    if (kind != H5T_FLOAT && kind != H5T_INTEGER)
      refuse(path, kind == H5T_STRING ? "holds text, not numbers" : "does not hold numbers");
    const int found = H5Sget_simple_extent_ndims(e.space);
    if (found > 1 || (rank == 1 && found != 1) || (rank == 0 && e.n != 1))
      refuse(path, rank == 0 ? fmt::format("holds {} numbers, one is wanted", e.n)
                             : fmt::format("has {} dimensions, a row is wanted", found));
    std::vector<double> values(e.n);
    if (H5Dread(e.set, H5T_NATIVE_DOUBLE, H5S_ALL, H5S_ALL, H5P_DEFAULT, values.data()) < 0)
      refuse(path, "cannot be read: the file is damaged");
    return values;
  }
};

ResultReader::ResultReader(const std::filesystem::path& path)
    : implementation_(std::make_unique<Implementation>()) {
  silence();
  implementation_->name = path.string();
  // Read once, whatever kind of file it is.
  std::string image = read_file(path);
  implementation_->file_bytes = static_cast<double>(image.size());
  const Handle access(H5Pcreate(H5P_FILE_ACCESS), H5Pclose, "H5Pcreate");
  check(H5Pset_fapl_core(access, 1 << 16, 0), "H5Pset_fapl_core");
  if (!image.empty()) {
    check(H5Pset_file_image(access, image.data(), image.size()), "H5Pset_file_image");
    implementation_->file = H5Fopen(name_in_memory().c_str(), H5F_ACC_RDONLY, access);
  }
  if (implementation_->file < 0)
    throw InputError(fmt::format("'{}' is not an HDF5 file, or is damaged", path.string()));
}
ResultReader::~ResultReader() = default;

bool ResultReader::has(const std::string& path) const { return implementation_->has(path); }

std::string ResultReader::place(const std::string& path) const { return implementation_->place(path); }

std::vector<double> ResultReader::dataset(const std::string& path) const {
  return implementation_->numbers(path, 1);
}

std::vector<double> ResultReader::finite(const std::string& path) const {
  std::vector<double> values = dataset(path);
  for (std::size_t k = 0; k < values.size(); ++k)
    if (!std::isfinite(values[k]))
      implementation_->refuse(path, fmt::format("is damaged: number {} is {}", k + 1, values[k]));
  return values;
}

std::vector<double> ResultReader::finite(const std::string& path, std::size_t n) const {
  std::vector<double> values = finite(path);
  if (values.size() != n)
    implementation_->refuse(path, fmt::format("has {} numbers, {} are wanted", values.size(), n));
  return values;
}

double ResultReader::scalar(const std::string& path) const {
  return implementation_->numbers(path, 0).front();
}

std::string ResultReader::text(const std::string& path) const {
  const Implementation& m = *implementation_;
  const auto e = m.entry(path);
  if (H5Tget_class(e.type) != H5T_STRING) m.refuse(path, "does not hold text");
  if (e.n != 1) m.refuse(path, fmt::format("holds {} texts, one is wanted", e.n));
  const auto refuse_reading = [&] { m.refuse(path, "cannot be read: the file is damaged"); };
  if (H5Tis_variable_str(e.type) > 0) {
    char* found = nullptr;
    if (H5Dread(e.set, e.type, H5S_ALL, H5S_ALL, H5P_DEFAULT, &found) < 0) refuse_reading();
    std::string value = found ? found : "";
    (void)H5Dvlen_reclaim(e.type, e.space, H5P_DEFAULT, &found);
    return value;
  }
  std::string value(H5Tget_size(e.type), '\0');
  if (H5Dread(e.set, e.type, H5S_ALL, H5S_ALL, H5P_DEFAULT, value.data()) < 0) refuse_reading();
  while (!value.empty() && value.back() == '\0') value.pop_back();
  return value;
}

namespace {
struct Visit {
  std::vector<std::string> entries;
  std::string elsewhere;  // a link that leads out of the file
};
herr_t visit_link(hid_t, const char* name, const H5L_info_t* link, void* to) {
  auto& visit = *static_cast<Visit*>(to);
  if (link->type == H5L_TYPE_HARD)
    visit.entries.push_back(std::string("/") + name);
  else if (visit.elsewhere.empty())
    visit.elsewhere = std::string("/") + name;
  return 0;
}
}  // namespace

void ResultReader::require_sensible_sizes() const {
  const Implementation& m = *implementation_;
  Visit visit;
  if (H5Lvisit(m.file, H5_INDEX_NAME, H5_ITER_NATIVE, visit_link, &visit) < 0)
    throw InputError(fmt::format("'{}' is damaged: its list of entries cannot be read", m.name));
  if (!visit.elsewhere.empty())
    m.refuse(visit.elsewhere, "is a link to another place: it is no part of this file");
  double bytes = 0;
  for (const std::string& path : visit.entries) {
    if (m.is_group(path)) continue;
    const auto e = m.entry(path);
    bytes += static_cast<double>(e.n) * static_cast<double>(H5Tget_size(e.type));
    require_memory(bytes / sizeof(double), 1, m.place(path), "It cannot be read on this machine.");
  }
}

void ResultReader::verify() const {
  const Implementation& m = *implementation_;
  const std::string all = text(checksums_path);
  const std::size_t end = all.find('\n');
  const std::string list = end == std::string::npos ? "" : all.substr(end + 1);
  if (all.substr(0, end) != fmt::format("{:016x}", checksum(list)))
    m.refuse(checksums_path, "is damaged: it is not as it was written");
  std::istringstream lines(list);
  for (std::string line; std::getline(lines, line);) {
    const std::size_t space = line.find(' ');
    if (space == std::string::npos) m.refuse(checksums_path, "is damaged: it is no list of entries");
    const std::string path = line.substr(space + 1);
    std::uint64_t now = 0;
    if (H5Tget_class(m.entry(path).type) == H5T_STRING) {
      now = checksum(text(path));
    } else {
      const std::vector<double> values = m.numbers(path, -1);
      now = checksum_of(values.data(), values.size());
    }
    if (line.substr(0, space) != fmt::format("{:016x}", now))
      m.refuse(path, "is damaged or was changed: its checksum is not that of its content");
  }
}

}  // namespace wiggers
