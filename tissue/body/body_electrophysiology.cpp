#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
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
#include <wiggers/tissue/parallel/collective.hpp>

namespace wiggers {

namespace {

struct ElectrophysiologyRun {
  const Scene& scene;
  const BodyRequest& request;
  MPI_Comm communicator;
  TissuePlan plan;
  Progress::Style style;

  std::shared_ptr<const TetMesh> mesh;
  FibreField fibres;
  std::unique_ptr<Partition> partition;
  std::unique_ptr<Monodomain> monodomain;

  double time_s = 0;  // of the model
  double start_s = 0, run_s = 0;
  Table rows;
  std::unique_ptr<FieldSeries> series;
  double next_fields_s = -1;

  ElectrophysiologyRun(const Scene& s, const BodyRequest& r, MPI_Comm c)
      : scene(s),
        request(r),
        communicator(c),
        plan(tissue_plan(s.walls.front())),
        style(r.quiet ? Progress::Style::quiet : Progress::Style::automatic) {
    if (plan.electrophysiology.tau_s > scene.rows_every_ms * units::s_per_ms * (1 + 1e-9))
      throw InputError(fmt::format("body.electrophysiology.tau_ms = {} is longer than run.rows_every_ms = {}",
                                   plan.electrophysiology.tau_s * units::ms_per_s, scene.rows_every_ms));
    rows.columns = {{"t_s", "s", "time", {}},
                    {"activated_share", "1", "share of the nodes activated in this beat", {}},
                    {"membrane_potential", "mV", "mean over the nodes", {}},
                    {"calcium", "uM", "mean over the nodes", {}}};
    for (std::size_t k = 0; k < plan.electrodes.size(); ++k)
      rows.columns.push_back(
          {fmt::format("lead_{}", k + 1), "mV m^2/s", "pseudo-ECG at the electrode, no absolute scale", {}});
  }

  void build(const std::map<std::string, PacedCellType>& cells) {
    mesh = make_mesh(plan, scene.walls.front().cavities, "body", communicator);
    place_stimuli(plan, *mesh, "body", communicator);
    collectively(communicator, [&] { fibres = make_fibres(plan, *mesh); });
    partition = std::make_unique<Partition>(mesh, communicator);
    check_interrupt_of_all(communicator);
    monodomain = std::make_unique<Monodomain>(*partition, &fibres, plan.electrophysiology,
                                              ionic_regions(scene, scene.walls.front(), *mesh, cells, "body"),
                                              plan.stimuli);
  }

  double within_beat(double t) const {
    const double beats = std::floor(t / scene.period_s + 1e-9);
    return std::max(0.0, t - beats * scene.period_s);
  }

  void add_row() {
    const NodeSpace& nodes = monodomain->nodes();
    const std::vector<double> calcium = monodomain->calcium_uM();
    double sums[4] = {};
    for (int k = 0; k < nodes.n_own; ++k) {
      sums[0] += monodomain->activation_s()[k] >= 0 ? 1 : 0;
      sums[1] += monodomain->potential_mV()[k];
      sums[2] += calcium[k];
      sums[3] += 1;
    }
    double all[4];
    MPI_Allreduce(sums, all, 4, MPI_DOUBLE, MPI_SUM, communicator);
    std::vector<double> row = {time_s};
    for (int k = 0; k < 3; ++k) row.push_back(all[k] / all[3]);
    for (const Point3& electrode : plan.electrodes) row.push_back(monodomain->lead(electrode));
    for (std::size_t k = 0; k < row.size(); ++k) rows.columns[k].values.push_back(row[k]);
  }

  std::vector<double> activation_at_vertices() const {
    return partition->gather_at_vertices(monodomain->nodes(), monodomain->activation_s().data(), 1, -1);
  }

  bool with_fields() const {
    return request.result && !is_special(*request.result) && plan.fields_every_ms > 0;
  }

  void open_fields(bool resumed) {
    if (!with_fields()) return;
    tissue_services().on_first_rank([&] {
      series = std::make_unique<FieldSeries>(series_beside(*request.result, "body"), *mesh,
                                             resumed ? std::optional<double>(time_s - 1e-6) : std::nullopt);
    });
    const double every = plan.fields_every_ms * units::s_per_ms;
    next_fields_s = resumed ? std::ceil(time_s / every - 1e-6) * every : 0;
  }

  void write_fields() {
    if (!with_fields() || time_s < next_fields_s - 1e-9) return;
    const double every = plan.fields_every_ms * units::s_per_ms;
    next_fields_s = (std::floor(time_s / every + 1e-9) + 1) * every;
    const NodeSpace& nodes = monodomain->nodes();
    const std::vector<double> calcium = monodomain->calcium_uM();
    const auto potential = partition->gather_at_vertices(nodes, monodomain->potential_mV(), 1, 0);
    const auto calcium_at = partition->gather_at_vertices(nodes, calcium.data(), 1, 0);
    const auto activation = activation_at_vertices();
    tissue_services().on_first_rank([&] {
      series->write(
          time_s,
          {{"potential_mV", 1, potential}, {"activation_s", 1, activation}, {"calcium_uM", 1, calcium_at}});
    });
  }

  nlohmann::ordered_json summary() const {
    const std::vector<double> at = activation_at_vertices();
    double first = -1, last = -1;
    for (double value : at) {
      if (value < 0) continue;
      first = first < 0 ? value : std::min(first, value);
      last = std::max(last, value);
    }
    nlohmann::ordered_json activation = {{"share", rows.columns[1].values.back()}};
    if (first >= 0) {
      activation["first_ms"] = first * units::ms_per_s;
      activation["last_ms"] = last * units::ms_per_s;
    }
    return {{"title", scene.title},
            {"physics", "electrophysiology"},
            {"activation", activation},
            {"time_ms", time_s * units::ms_per_s},
            {"cost", {{"start_s", start_s}, {"run_s", run_s}}},
            {"warnings", scene.warnings}};
  }

  std::map<std::string, WallFigure> figures() const {
    const MonodomainCost& cost = monodomain->cost();
    return {{"tetrahedra", {static_cast<double>(mesh->cells.size()), "1", "of the mesh"}},
            {"ranks", {static_cast<double>(partition->n_ranks()), "1", "MPI ranks"}},
            {"potential_nodes",
             {static_cast<double>(monodomain->nodes().n_global), "1", "unknowns of electrophysiology"}},
            {"electrophysiology_ionic", {cost.ionic_s, "s", "wall time of ionic cells"}},
            {"electrophysiology_solve", {cost.solve_s, "s", "wall time of linear systems"}},
            {"electrophysiology_right_side", {cost.right_side_s, "s", "wall time of right-hand sides"}},
            {"electrophysiology_assembly", {cost.assembly_s, "s", "wall time of matrices"}},
            {"electrophysiology_steps", {static_cast<double>(cost.steps), "1", "steps of electrophysiology"}},
            {"electrophysiology_iterations",
             {static_cast<double>(cost.iterations), "1", "of its linear solver"}}};
  }

  // What goes on is what a resumed run would go on with, bit for bit.
  void checkpoint(bool complete) {
    std::vector<double> state;
    monodomain->save(state);
    if (request.result) {
      const auto at = activation_at_vertices();
      const auto text = summary().dump();
      tissue_services().on_first_rank([&] {
        ResultWriter file;
        write_provenance(file, scene.title, scene.text(), complete, start_s + run_s);
        file.dataset("/time", rows.columns[0].values, "s", "time");
        for (std::size_t k = 1; k < rows.columns.size(); ++k)
          file.dataset("/body/" + rows.columns[k].name, rows.columns[k].values, rows.columns[k].unit,
                       rows.columns[k].meaning);
        file.dataset("/body/activation", at, "s",
                     "within the beat, of each vertex of the mesh; negative: not activated in it");
        file.text("/summary", text);
        for (const auto& [name, figure] : figures())
          file.scalar("/solver/walls/body/" + name, figure.value, figure.unit, figure.meaning);
        file.dataset("/checkpoint/body", state, "mixed", "potential, cells, activation");
        file.dataset("/checkpoint/run", {time_s, start_s, run_s}, "s", "time, costs");
        file.write(*request.result);
      });
    }
    std::span<const double> in = state;
    monodomain->restore(in);
  }

  void resume() {
    const ResultReader file(*request.resume);
    require_same_scene(file, *request.resume, scene.text());
    build({});
    const std::vector<double> state = file.finite("/checkpoint/body");
    std::span<const double> in = state;
    try {
      monodomain->restore(in);
      if (!in.empty()) throw InputError(fmt::format("it has {} numbers too many", in.size()));
    } catch (const InputError& error) {
      throw InputError(fmt::format("{}: {}", file.place("/checkpoint/body"), error.what()));
    }
    SavedNumbers run(file.dataset("/checkpoint/run"), file.place("/checkpoint/run"));
    time_s = run.not_negative();
    start_s = run.not_negative();
    run_s = run.not_negative();
    run.finish();
    const double n_rows = std::round(time_s / (scene.rows_every_ms * units::s_per_ms)) + 1;
    if (n_rows > 1e9) run.refuse("no run is as long as that");
    const auto n = static_cast<std::size_t>(n_rows);
    rows.columns[0].values = file.finite("/time", n);
    for (std::size_t k = 1; k < rows.columns.size(); ++k)
      rows.columns[k].values = file.finite("/body/" + rows.columns[k].name, n);
  }

  void advance() {
    const double before = run_s, end_s = scene.end_ms * units::s_per_ms,
                 row_s = scene.rows_every_ms * units::s_per_ms;
    const auto begin = Clock::now();
    Progress progress("electrophysiology", style);
    const double every = scene.checkpoint_every_ms * units::s_per_ms;
    double next_checkpoint = (std::floor(time_s / every + 1e-9) + 1) * every;
    try {
      while (time_s < end_s - 1e-9) {
        const double t = within_beat(time_s);
        if (t < 1e-9) monodomain->forget_activation();
        monodomain->advance(t, row_s);
        time_s += row_s;
        add_row();
        write_fields();
        run_s = before + seconds_since(begin);
        if (stop_asked(communicator, progress, time_s / end_s,
                       fmt::format("{:.0f} ms", time_s * units::ms_per_s))) {
          if (!request.result) throw Interrupted("stopped on request; no -o was given, nothing was saved");
          checkpoint(false);
          throw Interrupted(fmt::format("stopped on request after {:.3f} s; continue with --resume {}",
                                        time_s, request.result->string()));
        }
        if (time_s > next_checkpoint - 1e-9 && time_s < end_s - 1e-9) {
          checkpoint(false);
          next_checkpoint += every;
        }
      }
    } catch (const NumericalFailure& failure) {
      throw NumericalFailure(
          fmt::format("at {:.4f} s: {}", time_s,
                      failure_text(failure.what(), request.result ? request.result->string() : "")));
    }
    checkpoint(true);
    progress.finish(fmt::format("{:.0f} ms", time_s * units::ms_per_s));
  }
};

}  // namespace

BodyOutcome run_body_electrophysiology(const Scene& scene, const BodyRequest& request,
                                       MPI_Comm communicator) {
  ElectrophysiologyRun run(scene, request, communicator);
  if (request.resume) {
    run.resume();
  } else {
    const auto begin = Clock::now();
    run.build(pace_cells(scene, run.style));
    run.start_s = seconds_since(begin);
  }
  run.open_fields(request.resume.has_value());
  if (!request.resume) run.add_row();
  run.write_fields();
  run.checkpoint(false);
  run.advance();
  const auto summary = run.summary();
  std::string text = fmt::format("activated      {:.1f} % of the nodes\n",
                                 100 * summary["activation"]["share"].get<double>());
  if (summary["activation"].contains("first_ms"))
    text += fmt::format("activation     {:.1f} to {:.1f} ms within the beat\n",
                        summary["activation"]["first_ms"].get<double>(),
                        summary["activation"]["last_ms"].get<double>());
  const MonodomainCost& cost = run.monodomain->cost();
  text += fmt::format(
      "cost: start {:.2f} s, {:.0f} ms in {:.2f} s ({}cells {:.2f}, right-hand sides {:.2f}, linear systems "
      "{:.2f})\n",
      run.start_s, run.time_s * units::ms_per_s, run.run_s, request.resume ? "since the resume: " : "",
      cost.ionic_s, cost.right_side_s, cost.solve_s);
  return {text, summary.dump()};
}

}  // namespace wiggers
