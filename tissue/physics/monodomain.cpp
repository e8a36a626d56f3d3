#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/fixed_step.hpp>
#include <wiggers/core/stopwatch.hpp>
#include <wiggers/core/units.hpp>
#include <wiggers/tissue/mesh/reference_cell.hpp>
#include <wiggers/tissue/parallel/collective.hpp>
#include <wiggers/tissue/physics/element.hpp>
#include <wiggers/tissue/physics/monodomain.hpp>

namespace wiggers {

namespace {

// Mass and the six products of derivatives on the reference cell, as shares of the volume. Derivatives are by
// the barycentric coordinates 1, 2, 3; coordinate 0 follows, 1 - sum.
struct ReferenceMatrices {
  int n;
  std::array<std::array<double, 100>, 7> m{};  // mass, 11, 22, 33, 12 + 21, 13 + 31, 23 + 32

  explicit ReferenceMatrices(int order) : n(order == 1 ? 4 : 10) {
    for (const auto& q : tetrahedron_quadrature(5)) {
      const auto shape = shape_values<4>(order, q.at);
      for (int a = 0; a < n; ++a)
        for (int b = 0; b < n; ++b) {
          double da[3], db[3];
          for (int k = 0; k < 3; ++k) {
            da[k] = shape.slope[a][k + 1] - shape.slope[a][0];
            db[k] = shape.slope[b][k + 1] - shape.slope[b][0];
          }
          const std::array<double, 7> terms = {shape.value[a] * shape.value[b],
                                               da[0] * db[0],
                                               da[1] * db[1],
                                               da[2] * db[2],
                                               da[0] * db[1] + da[1] * db[0],
                                               da[0] * db[2] + da[2] * db[0],
                                               da[1] * db[2] + da[2] * db[1]};
          for (int t = 0; t < 7; ++t) m[t][n * a + b] += q.weight * terms[t];
        }
    }
  }
};

}  // namespace

bool Stimulus::holds(const Point3& point) const {
  constexpr double slack = 1e-9;
  if (shape == Shape::ball) return norm(point - centre) <= radius + slack;
  for (int k = 0; k < 3; ++k)
    if (point[k] < centre[k] - slack || point[k] > corner[k] + slack) return false;
  return true;
}

struct Monodomain::Implementation {
  struct Cell {
    double gradient[4][3];  // of the barycentric coordinates, in the fibre frame
    double volume;
    double sigma[3];  // m^2/s
  };
  struct Region {
    IonicRegion plan;
    std::vector<int> nodes;  // own nodes with these cells
    std::unique_ptr<CellPopulation> cells;
    std::vector<double> potential, rate;
    // SVI: the cells of the mesh in this region, and a set of ionic cells at their quadrature points.
    std::vector<int> mesh_cells;
    std::unique_ptr<CellPopulation> at_points;
    std::vector<double> point_states, point_potential, point_rate;
  };

  const Partition& partition;
  MonodomainSettings settings;
  std::vector<Stimulus> stimuli;
  NodeSpace space;
  ReferenceMatrices reference;
  std::vector<Cell> cells;  // of the local cells; volume 0: not conductive
  std::vector<std::array<double, 4>> deformation;
  std::vector<Region> regions;
  std::vector<std::vector<int>> stimulated;  // own nodes of each stimulus
  std::unique_ptr<NodeMatrix> mass, system;
  std::unique_ptr<LinearSolver> solver;
  double tau_ms = 0, a0 = 0;  // that the system was assembled for
  bool stale = true;
  std::vector<double> u, u_before;  // local
  std::vector<double> b, f, guess;  // own
  std::vector<double> activation;   // own
  bool has_history = false;
  std::function<double(const Point3&, double)> source;
  MonodomainCost cost;

  Implementation(const Partition& p, MonodomainSettings s)
      : partition(p), settings(s), space(p.make_nodes(s.order, true)), reference(s.order) {}

  void assemble(double new_a0, double new_tau_ms) {
    const auto begin = Clock::now();
    const int n = reference.n;
    mass->set_zero();
    system->set_zero();
    double local_mass[100], local_system[100];
    for (std::size_t c = 0; c < cells.size(); ++c) {
      const Cell& cell = cells[c];
      if (cell.volume == 0) continue;
      const int* slots = mass->cell_slots(static_cast<int>(c));
      const auto& d = deformation[c];
      const double weight = cell.volume * d[3];
      // The conductivity tensor in the cell's own coordinates, six numbers.
      double w[3];
      for (int k = 0; k < 3; ++k) w[k] = weight * units::s_per_ms * cell.sigma[k] / d[k];
      const auto product = [&](int i, int j) {
        const double *gi = cell.gradient[i], *gj = cell.gradient[j];
        return w[0] * gi[0] * gj[0] + w[1] * gi[1] * gj[1] + w[2] * gi[2] * gj[2];
      };
      const double g[6] = {product(1, 1), product(2, 2), product(3, 3),
                           product(1, 2), product(1, 3), product(2, 3)};
      const double time = new_a0 / new_tau_ms;
      const auto& m = reference.m;
      for (int k = 0; k < n * n; ++k) {
        local_mass[k] = weight * m[0][k];
        local_system[k] = time * local_mass[k] + g[0] * m[1][k] + g[1] * m[2][k] + g[2] * m[3][k] +
                          g[3] * m[4][k] + g[4] * m[5][k] + g[5] * m[6][k];
      }
      for (int k = 0; k < n * n; ++k)
        if (slots[k] >= 0) {
          *mass->block(slots[k]) += local_mass[k];
          *system->block(slots[k]) += local_system[k];
        }
    }
    mass->finish();
    system->finish();
    solver->matrix_changed();
    a0 = new_a0;
    tau_ms = new_tau_ms;
    stale = false;
    ++cost.assemblies;
    cost.assembly_s += seconds_since(begin);
  }

  // One state of each region's cells at the local nodes; zero where its model has none (an empty name).
  template <class NameOf>
  std::vector<double> read_states(const NameOf& name_of) const {
    std::vector<double> values(space.n_local, 0.0), part;
    for (const Region& region : regions) {
      const std::string_view name = name_of(*region.plan.model);
      if (region.nodes.empty() || name.empty()) continue;
      part.resize(region.nodes.size());
      region.cells->read_state(name, part);
      for (std::size_t k = 0; k < part.size(); ++k) values[region.nodes[k]] = part[k];
    }
    partition.update_ghosts(space, values.data(), 1);
    return values;
  }

  double table_spacing(const CellModel& model) const {
    return model.has_voltage_table ? settings.table_spacing_mV : 0;
  }

  const std::vector<QuadraturePoint<4>>& current_rule() const {
    return tetrahedron_quadrature(settings.order == 1 ? 2 : 5);
  }

  // SVI: adds the currents' part of the right-hand side, integrated from the states at quadrature points.
  void add_currents_at_points() {
    const auto& rule = current_rule();
    std::vector<ShapeValues<4>> shapes;
    for (const auto& q : rule) shapes.push_back(shape_values<4>(settings.order, q.at));
    const auto n = static_cast<std::size_t>(reference.n);
    // The extrapolated potential with its ghosts.
    std::vector<double> star(space.n_local);
    std::copy(guess.begin(), guess.end(), star.begin());
    partition.update_ghosts(space, star.data(), 1);
    for (Region& region : regions) {
      const std::size_t n_states = region.plan.model->states.size();
      std::vector<double> own(region.nodes.size() * n_states), states(space.n_local * n_states, 0.0);
      if (region.cells) region.cells->copy_states(0, own);
      for (std::size_t k = 0; k < region.nodes.size(); ++k)
        std::copy_n(&own[k * n_states], n_states, &states[region.nodes[k] * n_states]);
      partition.update_ghosts(space, states.data(), static_cast<int>(n_states));
      collectively(partition.communicator(), [&] {
        if (region.mesh_cells.empty()) return;
        const std::size_t n_points = region.mesh_cells.size() * rule.size();
        if (!region.at_points) {
          PopulationSettings population;
          population.integrator = "bdf2-imex";
          population.table_spacing_mV = table_spacing(*region.plan.model);
          region.at_points = std::make_unique<CellPopulation>(*region.plan.model, n_points, population,
                                                              region.plan.parameters);
          region.point_states.resize(n_points * n_states);
          region.point_potential.resize(n_points);
          region.point_rate.resize(n_points);
        }
        std::fill(region.point_states.begin(), region.point_states.end(), 0.0);
        std::fill(region.point_potential.begin(), region.point_potential.end(), 0.0);
        std::size_t point = 0;
        for (int cell : region.mesh_cells)
          for (std::size_t q = 0; q < rule.size(); ++q, ++point)
            for (std::size_t a = 0; a < n; ++a) {
              const int node = space.nodes_of(cell)[a];
              const double N = shapes[q].value[a];
              region.point_potential[point] += N * star[node];
              for (std::size_t i = 0; i < n_states; ++i) {
                // Concentrations linearly, from the vertices: quadratic interpolation of a steep one is
                // negative.
                const bool linear = region.plan.model->states[i].unit == "mM";
                const double weight = linear ? (a < 4 ? rule[q].at[a] : 0.0) : N;
                region.point_states[point * n_states + i] += weight * states[node * n_states + i];
              }
            }
        region.at_points->assign_states(0, region.point_states);
        region.at_points->assign_states(1, region.point_states);
        // A step of no length leaves the states and gives the rate.
        region.at_points->step_under(region.point_potential, 1e-12, true, region.point_rate);
        point = 0;
        for (int cell : region.mesh_cells) {
          const double weight = cells[cell].volume * deformation[cell][3];
          for (std::size_t q = 0; q < rule.size(); ++q, ++point)
            for (std::size_t a = 0; a < n; ++a) {
              const int node = space.nodes_of(cell)[a];
              if (node < space.n_own)
                b[node] += weight * rule[q].weight * shapes[q].value[a] * region.point_rate[point];
            }
        }
      });
    }
  }

  void step(double t_end_s, double tau) {
    const bool first = !has_history;
    const double wanted_a0 = first ? 1.0 : 1.5;
    if (stale || a0 != wanted_a0 || std::abs(tau - tau_ms) > 1e-9 * tau) assemble(wanted_a0, tau);
    const auto n = static_cast<std::size_t>(space.n_own);
    for (std::size_t k = 0; k < n; ++k) {
      guess[k] = first ? u[k] : 2 * u[k] - u_before[k];
      f[k] = (first ? u[k] : 2 * u[k] - 0.5 * u_before[k]) / tau;
    }
    const auto begin = Clock::now();
    collectively(partition.communicator(), [&] {
      for (Region& region : regions) {
        if (region.nodes.empty() || source) continue;
        for (std::size_t k = 0; k < region.nodes.size(); ++k) region.potential[k] = guess[region.nodes[k]];
        region.cells->step_under(region.potential, tau, first, region.rate);
        if (settings.currents == IonicCurrents::interpolated)
          for (std::size_t k = 0; k < region.nodes.size(); ++k) f[region.nodes[k]] += region.rate[k];
      }
    });
    for (std::size_t s = 0; s < stimuli.size(); ++s) {
      const double since = t_end_s - stimuli[s].start_s;
      if (since > 1e-9 && since <= stimuli[s].duration_s + 1e-9)
        for (int node : stimulated[s]) f[node] += stimuli[s].amplitude_V_per_s;
    }
    if (source)
      for (std::size_t k = 0; k < n; ++k) f[k] += source(space.points[k], t_end_s);
    const auto cells_done = Clock::now();
    mass->multiply(f.data(), b.data());
    if (settings.currents == IonicCurrents::at_quadrature_points && !source) add_currents_at_points();
    const auto right_side_done = Clock::now();
    const SolveReport report =
        solver->solve(b.data(), guess.data(), settings.relative_tolerance, 1e-300, 500);
    if (!report.converged)
      throw NumericalFailure(fmt::format("electrophysiology at t = {:.5f} s: the linear solver failed, {}",
                                         t_end_s, report.reason));
    for (std::size_t k = 0; k < n; ++k) {
      const double now = guess[k], before = u[k];
      u_before[k] = before;
      u[k] = now;
      const double threshold = settings.activation_threshold_mV;
      if (before < threshold && now >= threshold && activation[k] < 0)
        activation[k] = t_end_s - units::s_per_ms * tau * (now - threshold) / (now - before);
    }
    has_history = true;
    cost.ionic_s += std::chrono::duration<double>(cells_done - begin).count();
    cost.right_side_s += std::chrono::duration<double>(right_side_done - cells_done).count();
    cost.solve_s += seconds_since(right_side_done);
    ++cost.steps;
    cost.iterations += report.iterations;
  }
};

Monodomain::Monodomain(const Partition& partition, const FibreField* fibres, MonodomainSettings settings,
                       std::vector<IonicRegion> regions, std::vector<Stimulus> stimuli, const TetMesh* image)
    : me_(std::make_unique<Implementation>(partition, settings)) {
  auto& me = *me_;
  me.stimuli = std::move(stimuli);
  const TetMesh& mesh = partition.mesh();
  const NodeSpace& space = me.space;
  if (space.n_global == 0)
    throw InputError("electrophysiology: the mesh has no conductive cells (volume tags 1, 2, 3)");

  std::vector<int> region_of(space.n_local, -1);
  me.cells.resize(partition.cells().size());
  me.deformation.assign(partition.cells().size(), {1, 1, 1, 1});
  for (std::size_t r = 0; r < regions.size(); ++r)
    for (int tag : regions[r].tags)
      if (std::find(mesh.cell_tags.begin(), mesh.cell_tags.end(), tag) == mesh.cell_tags.end())
        throw InputError(
            fmt::format("electrophysiology: no tetrahedron of the mesh has the volume tag {}", tag));
  collectively(partition.communicator(), [&] {
    for (std::size_t c = 0; c < me.cells.size(); ++c) {
      if (!space.has(static_cast<int>(c))) continue;
      const int file = partition.cells()[c];
      const auto& v = mesh.cells[file];
      double x[4][3], g[4][3];
      for (int k = 0; k < 4; ++k)
        for (int i = 0; i < 3; ++i) x[k][i] = mesh.points[v[k]][i];
      auto& cell = me.cells[c];
      cell.volume = shape_gradients(x, g);
      const Frame frame = fibres ? frame_at(*fibres, mesh, file, {0.25, 0.25, 0.25, 0.25})
                                 : Frame{Point3{1, 0, 0}, Point3{0, 1, 0}, Point3{0, 0, 1}};
      for (int k = 0; k < 4; ++k)
        for (int a = 0; a < 3; ++a)
          cell.gradient[k][a] = g[k][0] * frame[a][0] + g[k][1] * frame[a][1] + g[k][2] * frame[a][2];
      int mine = -1;
      for (std::size_t r = 0; r < regions.size(); ++r)
        for (int tag : regions[r].tags)
          if (tag == mesh.cell_tags[file]) mine = static_cast<int>(r);
      if (mine < 0)
        throw InputError(fmt::format(
            "electrophysiology: no cells are named for the volume tag {} of the mesh", mesh.cell_tags[file]));
      for (int node : space.nodes_of(static_cast<int>(c))) {
        if (region_of[node] >= 0 && region_of[node] != mine)
          throw InputError(fmt::format(
              "electrophysiology: two kinds of cells share a point of the mesh at ({:.2f}, {:.2f}, {:.2f}) "
              "mm; "
              "atria and ventricles must be separated by non-conductive tetrahedra",
              1e3 * space.points[node][0], 1e3 * space.points[node][1], 1e3 * space.points[node][2]));
        region_of[node] = mine;
      }
      // The share of the cell in the fast layer, by its quadrature points.
      double fast = 0;
      if (fibres && settings.fast_layer_thickness > 0 && mesh.cell_tags[file] == mesh_tags::ventricles &&
          regions[mine].fast_layer.fibre > 0)
        for (const auto& q : tetrahedron_quadrature(5)) {
          double distance = 0;
          for (int k = 0; k < 4; ++k) distance += q.at[k] * fibres->endocardial_distance[v[k]];
          if (distance <= settings.fast_layer_thickness) fast += q.weight;
        }
      const Conductivity &slow = regions[mine].conductivity, &quick = regions[mine].fast_layer;
      cell.sigma[0] = (1 - fast) * slow.fibre + fast * quick.fibre;
      cell.sigma[1] = (1 - fast) * slow.sheet + fast * quick.sheet;
      cell.sigma[2] = (1 - fast) * slow.normal + fast * quick.normal;
    }
  });
  const auto n = static_cast<std::size_t>(space.n_own);
  me.u.assign(space.n_local, 0);
  for (std::size_t r = 0; r < regions.size(); ++r) {
    Implementation::Region region;
    region.plan = regions[r];
    for (int node = 0; node < space.n_own; ++node)
      if (region_of[node] == static_cast<int>(r)) region.nodes.push_back(node);
    if (!region.nodes.empty()) {
      PopulationSettings population;
      population.integrator = "bdf2-imex";
      population.table_spacing_mV = me.table_spacing(*regions[r].model);
      region.cells = std::make_unique<CellPopulation>(*regions[r].model, region.nodes.size(), population,
                                                      regions[r].parameters);
      std::vector<double> states;
      states.reserve(region.nodes.size() * regions[r].initial_state.size());
      for (std::size_t k = 0; k < region.nodes.size(); ++k)
        states.insert(states.end(), regions[r].initial_state.begin(), regions[r].initial_state.end());
      region.cells->assign_states(0, states);
      region.cells->assign_states(1, states);
      region.potential.resize(region.nodes.size());
      region.rate.resize(region.nodes.size());
    }
    for (std::size_t c = 0; c < me.cells.size(); ++c)
      if (space.has(static_cast<int>(c)) &&
          region_of[space.nodes_of(static_cast<int>(c))[0]] == static_cast<int>(r))
        region.mesh_cells.push_back(static_cast<int>(c));
    me.regions.push_back(std::move(region));
  }
  for (int node = 0; node < space.n_local; ++node)
    if (region_of[node] >= 0)
      me.u[node] = regions[region_of[node]].initial_state[regions[region_of[node]].model->membrane_potential];
  me.u_before = me.u;
  me.b.assign(n, 0);
  me.f.assign(n, 0);
  me.guess.assign(n, 0);
  me.activation.assign(n, -1);
  std::vector<Point3> places = space.points;
  if (image)
    for (std::size_t c = 0; c < me.cells.size(); ++c) {
      if (!space.has(static_cast<int>(c))) continue;
      const auto nodes = space.nodes_of(static_cast<int>(c));
      const auto& v = image->cells[partition.cells()[c]];
      for (int k = 0; k < 4; ++k) places[nodes[k]] = image->points[v[k]];
      for (std::size_t k = 4; k < nodes.size(); ++k)
        places[nodes[k]] = 0.5 * (image->points[v[tetrahedron_edges[k - 4][0]]] +
                                  image->points[v[tetrahedron_edges[k - 4][1]]]);
    }
  require_stimuli_touch(image ? *image : partition.mesh(), me.stimuli, settings.order);
  for (const Stimulus& stimulus : me.stimuli) {
    std::vector<int> nodes;
    for (int node = 0; node < space.n_own; ++node)
      if (stimulus.holds(places[node])) nodes.push_back(node);
    me.stimulated.push_back(std::move(nodes));
  }
  me.mass = std::make_unique<NodeMatrix>(partition, space, 1);
  me.system = std::make_unique<NodeMatrix>(partition, space, 1);
  me.solver = std::make_unique<LinearSolver>(*me.system, settings.solver);
}

void require_stimuli_touch(const TetMesh& mesh, std::span<const Stimulus> stimuli, int order) {
  for (const Stimulus& stimulus : stimuli) {
    bool touches = false;
    for (std::size_t c = 0; c < mesh.cells.size() && !touches; ++c) {
      if (!mesh_tags::conductive(mesh.cell_tags[c])) continue;
      const auto& v = mesh.cells[c];
      for (int vertex : v) touches = touches || stimulus.holds(mesh.points[vertex]);
      if (order == 2)
        for (const auto& edge : tetrahedron_edges)
          touches = touches || stimulus.holds(0.5 * (mesh.points[v[edge[0]]] + mesh.points[v[edge[1]]]));
    }
    if (!touches)
      throw InputError(fmt::format(
          "electrophysiology: the stimulus at ({:.2f}, {:.2f}, {:.2f}) mm touches no node of the conductive "
          "tissue; move it, widen it, or check the mesh's unit",
          1e3 * stimulus.centre[0], 1e3 * stimulus.centre[1], 1e3 * stimulus.centre[2]));
  }
}

Monodomain::~Monodomain() = default;

void Monodomain::set_deformation(std::span<const std::array<double, 4>> cells) {
  std::copy(cells.begin(), cells.end(), me_->deformation.begin());
  me_->stale = true;
}

void Monodomain::advance(double t_s, double dt_s) {
  const long n_steps = whole_steps(dt_s, me_->settings.tau_s);
  const double tau_s = dt_s / static_cast<double>(n_steps);
  for (long k = 1; k <= n_steps; ++k)
    me_->step(t_s + static_cast<double>(k) * tau_s, tau_s * units::ms_per_s);
  me_->partition.update_ghosts(me_->space, me_->u.data(), 1);
}

const NodeSpace& Monodomain::nodes() const { return me_->space; }
const double* Monodomain::potential_mV() const { return me_->u.data(); }
const std::vector<double>& Monodomain::activation_s() const { return me_->activation; }
void Monodomain::forget_activation() { std::fill(me_->activation.begin(), me_->activation.end(), -1.0); }
const MonodomainCost& Monodomain::cost() const { return me_->cost; }

std::vector<double> Monodomain::state(std::string_view name) const {
  return me_->read_states([&](const CellModel& model) -> std::string_view {
    for (const Quantity& q : model.states)
      if (q.name == name) return q.name;
    return {};
  });
}

std::vector<double> Monodomain::calcium_uM() const {
  std::vector<double> values = me_->read_states([](const CellModel& model) {
    return model.has_calcium() ? model.states[static_cast<std::size_t>(model.cytosolic_calcium)].name
                               : std::string_view{};
  });
  for (double& value : values) value *= units::uM_per_mM;
  return values;
}

double Monodomain::lead(const Point3& electrode) const {
  double sum = 0;
  const TetMesh& mesh = me_->partition.mesh();
  const auto shape = shape_values<4>(me_->space.order, {0.25, 0.25, 0.25, 0.25});
  for (int c = 0; c < me_->partition.n_own_cells(); ++c) {
    const auto& cell = me_->cells[c];
    if (cell.volume == 0) continue;
    const auto nodes = me_->space.nodes_of(c);
    const auto& v = mesh.cells[me_->partition.cells()[c]];
    // Both gradients at the centroid; that of 1/r from the linear interpolant of the cell, in the same frame.
    double du[3] = {}, dr[3] = {};
    for (int k = 0; k < 4; ++k) {
      double by_coordinate = 0;
      for (std::size_t a = 0; a < nodes.size(); ++a) by_coordinate += shape.slope[a][k] * me_->u[nodes[a]];
      const double inverse = 1 / norm(mesh.points[v[k]] - electrode);
      for (int i = 0; i < 3; ++i) {
        du[i] += by_coordinate * cell.gradient[k][i];
        dr[i] += inverse * cell.gradient[k][i];
      }
    }
    for (int i = 0; i < 3; ++i) sum -= cell.volume * cell.sigma[i] * du[i] * dr[i];
  }
  return me_->partition.sum(sum);
}

void Monodomain::prescribe(const std::function<double(const Point3&, double)>& exact, double t_s,
                           double tau_s, std::function<double(const Point3&, double)> source) {
  for (int k = 0; k < me_->space.n_local; ++k) {
    me_->u[k] = exact(me_->space.points[k], t_s);
    me_->u_before[k] = exact(me_->space.points[k], t_s - tau_s);
  }
  me_->has_history = true;
  me_->source = std::move(source);
}

void Monodomain::save(std::vector<double>& out) const {
  const Partition& partition = me_->partition;
  const NodeSpace& space = me_->space;
  const auto put = [&](const std::vector<double>& values, int components) {
    const auto all = partition.gather(space, values.data(), components);
    out.insert(out.end(), all.begin(), all.end());
  };
  out.push_back(me_->has_history ? 1 : 0);
  put(me_->u, 1);
  put(me_->u_before, 1);
  put(me_->activation, 1);
  for (const auto& region : me_->regions) {
    // Zero where a node has other cells: simple, and small beside what it costs to compute.
    const auto n_states = region.plan.model->states.size();
    for (int level = 0; level < 2; ++level) {
      std::vector<double> values(space.n_own * n_states, 0.0), part(region.nodes.size() * n_states);
      if (region.cells) region.cells->copy_states(level, part);
      for (std::size_t k = 0; k < region.nodes.size(); ++k)
        std::copy_n(&part[k * n_states], n_states, &values[region.nodes[k] * n_states]);
      put(values, static_cast<int>(n_states));
    }
  }
}

void Monodomain::restore(std::span<const double>& in) {
  const NodeSpace& space = me_->space;
  const auto take = [&](std::vector<double>& values, int components, int n_nodes) {
    const auto n = static_cast<std::size_t>(space.n_global) * components;
    if (in.size() < n) throw InputError("the saved state is damaged: it ends early");
    const auto all = in.first(n);
    in = in.subspan(n);
    values.resize(static_cast<std::size_t>(n_nodes) * components);
    for (int k = 0; k < n_nodes; ++k)
      std::copy_n(&all[static_cast<std::size_t>(space.file_index[k]) * components], components,
                  &values[static_cast<std::size_t>(k) * components]);
  };
  if (in.empty()) throw InputError("the saved state is damaged: it ends early");
  me_->has_history = in.front() != 0;
  in = in.subspan(1);
  take(me_->u, 1, space.n_local);
  take(me_->u_before, 1, space.n_local);
  take(me_->activation, 1, space.n_own);
  std::vector<double> values;
  for (auto& region : me_->regions) {
    const auto n_states = region.plan.model->states.size();
    for (int level = 0; level < 2; ++level) {
      take(values, static_cast<int>(n_states), space.n_own);
      std::vector<double> part(region.nodes.size() * n_states);
      for (std::size_t k = 0; k < region.nodes.size(); ++k)
        std::copy_n(&values[region.nodes[k] * n_states], n_states, &part[k * n_states]);
      if (region.cells) region.cells->assign_states(level, part);
    }
  }
}

}  // namespace wiggers
