// Mechanics: patch test, tangents, pressures and volumes, rotation, equilibria, what is refused.
#include <fmt/format.h>

#include <catch2/catch.hpp>
#include <cmath>
#include <functional>
#include <wiggers/core/errors.hpp>
#include <wiggers/tissue/mesh/geometry.hpp>
#include <wiggers/tissue/mesh/make.hpp>
#include <wiggers/tissue/physics/equilibrium.hpp>

#include "bodies.hpp"

using namespace wiggers;
using namespace wiggers::bodies;
using Catch::Contains;

namespace {

using Numbers = std::vector<double>;

struct NamedLaw {
  std::string name;
  ShapeLaw law;
};
const std::vector<NamedLaw>& laws() {
  static const std::vector<NamedLaw> all = [] {
    std::vector<NamedLaw> list;
    for_each_material_kind([&](auto kind) {
      list.push_back({std::string(kind.name), kind.law(defaults_of(kind.quantities))});
    });
    return list;
  }();
  return all;
}

struct Element {
  const char* name;
  int order;
  bool mean_dilatation;
};
constexpr Element elements[] = {{"P1", 1, false}, {"P2", 2, false}, {"P2/P0", 2, true}};

MechanicsSettings settings_of(const Element& element, const ShapeLaw& law) {
  MechanicsSettings settings;
  settings.order = element.order;
  settings.mean_dilatation = element.mean_dilatation;
  settings.materials = {{1, law, 20e3}};
  return settings;
}

Support fixed_side(int tag) {
  Support support;
  support.tag = tag;
  support.fixed = {true, true, true};
  return support;
}

// Displacement of all nodes by position.
Numbers by_position(const NodeSpace& space, const std::function<Vector3(const Point3&)>& at) {
  Numbers d;
  for (const Point3& p : space.points)
    for (double component : at(p)) d.push_back(component);
  return d;
}
std::function<Vector3(const Point3&)> affine(const Matrix& F, const Vector3& shift = {}) {
  return [=](const Point3& p) { return times(F, p) - p + shift; };
}
Numbers sum_of(const Numbers& a, double factor, const Numbers& b) {
  Numbers c = a;
  for (std::size_t k = 0; k < c.size(); ++k) c[k] += factor * b[k];
  return c;
}
double norm_of(const Numbers& a) {
  double sum = 0;
  for (double value : a) sum += value * value;
  return std::sqrt(sum);
}
double inner(const Numbers& a, const Numbers& b) {
  double sum = 0;
  for (std::size_t k = 0; k < a.size(); ++k) sum += a[k] * b[k];
  return sum;
}
double volume_of(const TetMesh& mesh) {
  double sum = 0;
  for (std::size_t c = 0; c < mesh.cells.size(); ++c) sum += cell_volume(mesh, c);
  return sum;
}

constexpr Matrix some_F = {{{1.08, 0.05, -0.03}, {0.02, 0.95, 0.06}, {-0.04, 0.03, 1.02}}};

// All of its sides are one closed surface, 24.
TetMesh closed_box() {
  TetMesh mesh = rough_box({0.01, 0.008, 0.012}, {2, 2, 2});
  std::fill(mesh.facet_tags.begin(), mesh.facet_tags.end(), 24);
  return mesh;
}

}  // namespace

TEST_CASE("affine patch test: the inside follows a boundary moved affinely") {
  const auto mesh = shared(rough_box({0.01, 0.008, 0.012}, {3, 3, 3}, 0.2));
  const Partition partition(mesh, MPI_COMM_SELF);
  const FibreField fibres = twisted_fibres(*mesh, 0);
  for (const Element& element : elements)
    for (const auto& [name, law] : laws()) {
      INFO(element.name << ", " << name);
      MechanicsSettings settings = settings_of(element, law);
      for (int side = 1; side <= 6; ++side) settings.supports.push_back(fixed_side(side));
      Mechanics mechanics(partition, &fibres, settings);
      const NodeSpace& space = mechanics.nodes();
      const Numbers exact = by_position(space, affine(some_F, {1e-3, -2e-3, 3e-3}));
      std::vector<char> outside(space.n_local, 0);
      for (const LocalFacet& facet : partition.facets())
        for (int node : space.nodes_of(facet.cell)) {
          // On the facet: the same barycentric coordinate vanishes, which the nodes of its corners tell.
          const auto nodes = space.nodes_of(facet.cell);
          const Point3 &a = space.points[nodes[facet.corner[0]]], &b = space.points[nodes[facet.corner[1]]],
                       &c = space.points[nodes[facet.corner[2]]];
          if (std::abs(dot(space.points[node] - a, cross(b - a, c - a))) < 1e-12 * std::pow(norm(b - a), 3))
            outside[node] = 1;
        }
      const Numbers noise = random_numbers(exact.size(), 1e-4, 4);
      auto& d = mechanics.displacement();
      d = exact;
      int n_inside = 0;
      for (int node = 0; node < space.n_local; ++node)
        if (!outside[node]) {
          ++n_inside;
          for (std::size_t i = 0; i < 3; ++i)
            d[3 * static_cast<std::size_t>(node) + i] += noise[3 * static_cast<std::size_t>(node) + i];
        }
      REQUIRE(n_inside > (element.order == 1 ? 7 : 100));
      REQUIRE(difference(d, exact) > 5e-5);
      const auto none = [](double) { return Numbers{}; };
      find_equilibrium(mechanics, none);
      CHECK(difference(mechanics.displacement(), exact) < 1e-10 * largest(exact));
    }
}

TEST_CASE("the residual of an affine motion is its boundary work") {
  const TetMesh mesh = rough_box({0.01, 0.008, 0.012}, {2, 2, 2}, 0.2);
  const Partition partition(shared(mesh), MPI_COMM_SELF);
  const Matrix R = rotation(0.4);
  const FibreField fibres = twisted_fibres(mesh, 0, R);
  const Matrix F = some_F;
  for (const Element& element : elements)
    for (const auto& [name, law] : laws())
      for (bool active : {false, true}) {
        INFO(element.name << ", " << name << (active ? ", active" : ""));
        Mechanics mechanics(partition, &fibres, settings_of(element, law));
        mechanics.displacement() = by_position(mechanics.nodes(), affine(F));
        ActiveStress stress;
        stress.tension_Pa = 5e3;
        if (active) {
          CellTension one;
          one.tension.fill(stress.tension_Pa);
          mechanics.set_tension(std::vector(partition.cells().size(), one));
        }
        mechanics.assemble({}, false);
        // By the laws themselves: P in the fibre frame, from F R with the columns f0, s0, n0 of R.
        const Matrix FR = F * R;
        Matrix P;
        visit_material({1, law, 20e3}, [&](const auto& shape, const auto& volumetric) {
          add_stress(shape, FR, P);
          add_stress(volumetric, FR, P);
        });
        if (active) add_stress(stress, FR, P);
        const Matrix P0 = P * transpose(R);
        const double scale = volume_of(mesh) * std::sqrt(contract(P0, P0));
        // r . (B x) = V P : B for every B.
        for (int i = 0; i < 3; ++i)
          for (int k = 0; k < 3; ++k) {
            const Numbers virtual_motion = by_position(mechanics.nodes(), [&](const Point3& p) {
              Vector3 v{};
              v[i] = p[k];
              return v;
            });
            CHECK(std::abs(inner(mechanics.residual(), virtual_motion) - volume_of(mesh) * P0.m[i][k]) <
                  1e-10 * scale);
          }
        // Inside there is no force.
        double inside = 0;
        const NodeSpace& space = mechanics.nodes();
        std::vector<char> boundary(space.n_local, 0);
        for (const auto& facet : mesh.facets)
          for (int v : facet)
            for (int node = 0; node < space.n_local; ++node)
              if (space.vertex[node] == v) boundary[node] = 1;
        for (int node = 0; node < space.n_local; ++node)
          if (space.vertex[node] >= 0 && !boundary[node])
            for (int i = 0; i < 3; ++i)
              inside =
                  std::max(inside, std::abs(mechanics.residual()[3 * static_cast<std::size_t>(node) + i]));
        CHECK(inside < 1e-11 * largest(mechanics.residual()));
      }
}

namespace {

// K v against differences of the residual along v, at a random state.
void check_tangent(Mechanics& mechanics, const Numbers& pressures, const std::vector<char>& held = {}) {
  const std::size_t n = mechanics.displacement().size();
  const Numbers d = random_numbers(n, 2.5e-4, 11);
  Numbers v = random_numbers(n, 1, 12);
  for (std::size_t k = 0; k < held.size(); ++k)
    if (held[k]) v[k] = 0;
  mechanics.displacement() = d;
  const Balance balance = mechanics.assemble(pressures, true);
  REQUIRE(balance.finite);
  REQUIRE(balance.smallest_J > 0.3);
  Numbers by_tangent(n);
  mechanics.matrix().multiply(v.data(), by_tangent.data());
  // The residual assembled with the tangent is the one without.
  const Numbers with = mechanics.residual();
  mechanics.assemble(pressures, false);
  CHECK(difference(with, mechanics.residual()) <= 1e-13 * largest(with));
  const double h = 1e-8;
  mechanics.displacement() = sum_of(d, h, v);
  mechanics.assemble(pressures, false);
  const Numbers ahead = mechanics.residual();
  mechanics.displacement() = sum_of(d, -h, v);
  mechanics.assemble(pressures, false);
  Numbers by_difference = sum_of(ahead, -1, mechanics.residual());
  for (double& value : by_difference) value /= 2 * h;
  const double error = norm_of(sum_of(by_tangent, -1, by_difference)) / norm_of(by_tangent);
  CHECK(error < 1e-6);
}

// v . K w - w . K v, relative.
double asymmetry(Mechanics& mechanics) {
  const std::size_t n = mechanics.displacement().size();
  const Numbers v = random_numbers(n, 1, 21), w = random_numbers(n, 1, 22);
  Numbers Kv(n), Kw(n);
  mechanics.matrix().multiply(v.data(), Kv.data());
  mechanics.matrix().multiply(w.data(), Kw.data());
  return std::abs(inner(w, Kv) - inner(v, Kw)) / (norm_of(Kv) * norm_of(w));
}

}  // namespace

TEST_CASE("the tangent is the derivative of the residual") {
  TetMesh mesh = rough_box({0.012, 0.006, 0.006}, {2, 1, 1});
  for (std::size_t c = 0; c < mesh.cells.size(); c += 4) mesh.cell_tags[c] = mesh_tags::annuli;
  const auto body = shared(mesh);
  const Partition partition(body, MPI_COMM_SELF);
  const FibreField fibres = twisted_fibres(mesh, 60);
  std::vector<CellTension> tensions(mesh.cells.size()), stiff(mesh.cells.size());
  const Numbers numbers = random_numbers(8 * mesh.cells.size(), 1, 5);
  for (std::size_t c = 0; c < mesh.cells.size(); ++c)
    for (std::size_t v = 0; v < 4; ++v) {
      tensions[c].tension[v] = stiff[c].tension[v] = 10e3 * (2 + numbers[8 * c + v]);
      stiff[c].stiffness[v] = 50e3 * (2 + numbers[8 * c + 4 + v]);
    }
  struct Variant {
    const char* name;
    std::function<void(MechanicsSettings&)> change;
    const std::vector<CellTension>* tension = nullptr;
    double dt = 0;
    bool symmetric = false;
  };
  const auto nothing = [](MechanicsSettings&) {};
  const auto surfaces = [](MechanicsSettings& s) { s.surfaces = {{2, {}}, {4, {}}}; };
  const auto robin = [](MechanicsSettings& s) {
    Support normal, full;
    normal.tag = 3;
    normal.normal_stiffness = 2e5;
    normal.normal_damping = 2e3;
    full.tag = 6;
    full.full_stiffness = 1e5;
    full.full_damping = 5e3;
    s.supports = {normal, full};
  };
  const std::vector<Variant> variants = {
      {"passive", nothing, nullptr, 0, true},
      {"tension", nothing, &tensions, 0, true},
      {"tension as second Piola-Kirchhoff stress", [](MechanicsSettings& s) { s.normalised_tension = false; },
       &tensions, 0, true},
      {"tension and stiffness along the fibre", [](MechanicsSettings& s) { s.n_n = 0; }, &stiff, 0, true},
      {"tension and stiffness", nothing, &stiff},
      {"tension and stiffness, second Piola-Kirchhoff",
       [](MechanicsSettings& s) { s.normalised_tension = false; }, &stiff},
      {"tension along three directions", [](MechanicsSettings& s) { s.n_s = 0.2; }, &stiff},
      {"pressures", surfaces},
      {"springs", robin, nullptr, 0, true},
      {"springs and dashpots", robin, nullptr, 1e-3, true},
      {"inertia", nothing, nullptr, 1e-4, true},
      {"viscosity", [](MechanicsSettings& s) { s.viscosity_Pa_s = 100; }, nullptr, 1e-3, true},
      {"clamp", [](MechanicsSettings& s) { s.supports = {fixed_side(1)}; }},
      {"rule of degree 5", [](MechanicsSettings& s) { s.quadrature_degree = 5; }, nullptr, 0, true},
      {"all of it",
       [&](MechanicsSettings& s) {
         surfaces(s);
         robin(s);
         s.supports.push_back(fixed_side(1));
         s.viscosity_Pa_s = 100;
       },
       &stiff, 1e-3},
  };
  for (const Element& element : elements)
    for (const auto& [name, law] : laws())
      for (const Variant& variant : variants) {
        INFO(element.name << ", " << name << ", " << variant.name);
        MechanicsSettings settings = settings_of(element, law);
        settings.materials.push_back({mesh_tags::annuli, NeoHookean{5e3, 25e3}});
        variant.change(settings);
        Mechanics mechanics(partition, &fibres, settings);
        const std::size_t n = mechanics.displacement().size();
        mechanics.last_displacement() = random_numbers(n, 2e-4, 7);
        mechanics.displacement_before_last() = random_numbers(n, 2e-4, 8);
        mechanics.set_step(variant.dt);
        if (variant.tension) mechanics.set_tension(*variant.tension);
        std::vector<char> held(n, 0);
        for (const Support& support : settings.supports)
          if (support.fixed[0])
            for (const LocalFacet& facet : partition.facets())
              if (facet.tag == support.tag) {
                const NodeSpace& space = mechanics.nodes();
                const auto nodes = space.nodes_of(facet.cell);
                const Point3 &a = space.points[nodes[facet.corner[0]]],
                             &b = space.points[nodes[facet.corner[1]]],
                             &c = space.points[nodes[facet.corner[2]]];
                for (int node : nodes)
                  if (std::abs(dot(space.points[node] - a, cross(b - a, c - a))) <
                      1e-12 * std::pow(norm(b - a), 3))
                    for (std::size_t i = 0; i < 3; ++i) held[3 * static_cast<std::size_t>(node) + i] = 1;
              }
        check_tangent(mechanics, Numbers(settings.surfaces.size(), 3e3), held);
        if (variant.symmetric) CHECK(asymmetry(mechanics) < 1e-12);
      }
}

TEST_CASE("a rigid motion keeps the volume of a closed surface and stresses nothing") {
  const TetMesh mesh = closed_box();
  const Partition partition(shared(mesh), MPI_COMM_SELF);
  for (const Element& element : elements) {
    INFO(element.name);
    MechanicsSettings settings = settings_of(element, UsykLaw3{});
    settings.surfaces = {{24, {0.3, -0.2, 0.1}}};
    Mechanics mechanics(partition, nullptr, settings);
    // The surface is seen from the tissue: what it encloses is outside.
    const double before = mechanics.assemble(Numbers{0}, false).volumes_m3[0];
    CHECK(before == Approx(-volume_of(mesh)).epsilon(1e-12));
    mechanics.displacement() = by_position(mechanics.nodes(), affine(rotation(2.1), {0.01, 0.02, -0.03}));
    const Balance balance = mechanics.assemble(Numbers{0}, false);
    CHECK(std::abs(balance.volumes_m3[0] / before - 1) < 1e-12);
    CHECK(balance.smallest_J == Approx(1).epsilon(1e-12));
    mechanics.displacement() = by_position(mechanics.nodes(), affine(some_F));
    const double stretched = mechanics.assemble(Numbers{0}, false).residual;
    CHECK(balance.residual < 1e-11 * stretched);
    CHECK(mechanics.assemble(Numbers{0}, false).volumes_m3[0] ==
          Approx(determinant(some_F) * before).epsilon(1e-12));
  }
}

TEST_CASE("the load of a pressure is minus the derivative of the volume") {
  const TetMesh mesh = closed_box();
  const Partition partition(shared(mesh), MPI_COMM_SELF);
  for (const Element& element : elements) {
    INFO(element.name);
    MechanicsSettings settings = settings_of(element, UsykLaw3{});
    settings.surfaces = {{24, {}}};
    Mechanics mechanics(partition, nullptr, settings);
    const std::size_t n = mechanics.displacement().size();
    const Numbers d = random_numbers(n, 1e-3, 1), v = random_numbers(n, 1e-3, 2);
    const auto volume_at = [&](double s) {
      mechanics.displacement() = sum_of(d, s, v);
      return mechanics.assemble(Numbers{0}, false).volumes_m3[0];
    };
    // The volume is cubic in the displacement: this difference is exact.
    const double slope = (8 * (volume_at(1) - volume_at(-1)) - (volume_at(2) - volume_at(-2))) / 12;
    volume_at(0);
    CHECK(slope == Approx(-inner(mechanics.load(0), v)).epsilon(1e-10));
    // The residual has p times the load.
    const Numbers without = mechanics.residual(), load = mechanics.load(0);
    mechanics.assemble(Numbers{700}, false);
    CHECK(difference(mechanics.residual(), sum_of(without, 700, load)) <
          1e-12 * largest(mechanics.residual()));
  }
}

TEST_CASE("a follower pressure on a closed surface has no resultant and no moment") {
  const TetMesh mesh = closed_box();
  const Partition partition(shared(mesh), MPI_COMM_SELF);
  for (const Element& element : elements) {
    INFO(element.name);
    MechanicsSettings settings = settings_of(element, UsykLaw3{});
    settings.surfaces = {{24, {}}};
    Mechanics mechanics(partition, nullptr, settings);
    mechanics.displacement() = random_numbers(mechanics.displacement().size(), 1e-3, 1);
    mechanics.assemble(Numbers{1}, false);
    Vector3 force{}, moment{};
    double forces = 0, moments = 0;
    const NodeSpace& space = mechanics.nodes();
    for (int node = 0; node < space.n_own; ++node) {
      Vector3 x = space.points[node], f{};
      for (int i = 0; i < 3; ++i) {
        x[i] += mechanics.displacement()[3 * static_cast<std::size_t>(node) + i];
        f[i] = mechanics.load(0)[3 * static_cast<std::size_t>(node) + i];
      }
      force = force + f;
      moment = moment + cross(x, f);
      forces += norm(f);
      moments += norm(x) * norm(f);
    }
    CHECK(norm(force) < 1e-12 * forces);
    CHECK(norm(moment) < 1e-12 * moments);
  }
}

TEST_CASE("inertia and dashpots have the mass and area of the body") {
  const TetMesh mesh = closed_box();
  const Partition partition(shared(mesh), MPI_COMM_SELF);
  double area = 0;
  for (std::size_t f = 0; f < mesh.facets.size(); ++f) area += norm(facet_area_vector(mesh, f));
  for (const Element& element : elements) {
    INFO(element.name);
    MechanicsSettings settings = settings_of(element, UsykLaw3{});
    settings.density = 1050;
    Support support;
    support.tag = 24;
    support.full_stiffness = 2e5;
    support.full_damping = 3e3;
    settings.supports = {support};
    Mechanics mechanics(partition, nullptr, settings);
    const Vector3 now = {3e-4, -1e-4, 2e-4}, last = {1e-4, 2e-4, 0}, before = {-1e-4, 1e-4, 5e-5};
    const auto uniform_shift = [&](const Vector3& d) {
      return by_position(mechanics.nodes(), [=](const Point3&) { return d; });
    };
    mechanics.displacement() = uniform_shift(now);
    mechanics.last_displacement() = uniform_shift(last);
    mechanics.displacement_before_last() = uniform_shift(before);
    const double dt = 1e-3;
    for (bool moving : {true, false}) {
      mechanics.set_step(moving ? dt : 0);
      mechanics.assemble({}, false);
      for (std::size_t i = 0; i < 3; ++i) {
        double force = 0;
        for (std::size_t k = i; k < mechanics.residual().size(); k += 3) force += mechanics.residual()[k];
        double expected = area * 2e5 * now[i];
        if (moving)
          expected += 1050 * volume_of(mesh) * (now[i] - 2 * last[i] + before[i]) / (dt * dt) +
                      area * 3e3 * (now[i] - last[i]) / dt;
        CHECK(force == Approx(expected).epsilon(1e-10));
      }
    }
    mechanics.accept();
    CHECK(mechanics.last_displacement() == uniform_shift(now));
    CHECK(mechanics.displacement_before_last() == uniform_shift(last));
  }
}

TEST_CASE("a steady velocity needs no force where the step's length changes") {
  const TetMesh mesh = closed_box();
  const Partition partition(shared(mesh), MPI_COMM_SELF);
  Mechanics mechanics(partition, nullptr, settings_of(elements[0], UsykLaw3{}));
  const double dt = 5e-4, dt_last = 1e-3;
  const auto shift = [&](double t) {
    return by_position(mechanics.nodes(), [=](const Point3&) { return t * Vector3{0.1, -0.2, 0.05}; });
  };
  mechanics.displacement() = shift(dt_last + dt);
  mechanics.last_displacement() = shift(dt_last);
  mechanics.displacement_before_last() = shift(0);
  mechanics.set_step(dt, dt_last);
  const double unequal = mechanics.assemble({}, false).residual;
  mechanics.set_step(dt, dt);
  const double wrong = mechanics.assemble({}, false).residual;
  CHECK(unequal < 1e-9 * wrong);
}

TEST_CASE("normal springs do not resist sliding") {
  const Partition partition(shared(box_mesh({uniform(0.01, 2), uniform(0.01, 2), uniform(0.01, 2)})),
                            MPI_COMM_SELF);
  MechanicsSettings settings = settings_of(elements[1], UsykLaw3{});
  Support support;
  support.tag = 4;  // y+
  support.normal_stiffness = 1e5;
  settings.supports = {support};
  Mechanics mechanics(partition, nullptr, settings);
  mechanics.displacement() = by_position(mechanics.nodes(), [](const Point3&) {
    return Vector3{1e-4, 2e-4, 3e-4};
  });
  mechanics.assemble({}, false);
  Vector3 force{};
  for (std::size_t k = 0; k < mechanics.residual().size(); ++k) force[k % 3] += mechanics.residual()[k];
  CHECK(std::abs(force[0]) < 1e-12);
  CHECK(force[1] == Approx(1e5 * 1e-4 * 2e-4).epsilon(1e-10));
  CHECK(std::abs(force[2]) < 1e-12);
}

TEST_CASE("deformation of the cells is measured along their fibres") {
  const TetMesh mesh = rough_box({0.01, 0.008, 0.012}, {2, 2, 2});
  const Partition partition(shared(mesh), MPI_COMM_SELF);
  const Matrix R = rotation(0.4);
  const FibreField fibres = twisted_fibres(mesh, 0, R);
  for (const Element& element : elements) {
    Mechanics mechanics(partition, &fibres, settings_of(element, UsykLaw3{}));
    mechanics.displacement() = by_position(mechanics.nodes(), affine(some_F));
    for (const auto& cell : mechanics.cell_deformation()) {
      for (int k = 0; k < 3; ++k)
        CHECK(cell[k] == Approx(square(stretch(Matrix(some_F * R), k))).epsilon(1e-12));
      CHECK(cell[3] == Approx(determinant(some_F)).epsilon(1e-12));
    }
    // One vertex pushed through its neighbours: the cell is found.
    const NodeSpace& space = mechanics.nodes();
    Numbers d = mechanics.displacement();
    for (int node = 0; node < space.n_local; ++node)
      if (space.vertex[node] == 13) d[3 * static_cast<std::size_t>(node)] += 0.02;
    const auto [ratio, cell] = mechanics.smallest_volume_ratio(d);
    CHECK(ratio < 0);
    const auto& corners = mesh.cells[static_cast<std::size_t>(cell)];
    CHECK(std::count(corners.begin(), corners.end(), 13) == 1);
    const Point3 centre = cell_centre(mesh, static_cast<std::size_t>(cell));
    CHECK(mechanics.place_of_cell(cell) ==
          fmt::format("tetrahedron {} (volume tag 1) at ({:.1f}, {:.1f}, {:.1f}) mm", cell, 1e3 * centre[0],
                      1e3 * centre[1], 1e3 * centre[2]));
  }
}

TEST_CASE("a turned body is deformed in the turned way") {
  const TetMesh mesh = rough_box({0.012, 0.006, 0.006}, {4, 2, 2});
  const Matrix R = rotation(1.3);
  for (const Element& element : elements) {
    INFO(element.name);
    std::vector<Numbers> results;
    for (bool turned : {false, true}) {
      const TetMesh body = turned ? moved(mesh, R) : mesh;
      const Partition partition(shared(body), MPI_COMM_SELF);
      const Matrix own = rotation(0.4);
      const FibreField fibres = twisted_fibres(mesh, 60, turned ? R * own : own);
      MechanicsSettings settings = settings_of(element, UsykLaw3{});
      Support springs;
      springs.tag = 4;
      springs.normal_stiffness = 1e5;
      settings.supports = {fixed_side(1), springs};
      settings.surfaces = {{5, {}}};
      Mechanics mechanics(partition, &fibres, settings);
      EquilibriumSettings numerics;
      numerics.relative_tolerance = 1e-10;
      find_equilibrium(
          mechanics, [](double s) { return Numbers{150 * s}; }, numerics,
          [&](double s) {
            CellTension one;
            one.tension.fill(800 * s);
            return std::vector(partition.cells().size(), one);
          });
      Numbers d = mechanics.displacement();
      if (turned)
        for (std::size_t k = 0; k < d.size(); k += 3) {
          const Vector3 back = times(transpose(R), {d[k], d[k + 1], d[k + 2]});
          for (std::size_t i = 0; i < 3; ++i) d[k + i] = back[i];
        }
      results.push_back(d);
    }
    CHECK(largest(results[0]) > 1e-4);
    CHECK(difference(results[0], results[1]) < 1e-8 * largest(results[0]));
  }
}

namespace {

// An eighth of a thick sphere under pressure from inside.
struct Shell {
  Partition partition;
  Mechanics mechanics;
  static const std::shared_ptr<const TetMesh>& mesh() {
    static const auto made = shared(make_sphere_octant(27, 37, 12));
    return made;
  }
  static MechanicsSettings settings(const Element& element) {
    MechanicsSettings s = settings_of(element, UsykLaw3::from(880, 5.5, 6, 5.5, 7.5, 5.5, 7.5));
    for (int k = 0; k < 3; ++k) {
      Support plane;
      plane.tag = 41 + k;
      plane.fixed[k] = true;
      s.supports.push_back(plane);
    }
    s.surfaces = {{31, {}}, {24, {}}};
    return s;
  }
  explicit Shell(const Element& element)
      : partition(mesh(), MPI_COMM_SELF), mechanics(partition, nullptr, settings(element)) {}
  double volume(double p) { return mechanics.assemble(Numbers{0, p}, false).volumes_m3[1]; }
  EquilibriumReport press(double from, double to, double tolerance = 1e-10) {
    EquilibriumSettings numerics;
    numerics.relative_tolerance = tolerance;
    return find_equilibrium(
        mechanics,
        [=](double s) {
          return Numbers{0, from + s * (to - from)};
        },
        numerics);
  }
};

}  // namespace

TEST_CASE("prescribed pressure and prescribed volume reach the same state") {
  for (const Element& element : elements) {
    INFO(element.name);
    Shell pressed(element);
    const double empty = pressed.volume(0);
    const EquilibriumReport report = pressed.press(0, 800);
    const double full = pressed.volume(800);
    CHECK(full > 1.1 * empty);
    CHECK(report.volumes_m3[1] == Approx(full).epsilon(1e-8));
    CHECK(report.smallest_J > 0.5);
    CHECK(report.worst_cell >= 0);

    Shell filled(element);
    EquilibriumSettings numerics;
    numerics.relative_tolerance = 1e-10;
    double slope = 0;
    const double p = inflate_to_volume(filled.mechanics, 1, full, {0, 0}, numerics, &slope);
    CHECK(p == Approx(800).epsilon(1e-7));
    CHECK(difference(filled.mechanics.displacement(), pressed.mechanics.displacement()) <
          1e-7 * largest(pressed.mechanics.displacement()));
    // The slope of the pressure-volume curve, and the way back.
    pressed.press(800, 801);
    CHECK(slope == Approx(1 / (pressed.volume(801) - full)).epsilon(1e-2));
    CHECK(slope > 0);
    pressed.press(801, 0);
    CHECK(pressed.volume(0) == Approx(empty).epsilon(1e-9));
    const double back = inflate_to_volume(filled.mechanics, 1, empty, {0, p}, numerics);
    CHECK(std::abs(back) < 1e-4 * 800);
    CHECK(largest(filled.mechanics.displacement()) < 1e-8);
    CHECK(largest(pressed.mechanics.displacement()) < 1e-8);
  }
}

TEST_CASE("a pressed shell grows monotonically and its wall keeps its volume") {
  Shell shell(elements[2]);
  double last = shell.volume(0);
  const double wall = last + shell.mechanics.assemble(Numbers{0, 0}, false).volumes_m3[0];
  for (double p = 250; p <= 1000; p += 250) {
    shell.press(p - 250, p, 1e-8);
    CHECK(shell.volume(p) > last);
    last = shell.volume(p);
  }
  const double now = last + shell.mechanics.assemble(Numbers{0, 1000}, false).volumes_m3[0];
  CHECK(std::abs(now / wall - 1) < 0.05);
}

TEST_CASE("a hopeless load fails with its place and leaves the last good state") {
  const TetMesh mesh = rough_box({0.012, 0.006, 0.006}, {4, 2, 2});
  const Partition partition(shared(mesh), MPI_COMM_SELF);
  for (const Element& element : elements) {
    INFO(element.name);
    MechanicsSettings settings = settings_of(element, NeoHookean{1e3, 2e3});
    settings.supports = {fixed_side(1)};
    settings.surfaces = {{5, {}}};
    Mechanics mechanics(partition, nullptr, settings);
    double reached = 0;
    Numbers good = mechanics.displacement();
    const auto load = [](double s) { return Numbers{1e6 * s}; };
    const auto run = [&] {
      EquilibriumSettings numerics;
      numerics.smallest_step = 1e-4;
      find_equilibrium(mechanics, load, numerics, {}, [&](double s) {
        reached = s;
        good = mechanics.displacement();
      });
    };
    std::string message;
    try {
      run();
    } catch (const NumericalFailure& failure) {
      message = failure.what();
    }
    CAPTURE(message);
    CHECK_THAT(message, Contains("static equilibrium: stopped at") && Contains("% of the load") &&
                            Contains("tetrahedron ") && Contains("(volume tag 1) at (") && Contains(" mm"));
    CHECK(reached < 1);
    CHECK(mechanics.displacement() == good);
    const Balance balance = mechanics.assemble(load(reached), false);
    CHECK(balance.smallest_J > 0);
    CHECK(balance.residual <= 1e-6 * (reached > 0 ? 1e6 * reached * norm_of(mechanics.load(0)) : 1));
  }
}

TEST_CASE("volume control that fails says where and leaves the last good state") {
  Shell shell(elements[0]);
  const double empty = shell.volume(0);
  CHECK_THROWS_AS(inflate_to_volume(shell.mechanics, 1, 1e6 * empty, {0, 0}), NumericalFailure);
  CHECK(shell.mechanics.smallest_volume_ratio(shell.mechanics.displacement()).first > 0);
  CHECK_THROWS_WITH(
      inflate_to_volume(shell.mechanics, 1, 1e6 * empty, {0, 0}),
      Contains("volume control: stopped at") && Contains("tetrahedron ") && Contains("(volume tag 1)"));
}

TEST_CASE("missing materials and surfaces are refused by their tags") {
  TetMesh mesh = rough_box({0.012, 0.006, 0.006}, {2, 1, 1});
  mesh.cell_tags[3] = mesh_tags::pulmonary_trunk;
  const Partition partition(shared(mesh), MPI_COMM_SELF);
  MechanicsSettings settings = settings_of(elements[0], UsykLaw3{});
  CHECK_THROWS_WITH(Mechanics(partition, nullptr, settings),
                    Contains("no material") && Contains("volume tag 8"));
  CHECK_THROWS_AS(Mechanics(partition, nullptr, settings), InputError);
  settings.materials.push_back({mesh_tags::pulmonary_trunk, NeoHookean{}});
  CHECK_NOTHROW(Mechanics(partition, nullptr, settings));
  settings.surfaces = {{24, {}}};
  CHECK_THROWS_WITH(Mechanics(partition, nullptr, settings),
                    Contains("surface tag 24") && Contains("pressure"));
  settings.surfaces.clear();
  settings.supports = {fixed_side(31)};
  CHECK_THROWS_WITH(Mechanics(partition, nullptr, settings),
                    Contains("surface tag 31") && Contains("support"));
  CHECK_THROWS_AS(Mechanics(partition, nullptr, settings), InputError);
}
