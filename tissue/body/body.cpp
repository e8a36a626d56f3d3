#include <fmt/core.h>
#include <fmt/format.h>

#include <algorithm>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/units.hpp>
#include <wiggers/heart/scene/tissue_services.hpp>
#include <wiggers/heart/walls/cell_source.hpp>
#include <wiggers/tissue/body/body.hpp>
#include <wiggers/tissue/mesh/check.hpp>
#include <wiggers/tissue/mesh/geometry.hpp>
#include <wiggers/tissue/mesh/make.hpp>
#include <wiggers/tissue/mesh/read.hpp>
#include <wiggers/tissue/parallel/collective.hpp>
#include <wiggers/tissue/parallel/mesh_broadcast.hpp>

namespace wiggers {

namespace {

bool contains(const std::vector<int>& tags, int tag) {
  return std::find(tags.begin(), tags.end(), tag) != tags.end();
}

}  // namespace

int endocardium_of(int chamber) {
  switch (chamber) {
    case LA:
      return mesh_tags::endocardium_LA;
    case LV:
      return mesh_tags::endocardium_LV;
    case RA:
      return mesh_tags::endocardium_RA;
    default:
      return mesh_tags::endocardium_RV;
  }
}

std::shared_ptr<const TetMesh> make_mesh(const TissuePlan& plan, const std::vector<int>& chambers,
                                         const std::string& place, MPI_Comm communicator) {
  int rank = 0;
  MPI_Comm_rank(communicator, &rank);
  auto mesh = std::make_shared<TetMesh>();
  collectively(communicator, [&] {
    if (rank != 0) return;
    const auto shape_of = [&](auto defaults) {
      std::copy(plan.shape_values.begin(), plan.shape_values.end(), defaults.begin());
      return defaults;
    };
    // What the reader had to assume or mend is said: a wrong unit shows in the extent.
    std::vector<std::string> notes;
    if (!plan.mesh_file.empty())
      *mesh = read_mesh(plan.mesh_file, mesh_unit(plan.mesh_unit), &notes);
    else if (plan.shape == "ellipsoid")
      *mesh = make_ellipsoid(plan.size_mm, shape_of(EllipsoidShape{}));
    else if (plan.shape == "biventricular")
      *mesh = make_biventricular(plan.size_mm, shape_of(BiventricularShape{}));
    else
      *mesh = make_heart(plan.size_mm, shape_of(HeartShape{}));
    std::vector<int> closed;
    for (int chamber : chambers) closed.push_back(endocardium_of(chamber));
    const std::string& name = plan.mesh_file.empty() ? place : plan.mesh_file;
    for (const std::string& warning : require_sound(*mesh, closed, name)) notes.push_back(warning);
    if (tissue_services().quiet) return;
    for (const std::string& note : notes) fmt::print("note: {}: {}\n", name, note);
  });
  broadcast_mesh(*mesh, communicator);
  return mesh;
}

void place_stimuli(TissuePlan& plan, const TetMesh& mesh, const std::string& place, MPI_Comm communicator) {
  int rank = 0;
  MPI_Comm_rank(communicator, &rank);
  for (std::size_t k = 0; k < plan.stimuli.size(); ++k) {
    if (!plan.sites[k]) continue;
    try {
      plan.stimuli[k].centre = find_site(mesh, *plan.sites[k]);
    } catch (const InputError& error) {
      throw InputError(fmt::format("{}.stimuli: {}", place, error.what()));
    }
    if (rank == 0 && !tissue_services().quiet)
      fmt::print("note: {}: stimulus {} at {}\n", place, k + 1, place_text(plan.stimuli[k].centre));
  }
}

FibreField make_fibres(const TissuePlan& plan, const TetMesh& mesh) {
  return plan.fibres_from_file ? fibres_from_cells(mesh) : rule_based_fibres(mesh, plan.fibres);
}

void say_of_locking(const TissuePlan& plan, const std::string& place, MPI_Comm communicator) {
  int rank = 0;
  MPI_Comm_rank(communicator, &rank);
  const std::string warning = locking_warning(plan.mechanics);
  if (!warning.empty() && !tissue_services().quiet && rank == 0)
    fmt::print("warning: {}: {}\n", place, warning);
}

void say_of_fibres(const TissuePlan& plan, const TetMesh& mesh, const FibreField& fibres,
                   const std::string& place, MPI_Comm communicator) {
  int rank = 0;
  MPI_Comm_rank(communicator, &rank);
  if (!plan.fibres_from_file || tissue_services().quiet || rank != 0) return;
  if (const AmbiguousTurns turns = ambiguous_turns(mesh, fibres); turns.cells > 0)
    fmt::print("ERROR: {}: {}\n", place, turns_text(mesh, turns));
}

std::vector<IonicRegion> ionic_regions(const Scene& scene, const WallPlan& wall, const TetMesh& mesh,
                                       const std::map<std::string, PacedCellType>& cells,
                                       const std::string& place) {
  const TissuePlan& plan = tissue_plan(wall);
  const double period_ms = scene.period_s * units::ms_per_s;
  std::vector<IonicRegion> regions;
  for (std::size_t r = 0; r < wall.fibres.size(); ++r) {
    const FibrePlan& fibre = wall.fibres[r];
    const bool atrial = wall.fibres.size() == 2 && r == 1;
    IonicRegion region;
    for (int tag : atrial ? std::vector<int>{mesh_tags::left_atrium, mesh_tags::right_atrium}
                          : std::vector<int>{mesh_tags::ventricles})
      if (contains(mesh.cell_tags, tag)) region.tags.push_back(tag);
    if (region.tags.empty())
      throw InputError(fmt::format("{}: the mesh has no tissue for cells {}", place, fibre.cells));
    const CellType& type = scene.cells.at(fibre.cells);
    if (!type.ionic)
      throw InputError(fmt::format("{}: tissue needs an ionic model; cells {} are a prescribed transient",
                                   place, fibre.cells));
    region.model = type.ionic;
    region.parameters = type.ionic_parameters;
    region.initial_state = type.ionic->default_state();
    if (const auto paced = cells.find(fibre.cells); paced != cells.end()) {
      // All cells start where their cycle is at the beat's start, the first stimulus being its onset.
      double onset_ms = fibre.activation_ms;
      if (onset_ms == 0) {
        onset_ms = plan.stimuli.front().start_s * units::ms_per_s;
        for (const Stimulus& s : plan.stimuli) onset_ms = std::min(onset_ms, s.start_s * units::ms_per_s);
      }
      const IonicCellSource at_start(
          *type.ionic, type.ionic_parameters, paced->second.state_at_onset,
          IonicCellSource::Pacing{period_ms, onset_ms, type.stimulus, scene.electrophysiology_integrator,
                                  scene.electrophysiology_substep_ms},
          type.rescaling);
      region.initial_state = at_start.state();
    }
    region.conductivity = atrial ? plan.atrial_conductivity : plan.conductivity;
    region.fast_layer = plan.fast_conductivity;
    regions.push_back(std::move(region));
  }
  return regions;
}

std::vector<int> arteries_of(const TetMesh& mesh) {
  std::vector<int> found;
  for (std::size_t k = 0; k < arteries.size(); ++k)
    if (contains(mesh.facet_tags, arteries[k].tag)) found.push_back(static_cast<int>(k));
  return found;
}

MechanicsSettings mechanics_of(const TissuePlan& plan, const std::vector<int>& chambers,
                               const TetMesh& mesh) {
  MechanicsSettings s = plan.mechanics;
  s.surfaces.clear();
  for (int chamber : chambers) s.surfaces.push_back({endocardium_of(chamber), {}});
  for (int artery : arteries_of(mesh)) s.surfaces.push_back({arteries[artery].tag, {}});
  for (const Artery& artery : arteries)
    if (contains(plan.named_tags, artery.tag) && !contains(mesh.facet_tags, artery.tag))
      throw InputError(
          fmt::format("load.{}: the mesh has no facet with surface tag {}", artery.name, artery.tag));
  // A mesh from a file holds some of the tags that could be there; what the scene names must be there.
  std::erase_if(s.materials, [&](const Material& m) {
    if (contains(mesh.cell_tags, m.tag)) return false;
    if (contains(plan.named_tags, m.tag))
      throw InputError(fmt::format(
          "materials.{}: the mesh has no cell with volume tag {}. Leave the table out, or correct the tag",
          mesh_tags::name_of_tag(mesh_tags::volumes, m.tag), m.tag));
    return true;
  });
  if (!plan.mesh_file.empty())
    std::erase_if(s.supports, [&](const Support& m) {
      return !contains(mesh.facet_tags, m.tag) && !contains(plan.named_tags, m.tag);
    });
  return s;
}

SolverKind solver_of(const TissuePlan& plan, const TetMesh& mesh) {
  if (plan.solver) return *plan.solver;
  if (plan.mechanics.order == 2) return SolverKind::direct;
  constexpr double stiff_Pa = 1e5, good_part = 0.1;
  const auto stiff = std::count_if(mesh.cell_tags.begin(), mesh.cell_tags.end(), [&](int tag) {
    return std::any_of(plan.mechanics.materials.begin(), plan.mechanics.materials.end(),
                       [&](const Material& m) { return m.tag == tag && m.stiffness_Pa >= stiff_Pa; });
  });
  return static_cast<double>(stiff) > good_part * static_cast<double>(mesh.cells.size())
             ? SolverKind::gmres_gamg
             : SolverKind::gmres_ilu;
}

std::shared_ptr<const TetMesh> unloaded_shape(const TissuePlan& plan, const std::vector<int>& chambers,
                                              const std::shared_ptr<const TetMesh>& image,
                                              const std::string& place, Progress::Style style,
                                              MPI_Comm communicator, RecoveryReport& report) {
  if (!plan.recover_reference) return image;
  std::vector<double> pressures;
  for (int chamber : chambers) pressures.push_back(plan.image_pressure_mmHg[chamber] * units::Pa_per_mmHg);
  for (int artery : arteries_of(*image))
    pressures.push_back(plan.artery_image_pressure_mmHg[artery] * units::Pa_per_mmHg);
  Progress progress(place + ": unloaded shape", style);
  std::unique_ptr<Partition> partition;
  FibreField fibres;
  auto unloaded = recover_reference(
      image, pressures,
      [&](std::shared_ptr<const TetMesh> mesh) {
        collectively(communicator, [&] { fibres = make_fibres(plan, *mesh); });
        partition = std::make_unique<Partition>(mesh, communicator);
        return std::make_unique<Mechanics>(*partition, &fibres, mechanics_of(plan, chambers, *image));
      },
      {}, report,
      [&](double share) {
        if (stop_asked(communicator, progress, share, "")) throw Interrupted("stopped on request");
      });
  progress.finish(fmt::format("{} iterations, {:.1e} mm off, smallest volume ratio {:.2f}",
                              report.fixed_point_iterations, 1e3 * report.residual_m,
                              report.smallest_volume_ratio));
  return unloaded;
}

}  // namespace wiggers
