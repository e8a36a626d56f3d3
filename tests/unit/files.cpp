// Files: CSV, HDF5 results, and writing that is whole or not at all.
#include <unistd.h>

#include <catch2/catch.hpp>
#include <filesystem>
#include <fstream>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/files.hpp>
#include <wiggers/core/result_file.hpp>
#include <wiggers/core/table.hpp>

using namespace wiggers;
namespace fs = std::filesystem;

namespace {
struct Folder {
  fs::path path = fs::temp_directory_path() / ("wiggers-test-" + std::to_string(getpid()));
  Folder() { fs::create_directories(path); }
  ~Folder() { fs::remove_all(path); }
};
std::size_t files_in(const fs::path& folder) {
  return static_cast<std::size_t>(std::distance(fs::directory_iterator(folder), fs::directory_iterator()));
}
}  // namespace

TEST_CASE("a CSV file reads back to the same doubles, names and units") {
  const Folder folder;
  Table table;
  table.add("t", "ms").values = {0, 0.1, 1.0 / 3};
  table.add("Ca_i", "mM").values = {1e-4, 2.35e-112, -7.25e300};
  write_csv(folder.path / "a.csv", table);
  const Table read = read_csv(folder.path / "a.csv");
  REQUIRE(read.columns.size() == 2);
  CHECK(read.columns[1].name == "Ca_i");
  CHECK(read.columns[1].unit == "mM");
  CHECK(read.columns[0].values == table.columns[0].values);
  CHECK(read.columns[1].values == table.columns[1].values);
  CHECK_THROWS_WITH(read.at("Ca"), Catch::Contains("Ca_i"));
}

TEST_CASE("a CSV file that makes no sense is refused with line and column") {
  const Folder folder;
  const auto refuse = [&](const char* text, const char* expected) {
    std::ofstream(folder.path / "b.csv") << text;
    CHECK_THROWS_WITH(read_csv(folder.path / "b.csv"), Catch::Contains(expected));
  };
  refuse("a,b\n1,2\n3\n", "line 3");
  refuse("a,b\n1,x\n", "column 'b'");
  refuse("a,b\n", "no rows");
  refuse("", "no column names");
  CHECK_THROWS_AS(read_csv(folder.path / "missing.csv"), InputError);
  CHECK_THROWS_AS(read_csv(folder.path), InputError);
}

TEST_CASE("writing replaces a file whole and leaves nothing beside it") {
  const Folder folder;
  const fs::path file = folder.path / "c.txt";
  write_file_atomically(file, "first");
  write_file_atomically(file, "second");
  CHECK(read_file(file) == "second");
  CHECK(files_in(folder.path) == 1);
  CHECK_THROWS_AS(write_file_atomically(folder.path / "no" / "such" / "d.txt", "x"), ResourceError);
  CHECK_THROWS_AS(require_writable(folder.path / "no" / "d.txt", "-o"), InputError);
  CHECK_THROWS_AS(require_writable(folder.path, "-o"), InputError);
}

TEST_CASE("a result file reads back what was written, with unit and meaning") {
  const Folder folder;
  const fs::path file = folder.path / "r.h5";
  {
    ResultWriter writer;
    writer.dataset("/cavities/LV/volume", {1, 2.5, 1.0 / 3}, "mL", "volume");
    writer.scalar("/indexes/LV/EF", 63.25, "%", "ejection fraction");
    writer.text("/provenance/scene", "title = \"x\"\n");
    writer.write(file);
  }
  const ResultReader reader(file);
  CHECK(reader.dataset("/cavities/LV/volume") == std::vector<double>{1, 2.5, 1.0 / 3});
  CHECK(reader.scalar("/indexes/LV/EF") == 63.25);
  CHECK(reader.text("/provenance/scene") == "title = \"x\"\n");
  CHECK(reader.has("/cavities/LV"));
  CHECK_FALSE(reader.has("/cavities/RV/volume"));
  CHECK_THROWS_WITH(reader.dataset("/cavities/RV/volume"), Catch::Contains("/cavities/RV/volume"));
  std::ofstream(folder.path / "no.h5") << "this is no HDF5";
  CHECK_THROWS_AS(ResultReader(folder.path / "no.h5"), InputError);
  CHECK_THROWS_AS(ResultReader(folder.path / "missing.h5"), InputError);
}
