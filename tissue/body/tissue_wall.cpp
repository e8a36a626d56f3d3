#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <optional>
#include <set>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/progress.hpp>
#include <wiggers/core/stopwatch.hpp>
#include <wiggers/core/units.hpp>
#include <wiggers/heart/scene/tissue_services.hpp>
#include <wiggers/tissue/body/body.hpp>
#include <wiggers/tissue/body/field_file.hpp>
#include <wiggers/tissue/body/tissue_wall.hpp>
#include <wiggers/tissue/mesh/geometry.hpp>
#include <wiggers/tissue/parallel/collective.hpp>
#include <wiggers/tissue/physics/activation.hpp>
#include <wiggers/tissue/physics/equilibrium.hpp>

namespace wiggers {

namespace {

constexpr int most_halvings = 7;

struct Cost {
  double electrophysiology_s = 0, activation_s = 0, assembly_s = 0, solve_s = 0, feedback_s = 0;
  long steps = 0, tangents = 0, residuals = 0, solves = 0, solver_iterations = 0, halvings = 0, rejected = 0,
       rescues = 0;
};

}  // namespace

struct TissueWall::Implementation {
  // As planned.
  std::string name;
  std::vector<int> chambers;
  TissuePlan plan;
  RateScheme rate;
  bool stabilise;
  double dt_s, period_s;
  std::vector<IonicRegion> ionic;
  std::vector<ForceRegion> force;
  std::vector<CalciumRescaling> rescaling;  // of each ionic region
  MPI_Comm communicator;
  bool first_rank = true;

  // On the unloaded mesh, made by set_up().
  std::shared_ptr<const TetMesh> image, mesh;
  FibreField fibres;
  std::unique_ptr<Partition> partition;
  std::unique_ptr<Monodomain> monodomain;
  std::unique_ptr<Activation> activation;
  std::unique_ptr<Mechanics> mechanics;
  SolverKind solver_kind = SolverKind::gmres_ilu;
  std::unique_ptr<LinearSolver> solver, direct;  // the latter where the former fails
  bool rescued = false;                          // the present matrix is the direct solver's
  std::vector<int> ep_node;         // node of the monodomain at each local vertex of the myocardium
  std::vector<int> region_of_node;  // region of the calcium's rescaling
  std::vector<double> cell_volume;  // of local conductive cells
  // Of bodies with several cavities: whose wall each own vertex and each own cell of the myocardium is,
  // indexes of `chambers`; -1: nobody's.
  std::vector<int> chamber_of_node, chamber_of_cell;
  std::optional<LongAxis> axis;  // of the left ventricle, on the image
  RecoveryReport recovery;

  std::vector<int> arteries_here;          // indexes of `arteries`
  std::vector<double> arterial_pressures;  // Pa, at the step's start, of arteries_here

  // State between steps.
  std::vector<double> stretch, stretch_before;  // of local vertices, at the step's start and one step earlier
  std::vector<double> calcium;                  // rescaled, at the step's start
  double last_dt = 0;
  double ep_done_until = 0;  // within the beat
  bool repeated = false;     // the step was rejected: it comes again, in halves

  // Of the present step.
  double dt = 0;
  std::vector<double> next_calcium;
  std::vector<double> pressures;  // Pa, at the last linearise(): cavities, then arteries
  std::vector<double> y, step, trial;
  std::vector<std::vector<double>> Y;
  std::vector<double> compliance;  // m^3/Pa
  bool balance_met = false, have_tangent = false, have_compliance = false;
  double first_residual = 0, last_residual = 0;
  int iteration = 0, tangent_age = 0;
  Balance balance;

  std::unique_ptr<FieldSeries> series;
  double next_fields_s = -1;
  bool fields_open = false;
  Cost cost;

  std::size_t n_cavities() const { return chambers.size(); }
  // Pressures of the cavities with those of the arteries behind them.
  std::vector<double> loaded(std::vector<double> of_cavities) const {
    of_cavities.insert(of_cavities.end(), arterial_pressures.begin(), arterial_pressures.end());
    return of_cavities;
  }
  Progress::Style progress_style() const {
    return first_rank && !tissue_services().quiet ? Progress::Style::automatic : Progress::Style::quiet;
  }

  void set_up(std::shared_ptr<const TetMesh> unloaded) {
    mesh = std::move(unloaded);
    collectively(communicator, [&] { fibres = make_fibres(plan, *mesh); });
    say_of_fibres(plan, *mesh, fibres, fmt::format("walls.{}", name), communicator);
    check_interrupt_of_all(communicator);
    partition = std::make_unique<Partition>(mesh, communicator);
    check_interrupt_of_all(communicator);
    monodomain = std::make_unique<Monodomain>(*partition, &fibres, plan.electrophysiology, ionic,
                                              plan.stimuli, image.get());
    check_interrupt_of_all(communicator);
    activation = std::make_unique<Activation>(*partition, &fibres, force, rate, stabilise);
    mechanics = std::make_unique<Mechanics>(*partition, &fibres, mechanics_of(plan, chambers, *image));
    direct.reset();
    rescued = false;
    solver_kind = solver_of(plan, *mesh);
    solver = std::make_unique<LinearSolver>(mechanics->matrix(), solver_kind);
    const NodeSpace& vertices = activation->nodes();
    ep_node.assign(vertices.n_local, -1);
    region_of_node.assign(vertices.n_local, 0);
    cell_volume.assign(partition->cells().size(), 0.0);
    for (std::size_t c = 0; c < partition->cells().size(); ++c) {
      if (!vertices.has(static_cast<int>(c))) continue;
      const int file = partition->cells()[c];
      int region = 0;
      for (std::size_t r = 0; r < ionic.size(); ++r)
        for (int tag : ionic[r].tags)
          if (tag == mesh->cell_tags[file]) region = static_cast<int>(r);
      const auto at = vertices.nodes_of(static_cast<int>(c)),
                 ep = monodomain->nodes().nodes_of(static_cast<int>(c));
      for (int k = 0; k < 4; ++k) {
        ep_node[at[k]] = ep[k];
        region_of_node[at[k]] = region;
      }
      cell_volume[c] = wiggers::cell_volume(*mesh, file);
    }
    tell_chambers();
    stretch.assign(vertices.n_local, 1.0);
    stretch_before = stretch;
    calcium = rescaled_calcium();
    next_calcium = calcium;
    last_dt = dt_s;
    arterial_pressures.resize(arteries_here.size(), 0.0);
    pressures = loaded(std::vector<double>(n_cavities(), 0.0));
    Y.assign(n_cavities(), std::vector<double>(3 * static_cast<std::size_t>(mechanics->nodes().n_own), 0.0));
    compliance.assign(n_cavities() * n_cavities(), 0.0);
  }

  // Atria by their tags, ventricles by which of them is nearer.
  void tell_chambers() {
    const NodeSpace& vertices = activation->nodes();
    const auto index_of = [&](int chamber) {
      const auto at = std::find(chambers.begin(), chambers.end(), chamber);
      return at == chambers.end() ? -1 : static_cast<int>(at - chambers.begin());
    };
    chamber_of_node.assign(vertices.n_local, -1);
    chamber_of_cell.assign(partition->cells().size(), -1);
    for (std::size_t c = 0; c < partition->cells().size(); ++c) {
      if (!vertices.has(static_cast<int>(c))) continue;
      const int file = partition->cells()[c], tag = mesh->cell_tags[file];
      const auto nodes = vertices.nodes_of(static_cast<int>(c));
      double left = 0;
      for (int k = 0; k < 4; ++k) {
        const double share = fibres.interventricular[mesh->cells[file][k]];
        left += 0.25 * share;
        // A vertex between two chambers is the later one's, whatever the order of the cells.
        chamber_of_node[nodes[k]] =
            std::max(chamber_of_node[nodes[k]], index_of(tag == mesh_tags::left_atrium    ? LA
                                                         : tag == mesh_tags::right_atrium ? RA
                                                         : share >= 0.5                   ? LV
                                                                                          : RV));
      }
      chamber_of_cell[c] = index_of(tag == mesh_tags::left_atrium    ? LA
                                    : tag == mesh_tags::right_atrium ? RA
                                    : left >= 0.5                    ? LV
                                                                     : RV);
    }
  }

  // Per chamber: mean tension (kPa) and stretch of its vertices, smallest J and volume (mL) of its cells.
  void chamber_values(double* values) const {
    const NodeSpace& vertices = activation->nodes();
    const std::size_t m = chambers.size();
    std::vector<double> sums(4 * m, 0.0), all(4 * m), smallest(m, std::numeric_limits<double>::infinity()),
        least(m);
    for (int k = 0; k < vertices.n_own; ++k) {
      if (chamber_of_node[k] < 0) continue;
      double* of = &sums[4 * static_cast<std::size_t>(chamber_of_node[k])];
      of[0] += activation->accepted_tension()[k] / units::Pa_per_kPa;
      of[1] += stretch[k];
      of[2] += 1;
    }
    const auto deformation = mechanics->cell_deformation();
    for (int c = 0; c < partition->n_own_cells(); ++c) {
      const int chamber = chamber_of_cell[c];
      if (chamber < 0) continue;
      sums[4 * static_cast<std::size_t>(chamber) + 3] +=
          cell_volume[c] * deformation[c][3] / units::m3_per_mL;
      smallest[chamber] = std::min(smallest[chamber], deformation[c][3]);
    }
    MPI_Allreduce(sums.data(), all.data(), static_cast<int>(sums.size()), MPI_DOUBLE, MPI_SUM, communicator);
    MPI_Allreduce(smallest.data(), least.data(), static_cast<int>(m), MPI_DOUBLE, MPI_MIN, communicator);
    for (std::size_t k = 0; k < m; ++k) {
      const double n = std::max(1.0, all[4 * k + 2]);
      for (double value : {all[4 * k] / n, all[4 * k + 1] / n, least[k], all[4 * k + 3]}) *values++ = value;
    }
  }

  // Motion of the left ventricle's base towards the apex and of its apex towards the base, from the image
  // (mm).
  void axis_values(double* values) const {
    const NodeSpace& nodes = mechanics->nodes();
    const double length = norm(axis->base - axis->apex);
    const Point3 up = (1 / length) * (axis->base - axis->apex);
    double sums[2] = {}, all[2];
    const std::set<int> ring(axis->ring.begin(), axis->ring.end());
    for (int k = 0; k < nodes.n_own; ++k) {
      const int vertex = nodes.vertex[k];
      if (vertex < 0 || !(ring.contains(vertex) || vertex == axis->apex_vertex)) continue;
      double along = 0;
      for (int i = 0; i < 3; ++i)
        along += up[i] *
                 (mesh->points[vertex][i] + mechanics->displacement()[3 * static_cast<std::size_t>(k) + i] -
                  image->points[vertex][i]);
      if (vertex == axis->apex_vertex) sums[1] += along;
      if (ring.contains(vertex)) sums[0] -= along / static_cast<double>(ring.size());
    }
    MPI_Allreduce(sums, all, 2, MPI_DOUBLE, MPI_SUM, communicator);
    for (int k = 0; k < 2; ++k) values[k] = all[k] * units::mm_per_m;
  }

  std::vector<double> rescaled_calcium() const {
    const std::vector<double> at_nodes = monodomain->calcium_uM();
    std::vector<double> values(ep_node.size());
    for (std::size_t k = 0; k < values.size(); ++k)
      values[k] = rescaling[region_of_node[k]](at_nodes[ep_node[k]]);
    return values;
  }

  // Volume-weighted mean over the adjacent cells of the myocardium.
  std::vector<double> vertex_stretch() const {
    const NodeSpace& vertices = activation->nodes();
    const auto deformation = mechanics->cell_deformation();
    std::vector<double> sum(vertices.n_local, 0.0), weight(vertices.n_local, 0.0);
    for (std::size_t c = 0; c < deformation.size(); ++c) {
      if (!vertices.has(static_cast<int>(c))) continue;
      const double lambda = std::sqrt(deformation[c][0]);
      for (int node : vertices.nodes_of(static_cast<int>(c))) {
        sum[node] += cell_volume[c] * lambda;
        weight[node] += cell_volume[c];
      }
    }
    for (std::size_t k = 0; k < sum.size(); ++k) sum[k] /= weight[k];
    partition->update_ghosts(vertices, sum.data(), 1);
    return sum;
  }

  std::vector<CellTension> cell_tension() const {
    const NodeSpace& vertices = activation->nodes();
    std::vector<CellTension> all(partition->cells().size());
    for (std::size_t c = 0; c < all.size(); ++c) {
      if (!vertices.has(static_cast<int>(c))) continue;
      const auto nodes = vertices.nodes_of(static_cast<int>(c));
      for (int k = 0; k < 4; ++k) {
        all[c].tension[k] = activation->tension()[nodes[k]];
        all[c].stiffness[k] = activation->stiffness()[nodes[k]];
      }
    }
    return all;
  }

  void set_ghosts(std::vector<double>& d) const { partition->update_ghosts(mechanics->nodes(), d.data(), 3); }

  void solve(const std::vector<double>& right, std::vector<double>& x, double tolerance) {
    const auto begin = Clock::now();
    // Where incomplete factors fail, complete ones take over until the next matrix: dear, but rare.
    constexpr int enough_iterations = 400;
    SolveReport report;
    if (!rescued) report = solver->solve(right.data(), x.data(), tolerance, 1e-12, enough_iterations);
    cost.solver_iterations += report.iterations;
    if (!report.converged && solver_kind != SolverKind::direct) {
      if (!direct) direct = std::make_unique<LinearSolver>(mechanics->matrix(), SolverKind::direct);
      if (!rescued) direct->matrix_changed();
      rescued = true;
      report = direct->solve(right.data(), x.data(), tolerance, 1e-12);
      ++cost.rescues;
    }
    cost.solve_s += seconds_since(begin);
    ++cost.solves;
    if (!report.converged)
      throw NumericalFailure(
          fmt::format("walls.{}: the linear solver of mechanics failed, {}; smallest J {:.3g} in {}", name,
                      report.reason, balance.smallest_J, mechanics->place_of_cell(balance.worst_cell)));
  }

  void assemble(bool tangent) {
    const auto begin = Clock::now();
    balance = mechanics->assemble(pressures, tangent);
    cost.assembly_s += seconds_since(begin);
    ++(tangent ? cost.tangents : cost.residuals);
    if (!balance.finite || !(balance.smallest_J > 0))
      throw NumericalFailure(fmt::format("walls.{}: Newton met a turned element, J = {:.3g} in {}", name,
                                         balance.smallest_J, mechanics->place_of_cell(balance.worst_cell)));
  }

  // Static equilibrium at these volumes.
  void bring_to_volumes(const double* volumes_mL, std::vector<double>& p) {
    EquilibriumSettings statics = static_settings(mechanics->nodes());
    statics.relative_tolerance = 1e-6;
    statics.first_step = 0.5;
    std::vector<std::optional<double>> wanted_m3;
    for (std::size_t k = 0; k < n_cavities(); ++k) wanted_m3.emplace_back(volumes_mL[k] * units::m3_per_mL);
    EquilibriumReport report;
    try {
      reach_volumes(*mechanics, wanted_m3, p, statics, report);
      mechanics->require_meaningful(mechanics->assemble(p, false));
    } catch (const NumericalFailure& failure) {
      throw NumericalFailure(fmt::format("walls.{}: {}", name, failure.what()));
    }
  }

  void after_displacement_changed() {
    stretch = vertex_stretch();
    if (plan.feedback) monodomain->set_deformation(mechanics->cell_deformation());
  }
};

std::unique_ptr<Wall> TissueRecipe::make(const WallPlan& plan, const WallSiteOf<double>& site,
                                         std::span<const double>) const {
  return std::make_unique<TissueWall>(site.scene, plan, *site.cells, MPI_COMM_WORLD);
}

TissueWall::TissueWall(const Scene& scene, const WallPlan& wall,
                       const std::map<std::string, PacedCellType>& cells, MPI_Comm communicator)
    : me_(std::make_unique<Implementation>()) {
  auto& me = *me_;
  me.name = wall.name;
  me.chambers = wall.cavities;
  me.plan = tissue_plan(wall);
  me.communicator = communicator;
  int rank = 0;
  MPI_Comm_rank(communicator, &rank);
  me.first_rank = rank == 0;
  me.rate = scene.rate;
  me.stabilise = scene.stabilise_active_stress;
  me.dt_s = scene.dt_s;
  me.period_s = scene.period_s;
  if (me.plan.electrophysiology.tau_s > me.dt_s * (1 + 1e-9))
    throw InputError(fmt::format("walls.{}.electrophysiology.tau_ms = {} is longer than solver.dt_s = {} s",
                                 me.name, me.plan.electrophysiology.tau_s * units::ms_per_s, me.dt_s));

  me.image = make_mesh(me.plan, me.chambers, fmt::format("walls.{}", me.name), communicator);
  place_stimuli(me.plan, *me.image, fmt::format("walls.{}", me.name), communicator);
  me.axis = long_axis(*me.image, false);
  me.arteries_here = arteries_of(*me.image);
  me.ionic = ionic_regions(scene, wall, *me.image, cells, fmt::format("walls.{}", me.name));
  // Before the minutes that the unloaded shape may take.
  require_stimuli_touch(*me.image, me.plan.stimuli, me.plan.electrophysiology.order);
  for (std::size_t r = 0; r < wall.fibres.size(); ++r) {
    const FibrePlan& fibre = wall.fibres[r];
    const PacedCellType& paced = cells.at(fibre.cells);
    CalciumRescaling rescaling = scene.cells.at(fibre.cells).rescaling;
    if (rescaling.reading == CalciumReading::peak) rescaling.diastolic_uM = paced.calcium_min_uM;
    me.rescaling.push_back(rescaling);
    ForceRegion force;
    force.tags = me.ionic[r].tags;
    force.model = fibre.force;
    force.parameters = fibre.force_parameters;
    force.rest_calcium_uM = paced.calcium_min_uM;
    force.right_share = r == 0 ? me.plan.right_share : 1.0;  // the atria have no left and right tension
    force.active = fibre.settings.active;
    force.subtract_rest_tension = fibre.settings.subtract_rest_tension;
    me.force.push_back(std::move(force));
  }
}

TissueWall::~TissueWall() = default;

std::span<const int> TissueWall::cavities() const { return me_->chambers; }

void TissueWall::start(const double&, const double* volumes, double* pressures) {
  auto& me = *me_;
  say_of_locking(me.plan, fmt::format("walls.{}", me.name), me.communicator);
  me.set_up(unloaded_shape(me.plan, me.chambers, me.image, fmt::format("walls.{}", me.name),
                           me.progress_style(), me.communicator, me.recovery));

  // The initial displacement: in equilibrium at the volumes wanted, with the tension of rest.
  Progress progress(fmt::format("walls.{}: initial displacement", me.name), me.progress_style());
  std::vector<CellTension> rest = me.cell_tension();
  for (CellTension& cell : rest) cell.stiffness = {};
  me.mechanics->set_tension(rest);
  std::vector<double> p = me.loaded(std::vector<double>(me.n_cavities(), 0.0));
  if (!me.arteries_here.empty())
    find_equilibrium(
        *me.mechanics,
        [&](double share) {
          std::vector<double> ramped = p;
          for (double& value : ramped) value *= share;
          return ramped;
        },
        static_settings(me.mechanics->nodes()));
  me.bring_to_volumes(volumes, p);
  me.pressures = p;
  for (std::size_t k = 0; k < me.n_cavities(); ++k) pressures[k] = p[k] / units::Pa_per_mmHg;
  me.mechanics->accept();
  me.mechanics->accept();
  me.after_displacement_changed();
  me.stretch_before = me.stretch;
  progress.finish(fmt::format("{:.1f} mL at {:.2f} mmHg", volumes[0], pressures[0]));
}

void TissueWall::set_arterial_pressures(const double* systemic_and_pulmonary_mmHg) {
  auto& me = *me_;
  me.arterial_pressures.clear();
  for (int artery : me.arteries_here)
    me.arterial_pressures.push_back(systemic_and_pulmonary_mmHg[artery] * units::Pa_per_mmHg);
}

void TissueWall::begin_step(const double& t, const double& dt) {
  auto& me = *me_;
  me.dt = dt;
  if (t == 0 && !me.repeated) {
    me.monodomain->forget_activation();
    me.ep_done_until = 0;
  }
  auto begin = Clock::now();
  // After a rejected step its electrophysiology is kept: the halves find their window done.
  if (t + dt > me.ep_done_until + 1e-9) {
    me.monodomain->advance(t, dt);
    me.ep_done_until = t + dt;
  }
  me.next_calcium = me.rescaled_calcium();
  me.cost.electrophysiology_s += seconds_since(begin);
  begin = Clock::now();
  // Second order in calcium: its mean over the step.
  std::vector<double> mean(me.calcium.size());
  for (std::size_t k = 0; k < mean.size(); ++k) mean[k] = 0.5 * (me.calcium[k] + me.next_calcium[k]);
  me.activation->begin_step(dt, mean, me.stretch, me.stretch_before, me.last_dt);
  me.mechanics->set_tension(me.cell_tension());
  me.cost.activation_s += seconds_since(begin);
  me.mechanics->set_step(dt, me.last_dt);
  // First guess: the last velocity goes on.
  auto& d = me.mechanics->displacement();
  const auto &last = me.mechanics->last_displacement(), &before = me.mechanics->displacement_before_last();
  const double ratio = dt / me.last_dt;
  for (std::size_t k = 0; k < d.size(); ++k) d[k] = last[k] + ratio * (last[k] - before[k]);
  if (!(me.mechanics->smallest_volume_ratio(d).first > 0)) d = last;
  me.iteration = 0;
  me.balance_met = false;
  me.first_residual = -1;
}

void TissueWall::linearise(const double* pressures, double* volumes, double* dV_dp) {
  auto& me = *me_;
  const std::size_t m = me.n_cavities();
  std::vector<double> of_cavities(m);
  for (std::size_t k = 0; k < m; ++k) of_cavities[k] = pressures[k] * units::Pa_per_mmHg;
  me.pressures = me.loaded(std::move(of_cavities));
  // The tangent of the last step, or of the last iteration, is kept while the residual falls fast enough.
  const bool old_enough = !me.have_tangent || me.tangent_age >= me.plan.tangent_every;
  me.assemble(me.iteration == 0 && old_enough);
  if (me.first_residual < 0) me.first_residual = me.balance.residual;
  const double floor = 1e-9;  // N, of the sums' round-off
  me.balance_met = me.iteration > 0 &&
                   me.balance.residual <= std::max(floor, me.plan.residual_tolerance * me.first_residual);
  bool fresh = me.iteration == 0 && old_enough;
  if (!me.balance_met && me.iteration > 0) {
    if (me.iteration > 2 && me.balance.residual > 1e3 * me.first_residual)
      throw NumericalFailure(fmt::format(
          "walls.{}: Newton diverges, residual {:.3g} N after {} iterations; smallest J {:.3g} in {}",
          me.name, me.balance.residual, me.iteration, me.balance.smallest_J,
          me.mechanics->place_of_cell(me.balance.worst_cell)));
    const bool slow = me.balance.residual > 0.1 * me.last_residual;
    if (me.plan.tangent_every == 1 || slow) {
      me.assemble(true);
      fresh = true;
    }
  }
  me.last_residual = me.balance.residual;
  if (fresh) {
    me.solver->matrix_changed();
    me.rescued = false;
    me.have_tangent = true;
    me.tangent_age = 0;
  }
  if (me.balance_met) {
    std::fill(me.y.begin(), me.y.end(), 0.0);
  } else {
    std::vector<double> right = me.mechanics->residual();
    for (double& value : right) value = -value;
    me.y.assign(right.size(), 0.0);
    me.solve(right, me.y, me.plan.linear_tolerance);
  }
  // The response to the pressures changes little within a step: once is enough, what it misses is left to the
  // next iteration.
  if ((fresh && me.iteration == 0) || !me.have_compliance) {
    // They start from those of the last step, and need not be exact: volumes are measured, not predicted. Of
    // several cavities they are most of the systems, and looser ones save more than the iterations of Newton
    // they cost.
    const double tolerance = m > 1 ? std::min(0.1, 10 * me.plan.linear_tolerance) : me.plan.linear_tolerance;
    for (std::size_t l = 0; l < m; ++l) me.solve(me.mechanics->load(static_cast<int>(l)), me.Y[l], tolerance);
    me.have_compliance = true;
  }
  for (std::size_t k = 0; k < m; ++k) {
    const auto& b = me.mechanics->load(static_cast<int>(k));
    volumes[k] = (me.balance.volumes_m3[k] - me.mechanics->product(b, me.y)) / units::m3_per_mL;
    for (std::size_t l = 0; l < m; ++l) {
      if (!me.balance_met) me.compliance[m * k + l] = me.mechanics->product(b, me.Y[l]);
      dV_dp[m * k + l] = me.compliance[m * k + l] * units::Pa_per_mmHg / units::m3_per_mL;
    }
  }
  ++me.iteration;
}

double TissueWall::admissible_share(const double* pressure_change) {
  auto& me = *me_;
  me.step = me.y;
  for (std::size_t l = 0; l < me.n_cavities(); ++l) {
    const double dp = pressure_change[l] * units::Pa_per_mmHg;
    for (std::size_t k = 0; k < me.step.size(); ++k) me.step[k] -= me.Y[l][k] * dp;
  }
  // Own nodes move, ghosts follow.
  me.trial = me.mechanics->displacement();
  const std::vector<double>& from = me.mechanics->displacement();
  double share = 1;
  for (int halvings = 0;; ++halvings, share *= 0.5) {
    for (std::size_t k = 0; k < me.step.size(); ++k) me.trial[k] = from[k] + share * me.step[k];
    me.set_ghosts(me.trial);
    const auto [J, cell] = me.mechanics->smallest_volume_ratio(me.trial);
    if (J > 0) return share;
    ++me.cost.halvings;
    if (halvings == most_halvings)
      throw NumericalFailure(
          fmt::format("walls.{}: no step of Newton keeps all elements upright: J = {:.3g} in {}", me.name, J,
                      me.mechanics->place_of_cell(cell)));
  }
}

void TissueWall::update(const double*, double share) {
  auto& me = *me_;
  auto& d = me.mechanics->displacement();
  for (std::size_t k = 0; k < me.step.size(); ++k) d[k] += share * me.step[k];
  me.set_ghosts(d);
}

void TissueWall::confirm_step() {
  auto& me = *me_;
  me.mechanics->require_meaningful(me.balance);
  me.activation->require_in_range(me.vertex_stretch());
}

std::string TissueWall::trouble() const {
  const auto& me = *me_;
  return fmt::format("walls.{}: residual {:.3g} N, smallest J {:.3g} in {}.", me.name, me.balance.residual,
                     me.balance.smallest_J, me.mechanics->place_of_cell(me.balance.worst_cell));
}

bool TissueWall::balanced() const { return me_->balance_met; }
double TissueWall::volume_tolerance_mL() const { return 1e-6; }

void TissueWall::accept_step() {
  auto& me = *me_;
  me.mechanics->accept();
  me.stretch_before = me.stretch;
  auto begin = Clock::now();
  me.after_displacement_changed();
  me.cost.feedback_s += seconds_since(begin);
  begin = Clock::now();
  me.activation->accept(me.stretch);
  me.cost.activation_s += seconds_since(begin);
  me.calcium = me.next_calcium;
  me.last_dt = me.dt;
  me.repeated = false;
  ++me.cost.steps;
  ++me.tangent_age;
}

void TissueWall::reject_step() {
  auto& me = *me_;
  me.activation->reject();
  me.mechanics->displacement() = me.mechanics->last_displacement();
  me.have_tangent = me.have_compliance = false;
  me.repeated = true;
  ++me.cost.rejected;
}

void TissueWall::move_to(const double* volumes) {
  auto& me = *me_;
  // Quasi-static, with the tension there is; the velocity is lost.
  me.pressures = me.loaded({me.pressures.begin(), me.pressures.begin() + static_cast<long>(me.n_cavities())});
  me.bring_to_volumes(volumes, me.pressures);
  me.mechanics->accept();
  me.mechanics->accept();
  me.after_displacement_changed();
  me.stretch_before = me.stretch;
  me.have_tangent = me.have_compliance = false;
}

void TissueWall::save(std::vector<double>& out) const {
  const auto& me = *me_;
  for (const Point3& p : me.mesh->points) out.insert(out.end(), p.begin(), p.end());
  out.insert(out.end(), {me.last_dt, me.ep_done_until});
  out.insert(out.end(), me.pressures.begin(), me.pressures.begin() + static_cast<long>(me.n_cavities()));
  const NodeSpace& nodes = me.mechanics->nodes();
  for (const auto* d : {&me.mechanics->last_displacement(), &me.mechanics->displacement_before_last()}) {
    const auto all = me.partition->gather(nodes, d->data(), 3);
    out.insert(out.end(), all.begin(), all.end());
  }
  const NodeSpace& vertices = me.activation->nodes();
  for (const auto* values : {&me.stretch, &me.stretch_before}) {
    const auto all = me.partition->gather(vertices, values->data(), 1);
    out.insert(out.end(), all.begin(), all.end());
  }
  me.monodomain->save(out);
  me.activation->save(out);
}

void TissueWall::restore(std::span<const double>& in) {
  auto& me = *me_;
  const auto take = [&](std::size_t n) {
    if (in.size() < n) throw InputError("the saved state is damaged: it ends early");
    const auto part = in.first(n);
    in = in.subspan(n);
    return part;
  };
  const auto points = take(3 * me.image->points.size());
  auto mesh = std::make_shared<TetMesh>(*me.image);
  bool same = me.mesh != nullptr;
  for (std::size_t k = 0; k < mesh->points.size(); ++k) {
    for (int i = 0; i < 3; ++i) mesh->points[k][i] = points[3 * k + i];
    same = same && mesh->points[k] == me.mesh->points[k];
  }
  if (!same) me.set_up(std::move(mesh));
  me.last_dt = take_saved(in);
  me.ep_done_until = take_saved(in);
  const auto p = take(me.n_cavities());
  me.pressures = me.loaded({p.begin(), p.end()});
  const NodeSpace& nodes = me.mechanics->nodes();
  for (auto* d : {&me.mechanics->last_displacement(), &me.mechanics->displacement_before_last()})
    Partition::scatter(nodes, take(3 * static_cast<std::size_t>(nodes.n_global)), d->data(), 3);
  me.mechanics->displacement() = me.mechanics->last_displacement();
  const NodeSpace& vertices = me.activation->nodes();
  std::vector<double> stretch(vertices.n_local), stretch_before(vertices.n_local);
  Partition::scatter(vertices, take(vertices.n_global), stretch.data(), 1);
  Partition::scatter(vertices, take(vertices.n_global), stretch_before.data(), 1);
  me.monodomain->restore(in);
  me.activation->restore(in);
  if (me.plan.feedback) me.monodomain->set_deformation(me.mechanics->cell_deformation());
  me.stretch = stretch;
  me.stretch_before = stretch_before;
  me.calcium = me.rescaled_calcium();
  me.have_tangent = me.have_compliance = false;
  me.solver->forget();
  if (me.direct) me.direct->forget();
  // Warm starts of the solver are forgotten in a running wall, too, when it is saved and goes on.
  for (auto& Y : me.Y) std::fill(Y.begin(), Y.end(), 0.0);
}

std::vector<WallOutput> TissueWall::outputs() const {
  std::vector<WallOutput> list = {
      {"calcium", "uM", "mean calcium that the force model sees"},
      {"active_tension", "kPa", "mean active tension, rest tension removed, stabilising term included"},
      {"stretch", "1", "mean fibre stretch", smallest_stretch, largest_stretch},
      {"membrane_potential", "mV", "mean membrane potential"},
      {"smallest_volume_ratio", "1", "smallest J of all elements"}};
  for (std::size_t k = 0; k < me_->plan.electrodes.size(); ++k)
    list.push_back(
        {fmt::format("lead_{}", k + 1), "mV m^2/s", "pseudo-ECG at the electrode, no absolute scale"});
  if (me_->n_cavities() > 1)
    for (int chamber : me_->chambers) {
      const std::string_view name = chamber_names[chamber];
      list.push_back(
          {fmt::format("active_tension_{}", name), "kPa", "mean active tension of this chamber's wall"});
      list.push_back({fmt::format("stretch_{}", name), "1", "mean fibre stretch of this chamber's wall",
                      smallest_stretch, largest_stretch});
      list.push_back({fmt::format("smallest_volume_ratio_{}", name), "1",
                      "smallest J of the elements of this chamber's wall"});
      list.push_back({fmt::format("wall_volume_{}", name), "mL", "volume of this chamber's wall"});
    }
  if (me_->axis) {
    list.push_back({"base_motion", "mm", "of the left ventricle's base towards its apex, from the image"});
    list.push_back({"apex_motion", "mm", "of the left ventricle's apex towards its base, from the image"});
  }
  return list;
}

void TissueWall::output_values(double* values) const {
  auto& me = *me_;
  const NodeSpace& vertices = me.activation->nodes();
  double sums[5] = {};
  for (int k = 0; k < vertices.n_own; ++k) {
    sums[0] += me.calcium[k];
    sums[1] += me.activation->accepted_tension()[k] / units::Pa_per_kPa;
    sums[2] += me.stretch[k];
    sums[3] += me.monodomain->potential_mV()[me.ep_node[k]];
    sums[4] += 1;
  }
  double all[5];
  MPI_Allreduce(sums, all, 5, MPI_DOUBLE, MPI_SUM, me.communicator);
  for (int k = 0; k < 4; ++k) values[k] = all[k] / all[4];
  values[4] = me.mechanics->smallest_volume_ratio(me.mechanics->last_displacement()).first;
  for (std::size_t k = 0; k < me.plan.electrodes.size(); ++k)
    values[5 + k] = me.monodomain->lead(me.plan.electrodes[k]);
  values += 5 + me.plan.electrodes.size();
  if (me.n_cavities() > 1) {
    me.chamber_values(values);
    values += 4 * me.n_cavities();
  }
  if (me.axis) me.axis_values(values);
}

void TissueWall::open_fields(const std::string& folder, double resume_at_s) {
  auto& me = *me_;
  if (me.plan.fields_every_ms <= 0) return;
  me.fields_open = true;
  collectively(me.communicator, [&] {
    if (!me.first_rank) return;
    // A frame of the moment at which the run goes on is written anew.
    me.series = std::make_unique<FieldSeries>(
        folder + "." + me.name, *me.mesh,
        resume_at_s >= 0 ? std::optional<double>(resume_at_s - 1e-6) : std::nullopt);
  });
  const double every = me.plan.fields_every_ms * units::s_per_ms;
  me.next_fields_s = resume_at_s >= 0 ? std::ceil(resume_at_s / every - 1e-6) * every : -1;
}

void TissueWall::write_fields(double time_s) {
  auto& me = *me_;
  if (!me.fields_open || time_s < me.next_fields_s - 1e-9) return;
  const double every = me.plan.fields_every_ms * units::s_per_ms;
  me.next_fields_s = (std::floor(time_s / every + 1e-9) + 1) * every;
  const auto on_vertices = [&](const NodeSpace& space, const double* values, int components,
                               double elsewhere) {
    return me.partition->gather_at_vertices(space, values, components, elsewhere);
  };
  const NodeSpace &ep = me.monodomain->nodes(), &vertices = me.activation->nodes();
  const auto displacement =
      on_vertices(me.mechanics->nodes(), me.mechanics->last_displacement().data(), 3, 0);
  const auto potential = on_vertices(ep, me.monodomain->potential_mV(), 1, 0);
  const auto activation = on_vertices(ep, me.monodomain->activation_s().data(), 1, -1);
  const auto calcium = on_vertices(vertices, me.calcium.data(), 1, 0);
  const auto tension = on_vertices(vertices, me.activation->accepted_tension().data(), 1, 0);
  const auto stretch = on_vertices(vertices, me.stretch.data(), 1, 1);
  collectively(me.communicator, [&] {
    if (!me.first_rank) return;
    me.series->write(time_s, {{"displacement_m", 3, displacement},
                              {"potential_mV", 1, potential},
                              {"activation_s", 1, activation},
                              {"calcium_uM", 1, calcium},
                              {"active_tension_Pa", 1, tension},
                              {"fibre_stretch", 1, stretch}});
  });
}

void TissueWall::report(std::map<std::string, WallFigure>& figures) const {
  const auto& me = *me_;
  if (!me.mesh) return;
  const auto put = [&](const char* name, double value, const char* unit, const char* meaning) {
    figures[name] = {value, unit, meaning};
  };
  const MonodomainCost& ep = me.monodomain->cost();
  const double steps = static_cast<double>(std::max(1L, me.cost.steps));
  put("tetrahedra", static_cast<double>(me.mesh->cells.size()), "1", "of the mesh");
  put("ranks", me.partition->n_ranks(), "1", "MPI ranks");
  put("potential_nodes", me.monodomain->nodes().n_global, "1", "unknowns of electrophysiology");
  put("displacement_unknowns", 3.0 * me.mechanics->nodes().n_global, "1", "unknowns of mechanics");
  put("steps", steps, "1", "steps of mechanics");
  put("electrophysiology", me.cost.electrophysiology_s, "s", "wall time of electrophysiology");
  put("electrophysiology_ionic", ep.ionic_s, "s", "of it ionic cells");
  put("electrophysiology_solve", ep.solve_s, "s", "of it linear systems");
  put("electrophysiology_right_side", ep.right_side_s, "s", "of it right-hand sides");
  put("electrophysiology_assembly", ep.assembly_s, "s", "of it matrices of the deformed tissue");
  put("electrophysiology_steps", static_cast<double>(ep.steps), "1", "steps of electrophysiology");
  put("electrophysiology_iterations", static_cast<double>(ep.iterations), "1", "of its linear solver");
  put("active_force", me.cost.activation_s, "s", "wall time of the force model");
  put("mechanics_assembly", me.cost.assembly_s, "s", "wall time of residuals and tangents");
  put("mechanics_solve", me.cost.solve_s, "s", "wall time of linear systems, preconditioners included");
  put("deformation", me.cost.feedback_s, "s", "wall time of stretches and deformed conductivities");
  put("tangents", static_cast<double>(me.cost.tangents), "1", "assemblies with tangent");
  put("residuals", static_cast<double>(me.cost.residuals), "1", "assemblies of the residual alone");
  put("solves", static_cast<double>(me.cost.solves), "1", "linear systems of mechanics");
  put("solver_iterations", static_cast<double>(me.cost.solver_iterations), "1",
      "of the linear solver of mechanics");
  put("direct_solves", static_cast<double>(me.cost.rescues), "1",
      "linear systems that the iterative solver did not solve");
  put("rejected_steps", static_cast<double>(me.cost.rejected), "1", "steps repeated in halves");
  put("halved_updates", static_cast<double>(me.cost.halvings), "1", "Newton updates cut back for J > 0");
  if (me.recovery.fixed_point_iterations > 0)
    put("reference_volume_ratio", me.recovery.smallest_volume_ratio, "1", "smallest, reference over image");
  if (me.recovery.fixed_point_iterations > 0)
    put("reference_smallest_angle", me.recovery.smallest_dihedral_deg, "deg",
        "smallest dihedral angle of the reference");
}

}  // namespace wiggers
