#include <fmt/format.h>
#include <hdf5.h>

#include <wiggers/core/errors.hpp>
#include <wiggers/core/files.hpp>
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
  ~Handle() { close(id); }
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

// Errors are reported by check(); the library's own printing would only repeat them.
void silence() { H5Eset_auto2(H5E_DEFAULT, nullptr, nullptr); }

}  // namespace

struct ResultWriter::Implementation {
  hid_t file = -1;
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
    const Handle set(H5Dcreate2(file, path.c_str(), type, space, links, H5P_DEFAULT, H5P_DEFAULT), H5Dclose,
                     path.c_str());
    check(H5Dwrite(set, type, H5S_ALL, H5S_ALL, H5P_DEFAULT, data), path.c_str());
  }
};

ResultWriter::ResultWriter() : implementation_(std::make_unique<Implementation>()) {
  silence();
  const Handle access(H5Pcreate(H5P_FILE_ACCESS), H5Pclose, "H5Pcreate");
  check(H5Pset_fapl_core(access, 1 << 20, 0), "H5Pset_fapl_core");
  // No times inside: equal results are equal files.
  const Handle creation(H5Pcreate(H5P_FILE_CREATE), H5Pclose, "H5Pcreate");
  implementation_->file = check(H5Fcreate("wiggers-result", H5F_ACC_TRUNC, creation, access), "H5Fcreate");
}
ResultWriter::~ResultWriter() = default;

void ResultWriter::dataset(const std::string& path, const std::vector<double>& values,
                           const std::string& unit, const std::string& meaning) {
  const hsize_t size[] = {values.size()};
  const Handle space(H5Screate_simple(1, size, nullptr), H5Sclose, "H5Screate_simple");
  implementation_->put(path, H5T_NATIVE_DOUBLE, space, values.data());
  implementation_->describe(path, unit, meaning);
}

void ResultWriter::scalar(const std::string& path, double value, const std::string& unit,
                          const std::string& meaning) {
  const Handle space(H5Screate(H5S_SCALAR), H5Sclose, "H5Screate");
  implementation_->put(path, H5T_NATIVE_DOUBLE, space, &value);
  implementation_->describe(path, unit, meaning);
}

void ResultWriter::text(const std::string& path, const std::string& value) {
  const Handle type(H5Tcopy(H5T_C_S1), H5Tclose, "H5Tcopy");
  check(H5Tset_size(type, value.empty() ? 1 : value.size()), "H5Tset_size");
  check(H5Tset_cset(type, H5T_CSET_UTF8), "H5Tset_cset");
  const Handle space(H5Screate(H5S_SCALAR), H5Sclose, "H5Screate");
  implementation_->put(path, type, space, value.empty() ? "" : value.data());
}

void ResultWriter::write(const std::filesystem::path& path) {
  check(H5Fflush(implementation_->file, H5F_SCOPE_GLOBAL), "H5Fflush");
  const ssize_t size = check(H5Fget_file_image(implementation_->file, nullptr, 0), "H5Fget_file_image");
  std::string image(static_cast<std::size_t>(size), '\0');
  check(H5Fget_file_image(implementation_->file, image.data(), image.size()), "H5Fget_file_image");
  write_file_atomically(path, image);
}

struct ResultReader::Implementation {
  hid_t file = -1;
  std::string name;
  ~Implementation() {
    if (file >= 0) H5Fclose(file);
  }
  void require(const std::string& path, bool present) const {
    if (!present)
      throw InputError(
          fmt::format("'{}' has no entry {}: it is no wiggers result, or of another version", name, path));
  }
};

ResultReader::ResultReader(const std::filesystem::path& path)
    : implementation_(std::make_unique<Implementation>()) {
  silence();
  implementation_->name = path.string();
  (void)read_file(path);  // missing or unreadable: refused with the system's reason
  implementation_->file = H5Fopen(path.c_str(), H5F_ACC_RDONLY, H5P_DEFAULT);
  if (implementation_->file < 0)
    throw InputError(fmt::format("'{}' is not an HDF5 file, or is damaged", path.string()));
}
ResultReader::~ResultReader() = default;

bool ResultReader::has(const std::string& path) const {
  for (std::size_t at = path.find('/', 1);; at = path.find('/', at + 1)) {
    if (H5Lexists(implementation_->file, path.substr(0, at).c_str(), H5P_DEFAULT) <= 0) return false;
    if (at == std::string::npos) return true;
  }
}

std::vector<double> ResultReader::dataset(const std::string& path) const {
  implementation_->require(path, has(path));
  const Handle set(H5Dopen2(implementation_->file, path.c_str(), H5P_DEFAULT), H5Dclose, path.c_str());
  const Handle space(H5Dget_space(set), H5Sclose, "H5Dget_space");
  std::vector<double> values(static_cast<std::size_t>(check(H5Sget_simple_extent_npoints(space), "extent")));
  check(H5Dread(set, H5T_NATIVE_DOUBLE, H5S_ALL, H5S_ALL, H5P_DEFAULT, values.data()), path.c_str());
  return values;
}

double ResultReader::scalar(const std::string& path) const { return dataset(path).at(0); }

std::string ResultReader::text(const std::string& path) const {
  implementation_->require(path, has(path));
  const Handle set(H5Dopen2(implementation_->file, path.c_str(), H5P_DEFAULT), H5Dclose, path.c_str());
  const Handle type(H5Dget_type(set), H5Tclose, "H5Dget_type");
  std::string value(H5Tget_size(type), '\0');
  check(H5Dread(set, type, H5S_ALL, H5S_ALL, H5P_DEFAULT, value.data()), path.c_str());
  while (!value.empty() && value.back() == '\0') value.pop_back();
  return value;
}

}  // namespace wiggers
