#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <wiggers/cellmodels/catalogue/catalogue.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/stopwatch.hpp>
#include <wiggers/core/units.hpp>
#include <wiggers/tissue/mesh/make.hpp>
#include <wiggers/tissue/mesh/shapes.hpp>
#include <wiggers/tissue/parallel/collective.hpp>
#include <wiggers/tissue/parallel/mesh_broadcast.hpp>
#include <wiggers/tissue/verification/benchmarks.hpp>

namespace wiggers::benchmarks {

namespace {

// Values of the nodes nearest to points, on every rank.
std::vector<double> values_at(const Partition& partition, const NodeSpace& space, const double* values,
                              int components, const std::vector<Point3>& points) {
  std::vector<double> found;
  for (const Point3& point : points) {
    double nearest = std::numeric_limits<double>::infinity();
    int node = -1;
    for (int k = 0; k < space.n_own; ++k)
      if (const double distance = norm(space.points[k] - point); distance < nearest) {
        nearest = distance;
        node = k;
      }
    const double best = partition.smallest(nearest);
    // Two ranks may both own a node at this distance: the lowest answers.
    const double owner = partition.smallest(nearest == best ? partition.rank() : partition.n_ranks());
    for (int c = 0; c < components; ++c)
      found.push_back(partition.sum(partition.rank() == owner ? values[node * components + c] : 0.0));
  }
  return found;
}

// The same mesh on all ranks, made by one.
std::shared_ptr<const TetMesh> made_once(MPI_Comm communicator, const std::function<TetMesh()>& make) {
  int rank = 0;
  MPI_Comm_rank(communicator, &rank);
  auto mesh = std::make_shared<TetMesh>();
  collectively(communicator, [&] {
    if (rank == 0) *mesh = make();
  });
  broadcast_mesh(*mesh, communicator);
  return mesh;
}

// The benchmarks' loads are large from the start: small first steps.
EquilibriumSettings small_steps(const NodeSpace& space) {
  EquilibriumSettings settings = static_settings(space);
  settings.first_step = 0.02;
  return settings;
}

}  // namespace

const std::array<Point3, SlabResult::n_probes> slab_probes_mm = {{{0, 0, 0},
                                                                  {20, 0, 0},
                                                                  {0, 0, 3},
                                                                  {20, 0, 3},
                                                                  {0, 7, 0},
                                                                  {20, 7, 0},
                                                                  {0, 7, 3},
                                                                  {20, 7, 3},
                                                                  {10, 3.5, 1.5}}};

SlabResult slab(const SlabSettings& settings, MPI_Comm communicator) {
  const std::array<double, 3> lengths_mm = {20, 7, 3};
  std::array<std::vector<double>, 3> coordinates;
  for (int k = 0; k < 3; ++k)
    coordinates[k] = uniform(1e-3 * lengths_mm[k],
                             std::max(1, static_cast<int>(std::lround(lengths_mm[k] / settings.dx_mm))));
  const auto mesh = std::make_shared<const TetMesh>(box_mesh(coordinates));
  const Partition partition(mesh, communicator);

  const CellModel& model = find_model("ttp06-epi");
  IonicRegion region;
  region.tags = {mesh_tags::ventricles};
  region.model = &model;
  region.parameters = model.parameter_values("default");
  region.initial_state = model.default_state();
  // The benchmark's own initial state.
  const std::vector<std::pair<std::string_view, double>> initial = {
      {"V", -85.23},     {"Xr1", 0.00621},   {"Xr2", 0.4712}, {"Xs", 0.0095},     {"m", 0.00172},
      {"h", 0.7444},     {"j", 0.7045},      {"d", 3.373e-5}, {"f", 0.7888},      {"f2", 0.9755},
      {"fCass", 0.9953}, {"s", 0.999998},    {"r", 2.42e-8},  {"Ca_i", 0.000126}, {"R_prime", 0.9073},
      {"Ca_SR", 3.64},   {"Ca_ss", 0.00036}, {"Na_i", 8.604}, {"K_i", 136.89}};
  for (const auto& [name, value] : initial)
    region.initial_state[require_index(model.states, "state", name)] = value;
  // Harmonic means of intra- and extracellular conductivity over chi C_m; 1 mm^2/ms = 1e-3 m^2/s.
  const auto harmonic = [](double inside, double outside) { return inside * outside / (inside + outside); };
  const double chi_per_m = 1400e2, C_F_per_m2 = 1e-2;
  const double along = harmonic(0.17, 0.62) / (chi_per_m * C_F_per_m2);
  const double across = harmonic(0.019, 0.24) / (chi_per_m * C_F_per_m2);
  region.conductivity = {along, across, across};

  Stimulus stimulus;
  stimulus.shape = Stimulus::Shape::box;
  stimulus.corner = {1.5e-3, 1.5e-3, 1.5e-3};
  stimulus.duration_s = 2e-3;
  stimulus.amplitude_V_per_s = 50000e-6 * 1e6 / (chi_per_m * C_F_per_m2);  // 50000 uA/cm^3 over chi C_m

  MonodomainSettings numerics;
  numerics.order = settings.order;
  if (settings.svi) numerics.currents = IonicCurrents::at_quadrature_points;
  numerics.tau_s = settings.dt_ms * 1e-3;
  numerics.table_spacing_mV = settings.table_spacing_mV;
  numerics.solver = settings.solver;
  numerics.activation_threshold_mV = 0;
  Monodomain monodomain(partition, nullptr, numerics, {region}, {stimulus});

  SlabResult result;
  result.n_tetrahedra = mesh->cells.size();
  result.n_nodes = monodomain.nodes().n_global;
  std::vector<Point3> probes;
  for (const Point3& p : slab_probes_mm) probes.push_back(1e-3 * p);
  for (double t_ms = 0; t_ms < settings.end_ms - 1e-9; t_ms += 1) {
    monodomain.advance(1e-3 * t_ms, 1e-3);
    const auto times = values_at(partition, monodomain.nodes(), monodomain.activation_s().data(), 1, probes);
    bool all = true;
    for (int k = 0; k < SlabResult::n_probes; ++k) {
      result.activation_ms[k] = times[k] < 0 ? -1 : 1e3 * times[k];
      all = all && times[k] >= 0;
    }
    if (all) break;
  }
  result.cost = monodomain.cost();
  return result;
}

BeamResult beam(const BeamSettings& settings, MPI_Comm communicator) {
  const auto begin = Clock::now();
  const auto mesh = std::make_shared<const TetMesh>(box_mesh(
      {graded(10e-3, settings.bricks[0], settings.grading, 1), uniform(1e-3, settings.bricks[1]),
       settings.grading > 1
           ? graded(1e-3, settings.bricks[2], std::sqrt(settings.grading), std::sqrt(settings.grading))
           : uniform(1e-3, settings.bricks[2])}));
  const Partition partition(mesh, communicator);
  MechanicsSettings mechanics_settings;
  mechanics_settings.order = settings.order;
  mechanics_settings.mean_dilatation = settings.mean_dilatation;
  mechanics_settings.quadrature_degree = settings.quadrature_degree;
  mechanics_settings.materials = {{1, UsykLaw3::guccione(2e3, 8, 2, 4), 1e3 * settings.bulk_kPa}};
  Support clamp;
  clamp.tag = 1;  // x = 0
  clamp.fixed = {true, true, true};
  mechanics_settings.supports = {clamp};
  mechanics_settings.surfaces = {{5, {}}};  // z = 0
  Mechanics mechanics(partition, nullptr, mechanics_settings);
  BeamResult result;
  result.n_tetrahedra = mesh->cells.size();
  result.report = find_equilibrium(
      mechanics, [](double s) { return std::vector<double>{4.0 * s}; }, small_steps(mechanics.nodes()));
  const std::vector<Point3> at = {{10e-3, 0.5e-3, 1e-3}, {10e-3, 0.5e-3, 0.5e-3}};
  const auto moved = values_at(partition, mechanics.nodes(), mechanics.displacement().data(), 3, at);
  for (int i = 0; i < 3; ++i) {
    result.tip_mm[i] = 1e3 * (at[0][i] + moved[i]);
    result.centre_mm[i] = 1e3 * (at[1][i] + moved[3 + i]);
  }
  result.seconds = seconds_since(begin);
  return result;
}

EllipsoidResult ellipsoid(const EllipsoidSettings& settings, MPI_Comm communicator) {
  const auto begin = Clock::now();
  const auto mesh = made_once(communicator, [&] {
    return make_benchmark_ellipsoid(settings.size_mm, settings.apex_size_mm, settings.quarter);
  });
  const Partition partition(mesh, communicator);
  MechanicsSettings mechanics_settings;
  mechanics_settings.order = settings.order;
  mechanics_settings.mean_dilatation = settings.mean_dilatation;
  mechanics_settings.quadrature_degree = settings.quadrature_degree;
  mechanics_settings.materials = {{1, UsykLaw3::guccione(10e3, 1, 1, 1), 1e3 * settings.bulk_kPa}};
  Support base;
  base.tag = 40;
  base.fixed = {true, true, true};
  mechanics_settings.supports = {base};
  if (settings.quarter)
    for (int k = 0; k < 2; ++k) {
      Support plane;
      plane.tag = 41 + k;
      plane.fixed[k] = true;
      mechanics_settings.supports.push_back(plane);
    }
  if (settings.curved)
    mechanics_settings.curve = [](int tag, const Point3& p) -> Point3 {
      if (tag != 24 && tag != 31) return p;
      const double width = tag == 24 ? 7e-3 : 10e-3, length = tag == 24 ? 17e-3 : 20e-3;
      const double z = p[2] / length, r = std::hypot(p[0], p[1]);
      // Along the circle in its plane, but towards the centre near the apex, where there is no such circle.
      if (r > 0.5 * width)
        return {p[0] * width * std::sqrt(1 - z * z) / r, p[1] * width * std::sqrt(1 - z * z) / r, p[2]};
      return (1 / std::sqrt(r * r / (width * width) + z * z)) * p;
    };
  // With the origin in the base plane neither it nor the planes of symmetry add to the cavity's volume. The
  // outside is a surface without pressure, for the volume of the wall.
  mechanics_settings.surfaces = {{24, {0, 0, 5e-3}}, {31, {0, 0, 5e-3}}};
  Mechanics mechanics(partition, nullptr, mechanics_settings);
  EllipsoidResult result;
  result.n_tetrahedra = mesh->cells.size();
  const double pieces = settings.quarter ? 4 : 1;
  const auto before = mechanics.assemble(std::vector<double>{0, 0}, false).volumes_m3;
  double last = before[0];
  result.report = find_equilibrium(
      mechanics,
      [](double s) {
        return std::vector<double>{10e3 * s, 0};
      },
      small_steps(mechanics.nodes()), {},
      [&](double s) {
        const double now = mechanics.assemble(std::vector<double>{10e3 * s, 0}, false).volumes_m3[0];
        result.monotone = result.monotone && now > last;
        last = now;
      });
  const auto after = mechanics.assemble(std::vector<double>{10e3, 0}, false).volumes_m3;
  result.cavity_before_mm3 = pieces * 1e9 * before[0];
  result.cavity_mm3 = pieces * 1e9 * after[0];
  result.wall_ratio = (after[0] + after[1]) / (before[0] + before[1]);
  const std::vector<Point3> apices = {{0, 0, -17e-3}, {0, 0, -20e-3}};
  const auto moved = values_at(partition, mechanics.nodes(), mechanics.displacement().data(), 3, apices);
  result.endo_z_mm = 1e3 * (apices[0][2] + moved[2]);
  result.epi_z_mm = 1e3 * (apices[1][2] + moved[5]);
  result.seconds = seconds_since(begin);
  return result;
}

SphereResult sphere(const SphereSettings& settings, MPI_Comm communicator) {
  const auto begin = Clock::now();
  const double inner_mm = 27.27575, outer_mm = 37.16350;
  const auto mesh = made_once(communicator, [&] {
    return settings.project_coefficients ? make_sphere(inner_mm, outer_mm, settings.size_mm)
                                         : make_sphere_octant(inner_mm, outer_mm, settings.size_mm);
  });
  const Partition partition(mesh, communicator);
  // Frames: s along the radius; fibre and normal tangential, the helix about the z axis.
  FibreField fibres;
  fibres.frames.resize(mesh->points.size());
  fibres.axes.resize(mesh->points.size());
  fibres.alpha_deg.resize(mesh->points.size());
  fibres.beta_deg.resize(mesh->points.size());
  for (std::size_t k = 0; k < mesh->points.size(); ++k) {
    const Point3& p = mesh->points[k];
    const double radius = norm(p);
    const Vector3 s = (1 / radius) * p;
    Vector3 around = cross({0, 0, 1}, s);
    const double length = norm(around);
    around = length > 1e-9 ? (1 / length) * around : Vector3{0, 1, 0};
    const Vector3 up = cross(s, around);
    const double depth = (radius - 1e-3 * inner_mm) / (1e-3 * (outer_mm - inner_mm));
    const double angle = settings.project_coefficients ? 60 - 120 * depth : 0;
    fibres.axes[k] = {around, up, s};
    fibres.alpha_deg[k] = angle;
    fibres.frames[k] = turned_frame(fibres.axes[k], angle, 0);
  }
  MechanicsSettings mechanics_settings;
  mechanics_settings.order = settings.order;
  mechanics_settings.mean_dilatation = settings.mean_dilatation;
  mechanics_settings.quadrature_degree = settings.quadrature_degree;
  const UsykLaw3 law = settings.project_coefficients ? UsykLaw3::from(880, 8, 6, 3, 12, 3, 3)
                                                     : UsykLaw3::from(880, 5.5, 6, 5.5, 7.5, 5.5, 7.5);
  mechanics_settings.materials = {{1, law, 1e3 * settings.bulk_kPa}};
  // A helix has no plane of symmetry: the whole sphere twists as it will, held by springs too soft to be
  // felt.
  const double pieces = settings.project_coefficients ? 1 : 8;
  if (settings.project_coefficients) {
    Support weak;
    weak.tag = 31;
    weak.full_stiffness = 1;
    mechanics_settings.supports.push_back(weak);
  }
  for (int k = 0; k < 3 && !settings.project_coefficients; ++k) {
    Support plane;
    plane.tag = 41 + k;
    plane.fixed[k] = true;
    mechanics_settings.supports.push_back(plane);
  }
  mechanics_settings.surfaces = {{24, {}}, {31, {}}};
  if (settings.curved)
    mechanics_settings.curve = [&](int tag, const Point3& p) -> Point3 {
      if (tag != 24 && tag != 31) return p;
      return (1e-3 * (tag == 24 ? inner_mm : outer_mm) / norm(p)) * p;
    };
  Mechanics mechanics(partition, &fibres, mechanics_settings);
  SphereResult result;
  result.n_tetrahedra = mesh->cells.size();
  const auto before = mechanics.assemble(std::vector<double>{0, 0}, false).volumes_m3;
  double pressure = 0;
  for (int k = 0; k < 3; ++k) {
    const double from = pressure, to = 1e3 * result.pressure_kPa[k];
    find_equilibrium(
        mechanics,
        [&](double s) {
          return std::vector<double>{from + s * (to - from), 0};
        },
        small_steps(mechanics.nodes()));
    pressure = to;
    const auto volumes = mechanics.assemble(std::vector<double>{pressure, 0}, false).volumes_m3;
    result.volume_mL[k] = pieces * volumes[0] / units::m3_per_mL;
    result.wall_ratio[k] = (volumes[0] + volumes[1]) / (before[0] + before[1]);
    double smallest = std::numeric_limits<double>::infinity(), largest = 0;
    const NodeSpace& space = mechanics.nodes();
    for (int node = 0; node < space.n_own; ++node) {
      if (space.vertex[node] < 0 || std::abs(norm(space.points[node]) - 1e-3 * inner_mm) > 1e-7) continue;
      Vector3 x = space.points[node];
      for (int i = 0; i < 3; ++i) x[i] += mechanics.displacement()[3 * static_cast<std::size_t>(node) + i];
      smallest = std::min(smallest, norm(x));
      largest = std::max(largest, norm(x));
    }
    smallest = partition.smallest(smallest);
    largest = partition.largest(largest);
    result.radius_spread[k] = (largest - smallest) / (0.5 * (largest + smallest));
  }
  result.seconds = seconds_since(begin);
  return result;
}

}  // namespace wiggers::benchmarks
