#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>
#include <optional>
#include <wiggers/circulation/physical_sense.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/files.hpp>
#include <wiggers/core/saved_numbers.hpp>
#include <wiggers/core/stopwatch.hpp>
#include <wiggers/core/table.hpp>
#include <wiggers/core/units.hpp>
#include <wiggers/heart/run/provenance.hpp>
#include <wiggers/tissue/body/body.hpp>
#include <wiggers/tissue/body/body_run.hpp>
#include <wiggers/tissue/body/field_file.hpp>
#include <wiggers/tissue/mesh/geometry.hpp>
#include <wiggers/tissue/parallel/collective.hpp>
#include <wiggers/tissue/physics/equilibrium.hpp>

namespace wiggers {

namespace {

struct MechanicsRun {
  const Scene& scene;
  const BodyRequest& request;
  MPI_Comm communicator;
  const TissuePlan& plan;
  const std::vector<int>& chambers;
  Progress::Style style;

  std::shared_ptr<const TetMesh> image, mesh;
  FibreField fibres;
  std::unique_ptr<Partition> partition;
  std::unique_ptr<Mechanics> mechanics;
  RecoveryReport recovery;
  std::vector<double> cell_volume;  // of local conductive cells that this rank counts; else 0
  double unloaded_tissue_m3 = 0;

  double share = 0;               // of the load
  std::vector<double> pressures;  // Pa: chambers, then arteries
  long newton = 0;
  double start_s = 0, run_s = 0;
  Table rows;
  std::unique_ptr<FieldSeries> series;

  MechanicsRun(const Scene& s, const BodyRequest& r, MPI_Comm c)
      : scene(s),
        request(r),
        communicator(c),
        plan(tissue_plan(s.walls.front())),
        chambers(s.walls.front().cavities),
        style(r.quiet ? Progress::Style::quiet : Progress::Style::automatic) {
    rows.columns = {{"/load", "1", "share of the load", {}}};
    for (int chamber : chambers) {
      rows.columns.push_back({fmt::format("/cavities/{}/pressure", chamber_names[chamber]),
                              "mmHg",
                              "pressure in the cavity",
                              {}});
      rows.columns.push_back(
          {fmt::format("/cavities/{}/volume", chamber_names[chamber]), "mL", "volume of the cavity", {}});
    }
    rows.columns.push_back({"/body/stretch", "1", "mean fibre stretch of the myocardium", {}});
    rows.columns.push_back(
        {"/body/myocardium_volume_ratio", "1", "of the myocardium, over the unloaded one", {}});
    rows.columns.push_back({"/body/smallest_volume_ratio", "1", "smallest J of all elements", {}});
  }

  void build(std::shared_ptr<const TetMesh> unloaded) {
    mesh = std::move(unloaded);
    collectively(communicator, [&] { fibres = make_fibres(plan, *mesh); });
    say_of_fibres(plan, *mesh, fibres, "body", communicator);
    partition = std::make_unique<Partition>(mesh, communicator);
    check_interrupt_of_all(communicator);
    mechanics = std::make_unique<Mechanics>(*partition, &fibres, mechanics_of(plan, chambers, *image));
    cell_volume.assign(partition->cells().size(), 0.0);
    double sum = 0;
    for (std::size_t c = 0; c < cell_volume.size(); ++c) {
      const int file = partition->cells()[c];
      if (!mesh_tags::conductive(mesh->cell_tags[file]) ||
          c >= static_cast<std::size_t>(partition->n_own_cells()))
        continue;
      cell_volume[c] = wiggers::cell_volume(*mesh, file);
      sum += cell_volume[c];
    }
    MPI_Allreduce(&sum, &unloaded_tissue_m3, 1, MPI_DOUBLE, MPI_SUM, communicator);
    pressures.assign(chambers.size() + arteries_of(*image).size(), 0.0);
  }

  // Pressures at a share of the load; those of cavities whose volume is prescribed as they are.
  std::vector<double> loads_at(double s) const {
    std::vector<double> p = pressures;
    for (std::size_t k = 0; k < chambers.size(); ++k)
      if (!plan.loads[chambers[k]].volume_mL)
        p[k] = s * plan.loads[chambers[k]].pressure_mmHg * units::Pa_per_mmHg;
    std::size_t k = chambers.size();
    for (int artery : arteries_of(*image))
      p[k++] = s * plan.arterial_pressure_mmHg[artery] * units::Pa_per_mmHg;
    return p;
  }

  std::vector<CellTension> tension_at(double s) const {
    const double tension = s * plan.active_tension_kPa * units::Pa_per_kPa;
    std::vector<CellTension> all(partition->cells().size());
    for (std::size_t c = 0; c < all.size(); ++c)
      if (mesh_tags::conductive(mesh->cell_tags[partition->cells()[c]])) all[c].tension.fill(tension);
    return all;
  }

  // From the present share of the load to the next, cavities with prescribed volumes in turn.
  void load_to(double next, const std::vector<double>& unloaded_mL) {
    const double from = share;
    const EquilibriumSettings settings = static_settings(mechanics->nodes());
    const std::vector<double> before = loads_at(from), after = loads_at(next);
    EquilibriumReport report = find_equilibrium(
        *mechanics,
        [&](double s) {
          std::vector<double> p = before;
          for (std::size_t k = 0; k < p.size(); ++k) p[k] += s * (after[k] - before[k]);
          return p;
        },
        settings,
        [&](double s) {
          return plan.active_tension_kPa > 0 ? tension_at(from + s * (next - from))
                                             : std::vector<CellTension>{};
        });
    pressures = after;
    std::vector<std::optional<double>> wanted_m3(chambers.size());
    bool any = false;
    for (std::size_t k = 0; k < chambers.size(); ++k)
      if (const auto& whole = plan.loads[chambers[k]].volume_mL) {
        wanted_m3[k] = units::m3_per_mL * (unloaded_mL[k] + next * (*whole - unloaded_mL[k]));
        any = true;
      }
    if (any) reach_volumes(*mechanics, wanted_m3, pressures, settings, report);
    newton += report.newton_iterations;
    const Balance balance = mechanics->assemble(pressures, false);
    mechanics->require_meaningful(balance);
    for (std::size_t k = 0; k < chambers.size(); ++k) {
      const double volume_mL = balance.volumes_m3[k] / units::m3_per_mL;
      if (!(volume_mL >= physical_sense::volume.lower && volume_mL <= physical_sense::volume.upper))
        throw NumericalFailure(
            fmt::format("unphysical: the volume of {} is {:.4g} mL at {:.4g} mmHg; no cavity is outside {} "
                        "to {} mL. Look at the "
                        "load, the stiffness of the wall and the unit of the mesh.",
                        chamber_names[chambers[k]], volume_mL, pressures[k] / units::Pa_per_mmHg,
                        physical_sense::volume.lower, physical_sense::volume.upper));
    }
    share = next;
  }

  void add_row() {
    const Balance balance = mechanics->assemble(pressures, false);
    const auto deformation = mechanics->cell_deformation();
    double sums[2] = {};
    for (std::size_t c = 0; c < deformation.size(); ++c) {
      sums[0] += cell_volume[c] * std::sqrt(deformation[c][0]);
      sums[1] += cell_volume[c] * deformation[c][3];
    }
    double all[2];
    MPI_Allreduce(sums, all, 2, MPI_DOUBLE, MPI_SUM, communicator);
    std::vector<double> row = {share};
    for (std::size_t k = 0; k < chambers.size(); ++k) {
      row.push_back(pressures[k] / units::Pa_per_mmHg);
      row.push_back(balance.volumes_m3[k] / units::m3_per_mL);
    }
    for (double value : {all[0] / unloaded_tissue_m3, all[1] / unloaded_tissue_m3, balance.smallest_J})
      row.push_back(value);
    for (std::size_t k = 0; k < row.size(); ++k) rows.columns[k].values.push_back(row[k]);
  }

  bool with_fields() const {
    return request.result && !is_special(*request.result) && plan.fields_every_step;
  }

  void open_fields(bool resumed) {
    if (!with_fields()) return;
    tissue_services().on_first_rank([&] {
      series = std::make_unique<FieldSeries>(series_beside(*request.result, "body"), *mesh,
                                             resumed ? std::optional<double>(share + 1e-9) : std::nullopt);
    });
  }

  // The place of time is taken by the share of the load.
  void write_fields() {
    if (!with_fields()) return;
    const auto displacement =
        partition->gather_at_vertices(mechanics->nodes(), mechanics->displacement().data(), 3, 0);
    // Stretch at vertices: the mean of the cells around, by volume.
    std::vector<double> weighted(2 * mesh->points.size(), 0.0);
    const auto deformation = mechanics->cell_deformation();
    for (std::size_t c = 0; c < deformation.size(); ++c) {
      if (!(cell_volume[c] > 0)) continue;
      for (int vertex : mesh->cells[partition->cells()[c]]) {
        weighted[2 * static_cast<std::size_t>(vertex)] += cell_volume[c] * std::sqrt(deformation[c][0]);
        weighted[2 * static_cast<std::size_t>(vertex) + 1] += cell_volume[c];
      }
    }
    MPI_Allreduce(MPI_IN_PLACE, weighted.data(), static_cast<int>(weighted.size()), MPI_DOUBLE, MPI_SUM,
                  communicator);
    std::vector<double> stretch(mesh->points.size(), 1.0);
    for (std::size_t k = 0; k < stretch.size(); ++k)
      if (weighted[2 * k + 1] > 0) stretch[k] = weighted[2 * k] / weighted[2 * k + 1];
    tissue_services().on_first_rank([&] {
      series->write(share, {{"displacement_m", 3, displacement}, {"fibre_stretch", 1, stretch}});
    });
  }

  nlohmann::ordered_json summary() const {
    nlohmann::ordered_json cavities;
    for (std::size_t k = 0; k < chambers.size(); ++k)
      cavities[std::string(chamber_names[chambers[k]])] = {
          {"unloaded_volume_mL", rows.columns[2 + 2 * k].values.front()},
          {"pressure_mmHg", rows.columns[1 + 2 * k].values.back()},
          {"volume_mL", rows.columns[2 + 2 * k].values.back()}};
    return {{"title", scene.title},
            {"physics", "mechanics"},
            {"load", share},
            {"cavities", cavities},
            {"smallest_volume_ratio", rows.columns.back().values.back()},
            {"cost", {{"start_s", start_s}, {"run_s", run_s}, {"newton_iterations", newton}}},
            {"warnings", scene.warnings}};
  }

  void write(bool complete) const {
    if (!request.result) return;
    const auto displacement = partition->gather(mechanics->nodes(), mechanics->displacement().data(), 3);
    std::vector<double> points;
    for (const Point3& p : mesh->points) points.insert(points.end(), p.begin(), p.end());
    tissue_services().on_first_rank([&] {
      ResultWriter file;
      write_provenance(file, scene.title, scene.text(), complete, start_s + run_s);
      for (const Column& column : rows.columns)
        file.dataset(column.name, column.values, column.unit, column.meaning);
      file.text("/summary", summary().dump());
      const auto put = [&](const char* name, double value, const char* meaning) {
        file.scalar(std::string("/solver/walls/body/") + name, value, "1", meaning);
      };
      put("tetrahedra", static_cast<double>(mesh->cells.size()), "of the mesh");
      put("ranks", partition->n_ranks(), "MPI ranks");
      put("displacement_unknowns", 3.0 * mechanics->nodes().n_global, "unknowns of mechanics");
      if (recovery.fixed_point_iterations > 0) {
        put("reference_volume_ratio", recovery.smallest_volume_ratio, "smallest, reference over image");
        file.scalar("/solver/walls/body/reference_smallest_angle", recovery.smallest_dihedral_deg, "deg",
                    "smallest dihedral angle of the reference");
      }
      file.dataset("/checkpoint/points", points, "m", "unloaded points");
      file.dataset("/checkpoint/displacement", displacement, "m", "of the nodes");
      file.dataset("/checkpoint/pressures", pressures, "Pa", "cavities, arteries");
      file.dataset("/checkpoint/run",
                   {share, start_s, run_s, static_cast<double>(newton),
                    static_cast<double>(recovery.fixed_point_iterations), recovery.smallest_volume_ratio,
                    recovery.smallest_dihedral_deg},
                   "mixed", "share of the load, costs, Newton iterations, recovery of the unloaded shape");
      file.write(*request.result);
    });
  }

  void start() {
    const auto begin = Clock::now();
    image = make_mesh(plan, chambers, "body", communicator);
    say_of_locking(plan, "body", communicator);
    build(unloaded_shape(plan, chambers, image, "body", style, communicator, recovery));
    start_s = seconds_since(begin);
    open_fields(false);
    add_row();
    write_fields();
    write(false);  // what the unloaded shape cost is not to be lost
  }

  void resume() {
    const ResultReader file(*request.resume);
    require_same_scene(file, *request.resume, scene.text());
    image = make_mesh(plan, chambers, "body", communicator);
    auto points = std::make_shared<TetMesh>(*image);
    const std::vector<double> flat = file.finite("/checkpoint/points", 3 * points->points.size());
    for (std::size_t k = 0; k < flat.size(); ++k) points->points[k / 3][k % 3] = flat[k];
    build(std::move(points));
    const std::vector<double> d =
        file.finite("/checkpoint/displacement", 3 * static_cast<std::size_t>(mechanics->nodes().n_global));
    Partition::scatter(mechanics->nodes(), d, mechanics->displacement().data(), 3);
    pressures = file.finite("/checkpoint/pressures", pressures.size());
    SavedNumbers run(file.dataset("/checkpoint/run"), file.place("/checkpoint/run"));
    constexpr long most = std::numeric_limits<int>::max();
    share = run.not_negative();
    if (share > 1 + 1e-9) run.refuse("more than the whole load");
    start_s = run.not_negative();
    run_s = run.not_negative();
    newton = run.count(most);
    recovery.fixed_point_iterations = static_cast<int>(run.count(most));
    recovery.smallest_volume_ratio = run.number();
    recovery.smallest_dihedral_deg = run.number();
    run.finish();
    rows.columns[0].values = file.finite(rows.columns[0].name);
    if (rows.n_rows() == 0) run.refuse("there is no row of it");
    for (Column& column : rows.columns) column.values = file.finite(column.name, rows.n_rows());
    open_fields(true);
  }

  void advance() {
    const double before = run_s;
    const auto begin = Clock::now();
    Progress progress("mechanics", style);
    std::vector<double> unloaded_mL;
    for (std::size_t k = 0; k < chambers.size(); ++k)
      unloaded_mL.push_back(rows.columns[2 + 2 * k].values.front());
    const double step = 1.0 / scene.load_steps;
    try {
      while (share < 1 - 1e-9) {
        load_to(std::min(1.0, (std::floor(share / step + 1e-6) + 1) * step), unloaded_mL);
        add_row();
        write_fields();
        run_s = before + seconds_since(begin);
        write(share >= 1 - 1e-9);
        if (stop_asked(communicator, progress, share, fmt::format("{:.0f} % of the load", 100 * share)))
          throw Interrupted("");
      }
    } catch (const Interrupted&) {
      throw Interrupted(
          request.result
              ? fmt::format("stopped on request; continue with --resume {}", request.result->string())
              : std::string("stopped on request; no -o was given, nothing was saved"));
    } catch (const NumericalFailure& failure) {
      throw NumericalFailure(
          fmt::format("after {:.1f} % of the load: {}", 100 * share,
                      failure_text(failure.what(), request.result ? request.result->string() : "")));
    }
    if (request.resume) write(true);  // perhaps into another file, with nothing left to do
    progress.finish(fmt::format("{} Newton iterations", newton));
  }

  std::string text() const {
    std::string out = fmt::format("{:>8}", "load %");
    for (int chamber : chambers)
      out += fmt::format("{:>12}{:>11}", fmt::format("p {} mmHg", chamber_names[chamber]),
                         fmt::format("V {} mL", chamber_names[chamber]));
    out += fmt::format("{:>10}{:>12}\n", "stretch", "smallest J");
    for (std::size_t r = 0; r < rows.n_rows(); ++r) {
      out += fmt::format("{:>8.1f}", 100 * rows.columns[0].values[r]);
      for (std::size_t k = 0; k < chambers.size(); ++k)
        out += fmt::format("{:>12.3f}{:>11.2f}", rows.columns[1 + 2 * k].values[r],
                           rows.columns[2 + 2 * k].values[r]);
      const std::size_t n = rows.columns.size();
      out +=
          fmt::format("{:>10.4f}{:>12.3f}\n", rows.columns[n - 3].values[r], rows.columns[n - 1].values[r]);
    }
    return out + fmt::format("cost: start {:.2f} s, loading {:.2f} s, {} Newton iterations\n", start_s, run_s,
                             newton);
  }
};

}  // namespace

BodyOutcome run_body_mechanics(const Scene& scene, const BodyRequest& request, MPI_Comm communicator) {
  MechanicsRun run(scene, request, communicator);
  if (request.resume)
    run.resume();
  else
    run.start();
  run.advance();
  return {run.text(), run.summary().dump()};
}

}  // namespace wiggers
