// Meshes: read, checked, made.
#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <wiggers/core/errors.hpp>
#include <wiggers/tissue/mesh/check.hpp>
#include <wiggers/tissue/mesh/geometry.hpp>
#include <wiggers/tissue/mesh/make.hpp>
#include <wiggers/tissue/mesh/read.hpp>
#include <wiggers/tissue/mesh/shapes.hpp>

using namespace wiggers;
using Catch::Contains;
namespace fs = std::filesystem;

namespace {

struct Folder {
  fs::path path = fs::temp_directory_path() / ("wiggers-mesh-" + std::to_string(getpid()));
  Folder() { fs::create_directories(path); }
  ~Folder() { fs::remove_all(path); }
  fs::path write(const std::string& name, const std::string& text) const {
    std::ofstream(path / name, std::ios::binary) << text;
    return path / name;
  }
};

TetMesh small_box() {
  return box_mesh({graded(0.03, 3, 1, 1), graded(0.02, 2, 1, 1), graded(0.02, 2, 1, 1)});
}

double total_volume_mL(const TetMesh& mesh) {
  double sum = 0;
  for (std::size_t c = 0; c < mesh.cells.size(); ++c) sum += 1e6 * cell_volume(mesh, c);
  return sum;
}

const MeshSurface& surface(const MeshReport& report, int tag) {
  for (const MeshSurface& s : report.surfaces)
    if (s.tag == tag) return s;
  throw std::runtime_error(fmt::format("no surface {}", tag));
}
double volume_mL(const MeshReport& report, int tag) {
  for (const MeshVolume& v : report.volumes)
    if (v.tag == tag) return v.volume_mL;
  return 0;
}

void check_same(const TetMesh& a, const TetMesh& b) {
  REQUIRE(a.points.size() == b.points.size());
  CHECK(a.cells == b.cells);
  CHECK(a.cell_tags == b.cell_tags);
  CHECK(a.facets.size() == b.facets.size());
  auto sorted = [](const TetMesh& m) {
    std::vector<std::array<int, 4>> all;
    for (std::size_t f = 0; f < m.facets.size(); ++f) {
      const auto t = ascending(m.facets[f]);
      all.push_back({t[0], t[1], t[2], m.facet_tags[f]});
    }
    std::sort(all.begin(), all.end());
    return all;
  };
  CHECK(sorted(a) == sorted(b));
  double distance = 0;
  for (std::size_t p = 0; p < a.points.size(); ++p)
    distance = std::max(distance, norm(a.points[p] - b.points[p]));
  CHECK(distance < 1e-15);
}

// Two tetrahedra on a common face, in mm; each part can be replaced.
std::string msh2(const std::string& elements,
                 const std::string& nodes = "5\n1 0 0 0\n2 30 0 0\n3 0 30 0\n4 0 0 30\n5 30 30 30\n") {
  return "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n" + nodes + "$EndNodes\n$Elements\n" + elements +
         "$EndElements\n";
}

std::string msh4(const TetMesh& mesh) {  // every tag its own entity, mm
  std::string text = "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$Entities\n0 0 6 1\n";
  for (int s = 1; s <= 6; ++s) text += fmt::format("{} 0 0 0 1 1 1 1 {} 0\n", 10 + s, s);
  text += "7 0 0 0 1 1 1 1 1 0\n$EndEntities\n";
  const auto n = mesh.points.size();
  text += fmt::format("$Nodes\n1 {} 1 {}\n3 7 0 {}\n", n, n, n);
  for (std::size_t p = 1; p <= n; ++p) text += fmt::format("{}\n", 10 * p);  // sparse numbers
  for (const auto& x : mesh.points) text += fmt::format("{} {} {}\n", 1e3 * x[0], 1e3 * x[1], 1e3 * x[2]);
  text += fmt::format("$EndNodes\n$Elements\n7 {} 1 9999\n", mesh.cells.size() + mesh.facets.size());
  int number = 0;
  for (int s = 1; s <= 6; ++s) {
    text += fmt::format("2 {} 2 {}\n", 10 + s, std::count(mesh.facet_tags.begin(), mesh.facet_tags.end(), s));
    for (std::size_t f = 0; f < mesh.facets.size(); ++f)
      if (mesh.facet_tags[f] == s)
        text += fmt::format("{} {} {} {}\n", ++number, 10 * (mesh.facets[f][0] + 1),
                            10 * (mesh.facets[f][1] + 1), 10 * (mesh.facets[f][2] + 1));
  }
  text += fmt::format("3 7 4 {}\n", mesh.cells.size());
  for (const auto& c : mesh.cells)
    text += fmt::format("{} {} {} {} {}\n", ++number, 10 * (c[0] + 1), 10 * (c[1] + 1), 10 * (c[2] + 1),
                        10 * (c[3] + 1));
  return text + "$EndElements\n";
}

template <class T>
void put(std::string& bytes, T value) {
  bytes.append(reinterpret_cast<const char*>(&value), sizeof(T));
}

std::string base64(const std::string& bytes) {
  constexpr char letters[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string text;
  for (std::size_t i = 0; i < bytes.size(); i += 3) {
    unsigned bits = 0;
    for (std::size_t k = 0; k < 3; ++k)
      bits = bits << 8 | (i + k < bytes.size() ? static_cast<unsigned char>(bytes[i + k]) : 0U);
    for (std::size_t k = 0; k < 4; ++k)
      text += i + k <= bytes.size() ? letters[bits >> (18 - 6 * k) & 63] : '=';
  }
  return text;
}

// VTU of cells and tagged triangles; the numbers as text, base64 or raw bytes at the end.
std::string vtu(const TetMesh& mesh, const std::string& format) {
  std::string appended, text =
                            "<?xml version=\"1.0\"?>\n<VTKFile type=\"UnstructuredGrid\" version=\"1.0\" "
                            "byte_order=\"LittleEndian\" header_type=\"UInt64\">\n<UnstructuredGrid>\n";
  const auto n = mesh.cells.size() + mesh.facets.size();
  text += fmt::format("<Piece NumberOfPoints=\"{}\" NumberOfCells=\"{}\">\n", mesh.points.size(), n);
  const auto array = [&](const std::string& name, const std::vector<double>& values, bool whole) {
    text += fmt::format("<DataArray type=\"{}\" Name=\"{}\" format=\"{}\"", whole ? "Int64" : "Float64", name,
                        format);
    std::string bytes, words;
    put<std::uint64_t>(bytes, 8 * values.size());
    for (const double v : values) {
      if (whole)
        put<std::int64_t>(bytes, std::llround(v));
      else
        put<double>(bytes, v);
      words += fmt::format("{} ", v);
    }
    if (format == "appended") {
      text += fmt::format(" offset=\"{}\"/>\n", appended.size());
      appended += bytes;
    } else {
      text += ">\n" + (format == "ascii" ? words : base64(bytes)) + "\n</DataArray>\n";
    }
  };
  std::vector<double> x, corners, ends, types, tags;
  for (const auto& p : mesh.points)
    for (const double c : p) x.push_back(1e3 * c);
  for (std::size_t c = 0; c < mesh.cells.size(); ++c) {
    corners.insert(corners.end(), mesh.cells[c].begin(), mesh.cells[c].end());
    ends.push_back(static_cast<double>(corners.size()));
    types.push_back(10);
    tags.push_back(mesh.cell_tags[c]);
  }
  for (std::size_t f = 0; f < mesh.facets.size(); ++f) {
    corners.insert(corners.end(), mesh.facets[f].begin(), mesh.facets[f].end());
    ends.push_back(static_cast<double>(corners.size()));
    types.push_back(5);
    tags.push_back(mesh.facet_tags[f]);
  }
  text += "<CellData Scalars=\"tag\">\n";
  array("tag", tags, true);
  text += "</CellData>\n<Points>\n";
  array("Points", x, false);
  text += "</Points>\n<Cells>\n";
  array("connectivity", corners, true);
  array("offsets", ends, true);
  array("types", types, true);
  text += "</Cells>\n</Piece>\n</UnstructuredGrid>\n";
  if (!appended.empty()) text += "<AppendedData encoding=\"raw\">\n_" + appended + "\n</AppendedData>\n";
  return text + "</VTKFile>\n";
}

}  // namespace

TEST_CASE("a box mesh fills the box and its sides are tagged") {
  const TetMesh mesh = box_mesh({graded(0.01, 8, 3, 1), graded(0.001, 2, 1, 1), graded(0.001, 2, 1, 1)});
  CHECK(mesh.cells.size() == 6 * 8 * 2 * 2);
  CHECK(total_volume_mL(mesh) == Approx(0.01).epsilon(1e-12));
  for (std::size_t c = 0; c < mesh.cells.size(); ++c) REQUIRE(cell_volume(mesh, c) > 0);
  const MeshReport report = check_mesh(mesh);
  CHECK(surface(report, 1).area_cm2 == Approx(0.01));
  CHECK(surface(report, 4).area_cm2 == Approx(0.1));
  CHECK(report.untagged_triangles == 0);
  for (std::size_t f = 0; f < mesh.facets.size(); ++f)
    if (mesh.facet_tags[f] == 1) CHECK(facet_area_vector(mesh, f)[0] < 0);
  const auto at = graded(10, 8, 4, 1);
  CHECK(at.back() == 10);
  CHECK((at[8] - at[7]) / (at[1] - at[0]) == Approx(4));
  CHECK_THROWS_WITH(box_mesh({{{0, 1}, {0, 0}, {0, 1}}}), Contains("ascend"));
}

TEST_CASE("the quality is one for the regular tetrahedron and zero for a flat one") {
  const double h = std::sqrt(2.0 / 3), r = std::sqrt(1.0 / 3);
  const Point3 a = {r, 0, 0}, b = {-r / 2, 0.5, 0}, c = {-r / 2, -0.5, 0};
  CHECK(tetrahedron_quality(a, b, c, {0, 0, h}) == Approx(1));
  CHECK(tetrahedron_quality(a, b, c, {0.1, 0, 0}) == 0);
  CHECK(tetrahedron_quality(a, c, b, {0, 0, h}) == Approx(-1));
}

TEST_CASE("mesh files of every kind read to the same mesh") {
  const Folder folder;
  const TetMesh mesh = small_box();
  write_msh(mesh, folder.path / "a.msh");
  check_same(read_mesh(folder.path / "a.msh"), mesh);
  std::vector<std::string> notes;
  check_same(read_mesh(folder.write("b.msh", msh4(mesh)), MeshUnit::automatic, &notes), mesh);
  REQUIRE(notes.size() == 1);
  CHECK_THAT(notes[0], Contains("30 x 20 x 20 mm"));
  for (const char* format : {"ascii", "binary", "appended"})
    check_same(read_mesh(folder.write("c.vtu", vtu(mesh, format))), mesh);
}

TEST_CASE("a binary gmsh file reads like a text one") {
  const Folder folder;
  std::string text = "$MeshFormat\n4.1 1 8\n";
  put<std::int32_t>(text, 1);
  text += "\n$EndMeshFormat\n$Entities\n";
  for (const int n : {0, 0, 0, 1}) put<std::uint64_t>(text, n);
  put<std::int32_t>(text, 3);
  for (int i = 0; i < 6; ++i) put<double>(text, 0);
  put<std::uint64_t>(text, 1), put<std::int32_t>(text, 9), put<std::uint64_t>(text, 0);
  text += "\n$EndEntities\n$Nodes\n";
  for (const int n : {1, 4, 1, 4}) put<std::uint64_t>(text, n);
  for (const int n : {3, 3, 0}) put<std::int32_t>(text, n);
  for (const int n : {4, 1, 2, 3, 4}) put<std::uint64_t>(text, n);
  for (const double x : {0, 0, 0, 30, 0, 0, 0, 30, 0, 0, 0, 30}) put<double>(text, x);
  text += "\n$EndNodes\n$Elements\n";
  for (const int n : {1, 1, 1, 1}) put<std::uint64_t>(text, n);
  for (const int n : {3, 3, 4}) put<std::int32_t>(text, n);
  for (const int n : {1, 1, 1, 2, 3, 4}) put<std::uint64_t>(text, n);
  text += "\n$EndElements\n";
  const TetMesh mesh = read_mesh(folder.write("d.msh", text));
  CHECK(total_volume_mL(mesh) == Approx(4.5));
  CHECK(mesh.cell_tags == std::vector<int>{9});
  CHECK_THROWS_AS(read_mesh(folder.write("e.msh", text.substr(0, text.size() - 60))), InputError);
}

TEST_CASE("a VTK file with cell data reads") {
  const Folder folder;
  const std::string text =
      "# vtk DataFile Version 3.0\ntitle\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 4 double\n0 0 0 30 0 0 0 "
      "30 0 0 0 "
      "30\nCELLS 2 9\n4 0 1 2 3\n3 0 1 2\nCELL_TYPES 2\n10 5\nCELL_DATA 2\nSCALARS tag int 1\nLOOKUP_TABLE "
      "default\n1 31\nVECTORS fibre double\n0 2 0 0 0 0\n";
  const TetMesh mesh = read_mesh(folder.write("a.vtk", text));
  CHECK(mesh.facet_tags == std::vector<int>{31});
  CHECK(facet_area_vector(mesh, 0)[2] < 0);
  REQUIRE(mesh.cell_frames.size() == 1);
  CHECK(mesh.cell_frames[0][0] == Point3{0, 1, 0});
  CHECK_THROWS_WITH(read_mesh(folder.write("b.vtk", "# vtk DataFile Version 3.0\nt\nBINARY\n")),
                    Contains("ASCII"));
}

TEST_CASE("CARP files read in micrometres with right-handed frames") {
  const Folder folder;
  folder.write("h.pts", "4\n0 0 0\n30000 0 0\n0 30000 0\n0 0 30000\n");
  folder.write("h.elem", "1\nTt 0 1 3 2 2\n");
  folder.write("h.lon", "2\n0 0 2 0 1 1\n");
  std::vector<std::string> notes;
  const TetMesh mesh = read_mesh(folder.path / "h.pts", MeshUnit::automatic, &notes);
  CHECK(total_volume_mL(mesh) == Approx(4.5));
  CHECK(mesh.cell_tags == std::vector<int>{2});
  CHECK(mesh.facets.empty());
  CHECK(mesh.cell_frames[0] == std::array<Point3, 3>{{{0, 0, 1}, {0, 1, 0}, {-1, 0, 0}}});
  REQUIRE(notes.size() == 2);
  CHECK_THAT(notes[0], Contains("taken as um"));
  CHECK_THAT(notes[1], Contains("1 of 1 cells were left-handed"));
  folder.write("h.lon", "1\n1 2 3\n");
  const auto frame = read_mesh(folder.path / "h.elem").cell_frames[0];
  CHECK(dot(frame[0], frame[1]) == Approx(0).margin(1e-15));
  CHECK(dot(cross(frame[0], frame[1]), frame[2]) == Approx(1));
  folder.write("h.elem", "1\nTt 0 1 2 4 1\n");
  CHECK_THROWS_WITH(read_mesh(folder.path / "h"),
                    Contains("point 4") && Contains("0 to 3") && Contains("line 2"));
  folder.write("h.elem", "1\nHx 0 1 2 3 4 5 6 7 1\n");
  CHECK_THROWS_WITH(read_mesh(folder.path / "h"), Contains("Hx"));
}

TEST_CASE("the unit follows the size and can be given") {
  const Folder folder;
  const auto width_mm = [&](double scale, MeshUnit unit) {
    const auto file =
        folder.write("u.msh", msh2("1\n1 4 2 1 1 1 2 3 4\n", fmt::format("4\n1 0 0 0\n2 {0} 0 0\n3 0 {0} "
                                                                         "0\n4 0 0 {0}\n",
                                                                         scale)));
    return check_mesh(read_mesh(file, unit)).extent_mm[0];
  };
  CHECK(width_mm(100, MeshUnit::automatic) == Approx(100));
  CHECK(width_mm(10.5, MeshUnit::automatic) == Approx(105));
  CHECK(width_mm(0.1, MeshUnit::automatic) == Approx(100));
  CHECK(width_mm(90000, MeshUnit::automatic) == Approx(90));
  CHECK(width_mm(10.5, MeshUnit::millimetre) == Approx(10.5));
  CHECK(mesh_unit("cm") == MeshUnit::centimetre);
  CHECK_THROWS_WITH(mesh_unit("inch"), Contains("mm"));
}

TEST_CASE("mesh files that make no sense are refused with their place") {
  const Folder folder;
  const auto refuse = [&](const std::string& text, const char* expected) {
    CHECK_THROWS_WITH(read_mesh(folder.write("bad.msh", text)), Contains(expected));
    CHECK_THROWS_AS(read_mesh(folder.path / "bad.msh"), InputError);
  };
  refuse("", "$MeshFormat");
  refuse("$MeshFormat\n4.0 0 8\n$EndMeshFormat\n", "known: 2.2, 4.1");
  refuse(msh2("2\n1 4 2 1 1 1 2 3 4\n2 4 2 1 1 2 1 4 3\n"), "the same tetrahedron");
  refuse(msh2("1\n1 4 2 1 1 1 2 3 3\n"), "uses a point twice");
  refuse(msh2("1\n1 4 2 1 1 1 2 3 7\n"), "node 7, which does not exist");
  refuse(msh2("1\n1 4 2 1 1 1 2 3 4\n", "4\n1 0 0 0\n2 30 0 0\n3 0 30 0\n4 9 9 0\n"), "no volume");
  refuse(msh2("1\n1 4 2 1 1 1 2 3 4\n", "4\n1 0 0 0\n2 30 x 0\n3 0 30 0\n4 9 9 0\n"), "line 7");
  refuse(msh2("1\n1 5 2 1 1 1 2 3 4 1 2 3 4\n"), "hexahedron");
  refuse(msh2("1\n1 11 2 1 1 1 2 3 4 1 2 3 4 1 2\n"), "tetrahedron of order 2");
  refuse(msh2("2\n1 4 2 1 1 1 2 3 4\n2 2 2 31 1 1 2 5\n"), "tag 31");
  refuse(msh2("3\n1 4 2 1 1 1 2 3 4\n2 2 2 31 1 1 2 3\n3 2 2 32 1 3 2 1\n"), "two tags");
  refuse(msh2("0\n"), "no tetrahedra");
  refuse(msh2("99999999\n1 4 2 1 1 1 2 3 4\n"), "more than this file can hold");
  const std::string whole = msh4(small_box());
  for (std::size_t part = 1; part < 20; ++part)
    CHECK_THROWS_AS(read_mesh(folder.write("cut.msh", whole.substr(0, whole.size() * part / 20))),
                    InputError);
  CHECK_THROWS_AS(read_mesh(folder.path / "missing.msh"), ResourceError);
  CHECK_THROWS_WITH(read_mesh(folder.write("a.stl", "solid")), Contains(".msh"));
  std::string compressed = vtu(small_box(), "ascii");
  compressed.replace(compressed.find("header_type"), 0, "compressor=\"vtkZLibDataCompressor\" ");
  CHECK_THROWS_WITH(read_mesh(folder.write("z.vtu", compressed)), Contains("compressed"));
}

TEST_CASE("what can be mended is mended and noted") {
  const Folder folder;
  std::vector<std::string> notes;
  // The second cell left-handed, the fifth point unused, the triangle wrong way round and once too often, one
  // triangle between the cells.
  const auto file = folder.write(
      "m.msh",
      msh2("5\n1 4 2 1 1 1 2 3 4\n2 4 2 1 1 2 3 4 6\n3 2 2 31 1 1 2 3\n4 2 2 31 1 1 2 3\n5 2 2 8 1 2 3 4\n",
           "6\n1 0 0 0\n2 30 0 0\n3 0 30 0\n4 0 0 30\n5 90 90 90\n6 30 30 30\n"));
  const TetMesh mesh = read_mesh(file, MeshUnit::millimetre, &notes);
  CHECK(mesh.points.size() == 5);
  CHECK(cell_volume(mesh, 1) > 0);
  REQUIRE(mesh.facets.size() == 1);
  CHECK(facet_area_vector(mesh, 0)[2] < 0);
  std::string all;
  for (const auto& note : notes) all += note + "\n";
  CHECK_THAT(all, Contains("1 points belong to no cell") && Contains("stand twice") &&
                      Contains("between two cells"));
}

TEST_CASE("a mesh that does not fit a heart is reported and refused") {
  TetMesh mesh = small_box();
  const MeshReport unknown = check_mesh(mesh);
  CHECK(std::any_of(unknown.findings.begin(), unknown.findings.end(),
                    [](const MeshFinding& f) { return f.text.find("surface tag 1") != std::string::npos; }));
  const int left[] = {mesh_tags::endocardium_LV};
  CHECK_NOTHROW(require_sound(mesh, {}, "box"));
  CHECK_THROWS_WITH(require_sound(mesh, left, "box"), Contains("endocardium-LV"));
  for (int& tag : mesh.facet_tags) tag = tag == 6 ? 31 : 24;
  CHECK_THROWS_WITH(require_sound(mesh, left, "box"), Contains("not closed") && Contains("20.00) mm"));
  for (int& tag : mesh.facet_tags) tag = 24;
  CHECK_THROWS_WITH(require_sound(mesh, left, "box"), Contains("encloses tissue"));
  mesh.cell_tags[0] = 2;
  mesh.cell_tags[1] = 4;
  CHECK_THROWS_WITH(require_sound(mesh, {}, "box"), Contains("share") && Contains("volume tag 4"));
}

TEST_CASE("a wall with one element across is warned of and another unit is refused") {
  const auto thin = [](const TetMesh& mesh) {
    for (const std::string& warning : require_sound(mesh, std::vector<int>{24}, "ellipsoid"))
      if (warning.find("reach through the wall") != std::string::npos) return true;
    return false;
  };
  CHECK(thin(make_ellipsoid(12)));
  EllipsoidShape thick = defaults_of(ellipsoid_quantities);
  thick[2] = 25;
  CHECK(check_mesh(make_ellipsoid(6, thick)).thin_share < 0.05);
  TetMesh in_um = make_ellipsoid(12);
  for (Point3& p : in_um.points) p = 1e3 * p;
  CHECK_THROWS_WITH(require_sound(in_um, std::vector<int>{24}, "ellipsoid"),
                    Contains("no size of a heart") && Contains("give the unit"));
}

TEST_CASE("ellipsoids have closed cavities and the volumes of the formula and good cells") {
  const auto [radius, length, wall, base, cap] = defaults_of(ellipsoid_quantities);
  const auto below_mL = [](double r, double l, double z) {
    return M_PI * r * r * (2 * l / 3 + z - z * z * z / (3 * l * l)) / 1000;
  };
  for (const double size : {8.0, 5.0, 4.0}) {
    INFO("size " << size);
    const TetMesh mesh = make_ellipsoid(size);
    const MeshReport report = check_mesh(mesh);
    CHECK(report.lowest_quality >= 0.1);
    CHECK(surface(report, 24).closed);
    const double faceted = size * size / 2500;  // chords lie inside the curve
    CHECK(surface(report, 24).enclosed_mL == Approx(below_mL(radius, length, base - cap)).epsilon(faceted));
    const double wall_mL = below_mL(radius + wall, length + wall, base) - below_mL(radius, length, base);
    CHECK(volume_mL(report, 1) == Approx(wall_mL).epsilon(faceted));
    CHECK(report.untagged_triangles == 0);
    CHECK_NOTHROW(require_sound(mesh, std::vector<int>{24}, "ellipsoid"));
  }
  check_same(make_ellipsoid(8), make_ellipsoid(8));
  CHECK_THROWS_WITH(make_ellipsoid(0.01), Contains("size-mm"));
  CHECK_THROWS_AS(make_ellipsoid(8, {25, 20, 10, 50, 3}), InputError);
}

TEST_CASE("two ventricles have two closed cavities and good cells") {
  const TetMesh mesh = make_biventricular(6);
  const MeshReport report = check_mesh(mesh);
  CHECK(report.lowest_quality >= 0.1);
  CHECK_NOTHROW(require_sound(mesh, std::vector<int>{23, 24}, "biventricular"));
  CHECK(surface(report, 24).enclosed_mL == Approx(76.5).epsilon(0.02));
  CHECK(surface(report, 23).enclosed_mL == Approx(63.3).epsilon(0.02));
  CHECK(volume_mL(report, 1) == Approx(132.7).epsilon(0.01));
  CHECK(report.ventricular_pieces == 1);
  BiventricularShape narrow = defaults_of(biventricular_quantities);
  narrow[7] = 20;
  CHECK_THROWS_WITH(make_biventricular(6, narrow), Contains("tricuspid") && Contains("rv-offset-mm"));
}

TEST_CASE("the heart has four closed cavities and every tag and good cells") {
  const TetMesh mesh = make_heart(5);
  const MeshReport report = check_mesh(mesh);
  CHECK(report.lowest_quality >= 0.1);
  CHECK_NOTHROW(require_sound(mesh, std::vector<int>{21, 22, 23, 24}, "heart"));
  for (const auto& tag : mesh_tags::volumes) CHECK(volume_mL(report, tag.tag) > 0);
  for (const auto& tag : mesh_tags::surfaces) CHECK(surface(report, tag.tag).area_cm2 > 0);
  CHECK(report.surfaces.size() == mesh_tags::surfaces.size());
  CHECK(report.untagged_triangles == 0);
  CHECK(report.ventricular_pieces == 1);
  CHECK(report.atrial_pieces == 1);
  CHECK(surface(report, 22).enclosed_mL == Approx(33.6).epsilon(0.02));
  CHECK(surface(report, 21).enclosed_mL == Approx(32.7).epsilon(0.02));
  // A tube open at the top: its wall and the closed valve.
  CHECK(surface(report, 25).area_cm2 == Approx((2 * M_PI * 6.2 * 60 + M_PI * 6.2 * 6.2) / 100).epsilon(0.03));
}

TEST_CASE("benchmark shapes have the volumes of their formulas") {
  const TetMesh octant = make_sphere_octant(27.27575, 37.1635, 4);
  const MeshReport sphere = check_mesh(octant);
  CHECK(volume_mL(sphere, 1) == Approx(130.0 / 8).epsilon(0.005));
  CHECK(surface(sphere, 43).area_cm2 ==
        Approx(M_PI / 4 * (37.1635 * 37.1635 - 27.27575 * 27.27575) / 100).epsilon(0.01));
  CHECK(sphere.untagged_triangles == 0);
  CHECK(sphere.lowest_quality >= 0.1);
  const TetMesh whole = make_sphere(27.27575, 37.1635, 6);
  const MeshReport sphere_of_eight = check_mesh(whole);
  CHECK(volume_mL(sphere_of_eight, 1) ==
        Approx(8 * volume_mL(check_mesh(make_sphere_octant(27.27575, 37.1635, 6)), 1)).epsilon(1e-9));
  CHECK(surface(sphere_of_eight, 24).closed);
  CHECK(surface(sphere_of_eight, 24).enclosed_mL == Approx(85).epsilon(0.02));
  CHECK(sphere_of_eight.surfaces.size() == 2);
  CHECK_NOTHROW(require_sound(whole, std::vector<int>{24}, "sphere"));
  for (const bool quarter : {true, false}) {
    const MeshReport land = check_mesh(make_benchmark_ellipsoid(2, 1, quarter));
    CHECK(volume_mL(land, 1) == Approx(3.23473 / (quarter ? 4 : 1)).epsilon(0.01));
    CHECK(land.lowest_quality >= 0.1);
    CHECK(land.surfaces.size() == (quarter ? 5 : 3));
  }
}

TEST_CASE("the reference meshes have the volumes of their notes") {
  const fs::path folder = fs::path(WIGGERS_REFERENCE_DIR) / "tissue";
  if (!fs::exists(folder / "lv_ellipsoid_4mm.msh")) {
    WARN("no reference meshes in " << folder);
    return;
  }
  const MeshReport ellipsoid = check_mesh(read_mesh(folder / "lv_ellipsoid_4mm.msh"));
  CHECK(ellipsoid.cells == 12690);
  CHECK(volume_mL(ellipsoid, 1) == Approx(144.33).epsilon(1e-4));
  CHECK(volume_mL(ellipsoid, 2) == Approx(5.40).epsilon(1e-3));
  CHECK(surface(ellipsoid, 11).enclosed_mL == Approx(117.09).epsilon(1e-4));
  CHECK(surface(ellipsoid, 12).area_cm2 == Approx(183.0).epsilon(1e-3));
  const MeshReport heart = check_mesh(read_mesh(folder / "idealised_heart_5mm.msh"));
  CHECK(heart.cells == 18200);
  CHECK(heart.points == 5426);
  for (const int tag : {20, 21, 22, 23, 24}) CHECK(surface(heart, tag).closed);
  CHECK(volume_mL(heart, 1) == Approx(132.7).epsilon(1e-3));
  CHECK(heart.atrial_pieces == 1);
}

TEST_CASE("a tangled mesh is an error: cells on one side of their common face overlap") {
  TetMesh mesh;
  mesh.points = {{0, 0, 0}, {1e-2, 0, 0}, {0, 1e-2, 0}, {0, 0, 1e-2}, {0, 0, 5e-3}};
  mesh.cells = {{0, 1, 2, 3}, {0, 1, 2, 4}};
  mesh.cell_tags = {1, 1};
  const auto tangled = [](const TetMesh& m) {
    const MeshReport report = check_mesh(m);
    return std::any_of(report.findings.begin(), report.findings.end(),
                       [](const MeshFinding& f) { return f.text.find("tangled") != std::string::npos; });
  };
  CHECK(tangled(mesh));
  mesh.points[4][2] = -5e-3;
  mesh.cells[1] = {0, 2, 1, 4};
  CHECK(!tangled(mesh));
}

TEST_CASE("sizes without sense are told in few digits") {
  TetMesh mesh = small_box();
  for (Point3& x : mesh.points) x = 1e100 * x;
  const std::string text = report_text(check_mesh(mesh));
  INFO(text);
  CHECK_THAT(text, Contains("3e+101 x 2e+101 x 2e+101 mm") && Contains("1.2e+301 mL"));
  for (std::size_t at = 0; (at = text.find_first_of("0123456789", at)) != std::string::npos;) {
    const std::size_t end = std::min(text.find_first_not_of("0123456789", at), text.size());
    CHECK(end - at < 12);
    at = end;
  }
}
