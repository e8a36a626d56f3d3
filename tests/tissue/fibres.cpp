// Fibres from Laplace problems on meshes small enough to be made here, and field files read back.
#include <unistd.h>

#include <catch2/catch.hpp>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <functional>
#include <map>
#include <numbers>
#include <random>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/files.hpp>
#include <wiggers/tissue/body/field_file.hpp>
#include <wiggers/tissue/fibres/fibres.hpp>
#include <wiggers/tissue/fibres/laplace.hpp>
#include <wiggers/tissue/laws/tensor.hpp>

using namespace wiggers;

namespace {

using Index = std::array<int, 3>;

// A block of n[0] x n[1] x n[2] boxes, each cut into six tetrahedra around its diagonal. `tag` gives the
// volume tag of a box (0: a hole), `place` the point of a grid index, `surface` the tag of a boundary
// triangle with these grid indices (0: none). Grid points that coincide (a pole, a seam) become one.
TetMesh block(const Index& n, const std::function<int(Index)>& tag, const std::function<Point3(Index)>& place,
              const std::function<int(std::array<Index, 3>, int)>& surface) {
  TetMesh mesh;
  std::map<std::array<long, 3>, int> number;
  std::vector<std::array<Index, 4>> cells;
  const auto vertex = [&](const Index& i) {
    const Point3 p = place(i);
    const std::array<long, 3> key = {std::lround(p[0] * 1e9), std::lround(p[1] * 1e9),
                                     std::lround(p[2] * 1e9)};
    const auto [entry, fresh] = number.emplace(key, static_cast<int>(mesh.points.size()));
    if (fresh) mesh.points.push_back(p);
    return entry->second;
  };
  const std::array<Index, 6> orders = {{{0, 1, 2}, {0, 2, 1}, {1, 0, 2}, {1, 2, 0}, {2, 0, 1}, {2, 1, 0}}};
  for (int i = 0; i < n[0]; ++i)
    for (int j = 0; j < n[1]; ++j)
      for (int k = 0; k < n[2]; ++k) {
        if (tag({i, j, k}) == 0) continue;
        for (const Index& order : orders) {
          std::array<Index, 4> grid;
          grid[0] = {i, j, k};
          for (std::size_t step = 0; step < 3; ++step) {
            grid[step + 1] = grid[step];
            ++grid[step + 1][static_cast<std::size_t>(order[step])];
          }
          std::array<int, 4> cell;
          for (std::size_t v = 0; v < 4; ++v) cell[v] = vertex(grid[v]);
          const std::array<Point3, 4> p = {
              mesh.points[static_cast<std::size_t>(cell[0])], mesh.points[static_cast<std::size_t>(cell[1])],
              mesh.points[static_cast<std::size_t>(cell[2])], mesh.points[static_cast<std::size_t>(cell[3])]};
          const double volume = dot(cross(p[1] - p[0], p[2] - p[0]), p[3] - p[0]);
          if (std::abs(volume) < 1e-18) continue;  // collapsed at a pole
          if (volume < 0) {
            std::swap(cell[2], cell[3]);
            std::swap(grid[2], grid[3]);
          }
          mesh.cells.push_back(cell);
          mesh.cell_tags.push_back(tag({i, j, k}));
          cells.push_back(grid);
        }
      }
  struct Face {
    int count = 0;
    std::array<int, 3> vertices;
    std::array<Index, 3> grid;
    int tag;
  };
  std::map<std::array<int, 3>, Face> faces;
  const std::array<Index, 4> of_cell = {{{1, 2, 3}, {0, 3, 2}, {0, 1, 3}, {0, 2, 1}}};
  for (std::size_t c = 0; c < mesh.cells.size(); ++c)
    for (const Index& f : of_cell) {
      Face face;
      for (std::size_t v = 0; v < 3; ++v) {
        face.vertices[v] = mesh.cells[c][static_cast<std::size_t>(f[v])];
        face.grid[v] = cells[c][static_cast<std::size_t>(f[v])];
      }
      auto key = face.vertices;
      std::sort(key.begin(), key.end());
      face.tag = mesh.cell_tags[c];
      face.count = faces.contains(key) ? 2 : 1;
      faces[key] = face;
    }
  for (const auto& [key, face] : faces) {
    const int s = face.count == 1 ? surface(face.grid, face.tag) : 0;
    if (s == 0) continue;
    mesh.facets.push_back(face.vertices);
    mesh.facet_tags.push_back(s);
  }
  return mesh;
}

bool all_at(const std::array<Index, 3>& face, std::size_t axis, int value) {
  return face[0][axis] == value && face[1][axis] == value && face[2][axis] == value;
}

// A left ventricle: ellipsoids of radii 25, 25, 65 mm and 35, 35, 75 mm, cut at z = 20 mm.
TetMesh ellipsoid(int layers, int along, int around) {
  const auto place = [=](Index i) -> Point3 {
    const double t = static_cast<double>(i[0]) / layers;
    const double radius = 0.025 + 0.01 * t, length = 0.065 + 0.01 * t;
    const double polar = std::acos(-0.02 / length) * i[1] / along;
    const double azimuth = 2 * std::numbers::pi * (i[2] % around) / around;
    return {radius * std::sin(polar) * std::cos(azimuth), radius * std::sin(polar) * std::sin(azimuth),
            -length * std::cos(polar)};
  };
  return block(
      {layers, along, around}, [](Index) { return 1; }, place,
      [=](const std::array<Index, 3>& face, int) {
        return all_at(face, 0, 0)        ? mesh_tags::endocardium_LV
               : all_at(face, 0, layers) ? mesh_tags::epicardium
               : all_at(face, 1, along)  ? mesh_tags::epicardium_fat
                                         : 0;
      });
}

// Two ventricles as a block of 24 x 12 x 14 boxes of 3 mm with two wells; a cap closes the left one.
TetMesh two_wells() {
  const auto well = [](Index i) {
    if (i[1] < 3 || i[1] >= 9 || i[2] < 3) return 0;
    return i[0] >= 3 && i[0] < 9 ? 24 : i[0] >= 12 && i[0] < 21 ? 23 : 0;
  };
  const auto tag = [=](Index i) { return well(i) == 0 ? 1 : well(i) == 24 && i[2] == 13 ? 9 : 0; };
  const auto place = [](Index i) -> Point3 { return {0.003 * i[0], 0.003 * i[1], 0.003 * i[2]}; };
  return block({24, 12, 14}, tag, place, [](const std::array<Index, 3>& face, int) {
    if (all_at(face, 2, 14)) return mesh_tags::epicardium_fat;
    if (all_at(face, 0, 0) || all_at(face, 0, 24) || all_at(face, 1, 0) || all_at(face, 1, 12) ||
        all_at(face, 2, 0))
      return mesh_tags::epicardium;
    const int middle = face[0][0] + face[1][0] + face[2][0];
    return middle <= 3 * 9 ? mesh_tags::endocardium_LV : mesh_tags::endocardium_RV;
  });
}

const TetMesh& shell() {
  static const TetMesh mesh = ellipsoid(6, 24, 40);
  return mesh;
}
const FibreField& shell_fibres() {
  static const FibreField field = rule_based_fibres(shell());
  return field;
}

Point3 outward_of_ellipsoid(const Point3& p) {
  return {p[0] / (0.03 * 0.03), p[1] / (0.03 * 0.03), p[2] / (0.07 * 0.07)};
}

bool away_from_apex_and_base(const Point3& p) { return p[2] > -0.045 && p[2] < 0.01; }

double mean_helix_angle(const TetMesh& mesh, const FibreField& field, double lowest, double highest) {
  double sum = 0;
  int n = 0;
  for (std::size_t v = 0; v < mesh.points.size(); ++v) {
    const double depth = field.transmural[v];
    if (!away_from_apex_and_base(mesh.points[v]) || depth < lowest || depth > highest) continue;
    sum += helix_angle_deg(field.frames[v][0], outward_of_ellipsoid(mesh.points[v]), {0, 0, 1});
    ++n;
  }
  REQUIRE(n > 20);
  return sum / n;
}

struct Folder {
  Folder() { std::filesystem::create_directories(path); }
  ~Folder() { std::filesystem::remove_all(path); }
  std::filesystem::path path =
      std::filesystem::temp_directory_path() / ("wiggers-fields-" + std::to_string(getpid()));
};

// Counts the appended arrays of a VTU file, each of which must lie whole inside it; -1 if one does not.
int whole_arrays(const std::string& bytes) {
  const std::size_t raw = bytes.find("encoding=\"raw\">\n_");
  if (raw == std::string::npos || !bytes.ends_with("\n  </AppendedData>\n</VTKFile>\n")) return -1;
  const std::size_t start = raw + std::strlen("encoding=\"raw\">\n_");
  const std::size_t size = bytes.size() - start - std::strlen("\n  </AppendedData>\n</VTKFile>\n");
  int n = 0;
  std::size_t expected = 0;
  for (std::size_t at = bytes.find(" offset=\""); at < raw; at = bytes.find(" offset=\"", at + 1), ++n) {
    if (std::stoul(bytes.substr(at + 9)) != expected || expected + 8 > size) return -1;
    std::uint64_t length;
    std::memcpy(&length, bytes.data() + start + expected, sizeof length);
    expected += sizeof length + length;
  }
  return expected == size ? n : -1;
}

}  // namespace

TEST_CASE("a Laplace problem reproduces linear functions") {
  const TetMesh mesh = two_wells();
  const LaplaceProblem problem(mesh, {1, 9});
  // On a block that includes the cap, with all boundary values given.
  std::vector<BoundarySet> sets;
  std::vector<double> values;
  const auto linear = [](const Point3& p) { return 1 + 20 * p[0] - 30 * p[1] + 10 * p[2]; };
  std::vector<char> on_boundary(mesh.points.size(), 0);
  for (const auto& facet : mesh.facets)
    for (int v : facet) on_boundary[static_cast<std::size_t>(v)] = 1;
  for (std::size_t v = 0; v < mesh.points.size(); ++v)
    if (on_boundary[v]) {
      sets.push_back({"one", {static_cast<int>(v)}});
      values.push_back(linear(mesh.points[v]));
    }
  const auto u = problem.solve(sets, values);
  double worst = 0, worst_gradient = 0;
  const auto gradients = problem.vertex_gradients(u);
  for (std::size_t v = 0; v < u.size(); ++v) {
    worst = std::max(worst, std::abs(u[v] - linear(mesh.points[v])));
    worst_gradient = std::max(worst_gradient, norm(gradients[v] - Point3{20, -30, 10}));
  }
  CHECK(worst < 1e-11);
  CHECK(worst_gradient < 1e-8);
}

TEST_CASE("Laplace problems refuse boundary sets that touch nothing and parts that float") {
  TetMesh mesh = shell();
  const LaplaceProblem problem(mesh, {1});
  CHECK_THROWS_WITH(problem.solve(std::vector{BoundarySet{"endocardium-RV (surface 23)", {}}}, {1}),
                    Catch::Contains("endocardium-RV (surface 23)") && Catch::Contains("no vertex"));
  CHECK_THROWS_WITH(LaplaceProblem(mesh, {3}), Catch::Contains("no cell in volume 3"));
  // A copy of the mesh far away hangs on nothing.
  const int n = static_cast<int>(mesh.points.size());
  const auto cells = mesh.cells;
  for (int v = 0; v < n; ++v)
    mesh.points.push_back(mesh.points[static_cast<std::size_t>(v)] + Point3{1, 0, 0});
  for (auto cell : cells) {
    for (int& v : cell) v += n;
    mesh.cells.push_back(cell);
    mesh.cell_tags.push_back(1);
  }
  CHECK_THROWS_WITH(LaplaceProblem(mesh, {1}).solve(std::vector{BoundarySet{"one", {0}}}, {1}),
                    Catch::Contains("falls apart"));
  for (int& tag : mesh.facet_tags)
    if (tag == mesh_tags::endocardium_LV) tag = 0;
  CHECK_THROWS_WITH(rule_based_fibres(mesh), Catch::Contains("tagged 24"));
}

TEST_CASE("fibres of a left ventricle are right-handed frames") {
  const FibreCheck check = check_fibres(shell(), shell_fibres());
  CHECK(check.good());
  CHECK(check.vertices_with_frame == shell().points.size());
  CHECK(check.worst_length < 1e-10);
  CHECK(check.worst_orthogonality < 1e-10);
  CHECK(check.worst_handedness < 1e-10);
  for (double xi : shell_fibres().interventricular) REQUIRE(xi == 1);
  FibreField broken = shell_fibres();
  broken.frames[7][1][0] = std::nan("");
  CHECK_FALSE(check_fibres(shell(), broken).good());
  broken = shell_fibres();
  broken.frames[7] = {};
  CHECK(check_fibres(shell(), broken).vertices_missing == 1);
}

TEST_CASE("the helix angle is linear in depth and zero in the middle of the wall") {
  const FibreField& field = shell_fibres();
  double worst = 0;
  for (std::size_t v = 0; v < shell().points.size(); ++v) {
    const Point3& p = shell().points[v];
    if (!away_from_apex_and_base(p)) continue;
    const double angle = helix_angle_deg(field.frames[v][0], outward_of_ellipsoid(p), {0, 0, 1});
    worst = std::max(worst, std::abs(angle - (-60 + 120 * field.transmural[v])));
  }
  CHECK(worst < 5);
  // Half-way between the surfaces in millimetres; phi is there 0.46 because the wall is curved.
  double sum = 0;
  int n = 0;
  for (std::size_t v = 0; v < shell().points.size(); ++v) {
    const Point3& p = shell().points[v];
    const double on_middle = std::hypot(p[0], p[1]) / 0.03, z = p[2] / 0.07;
    if (!away_from_apex_and_base(p) || std::abs(on_middle * on_middle + z * z - 1) > 1e-6) continue;
    sum += helix_angle_deg(field.frames[v][0], outward_of_ellipsoid(p), {0, 0, 1});
    ++n;
  }
  REQUIRE(n > 100);
  CHECK(std::abs(sum / n) < 10);
  const auto table = helix_table(shell(), field);
  REQUIRE(table.size() == 1);
  CHECK(table[0].endo_deg == Approx(60).margin(3));
  CHECK(table[0].epi_deg == Approx(-60).margin(3));
  CHECK(std::abs(table[0].mid_deg) < 10);
}

TEST_CASE("a positive angle is a right-handed helix and sheets turn by beta") {
  CHECK(helix_angle_deg({0, std::cos(1.0), std::sin(1.0)}, {2, 0, 0}, {0, 0, 3}) ==
        Approx(180 / std::numbers::pi));
  std::array<double, 16> angles = defaults_of(fibre_quantities);
  angles[0] = angles[1] = 0;
  angles[2] = angles[3] = 30;
  const FibreField field = rule_based_fibres(shell(), fibre_rule(FibreRuleKind::doste, angles));
  for (std::size_t v = 0; v < shell().points.size(); ++v) {
    if (!away_from_apex_and_base(shell().points[v])) continue;
    const Point3 out = outward_of_ellipsoid(shell().points[v]);
    REQUIRE(std::abs(dot(field.frames[v][1], out)) / norm(out) ==
            Approx(std::cos(std::numbers::pi / 6)).margin(0.05));
    REQUIRE(std::abs(field.frames[v][0][2]) < 0.05);  // circumferential
  }
  angles[0] = 100;
  CHECK_THROWS_WITH(fibre_rule(FibreRuleKind::bayer, angles), Catch::Contains("left-alpha-endo"));
  CHECK_THROWS_WITH(fibre_rule_kind("bayern"), Catch::Contains("bayer"));
}

TEST_CASE("refining the mesh changes the mean angle by less than 3 degrees") {
  const TetMesh coarse = ellipsoid(4, 14, 24);
  const FibreField field = rule_based_fibres(coarse);
  for (const auto& [lowest, highest] : {std::pair{0.95, 1.0}, std::pair{0.0, 0.05}, std::pair{0.0, 1.0}})
    CHECK(std::abs(mean_helix_angle(coarse, field, lowest, highest) -
                   mean_helix_angle(shell(), shell_fibres(), lowest, highest)) < 3);
}

TEST_CASE("a cell across the whole wall has in its middle the fibres of the middle") {
  const TetMesh mesh = ellipsoid(1, 14, 24);
  for (const auto kind : {FibreRuleKind::bayer, FibreRuleKind::doste})
    for (const double most : {44.0, 46.0, 60.0, 90.0}) {
      std::array<double, 16> angles = defaults_of(fibre_quantities);
      angles[0] = most;
      angles[1] = -most;
      const FibreField field = rule_based_fibres(mesh, fibre_rule(kind, angles));
      int n = 0;
      for (int c = 0; c < static_cast<int>(mesh.cells.size()); ++c)
        for (std::size_t i = 0; i < 4; ++i)
          for (std::size_t k = 0; k < 4; ++k) {
            const auto& cell = mesh.cells[static_cast<std::size_t>(c)];
            const auto in = static_cast<std::size_t>(cell[i]), out = static_cast<std::size_t>(cell[k]);
            if (field.transmural[in] != 1 || field.transmural[out] != 0) continue;
            for (const double depth : {0.25, 0.5, 0.75}) {
              std::array<double, 4> at{};
              at[i] = depth;
              at[k] = 1 - depth;
              const Point3 p = depth * mesh.points[in] + (1 - depth) * mesh.points[out];
              if (!away_from_apex_and_base(p)) continue;
              const double angle =
                  helix_angle_deg(frame_at(field, mesh, c, at)[0], outward_of_ellipsoid(p), {0, 0, 1});
              INFO("+-" << most << " at depth " << depth);
              REQUIRE(angle == Approx(most * (2 * depth - 1)).margin(6));
              ++n;
            }
          }
      REQUIRE(n > 1000);
    }
}

namespace {

// Degrees between two lines.
double between_lines(const Point3& a, const Point3& b) {
  return std::asin(std::min(1.0, norm(cross(a, b)))) * 180 / std::numbers::pi;
}

std::array<double, 4> random_place(std::mt19937& random) {
  std::exponential_distribution<double> share;
  std::array<double, 4> at;
  double sum = 0;
  for (double& x : at) sum += x = share(random);
  for (double& x : at) x /= sum;
  return at;
}

// In random cells, the ones at the apex and between the ventricles among them: orthonormal at random places,
// without a jump on the way between two of them, and at the vertices the frames there.
void check_cells(const TetMesh& mesh, const FibreField& field, int n_cells) {
  std::mt19937 random(7);
  std::uniform_int_distribution<int> any(0, static_cast<int>(mesh.cells.size()) - 1);
  constexpr int n_steps = 200;
  double off = 0, jump = 0, at_vertices = 0;
  for (int n = 0; n < n_cells; ++n) {
    const int c = any(random);
    if (!mesh_tags::conductive(mesh.cell_tags[static_cast<std::size_t>(c)])) continue;
    const auto from = random_place(random), to = random_place(random);
    Frame before = frame_at(field, mesh, c, from);
    for (int k = 1; k <= n_steps; ++k) {
      std::array<double, 4> at;
      for (std::size_t i = 0; i < 4; ++i) at[i] = from[i] + (to[i] - from[i]) * k / n_steps;
      const Frame here = frame_at(field, mesh, c, at);
      for (std::size_t i = 0; i < 3; ++i) {
        for (std::size_t j = 0; j < 3; ++j) off = std::max(off, std::abs(dot(here[i], here[j]) - (i == j)));
        jump = std::max(jump, between_lines(before[i], here[i]));
        REQUIRE(dot(before[i], here[i]) > 0);  // nor does a sign change within the cell
      }
      off = std::max(off, norm(cross(here[0], here[1]) - here[2]));
      before = here;
    }
    for (std::size_t i = 0; i < 4; ++i) {
      std::array<double, 4> at{};
      at[i] = 1;
      const Frame here = frame_at(field, mesh, c, at);
      const auto v = static_cast<std::size_t>(mesh.cells[static_cast<std::size_t>(c)][i]);
      for (std::size_t k = 0; k < 3; ++k)
        at_vertices = std::max(at_vertices, between_lines(here[k], field.frames[v][k]));
    }
  }
  CHECK(off < 1e-12);
  CHECK(jump < 5);
  CHECK(at_vertices < 1e-5);
}

}  // namespace

TEST_CASE("frames are orthonormal and continuous in every cell") {
  std::array<double, 16> steep = defaults_of(fibre_quantities);
  steep[0] = 90;
  steep[1] = -90;
  const TetMesh single = ellipsoid(1, 10, 16), wells = two_wells();
  for (const auto kind : {FibreRuleKind::bayer, FibreRuleKind::doste})
    for (const auto& angles : {defaults_of(fibre_quantities), steep}) {
      check_cells(single, rule_based_fibres(single, fibre_rule(kind, angles)), 500);
      check_cells(wells, rule_based_fibres(wells, fibre_rule(kind, angles)), 2000);
    }
  // Lines alone.
  FibreField lines = rule_based_fibres(wells);
  lines.alpha_deg.clear();
  lines.axes = lines.frames;
  check_cells(wells, lines, 1000);
}

TEST_CASE("the signs of axes and of lines do not matter") {
  const TetMesh& mesh = shell();
  FibreField turned = shell_fibres(), lines = shell_fibres();
  lines.alpha_deg.clear();
  FibreField other = lines;
  // Half a turn round each of the three directions in turn: the same lines, from other angles.
  for (std::size_t v = 0; v < turned.frames.size(); ++v) {
    const std::size_t kept = v % 4;
    for (std::size_t k = 0; k < 3 && kept < 3; ++k)
      if (k != kept) {
        turned.axes[v][k] = -1.0 * turned.axes[v][k];
        other.frames[v][k] = -1.0 * other.frames[v][k];
      }
    if (kept == 0 || kept == 1) turned.alpha_deg[v] *= -1;
    if (kept == 1 || kept == 2) turned.beta_deg[v] *= -1;
  }
  const std::array<double, 4> place = {0.4, 0.3, 0.2, 0.1};
  for (int c = 0; c < static_cast<int>(mesh.cells.size()); c += 17)
    for (const auto& [one, two] :
         {std::pair(&shell_fibres(), &turned), std::pair<const FibreField*, FibreField*>(&lines, &other)}) {
      const Frame a = frame_at(*one, mesh, c, place), b = frame_at(*two, mesh, c, place);
      for (std::size_t k = 0; k < 3; ++k) REQUIRE(std::abs(dot(a[k], b[k])) == Approx(1).epsilon(1e-9));
      REQUIRE(dot(cross(b[0], b[1]), b[2]) == Approx(1).epsilon(1e-12));
    }
}

TEST_CASE("fibres of a file that turn too far from cell to cell are told, with the place") {
  const auto as_from_file = [](TetMesh mesh, const FibreField& rule) {
    mesh.cell_frames.clear();
    for (int c = 0; c < static_cast<int>(mesh.cells.size()); ++c)
      mesh.cell_frames.push_back(frame_at(rule, mesh, c, {0.25, 0.25, 0.25, 0.25}));
    return mesh;
  };
  // Resolved by six cells across: nothing is said, at the apex neither.
  const TetMesh fine = as_from_file(shell(), shell_fibres());
  CHECK(ambiguous_turns(fine, fibres_from_cells(fine)).cells == 0);
  CHECK(ambiguous_turns(shell(), shell_fibres()).cells == 0);  // angles are known
  // Two layers of one direction each: 100 degrees apart is 80 the other way round, 50 is no question.
  const TetMesh two = ellipsoid(2, 14, 24);
  const auto layers = [&](double angle) {
    std::array<double, 16> angles = defaults_of(fibre_quantities);
    angles[0] = angles[1] = angle;
    const FibreField inner = rule_based_fibres(two, fibre_rule(FibreRuleKind::bayer, angles));
    angles[0] = angles[1] = -angle;
    const FibreField outer = rule_based_fibres(two, fibre_rule(FibreRuleKind::bayer, angles));
    TetMesh inside = as_from_file(two, inner), outside = as_from_file(two, outer);
    for (std::size_t c = 0; c < two.cells.size(); ++c) {
      double depth = 0;
      for (int v : two.cells[c]) depth += 0.25 * inner.transmural[static_cast<std::size_t>(v)];
      if (depth < 0.45) inside.cell_frames[c] = outside.cell_frames[c];
    }
    return inside;
  };
  const TetMesh torn = layers(50), whole = layers(25);
  const AmbiguousTurns turns = ambiguous_turns(torn, fibres_from_cells(torn));
  CHECK(turns.cells > torn.cells.size() / 5);
  CHECK(ambiguous_turns(whole, fibres_from_cells(whole)).cells == 0);
  CHECK_THAT(turns_text(torn, turns), Catch::Contains("in " + std::to_string(turns.cells) + " of ") &&
                                          Catch::Contains(" mm") && Catch::Contains("Remedy"));
  // Straight fibres in a round wall are no turn.
  TetMesh straight = two;
  straight.cell_frames.assign(two.cells.size(), Frame{{{0, 1, 0}, {0, 0, 1}, {1, 0, 0}}});
  CHECK(ambiguous_turns(straight, fibres_from_cells(straight)).cells == 0);
}

TEST_CASE("fibres a mesh file brings are used in its cells") {
  TetMesh mesh = ellipsoid(2, 8, 12);
  CHECK_THROWS_WITH(fibres_from_cells(mesh), Catch::Contains("one a cell"));
  mesh.cell_frames.assign(mesh.cells.size(), Frame{{{0, 2, 0}, {0, 0.1, 1}, {}}});
  for (std::size_t c = 0; c < mesh.cells.size(); c += 2) mesh.cell_frames[c][0][1] = -2;
  const FibreField field = fibres_from_cells(mesh);
  CHECK(check_fibres(mesh, field).good());
  const Frame frame = frame_at(field, mesh, 3, {0.25, 0.25, 0.25, 0.25});
  CHECK(norm(frame[0] - Point3{0, 1, 0}) < 1e-12);
  CHECK(norm(frame[1] - Point3{0, 0, 1}) < 1e-12);
  for (const Frame& f : field.frames) REQUIRE(std::abs(f[0][1]) == Approx(1).epsilon(1e-9));
}

TEST_CASE("two ventricles under a cap have frames and sides") {
  const TetMesh mesh = two_wells();
  for (const auto kind : {FibreRuleKind::bayer, FibreRuleKind::doste}) {
    const FibreField field = rule_based_fibres(mesh, fibre_rule(kind));
    const FibreCheck check = check_fibres(mesh, field);
    CHECK(check.good());
    CHECK(check.vertices_with_frame < mesh.points.size());  // none inside the cap
    for (std::size_t v = 0; v < mesh.points.size(); ++v) {
      const Point3& p = mesh.points[v];
      if (norm(field.frames[v][0]) == 0) continue;
      if (p[0] < 0.0135) REQUIRE(field.interventricular[v] > 0.97);
      if (p[0] > 0.0585) REQUIRE(field.interventricular[v] < 0.03);
    }
    // The middle of the left free wall, from the outside inwards, and of the right one.
    for (std::size_t v = 0; v < mesh.points.size(); ++v) {
      const Point3& p = mesh.points[v];
      if (norm(p - Point3{p[0], 0.018, 0.027}) > 1e-9 || norm(field.frames[v][0]) == 0) continue;
      if (p[0] < 0.0095)
        CHECK(helix_angle_deg(field.frames[v][0], {-1, 0, 0}, {0, 0, 1}) ==
              Approx(-60 + 120 * field.transmural[v]).margin(4));
      if (p[0] > 0.0625) {
        const double angle = helix_angle_deg(field.frames[v][0], {1, 0, 0}, {0, 0, 1});
        const double off = std::remainder(angle - (-25 + 115 * field.transmural[v]), 180);
        CHECK(std::abs(off) < 4);
      }
      // The septum from the left: +60 at the left face, 0 inside, and vertical (90) at the right face.
      if (std::abs(p[0] - 0.027) < 1e-9)
        CHECK(helix_angle_deg(field.frames[v][0], {1, 0, 0}, {0, 0, 1}) == Approx(60).margin(4));
      if (std::abs(p[0] - 0.036) < 1e-9) CHECK(std::abs(field.frames[v][0][2]) > 0.99);
    }
  }
}

TEST_CASE("a VTU file is whole and refuses fields of another size") {
  const Folder folder;
  const TetMesh mesh = ellipsoid(1, 4, 6);
  const std::vector<double> u(mesh.points.size(), -85), d(3 * mesh.points.size(), 0.5),
      j(mesh.cells.size(), 1);
  write_vtu(folder.path / "a.vtu", mesh, {{"potential_mV", 1, u}, {"displacement_m", 3, d}},
            {{"volume_ratio", 1, j}});
  const std::string bytes = read_file(folder.path / "a.vtu");
  CHECK(whole_arrays(bytes) == 8);
  CHECK(bytes.find("NumberOfPoints=\"" + std::to_string(mesh.points.size()) + "\"") != std::string::npos);
  CHECK_THROWS_WITH(write_vtu(folder.path / "b.vtu", mesh, {{"potential_mV", 3, u}}),
                    Catch::Contains("potential_mV"));
  CHECK_THROWS_WITH(write_vtu(folder.path / "b.vtu", mesh, {{"u", 1, u}, {"u", 1, u}}),
                    Catch::Contains("twice"));
  CHECK_THROWS_AS(write_vtu(folder.path / "b.vtu", mesh, {{"u", 2, d}}), InputError);
  CHECK_FALSE(std::filesystem::exists(folder.path / "b.vtu"));
}

TEST_CASE("a field series survives a kill and resumes where it is told") {
  const Folder folder;
  const TetMesh mesh = ellipsoid(1, 4, 6);
  const std::vector<double> u(mesh.points.size(), 1);
  {
    FieldSeries series(folder.path / "beat", mesh);
    for (int k = 0; k < 5; ++k) series.write(0.01 * k, {{"potential_mV", 1, u}});
    CHECK_THROWS_AS(series.write(0.04, {}), InputError);
  }
  const auto frames = folder.path / "beat.fields";
  // Killed while it wrote a sixth frame.
  std::ofstream(frames / "frame_000005.vtu") << "half";
  std::ofstream(frames / "frame_000005.vtu.123.partial") << "ha";
  FieldSeries series(frames, mesh, 0.02);
  REQUIRE(series.frames().size() == 3);
  CHECK(series.frames().back().time_s == 0.02);
  CHECK_FALSE(std::filesystem::exists(frames / "frame_000003.vtu"));
  CHECK_FALSE(std::filesystem::exists(frames / "frame_000005.vtu.123.partial"));
  series.write(0.03, {{"potential_mV", 1, u}});
  const std::string index = read_file(series.index());
  CHECK(index.find("timestep=\"0.03\" part=\"0\" file=\"frame_000003.vtu\"") != std::string::npos);
  CHECK(index.find("frame_000004") == std::string::npos);
  for (const auto& frame : series.frames()) CHECK(whole_arrays(read_file(frames / frame.file)) == 6);
  CHECK_THROWS_WITH(FieldSeries(frames, shell(), 0.02), Catch::Contains("another mesh"));
  CHECK(FieldSeries(frames, mesh).frames().empty());
  CHECK_FALSE(std::filesystem::exists(frames / "frame_000000.vtu"));
}
