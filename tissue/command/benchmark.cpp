// `wiggers benchmark NAME`: a published verification problem at a chosen discretisation, with its reference.
#include <fmt/core.h>
#include <fmt/format.h>

#include <wiggers/core/errors.hpp>
#include <wiggers/tissue/verification/benchmarks.hpp>

#include "verbs.hpp"

namespace wiggers::command {

namespace {

using namespace wiggers::benchmarks;

// Mean and standard deviation of the eleven codes at dx = 0.1 mm, dt = 0.01 ms.
constexpr double published_ms[9][2] = {{1.04, 0.38},  {32.23, 0.56}, {8.95, 0.56},
                                       {33.70, 1.00}, {29.76, 1.65}, {43.97, 2.83},
                                       {31.32, 2.12}, {44.93, 3.22}, {20.50, 1.30}};

struct Options {
  SlabSettings slab;
  BeamSettings beam;
  EllipsoidSettings ellipsoid;
  SphereSettings sphere;
};

bool first_rank() {
  int rank = 0;
  MPI_Comm_rank(MPI_COMM_WORLD, &rank);
  return rank == 0;
}

void run_slab(const SlabSettings& s) {
  const SlabResult r = slab(s, MPI_COMM_WORLD);
  if (!first_rank()) return;
  fmt::print("slab: P{}{}, dx {} mm, dt {} ms, {} tetrahedra, {} nodes\n", s.order, s.svi ? " SVI" : "",
             s.dx_mm, s.dt_ms, r.n_tetrahedra, r.n_nodes);
  fmt::print("{:>6} {:>18} {:>12} {:>16} {:>8}\n", "probe", "position mm", "activated ms", "eleven codes ms",
             "sd off");
  for (int k = 0; k < SlabResult::n_probes; ++k) {
    const Point3& p = slab_probes_mm[k];
    const bool activated = r.activation_ms[k] >= 0;
    const double off = (r.activation_ms[k] - published_ms[k][0]) / published_ms[k][1];
    fmt::print("{:>6} {:>18} {:>12} {:>9.2f} +- {:.2f} {:>8}\n", fmt::format("P{}", k + 1),
               fmt::format("({:g}, {:g}, {:g})", p[0], p[1], p[2]),
               activated ? fmt::format("{:.2f}", r.activation_ms[k]) : "never", published_ms[k][0],
               published_ms[k][1], activated ? fmt::format("{:.1f}", off) : "-");
  }
  const double steps = static_cast<double>(r.cost.steps);
  fmt::print("a step: {:.2f} ms ionic, {:.2f} ms right-hand side, {:.2f} ms solve ({:.1f} iterations)\n",
             1e3 * r.cost.ionic_s / steps, 1e3 * r.cost.right_side_s / steps, 1e3 * r.cost.solve_s / steps,
             static_cast<double>(r.cost.iterations) / steps);
}

void print_report(const EquilibriumReport& report, double seconds) {
  fmt::print("{} load steps, {} failed, {} Newton iterations, smallest J {:.3f}, {:.1f} s\n",
             report.load_steps, report.failed_steps, report.newton_iterations, report.smallest_J, seconds);
}

std::string element(int order, bool mean_dilatation) {
  return fmt::format("P{}{}", order, mean_dilatation ? "/P0" : "");
}

void run_beam(const BeamSettings& s) {
  const BeamResult r = beam(s, MPI_COMM_WORLD);
  if (!first_rank()) return;
  fmt::print("beam: {}, {} x {} x {} bricks, grading {}, B {} kPa, {} tetrahedra\n",
             element(s.order, s.mean_dilatation), s.bricks[0], s.bricks[1], s.bricks[2], s.grading,
             s.bulk_kPa, r.n_tetrahedra);
  fmt::print("(10, 0.5, 1) -> x {:.4f}, z {:.4f} mm; incompressible 9.1765, 4.1695 ({:+.2f} % in z)\n",
             r.tip_mm[0], r.tip_mm[2], 100 * (r.tip_mm[2] / 4.1695 - 1));
  print_report(r.report, r.seconds);
}

void run_ellipsoid(const EllipsoidSettings& s) {
  const EllipsoidResult r = ellipsoid(s, MPI_COMM_WORLD);
  if (!first_rank()) return;
  fmt::print("ellipsoid: {}, {} mm, apex {} mm, B {} kPa, {} tetrahedra{}\n",
             element(s.order, s.mean_dilatation), s.size_mm, s.apex_size_mm, s.bulk_kPa, r.n_tetrahedra,
             s.quarter ? " (a quarter)" : "");
  fmt::print("apices z {:.3f} and {:.3f} mm; incompressible -26.612 ({:+.2f} %) and -28.280 ({:+.2f} %)\n",
             r.endo_z_mm, r.epi_z_mm, 100 * (r.endo_z_mm / -26.612 - 1), 100 * (r.epi_z_mm / -28.280 - 1));
  fmt::print(
      "cavity {:.1f} -> {:.1f} mm3 (2492.1 -> 10734.3), wall volume ratio {:.5f}, {}monotone in pressure\n",
      r.cavity_before_mm3, r.cavity_mm3, r.wall_ratio, r.monotone ? "" : "not ");
  print_report(r.report, r.seconds);
}

void run_sphere(const SphereSettings& s) {
  const SphereResult r = sphere(s, MPI_COMM_WORLD);
  if (!first_rank()) return;
  fmt::print("sphere: {}, {} mm, B {} kPa, {} tetrahedra ({}), {}\n", element(s.order, s.mean_dilatation),
             s.size_mm, s.bulk_kPa, r.n_tetrahedra, s.project_coefficients ? "the whole" : "an eighth",
             s.project_coefficients ? "helix +60 to -60 degrees, coefficients 8 6 3 12 3 3"
                                    : "helix-independent law");
  constexpr double incompressible[] = {113.5527, 141.9279, 174.2699};
  constexpr double at_50[] = {114.0317, 142.5032, 174.9138}, at_1000[] = {113.5774, 141.9576, 174.3031};
  fmt::print("{:>8} {:>10} {:>24} {:>18} {:>12} {:>10}\n", "p kPa", "V mL", "reduced wall mL", "reference mL",
             "wall ratio", "round %");
  for (int k = 0; k < 3; ++k) {
    const double reference = s.bulk_kPa == 50     ? at_50[k]
                             : s.bulk_kPa == 1000 ? at_1000[k]
                                                  : incompressible[k];
    fmt::print("{:>8} {:>10.4f} {:>12.4f} ({:+.3f} %) {:>18} {:>12.5f} {:>10.3f}\n", r.pressure_kPa[k],
               r.volume_mL[k], incompressible[k], 100 * (r.volume_mL[k] / incompressible[k] - 1),
               s.project_coefficients
                   ? std::string("-")
                   : fmt::format("{:.4f} ({:+.3f} %)", reference, 100 * (r.volume_mL[k] / reference - 1)),
               r.wall_ratio[k], 100 * r.radius_spread[k]);
  }
  fmt::print("{:.1f} s\n", r.seconds);
}

}  // namespace

void add_benchmark(CLI::App& app) {
  auto* verb = app.add_subcommand("benchmark", "a published verification problem of the 3D tissue");
  verb->require_subcommand(1);
  const auto options = std::make_shared<Options>();

  auto* slab_verb = verb->add_subcommand("slab", "monodomain slab (Niederer et al. 2011)");
  slab_verb->add_option("--dx-mm", options->slab.dx_mm, "spacing of the mesh, mm")
      ->capture_default_str()
      ->check(CLI::Range(0.05, 3.0));
  slab_verb->add_option("--dt-ms", options->slab.dt_ms, "step, ms")
      ->capture_default_str()
      ->check(CLI::Range(1e-3, 0.2));
  slab_verb->add_option("--order", options->slab.order, "1 or 2")
      ->capture_default_str()
      ->check(CLI::Range(1, 2));
  slab_verb->add_flag("--svi", options->slab.svi,
                      "states interpolated to quadrature points, not currents (slow)");
  slab_verb
      ->add_option("--table-mV", options->slab.table_spacing_mV, "spacing of the ionic tables, mV; 0: none")
      ->capture_default_str();
  slab_verb->add_option("--end-ms", options->slab.end_ms, "give up then, ms")
      ->capture_default_str()
      ->check(CLI::Range(1.0, 1e4));
  slab_verb->callback([options] { run_slab(options->slab); });

  const auto add_element = [](CLI::App* sub, auto& s) {
    sub->add_option("--order", s.order, "of the displacement, 1 or 2")
        ->capture_default_str()
        ->check(CLI::Range(1, 2));
    sub->add_flag("--mean-dilatation", s.mean_dilatation,
                  "two-field: volume ratio averaged over each element");
    sub->add_option("--bulk-kPa", s.bulk_kPa, "bulk modulus of the penalty, kPa")
        ->capture_default_str()
        ->check(CLI::PositiveNumber);
    sub->add_option("--quadrature", s.quadrature_degree,
                    "degree; 0: 1 for P1, 2 for P2, 5 with mean dilatation")
        ->capture_default_str()
        ->check(CLI::Range(0, 5));
  };
  auto* beam_verb = verb->add_subcommand("beam", "bending beam (Land et al. 2015, problem 1)");
  beam_verb->add_option("--bricks", options->beam.bricks, "bricks of six tetrahedra along x, y, z")
      ->capture_default_str();
  beam_verb->add_option("--grading", options->beam.grading, "spacing at the free end over that at the clamp")
      ->capture_default_str();
  add_element(beam_verb, options->beam);
  beam_verb->callback([options] { run_beam(options->beam); });

  auto* ellipsoid_verb =
      verb->add_subcommand("ellipsoid", "inflated ellipsoid (Land et al. 2015, problem 2)");
  ellipsoid_verb->add_option("--size-mm", options->ellipsoid.size_mm, "edge length, mm")
      ->capture_default_str();
  ellipsoid_verb->add_option("--apex-mm", options->ellipsoid.apex_size_mm, "edge length at the apices, mm")
      ->capture_default_str();
  ellipsoid_verb->add_flag("!--whole", options->ellipsoid.quarter,
                           "the whole body, not a quarter with symmetry");
  ellipsoid_verb->add_flag("!--straight", options->ellipsoid.curved,
                           "edges of quadratic tetrahedra straight, not on the surface");
  add_element(ellipsoid_verb, options->ellipsoid);
  ellipsoid_verb->callback([options] { run_ellipsoid(options->ellipsoid); });

  auto* sphere_verb = verb->add_subcommand("sphere", "thick sphere: reduced wall against the 3D law");
  sphere_verb->add_option("--size-mm", options->sphere.size_mm, "edge length, mm")->capture_default_str();
  sphere_verb->add_flag(
      "--project-coefficients", options->sphere.project_coefficients,
      "the project's own coefficients, helix +60 to -60 degrees: the reduced wall's modelling error");
  sphere_verb->add_flag("!--straight", options->sphere.curved,
                        "edges of quadratic tetrahedra straight, not on the surface");
  add_element(sphere_verb, options->sphere);
  sphere_verb->callback([options] { run_sphere(options->sphere); });
}

}  // namespace wiggers::command
