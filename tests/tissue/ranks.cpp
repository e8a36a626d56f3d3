// What must not depend on the number of processes. Run on 1, 2 and 3 ranks; every rank checks the same
// numbers.
#include <fmt/format.h>

#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <functional>
#include <numeric>
#include <set>
#include <wiggers/cellmodels/catalogue/catalogue.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/tissue/mesh/geometry.hpp>
#include <wiggers/tissue/mesh/reference_cell.hpp>
#include <wiggers/tissue/parallel/collective.hpp>
#include <wiggers/tissue/parallel/mesh_broadcast.hpp>
#include <wiggers/tissue/physics/element.hpp>
#include <wiggers/tissue/physics/equilibrium.hpp>
#include <wiggers/tissue/physics/monodomain.hpp>

#include "bodies.hpp"

using namespace wiggers;
using namespace wiggers::bodies;
using Catch::Contains;

namespace {

// A block with an end that does not conduct.
std::shared_ptr<const TetMesh> block() {
  TetMesh mesh = rough_box({12e-3, 6e-3, 4e-3}, {6, 3, 2});
  for (std::size_t c = 0; c < mesh.cells.size(); ++c)
    if (cell_centre(mesh, c)[0] > 8e-3) mesh.cell_tags[c] = mesh_tags::aorta;
  return shared(std::move(mesh));
}

// The same on all ranks, so that a failure is one on all ranks.
bool everywhere(const Partition& partition, bool value) { return !partition.any(!value); }

std::vector<double> values_of(const NodeSpace& space) {
  std::vector<double> values(space.n_local, -1);
  for (int k = 0; k < space.n_own; ++k) values[k] = std::sin(space.file_index[k]) + 3 * space.points[k][1];
  return values;
}

}  // namespace

TEST_CASE("nodes are numbered without gaps whatever the partition", "[ranks]") {
  const auto mesh = block();
  const Partition partition(mesh, MPI_COMM_WORLD), serial(mesh, MPI_COMM_SELF);
  for (int order : {1, 2})
    for (bool conductive_only : {false, true}) {
      const NodeSpace space = partition.make_nodes(order, conductive_only);
      const NodeSpace reference = serial.make_nodes(order, conductive_only);
      INFO(fmt::format("P{}, {}", order, conductive_only ? "conductive" : "all"));
      CHECK(partition.sum(space.n_own) == space.n_global);
      CHECK(space.n_global == reference.n_global);
      // Each number in the file's order once; with the right point.
      std::vector<double> own(space.n_own, 1.0), points(3 * static_cast<std::size_t>(space.n_own)),
          vertex(space.n_own);
      std::vector<double> reference_points(3 * static_cast<std::size_t>(reference.n_own)),
          reference_vertex(reference.n_own);
      const auto copy = [](const NodeSpace& from, std::vector<double>& p, std::vector<double>& v) {
        for (int k = 0; k < from.n_own; ++k) {
          for (int i = 0; i < 3; ++i) p[3 * static_cast<std::size_t>(k) + i] = from.points[k][i];
          v[k] = from.vertex[k];
        }
      };
      copy(space, points, vertex);
      copy(reference, reference_points, reference_vertex);
      const auto all = partition.gather(space, own.data(), 1);
      CHECK(std::count(all.begin(), all.end(), 1.0) == space.n_global);
      CHECK(partition.gather(space, points.data(), 3) ==
            serial.gather(reference, reference_points.data(), 3));
      CHECK(partition.gather(space, vertex.data(), 1) ==
            serial.gather(reference, reference_vertex.data(), 1));
      // Local numbers are complete: every node of an own cell is there, ghosts belong to others.
      bool good = true;
      for (std::size_t c = 0; c < partition.cells().size(); ++c)
        if (!conductive_only || mesh_tags::conductive(mesh->cell_tags[partition.cells()[c]]))
          for (int node : space.nodes_of(static_cast<int>(c)))
            good = good && node >= 0 && node < space.n_local;
        else
          good = good && !space.has(static_cast<int>(c));
      for (int ghost : space.ghosts)
        good = good && (ghost < space.first || ghost >= space.first + space.n_own);
      const std::set<int> different(space.file_index.begin(), space.file_index.end());
      good = good && different.size() == static_cast<std::size_t>(space.n_local) && *different.begin() >= 0;
      CHECK(everywhere(partition, good));
    }
}

TEST_CASE("every cell around an own node is at hand", "[ranks]") {
  const auto mesh = block();
  const Partition partition(mesh, MPI_COMM_WORLD);
  const NodeSpace space = partition.make_nodes(1, false);
  std::set<int> local(partition.cells().begin(), partition.cells().end()), own_vertices;
  for (int k = 0; k < space.n_own; ++k) own_vertices.insert(space.vertex[k]);
  bool good = local.size() == partition.cells().size();
  for (std::size_t c = 0; c < mesh->cells.size(); ++c)
    for (int v : mesh->cells[c])
      if (own_vertices.count(v)) good = good && local.count(static_cast<int>(c));
  CHECK(everywhere(partition, good));
  // Tagged facets of the own cells are those of the mesh, each once, normals out.
  double count = 0;
  Point3 sum{};
  for (const LocalFacet& facet : partition.facets()) {
    if (facet.cell >= partition.n_own_cells()) continue;
    ++count;
    const auto& v = mesh->cells[partition.cells()[facet.cell]];
    const Point3 area = triangle_area_vector(
        mesh->points[v[facet.corner[0]]], mesh->points[v[facet.corner[1]]], mesh->points[v[facet.corner[2]]]);
    good = good &&
           norm(area - facet_area_vector(*mesh, static_cast<std::size_t>(facet.facet))) < 1e-12 * norm(area);
    good = good && facet.tag == mesh->facet_tags[facet.facet];
    sum = sum + area;
  }
  CHECK(everywhere(partition, good));
  CHECK(partition.sum(count) == static_cast<double>(mesh->facets.size()));
  for (double component : sum) CHECK(std::abs(partition.sum(component)) < 1e-15);
}

TEST_CASE("values gather and scatter and ghosts follow their owners", "[ranks]") {
  const Partition partition(block(), MPI_COMM_WORLD);
  for (bool conductive_only : {false, true}) {
    const NodeSpace space = partition.make_nodes(2, conductive_only);
    std::vector<double> values = values_of(space), back(space.n_local, 0.0);
    const std::vector<double> all = partition.gather(space, values.data(), 1);
    Partition::scatter(space, all, back.data(), 1);
    partition.update_ghosts(space, values.data(), 1);
    CHECK(everywhere(partition, values == back));
    // Three numbers a node.
    std::vector<double> vectors(3 * static_cast<std::size_t>(space.n_local), 7.0), vectors_back = vectors;
    for (int k = 0; k < space.n_own; ++k)
      for (int i = 0; i < 3; ++i) vectors[3 * static_cast<std::size_t>(k) + i] = values[k] + i;
    const auto all_vectors = partition.gather(space, vectors.data(), 3);
    Partition::scatter(space, all_vectors, vectors_back.data(), 3);
    partition.update_ghosts(space, vectors.data(), 3);
    CHECK(everywhere(partition, vectors == vectors_back));
    bool good = true;
    for (std::size_t k = 0; k < all.size(); ++k) good = good && all_vectors[3 * k + 2] == all[k] + 2;
    CHECK(good);
  }
  std::vector<double> numbers;
  for (int c = 0; c < partition.n_own_cells(); ++c) {
    numbers.push_back(partition.cells()[c]);
    numbers.push_back(-1);
  }
  const auto cells = partition.gather_cells(numbers.data(), 2);
  for (std::size_t c = 0; c < partition.mesh().cells.size(); ++c)
    CHECK(cells[2 * c] == static_cast<double>(c));
}

namespace {

// Mass (1 component), or mass times a full 3 x 3 matrix that is not symmetric, which tells rows from columns.
constexpr double coupling[3][3] = {{3, 0.5, -0.25}, {-1, 4, 0.75}, {0.125, 1, 5}};

// `more` times the mean volume of a node is added to the diagonal.
void assemble_mass(NodeMatrix& matrix, const std::function<double(int)>& more = {}) {
  const Partition& partition = matrix.partition();
  const NodeSpace& space = matrix.space();
  const int n = space.nodes_per_cell;
  matrix.set_zero();
  for (std::size_t c = 0; c < partition.cells().size(); ++c) {
    if (!space.has(static_cast<int>(c))) continue;
    const double volume = cell_volume(partition.mesh(), static_cast<std::size_t>(partition.cells()[c]));
    const int* slots = matrix.cell_slots(static_cast<int>(c));
    for (const auto& q : tetrahedron_quadrature(5)) {
      const auto shape = shape_values<4>(space.order, q.at);
      for (int a = 0; a < n; ++a)
        for (int b = 0; b < n; ++b) {
          const int slot = slots[a * n + b];
          if (slot < 0) continue;
          const double m = q.weight * volume * shape.value[a] * shape.value[b];
          if (matrix.components() == 1) {
            *matrix.block(slot) += m;
          } else {
            for (int i = 0; i < 3; ++i)
              for (int j = 0; j < 3; ++j) matrix.block(slot)[3 * j + i] += m * coupling[i][j];
          }
        }
    }
  }
  if (more) {
    double volume = 0;
    for (std::size_t c = 0; c < partition.mesh().cells.size(); ++c)
      volume += cell_volume(partition.mesh(), c);
    for (int node = 0; node < space.n_own; ++node)
      for (int i = 0; i < matrix.components(); ++i)
        matrix.block(matrix.diagonal_slot(node))[(matrix.components() + 1) * i] +=
            volume / space.n_global * more(space.global(node));
  }
  matrix.finish();
}

// The same product from the mesh itself, in the file's order, on every rank.
std::vector<double> mass_product(const Partition& serial, int order, bool conductive_only,
                                 const std::vector<double>& x, int components) {
  const NodeSpace space = serial.make_nodes(order, conductive_only);
  std::vector<double> y(x.size(), 0.0);
  for (std::size_t c = 0; c < serial.cells().size(); ++c) {
    if (!space.has(static_cast<int>(c))) continue;
    const double volume = cell_volume(serial.mesh(), static_cast<std::size_t>(serial.cells()[c]));
    const auto nodes = space.nodes_of(static_cast<int>(c));
    for (const auto& q : tetrahedron_quadrature(5)) {
      const auto shape = shape_values<4>(order, q.at);
      for (std::size_t a = 0; a < nodes.size(); ++a)
        for (std::size_t b = 0; b < nodes.size(); ++b)
          for (int i = 0; i < components; ++i)
            for (int j = 0; j < components; ++j)
              y[static_cast<std::size_t>(space.file_index[nodes[a]]) * components + i] +=
                  q.weight * volume * shape.value[a] * shape.value[b] *
                  (components == 1 ? 1 : coupling[i][j]) *
                  x[static_cast<std::size_t>(space.file_index[nodes[b]]) * components + j];
    }
  }
  return y;
}

}  // namespace

TEST_CASE("matrices multiply alike on any number of ranks", "[ranks]") {
  const auto mesh = block();
  const Partition partition(mesh, MPI_COMM_WORLD), serial(mesh, MPI_COMM_SELF);
  double volume = 0, conductive = 0, own = 0;
  for (std::size_t c = 0; c < mesh->cells.size(); ++c) {
    volume += cell_volume(*mesh, c);
    if (mesh_tags::conductive(mesh->cell_tags[c])) conductive += cell_volume(*mesh, c);
  }
  for (int c = 0; c < partition.n_own_cells(); ++c)
    own += cell_volume(*mesh, static_cast<std::size_t>(partition.cells()[c]));
  CHECK(partition.sum(own) == Approx(volume).epsilon(1e-13));
  for (int order : {1, 2})
    for (bool conductive_only : {false, true})
      for (int components : {1, 3}) {
        INFO(
            fmt::format("P{}, {} components, {}", order, components, conductive_only ? "conductive" : "all"));
        const NodeSpace space = partition.make_nodes(order, conductive_only);
        NodeMatrix matrix(partition, space, components);
        assemble_mass(matrix);
        assemble_mass(matrix);  // again: set_zero() forgets the first
        std::vector<double> x = random_numbers(static_cast<std::size_t>(space.n_global) * components, 1, 3);
        std::vector<double> local(static_cast<std::size_t>(space.n_local) * components), y(local.size());
        Partition::scatter(space, x, local.data(), components);
        matrix.multiply(local.data(), y.data());
        const auto expected = mass_product(serial, order, conductive_only, x, components);
        CHECK(difference(partition.gather(space, y.data(), components), expected) <
              1e-13 * largest(expected));
        if (components == 1) {
          std::fill(local.begin(), local.end(), 1.0);
          matrix.multiply(local.data(), y.data());
          CHECK(partition.sum(std::accumulate(y.begin(), y.begin() + space.n_own, 0.0)) ==
                Approx(conductive_only ? conductive : volume).epsilon(1e-12));
        }
      }
}

TEST_CASE("every solver solves on any number of ranks", "[ranks]") {
  const auto mesh = block();
  const Partition partition(mesh, MPI_COMM_WORLD);
  for (int components : {1, 3})
    for (SolverKind kind : {SolverKind::cg_jacobi, SolverKind::cg_ilu, SolverKind::gmres_ilu,
                            SolverKind::gmres_gamg, SolverKind::direct}) {
      const bool symmetric_only = kind == SolverKind::cg_jacobi || kind == SolverKind::cg_ilu;
      if (components == 3 && symmetric_only) continue;
      if (components == 1 && kind == SolverKind::gmres_gamg)
        continue;  // its rigid-body modes are of mechanics
      INFO(fmt::format("{}, {} components", solver_kind_names[static_cast<int>(kind)], components));
      const NodeSpace space = partition.make_nodes(2, false);
      NodeMatrix matrix(partition, space, components);
      assemble_mass(matrix);
      LinearSolver solver(matrix, kind);
      const auto size = static_cast<std::size_t>(space.n_own) * components;
      std::vector<double> wanted =
          random_numbers(static_cast<std::size_t>(space.n_global) * components, 1, 5);
      std::vector<double> exact(static_cast<std::size_t>(space.n_local) * components), b(size), x(size, 0.0);
      Partition::scatter(space, wanted, exact.data(), components);
      matrix.multiply(exact.data(), b.data());
      const SolveReport report = solver.solve(b.data(), x.data(), 1e-11, 0);
      INFO(report.reason);
      CHECK(report.converged);
      CHECK(difference(partition.gather(space, x.data(), components), wanted) < 1e-8);
      // A matrix with new values.
      assemble_mass(matrix);
      matrix.set_zero();
      for (int node = 0; node < space.n_own; ++node)
        for (int i = 0; i < components; ++i)
          matrix.block(matrix.diagonal_slot(node))[(components + 1) * i] = 2 + i;
      matrix.finish();
      solver.matrix_changed();
      std::fill(x.begin(), x.end(), 0.0);
      CHECK(solver.solve(b.data(), x.data(), 1e-11, 0).converged);
      bool good = true;
      for (std::size_t k = 0; k < size; ++k)
        good =
            good && std::abs(x[k] - b[k] / (2 + static_cast<double>(k % components))) <= 1e-10 * largest(b);
      CHECK(everywhere(partition, good));
    }
}

TEST_CASE("complete factors serve later matrices while a few iterations do", "[ranks]") {
  const auto mesh = block();
  const Partition partition(mesh, MPI_COMM_WORLD);
  const NodeSpace space = partition.make_nodes(1, false);
  NodeMatrix matrix(partition, space, 3);
  const auto size = static_cast<std::size_t>(space.n_own) * 3;
  LinearSolver solver(matrix, SolverKind::direct);
  // A diagonal is enough: how far it is from the one before decides on the factors.
  const auto iterations_with = [&](const std::function<double(int)>& value) {
    matrix.set_zero();
    for (int node = 0; node < space.n_own; ++node)
      for (int i = 0; i < 3; ++i) matrix.block(matrix.diagonal_slot(node))[4 * i] = value(space.global(node));
    matrix.finish();
    solver.matrix_changed();
    const std::vector<double> b(size, 1.0);
    std::vector<double> x(size, 0.0);
    const SolveReport report = solver.solve(b.data(), x.data(), 1e-10, 0);
    bool good = true;
    if (!report.converged) {
      for (double value : x) good = good && value == 0;  // the guess is still there
      CHECK(everywhere(partition, good));
      return -1;
    }
    for (int node = 0; node < space.n_own; ++node)
      for (int i = 0; i < 3; ++i)
        good = good && std::abs(x[3 * node + i] * value(space.global(node)) - 1) < 1e-8;
    CHECK(everywhere(partition, good));
    return report.iterations;
  };
  const auto first = [](int node) { return 1.0 + node % 7; };
  const auto near = [&](int node) { return first(node) * (1 + 0.02 * (node % 5)); };
  const auto far = [](int node) { return std::exp(0.01 * ((13 * node) % 701)); };
  CHECK(iterations_with(first) == 1);
  const int with_old_factors = iterations_with(near);
  CHECK(with_old_factors > 1);
  CHECK(with_old_factors <= 10);
  CHECK(iterations_with(far) > 10);  // in vain with the old factors, then with new ones
  CHECK(iterations_with(far) == 1);
  solver.forget();
  CHECK(iterations_with(near) == 1);
  // A matrix that cannot be solved leaves nothing behind.
  CHECK(iterations_with([](int) { return 0.0; }) == -1);
  CHECK(iterations_with(first) == 1);
}

TEST_CASE("multigrid serves later matrices while it does so well, and gives way", "[ranks]") {
  const auto mesh = block();
  const Partition partition(mesh, MPI_COMM_WORLD);
  const NodeSpace space = partition.make_nodes(1, false);
  NodeMatrix matrix(partition, space, 3);
  const auto size = static_cast<std::size_t>(space.n_own) * 3;
  LinearSolver solver(matrix, SolverKind::gmres_gamg);
  // The mass matrix with diagonal blocks that differ by `share`, solved for a right side of all ones.
  const auto iterations_with = [&](const std::function<double(int)>& share) {
    assemble_mass(matrix, share);
    solver.matrix_changed();
    const std::vector<double> b(size, 1.0);
    std::vector<double> x(size, 0.0), back(size);
    const SolveReport report = solver.solve(b.data(), x.data(), 1e-8, 0);
    CHECK(report.converged);
    matrix.multiply(x.data(), back.data());
    double off = 0;
    for (std::size_t k = 0; k < size; ++k) off += (back[k] - b[k]) * (back[k] - b[k]);
    CHECK(std::sqrt(partition.sum(off) / (3.0 * space.n_global)) < 1e-7);
    return report.iterations;
  };
  const auto first = [](int) { return 1.0; };
  const auto near = [](int node) { return 1 + 0.02 * (node % 5); };
  const auto far = [](int node) { return std::exp(0.01 * ((13 * node) % 1301)); };
  const int fresh = iterations_with(first);
  const int kept = iterations_with(near);
  CHECK(kept <= 2 * std::max(8, fresh));
  // In vain with the old one, or many with it; then one of its own.
  iterations_with(far);
  const int own = iterations_with(far);
  solver.forget();
  CHECK(own <= 2 * std::max(8, iterations_with(far)));
  // Once forgotten it is as new: on one rank to the last bit, on several, where multigrid orders its sums by
  // the moment, to the solvers' tolerance.
  const auto solved = [&](LinearSolver& by) {
    const std::vector<double> b(size, 1.0);
    std::vector<double> x(size, 0.0);
    CHECK(by.solve(b.data(), x.data(), 1e-4, 0).converged);
    return x;
  };
  assemble_mass(matrix, near);
  solver.matrix_changed();
  solver.forget();
  LinearSolver other(matrix, SolverKind::gmres_gamg);
  const std::vector<double> again = solved(solver), anew = solved(other);
  if (partition.n_ranks() == 1) CHECK(again == anew);
  bool near_enough = true;
  for (std::size_t k = 0; k < size; ++k)
    near_enough =
        near_enough && std::abs(again[k] - anew[k]) <= 1e-3 * std::abs(anew[k]) + 1e-3 * largest(anew);
  CHECK(everywhere(partition, near_enough));
}

namespace {

struct Excitation {
  std::vector<double> u, calcium, activation;
  double lead;
  std::vector<double> saved;
};

Excitation excite(MPI_Comm communicator, std::vector<double>* resume = nullptr) {
  const auto mesh = block();
  const Partition partition(mesh, communicator);
  const FibreField fibres = twisted_fibres(*mesh, 80);
  IonicRegion region;
  region.tags = {mesh_tags::ventricles};
  region.model = &find_model("ttp06-epi");
  region.parameters = region.model->parameter_values("default");
  region.initial_state = region.model->default_state();
  region.conductivity = {2e-4, 1e-4, 0.5e-4};
  Stimulus stimulus;
  stimulus.radius = 3e-3;
  MonodomainSettings settings;
  settings.relative_tolerance = 1e-10;
  Monodomain monodomain(partition, &fibres, settings, {region}, {stimulus});
  if (resume) {
    std::span<const double> in(*resume);
    monodomain.restore(in);
    monodomain.advance(2e-3, 3e-3);
  } else {
    monodomain.advance(0, 2e-3);
    Excitation half;
    std::vector<double> saved;
    monodomain.save(saved);
    monodomain.advance(2e-3, 3e-3);
    half.saved = std::move(saved);
    const NodeSpace& space = monodomain.nodes();
    half.u = partition.gather(space, monodomain.potential_mV(), 1);
    half.calcium = partition.gather(space, monodomain.calcium_uM().data(), 1);
    half.activation = partition.gather(space, monodomain.activation_s().data(), 1);
    half.lead = monodomain.lead({0.05, 0, 0});
    return half;
  }
  const NodeSpace& space = monodomain.nodes();
  return {partition.gather(space, monodomain.potential_mV(), 1),
          partition.gather(space, monodomain.calcium_uM().data(), 1),
          partition.gather(space, monodomain.activation_s().data(), 1),
          monodomain.lead({0.05, 0, 0}),
          {}};
}

void check_same(const Excitation& a, const Excitation& b) {
  CHECK(difference(a.u, b.u) < 1e-6 * largest(a.u));
  CHECK(difference(a.calcium, b.calcium) < 1e-6 * largest(a.calcium));
  CHECK(difference(a.activation, b.activation) < 1e-6 * largest(a.activation));
  CHECK(a.lead == Approx(b.lead).epsilon(1e-6));
}

}  // namespace

TEST_CASE("excitation does not depend on the number of ranks", "[ranks]") {
  Excitation together = excite(MPI_COMM_WORLD);
  Excitation alone = excite(MPI_COMM_SELF);
  CHECK(std::count_if(alone.activation.begin(), alone.activation.end(), [](double t) { return t >= 0; }) >
        20);
  check_same(alone, together);
  CHECK(difference(alone.saved, together.saved) < 1e-6 * largest(alone.saved));
  // What many ranks saved goes on in one, and the other way round.
  check_same(alone, excite(MPI_COMM_SELF, &together.saved));
  check_same(alone, excite(MPI_COMM_WORLD, &alone.saved));
}

namespace {

struct Deformed {
  std::vector<double> d, cells;
  double volume = 0, smallest_J = 0;
  int worst_cell = -1;
};

Deformed deform(MPI_Comm communicator, int order, bool mean, SolverKind solver) {
  const auto mesh = block();
  const Partition partition(mesh, communicator);
  const FibreField fibres = twisted_fibres(*mesh, 80);
  MechanicsSettings settings;
  settings.order = order;
  settings.mean_dilatation = mean;
  settings.materials = {{mesh_tags::ventricles, UsykLaw3{}}, {mesh_tags::aorta, NeoHookean{2e3, 5e3}}};
  Support clamp;
  clamp.tag = 1;
  clamp.fixed = {true, true, true};
  Support springs;
  springs.tag = 4;
  springs.normal_stiffness = 2e5;
  springs.full_stiffness = 1e4;
  settings.supports = {clamp, springs};
  settings.surfaces = {{5, {}}, {2, {}}};
  Mechanics mechanics(partition, &fibres, settings);
  EquilibriumSettings numerics;
  numerics.solver = solver;
  numerics.relative_tolerance = 1e-10;
  numerics.linear_tolerance = 1e-11;
  numerics.first_step = 0.5;
  find_equilibrium(
      mechanics,
      [](double s) {
        return std::vector<double>{100 * s, -60 * s};
      },
      numerics,
      [&](double s) {
        std::vector<CellTension> tension(partition.cells().size());
        for (std::size_t c = 0; c < tension.size(); ++c)
          tension[c].tension.fill(
              s * 300 * (1 + 30 * cell_centre(*mesh, static_cast<std::size_t>(partition.cells()[c]))[1]));
        return tension;
      });
  Deformed result;
  const Balance balance = mechanics.assemble(std::vector<double>{100, -60}, false);
  result.d = partition.gather(mechanics.nodes(), mechanics.displacement().data(), 3);
  const auto cells = mechanics.cell_deformation();
  result.cells = partition.gather_cells(cells.front().data(), 4);
  result.volume = balance.volumes_m3[0];
  result.smallest_J = balance.smallest_J;
  result.worst_cell = balance.worst_cell;
  const auto [ratio, cell] = mechanics.smallest_volume_ratio(mechanics.displacement());
  CHECK(ratio == Approx(balance.smallest_J).epsilon(1e-12));
  CHECK(cell == balance.worst_cell);
  return result;
}

}  // namespace

TEST_CASE("static mechanics does not depend on the number of ranks", "[ranks]") {
  struct Case {
    int order;
    bool mean;
    SolverKind solver;
  };
  for (const Case& c : {Case{1, false, SolverKind::direct}, Case{1, false, SolverKind::gmres_gamg},
                        Case{1, false, SolverKind::gmres_ilu}, Case{2, true, SolverKind::direct}}) {
    INFO(fmt::format("P{}{}, {}", c.order, c.mean ? "/P0" : "",
                     solver_kind_names[static_cast<int>(c.solver)]));
    const Deformed together = deform(MPI_COMM_WORLD, c.order, c.mean, c.solver);
    const Deformed alone = deform(MPI_COMM_SELF, c.order, c.mean, SolverKind::direct);
    CHECK(largest(alone.d) > 1e-4);
    CHECK(difference(alone.d, together.d) < 1e-6 * largest(alone.d));
    CHECK(difference(alone.cells, together.cells) < 1e-6);
    CHECK(together.volume == Approx(alone.volume).epsilon(1e-6));
    CHECK(together.smallest_J == Approx(alone.smallest_J).epsilon(1e-6));
    CHECK(together.worst_cell == alone.worst_cell);
  }
}

TEST_CASE("volumes and loads are whole where ranks own cells but none of their nodes", "[ranks]") {
  for (const std::array<int, 3>& n :
       {std::array{2, 1, 1}, std::array{3, 1, 1}, std::array{2, 2, 1}, std::array{2, 2, 2}})
    for (int order : {1, 2}) {
      INFO(fmt::format("P{}, {} x {} x {} bricks", order, n[0], n[1], n[2]));
      TetMesh mesh = rough_box({12e-3, 6e-3, 4e-3}, n);
      std::fill(mesh.facet_tags.begin(), mesh.facet_tags.end(), 24);
      double volume = 0;
      for (std::size_t c = 0; c < mesh.cells.size(); ++c) volume += cell_volume(mesh, c);
      const Partition partition(shared(mesh), MPI_COMM_WORLD);
      MechanicsSettings settings;
      settings.order = order;
      settings.materials = {{1, UsykLaw3{}}};
      settings.surfaces = {{24, {}}};
      Mechanics mechanics(partition, nullptr, settings);
      CHECK(mechanics.assemble(std::vector<double>{0}, false).volumes_m3[0] ==
            Approx(-volume).epsilon(1e-12));
      // b . x = int x . n da.
      double work = 0;
      for (std::size_t k = 0; k < mechanics.load(0).size(); ++k)
        work += mechanics.load(0)[k] * mechanics.nodes().points[k / 3][k % 3];
      CHECK(partition.sum(work) == Approx(3 * volume).epsilon(1e-12));
    }
}

TEST_CASE("a failure on one rank is a failure on all", "[ranks]") {
  int rank = 0, n_ranks = 1;
  MPI_Comm_rank(MPI_COMM_WORLD, &rank);
  MPI_Comm_size(MPI_COMM_WORLD, &n_ranks);
  CHECK_NOTHROW(collectively(MPI_COMM_WORLD, [] {}));
  CHECK_THROWS_WITH(collectively(MPI_COMM_WORLD,
                                 [&] {
                                   if (rank == n_ranks - 1)
                                     throw InputError(fmt::format("no good on rank {}", rank));
                                 }),
                    fmt::format("no good on rank {}", n_ranks - 1));
  CHECK_THROWS_AS(collectively(MPI_COMM_WORLD,
                               [&] {
                                 if (rank == n_ranks - 1) throw NumericalFailure("broke down");
                               }),
                  NumericalFailure);
}

TEST_CASE("one rank's mesh reaches all and too many ranks are refused", "[ranks]") {
  int rank = 0, n_ranks = 1;
  MPI_Comm_rank(MPI_COMM_WORLD, &rank);
  MPI_Comm_size(MPI_COMM_WORLD, &n_ranks);
  const auto reference = block();
  TetMesh mesh = rank == 0 ? *reference : TetMesh{};
  broadcast_mesh(mesh, MPI_COMM_WORLD);
  CHECK(mesh.points == reference->points);
  CHECK(mesh.cells == reference->cells);
  CHECK(mesh.cell_tags == reference->cell_tags);
  CHECK(mesh.facets == reference->facets);
  CHECK(mesh.facet_tags == reference->facet_tags);
  TetMesh one;
  one.points = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
  one.cells = {{0, 1, 2, 3}};
  one.cell_tags = {1};
  if (n_ranks > 1)
    CHECK_THROWS_WITH(Partition(shared(one), MPI_COMM_WORLD), Contains("1 tetrahedra"));
  else
    CHECK_NOTHROW(Partition(shared(one), MPI_COMM_WORLD));
  CHECK_THROWS_WITH(Partition(shared(TetMesh{}), MPI_COMM_SELF), Contains("no tetrahedra"));
}
