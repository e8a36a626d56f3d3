// Files: CSV, HDF5 results, and writing that is whole or not at all.
#include <fcntl.h>
#include <hdf5.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <catch2/catch.hpp>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <random>
#include <thread>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/files.hpp>
#include <wiggers/core/memory.hpp>
#include <wiggers/core/result_file.hpp>
#include <wiggers/core/saved_numbers.hpp>
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
  CHECK_THROWS_AS(require_writable(folder.path / "no" / "d.txt", "-o", FileKind::table), InputError);
  CHECK_THROWS_AS(require_writable(folder.path, "-o", FileKind::table), InputError);
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

namespace {
mode_t mode_of(const fs::path& path) { return static_cast<mode_t>(fs::status(path).permissions()) & 0777; }

// A result file with one entry, by the library itself, as another program may have written it.
void write_entry(const fs::path& path, const char* name, hid_t type, hid_t space, const void* data) {
  const hid_t file = H5Fcreate(path.c_str(), H5F_ACC_TRUNC, H5P_DEFAULT, H5P_DEFAULT);
  const hid_t set = H5Dcreate2(file, name, type, space, H5P_DEFAULT, H5P_DEFAULT, H5P_DEFAULT);
  REQUIRE(H5Dwrite(set, type, H5S_ALL, H5S_ALL, H5P_DEFAULT, data) >= 0);
  H5Dclose(set);
  H5Fclose(file);
}
}  // namespace

TEST_CASE("an earlier file's mode is kept, a new one follows the umask") {
  const Folder folder;
  const mode_t before = umask(0027);
  write_file_atomically(folder.path / "new", "x");
  umask(before);
  CHECK(mode_of(folder.path / "new") == 0640);
  fs::permissions(folder.path / "new", fs::perms::owner_read | fs::perms::owner_write);
  write_file_atomically(folder.path / "new", "y");
  CHECK(mode_of(folder.path / "new") == 0600);
}

TEST_CASE("a link is followed to its file, which is replaced beside itself") {
  const Folder folder;
  fs::create_directory(folder.path / "real");
  write_file_atomically(folder.path / "real" / "a", "first");
  fs::create_symlink("real/a", folder.path / "link");
  fs::create_symlink(folder.path / "link", folder.path / "second");
  write_file_atomically(folder.path / "second", "through two links");
  CHECK(fs::is_symlink(folder.path / "link"));
  CHECK(fs::is_symlink(folder.path / "second"));
  CHECK(read_file(folder.path / "real" / "a") == "through two links");
  fs::create_symlink("real/not-yet", folder.path / "dangling");
  write_file_atomically(folder.path / "dangling", "made");
  CHECK(read_file(folder.path / "real" / "not-yet") == "made");
  fs::create_symlink("loop", folder.path / "loop");
  CHECK_THROWS_AS(write_file_atomically(folder.path / "loop", "x"), ResourceError);
  CHECK_THROWS_AS(require_writable(folder.path / "loop", "-o", FileKind::table), InputError);
}

TEST_CASE("devices, pipes and open files are written through, never replaced") {
  const Folder folder;
  fs::create_symlink("/dev/null", folder.path / "null");
  for (const char* name : {"/dev/null", "/dev/stdout", "/dev/fd/1", "/proc/self/fd/1", "/dev/../dev/null"})
    CHECK(is_special(name));
  CHECK(is_special(folder.path / "null"));
  CHECK_FALSE(is_special(folder.path));
  CHECK_FALSE(is_special(folder.path / "missing"));
  write_file_atomically(folder.path / "null", "gone");
  CHECK(fs::is_symlink(folder.path / "null"));
  CHECK(fs::is_character_file("/dev/null"));
  // An open file is written where it stands.
  const int open_file = ::open((folder.path / "log").c_str(), O_RDWR | O_CREAT, 0600);
  REQUIRE(::write(open_file, "begin ", 6) == 6);
  write_file_atomically("/dev/fd/" + std::to_string(open_file), "middle ");
  REQUIRE(::write(open_file, "end", 3) == 3);
  ::close(open_file);
  CHECK(read_file(folder.path / "log") == "begin middle end");
  // A pipe.
  REQUIRE(mkfifo((folder.path / "pipe").c_str(), 0600) == 0);
  std::string got;
  std::thread reader([&] {
    std::ifstream in(folder.path / "pipe");
    std::getline(in, got);
  });
  write_file_atomically(folder.path / "pipe", "a line\n");
  reader.join();
  CHECK(got == "a line");
  CHECK(fs::is_fifo(folder.path / "pipe"));
}

TEST_CASE("what killed runs left goes with the next write - what is written or not ours stays") {
  const Folder folder;
  const pid_t child = fork();
  if (child == 0) _exit(0);
  waitpid(child, nullptr, 0);  // a process that is gone
  const auto partial = [&](const std::string& name, pid_t process) {
    return folder.path / (name + "." + std::to_string(process) + "-0123456789abcdef.partial");
  };
  for (const fs::path& path : {partial("r.h5", child), partial("r.h5", getpid()), partial("other.h5", child),
                               folder.path / "r.h5.notes.partial"})
    std::ofstream(path) << "x";
  std::ofstream(folder.path / "victim") << "kept";
  fs::remove(partial("r.h5", child));
  fs::create_symlink("victim", partial("r.h5", child));  // planted
  write_file_atomically(folder.path / "r.h5", "result");
  CHECK(read_file(folder.path / "victim") == "kept");
  fs::remove(partial("r.h5", child));
  std::ofstream(partial("r.h5", child)) << "x";
  write_file_atomically(folder.path / "r.h5", "result");
  CHECK_FALSE(fs::exists(partial("r.h5", child)));
  CHECK(fs::exists(partial("r.h5", getpid())));
  CHECK(fs::exists(partial("other.h5", child)));
  CHECK(fs::exists(folder.path / "r.h5.notes.partial"));
}

TEST_CASE("an input is no output, whichever is known first and by whichever name") {
  const Folder folder;
  const auto path = [&](const char* name) { return folder.path / name; };
  const std::string table = "a,b\n1,2\n";
  for (const char* name : {"scene", "mesh", "csv", "result"}) std::ofstream(path(name)) << table;
  (void)read_file(path("scene"));
  CHECK_THROWS_WITH(require_writable(path("scene"), "-o", FileKind::table),
                    Catch::Contains("is an input of this command"));
  fs::create_symlink("scene", path("link"));
  fs::create_hard_link(path("scene"), path("hard"));
  CHECK_THROWS_AS(require_writable(path("link"), "-o", FileKind::table), InputError);
  CHECK_THROWS_AS(require_writable(path("hard"), "-o", FileKind::table), InputError);
  CHECK_THROWS_AS(require_writable(folder.path / "." / "scene", "-o", FileKind::table), InputError);
  require_writable(path("mesh"), "-o", FileKind::table);
  CHECK_THROWS_WITH(read_file(path("mesh")), Catch::Contains("is an input of this command"));
  CHECK_THROWS_WITH(require_writable(path("mesh"), "--final-state", FileKind::table),
                    Catch::Contains("-o already"));
  allow_going_on_in(path("result"));
  require_writable(path("result"), "-o", FileKind::table);
  CHECK(read_file(path("result")) == table);
  fs::create_directory(path("r.fields"));
  std::ofstream(path("r.fields") / "frame_000000.vtu") << "mesh";
  (void)read_file(path("r.fields") / "frame_000000.vtu");
  CHECK_THROWS_WITH(require_writable_folder(path("r.fields"), "-o"), Catch::Contains("frame_000000.vtu"));
  CHECK(read_file(path("scene")) == table);
}

TEST_CASE("a file is replaced only by one of its own kind") {
  const Folder folder;
  const auto put = [&](const char* name, std::string_view text) {
    std::ofstream(folder.path / name, std::ios::binary) << text;
    return folder.path / name;
  };
  {
    ResultWriter writer;
    writer.dataset("/cells/crn/V", std::vector<double>(100000, -81.0), "mV", "potential");
    writer.write(folder.path / "ours.h5");
  }
  const double one = 1;
  const hid_t scalar = H5Screate(H5S_SCALAR);
  write_entry(folder.path / "theirs.h5", "a", H5T_NATIVE_DOUBLE, scalar, &one);
  struct Case {
    fs::path path;
    FileKind kind;
    bool good;
  };
  const std::string wide = "a" + std::string(20000, ',') + "\n1" + std::string(20000, ',') + "\n";
  const Case cases[] = {
      {folder.path / "ours.h5", FileKind::result, true},
      {folder.path / "theirs.h5", FileKind::result, false},
      {put("named.h5", "\x89HDF\r\n\x1a\n history: see the provenance notes"), FileKind::result, false},
      {folder.path / "none.h5", FileKind::result, true},
      {put("empty", ""), FileKind::result, true},
      {"/dev/null", FileKind::result, true},
      {put("scene.toml", "title = \"x\"\nbase = \"y.toml\"\n"), FileKind::result, false},
      {put("scene.csv", "title = \"x, y\"\nbase = \"y.toml\"\n"), FileKind::table, false},
      {put("one.csv", "period_s = 1\n\n[heart]\n"), FileKind::table, false},
      {put("t.csv", "t [ms],V [mV]\r\n0,-81.2\r\n1,nan\r\n"), FileKind::table, true},
      {put("notes.csv", "name,age\nAnna,31\n"), FileKind::table, false},
      {put("diary.csv", "dear diary\n42\nI went\n"), FileKind::table, false},
      {put("foot.csv", "t,Ca\n0,0.1\n\nnotes: do not lose\n"), FileKind::table, false},
      {put("wide.csv", wide), FileKind::table, false},
      {put("zeros.csv", std::string_view("a,b\n1,2\n\0", 9)), FileKind::table, false},
      {folder.path / "ours.h5", FileKind::table, false},
      {put("t2.csv", "a,b\n1,2\n"), FileKind::result, false},
      {put("a.msh", "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Comments\nwritten by wiggers; unit: mm\n"),
       FileKind::mesh, true},
      {put("b.msh", "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n"), FileKind::mesh, false},
      {put("a.json", "{\n \"format\": 1,\n \"model\": \"crn\","), FileKind::state, true},
      {put("e.json", "{\"format\": \"mylab\", \"model\": \"forest\"}"), FileKind::state, false},
      {put("b.json", "{\"name\": \"package\"}"), FileKind::state, false},
      {put("c.json", "{\n \"subject\": \"crn\""), FileKind::study, true},
      {put("d.json", "[1, 2]"), FileKind::study, false},
      {put("a.png", "\x89PNG\r\n tEXtSoftware Matplotlib version"), FileKind::picture, true},
      {put("b.png", "\x89PNG\r\n a photograph"), FileKind::picture, false},
      {put("a.html", "<!doctype html><html><meta content='written by wiggers'>"), FileKind::page, true},
      {put("b.html", "<!doctype html><html><p>my page"), FileKind::page, false},
  };
  for (const Case& c : cases) {
    INFO(c.path << " as " << name_of(c.kind));
    CHECK(is_replaceable(c.path, c.kind) == c.good);
  }
  fs::create_symlink("scene.toml", folder.path / "link");
  CHECK_THROWS_WITH(
      require_writable(folder.path / "link", "-o", FileKind::result),
      Catch::Contains("is there already and is not a result") && Catch::Contains("name another file"));
}

TEST_CASE("frames of others are not replaced, nor what a linked folder holds") {
  const Folder folder;
  const fs::path fields = folder.path / "r.LV.fields";
  require_writable_folder(fields, "-o");
  fs::create_directory(fields);
  std::ofstream(fields / "notes.txt") << "x";
  require_writable_folder(fields, "-o");
  std::ofstream(fields / "frame_000001.vtu") << "x";
  CHECK_THROWS_WITH(require_writable_folder(fields, "-o"), Catch::Contains("no index.pvd"));
  std::ofstream(fields / "index.pvd") << "<VTKFile type=\"Collection\">";
  CHECK_THROWS_WITH(require_writable_folder(fields, "-o"), Catch::Contains("index.pvd' is there already"));
  std::ofstream(fields / "index.pvd")
      << "<?xml?>\n<!-- mesh: 4 points, 1 cells -->\n<VTKFile type=\"Collection\">";
  require_writable_folder(fields, "-o");
  fs::create_directory_symlink("r.LV.fields", folder.path / "l.LV.fields");
  CHECK_THROWS_WITH(require_writable_folder(folder.path / "l.LV.fields", "-o"), Catch::Contains("is a link"));
  CHECK_THROWS_WITH(require_writable_folder(folder.path / "l.LV.fields" / "", "-o"),
                    Catch::Contains("is a link"));
}

TEST_CASE("a name of any legal length can be written, and what killed runs left of it goes") {
  const Folder folder;
  const pid_t child = fork();
  if (child == 0) _exit(0);
  waitpid(child, nullptr, 0);
  for (const std::size_t length : {220, 221, 240, 255}) {
    for (const std::string letter : {"n", "\xc3\xa9"}) {
      std::string name = length % 2 ? "x" : "";
      while (name.size() + letter.size() <= length) name += letter;
      const fs::path file = folder.path / name;
      INFO(length << " bytes of " << letter);
      require_writable(file, "-o", FileKind::table);
      write_file_atomically(file, "a,b\n1,2\n");
      CHECK(read_own_file(file) == "a,b\n1,2\n");
      std::string stem = name;
      if (stem.size() > 220)
        stem.resize(letter.size() == 2 && length % 2 == 0 ? 220 : letter.size() == 2 ? 219 : 220);
      const fs::path left = folder.path / (stem + "." + std::to_string(child) + "-0123456789abcdef.partial");
      std::ofstream(left) << "x";
      write_file_atomically(file, "a,b\n3,4\n");
      CHECK_FALSE(fs::exists(left));
      CHECK(files_in(folder.path) == 1);
      fs::remove(file);
    }
  }
  CHECK_THROWS_WITH(require_writable(folder.path / std::string(256, 'n'), "-o", FileKind::table),
                    Catch::Contains("name too long"));
}

TEST_CASE("pipes are read once, and not for ever - a missing file names its neighbour") {
  const Folder folder;
  REQUIRE(mkfifo((folder.path / "scene").c_str(), 0600) == 0);
  std::thread writer([&] { std::ofstream(folder.path / "scene") << "title = 1"; });
  CHECK(read_file(folder.path / "scene") == "title = 1");
  writer.join();
  CHECK(read_file(folder.path / "scene") == "title = 1");
  CHECK(special_file_was_read());
  CHECK_THROWS_WITH(read_file("/dev/zero"), Catch::Contains("does not end"));
  std::ofstream(folder.path / "whole_heart.toml") << "x";
  CHECK_THROWS_WITH(read_file(folder.path / "whole_haert.toml"),
                    Catch::Contains("did you mean") && Catch::Contains("whole_heart.toml"));
}

TEST_CASE("entries of another kind, rank or length are refused with their name, and nothing is read") {
  const Folder folder;
  const fs::path file = folder.path / "x.h5";
  const auto refuse = [&](auto read, const char* why) {
    const ResultReader reader(file);
    CHECK_THROWS_WITH(read(reader), Catch::Contains("x.h5") && Catch::Contains("/a") && Catch::Contains(why));
    CHECK_THROWS_AS(read(reader), InputError);
  };
  const auto numbers = [](const ResultReader& r) { return r.dataset("/a"); };
  const auto text = [](const ResultReader& r) { return r.text("/a"); };
  const hsize_t three[] = {3}, square[] = {2, 2};
  const hid_t row = H5Screate_simple(1, three, nullptr), plane = H5Screate_simple(2, square, nullptr),
              one = H5Screate(H5S_SCALAR);
  const double values[4] = {1, std::nan(""), 3, 4};
  const hid_t fixed = H5Tcopy(H5T_C_S1), variable = H5Tcopy(H5T_C_S1);
  H5Tset_size(fixed, 8);
  H5Tset_size(variable, H5T_VARIABLE);

  write_entry(file, "a", H5T_NATIVE_DOUBLE, row, values);
  refuse(text, "does not hold text");
  refuse([](const ResultReader& r) { return r.finite("/a"); }, "number 2");
  refuse([](const ResultReader& r) { return r.scalar("/a"); }, "one is wanted");
  write_entry(file, "a", H5T_NATIVE_DOUBLE, one, values);
  CHECK(ResultReader(file).scalar("/a") == 1);
  refuse(numbers, "a row is wanted");
  write_entry(file, "a", H5T_NATIVE_DOUBLE, plane, values);
  refuse(numbers, "2 dimensions");
  write_entry(file, "a", fixed, row, "one\0\0\0\0\0two\0\0\0\0\0three\0\0");
  refuse(numbers, "text, not numbers");
  refuse(text, "3 texts");
  write_entry(file, "a", fixed, one, "eightchr");
  CHECK(ResultReader(file).text("/a") == "eightchr");
  const char* word = "of any length";
  write_entry(file, "a", variable, one, &word);
  CHECK(ResultReader(file).text("/a") == word);
  const hid_t empty = H5Screate(H5S_NULL);
  write_entry(file, "a", H5T_NATIVE_DOUBLE, empty, nullptr);
  refuse(numbers, "is empty");
  // More numbers than the file has bytes: declared, never written.
  const hsize_t many[] = {hsize_t{1} << 50}, part[] = {1000};
  const hid_t vast = H5Screate_simple(1, many, nullptr), packed = H5Pcreate(H5P_DATASET_CREATE);
  H5Pset_chunk(packed, 1, part);
  const hid_t made = H5Fcreate(file.c_str(), H5F_ACC_TRUNC, H5P_DEFAULT, H5P_DEFAULT);
  H5Dclose(H5Dcreate2(made, "a", H5T_NATIVE_DOUBLE, vast, H5P_DEFAULT, packed, H5P_DEFAULT));
  H5Lcreate_external("elsewhere.h5", "/a", made, "b", H5P_DEFAULT, H5P_DEFAULT);
  H5Gclose(H5Gcreate2(made, "g", H5P_DEFAULT, H5P_DEFAULT, H5P_DEFAULT));
  H5Fclose(made);
  refuse(numbers, "can hold");
  CHECK_FALSE(ResultReader(file).has("/b"));
  CHECK_THROWS_WITH(ResultReader(file).require_sensible_sizes(),
                    Catch::Contains("entry /b is a link to another place"));
  // Without links the size is what is told; within what packing could hold, the memory.
  const auto declare = [&](hsize_t n, std::size_t bytes_of_rest) {
    const hid_t made = H5Fcreate(file.c_str(), H5F_ACC_TRUNC, H5P_DEFAULT, H5P_DEFAULT);
    const hsize_t size[] = {n}, rest[] = {bytes_of_rest};
    H5Gclose(H5Gcreate2(made, "g", H5P_DEFAULT, H5P_DEFAULT, H5P_DEFAULT));
    H5Dclose(H5Dcreate2(made, "g/claims", H5T_NATIVE_DOUBLE, H5Screate_simple(1, size, nullptr), H5P_DEFAULT,
                        packed, H5P_DEFAULT));
    const hid_t set = H5Dcreate2(made, "rest", H5T_NATIVE_CHAR, H5Screate_simple(1, rest, nullptr),
                                 H5P_DEFAULT, H5P_DEFAULT, H5P_DEFAULT);
    const std::string content(bytes_of_rest, 'x');
    H5Dwrite(set, H5T_NATIVE_CHAR, H5S_ALL, H5S_ALL, H5P_DEFAULT, content.data());
    H5Dclose(set);
    H5Fclose(made);
  };
  declare(1000, 10);
  ResultReader(file).require_sensible_sizes();
  declare(hsize_t{1} << 40, 10);
  CHECK_THROWS_WITH(ResultReader(file).require_sensible_sizes(),
                    Catch::Contains("/g/claims") && Catch::Contains("can hold"));
  const auto most = static_cast<hsize_t>(0.3 * available_memory());
  declare(most / 8, most / 190);
  CHECK_THROWS_WITH(ResultReader(file).require_sensible_sizes(),
                    Catch::Contains("/g/claims") && Catch::Contains("cannot be read on this machine"));
  CHECK_THROWS_WITH(ResultReader(file).dataset("/g"), Catch::Contains("no row of numbers"));
}

TEST_CASE("a result of which one bit changed is refused, wherever it is") {
  const Folder folder;
  const fs::path file = folder.path / "r.h5";
  {
    ResultWriter writer;
    for (int k = 0; k < 40; ++k)
      writer.dataset("/checkpoint/part" + std::to_string(k), std::vector<double>(20, 0.1 * k), "mL",
                     "numbers");
    writer.text("/provenance/scene", "title = \"x\"\n");
    writer.write(file);
  }
  ResultReader(file).verify();
  const std::string whole = read_file(file);
  std::mt19937 random(1);
  int refused = 0, untouched = 0;
  for (int k = 0; k < 400; ++k) {
    std::string changed = whole;
    changed[random() % changed.size()] ^= static_cast<char>(1 << random() % 8);
    std::ofstream(file, std::ios::binary) << changed;
    // Whatever is not refused reads as it was: bytes between entries, units, meanings.
    try {
      const ResultReader reader(file);
      reader.verify();
      CHECK(reader.finite("/checkpoint/part7") == std::vector<double>(20, 0.1 * 7));
      ++untouched;
    } catch (const InputError&) {
      ++refused;
    }
  }
  CHECK(refused > 200);
  CHECK(refused + untouched == 400);
  for (std::size_t size : {std::size_t{0}, whole.size() / 2, whole.size() - 1}) {
    std::ofstream(file, std::ios::binary) << whole.substr(0, size);
    CHECK_THROWS_AS(ResultReader(file).verify(), InputError);
  }
}

TEST_CASE("saved numbers are taken one by one and in sense") {
  SavedNumbers in({3, -1, 2.5, std::nan("")}, "r.h5: /checkpoint/run");
  CHECK(in.count(10) == 3);
  CHECK_THROWS_WITH(in.count(10), Catch::Contains("r.h5: /checkpoint/run") && Catch::Contains("-1"));
  CHECK_THROWS_AS(in.count(10), InputError);
  CHECK_THROWS_AS(in.number(), InputError);
  CHECK_THROWS_WITH(in.number(), Catch::Contains("ends after 4"));
  SavedNumbers two({1, 2}, "x");
  CHECK(two.number() == 1);
  CHECK_THROWS_WITH(two.finish(), Catch::Contains("1 more"));
  CHECK_THROWS_AS(two.numbers(3), InputError);
}

TEST_CASE("requests that fill the memory are refused with the numbers") {
  CHECK(available_memory() > 1e8);
  require_memory(1e5, 40, "x", "y");
  CHECK_THROWS_WITH(require_memory(1e12, 40, "--sample-ms 1e-9", "Take a larger one."),
                    Catch::Contains("--sample-ms 1e-9") && Catch::Contains("1e+12 rows") &&
                        Catch::Contains("GB") && Catch::Contains("Take a larger one."));
}

TEST_CASE("messages quote a bounded, printable part of what stands in a file") {
  const std::string message =
      InputError("unknown key '" + std::string(10'000'000, 'k') + "'; known: a, b").what();
  CHECK(message.size() < 1000);
  CHECK(message.starts_with("unknown key 'kkk"));
  CHECK(message.ends_with("'; known: a, b"));
  CHECK(std::string(InputError("a\x1b[2Jb\nc").what()) == "a?[2Jb\nc");
  CHECK(nearest_name(std::string(10'000'000, 'k'), std::vector<std::string>{"kk"}).empty());
}
