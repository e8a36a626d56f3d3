// Work and precision of 3D tissue: the first part of a beat, from filling into ejection.
//
// Three families, each against its own reference: steps and tolerances on a coarse mesh, elements of the
// displacement, meshes and elements of the potential with the usual steps. The shape of the mesh is taken as
// unloaded, so that no row pays for its recovery.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/units.hpp>
#include <wiggers/heart/measure/trade.hpp>
#include <wiggers/heart/run/run.hpp>
#include <wiggers/heart/scene/wall_kind.hpp>

namespace wiggers {

namespace {

constexpr double window_ms = 400;

struct Window {
  std::vector<double> values;
  double cost_s = 0;
  long steps = 0;
};

// The name of the scene's wall of tissue.
std::string tissue_wall(const Scene& scene) {
  for (const WallPlan& wall : scene.walls)
    if (wall.recipe->in_space()) return wall.name;
  return "";
}

Window run_window(const std::filesystem::path& file, std::vector<std::string> overrides) {
  const Scene plain = read_scene(file, overrides);
  const std::string wall = tissue_wall(plain);
  for (const char* fixed : {"reference.recover=false", "fields_every_ms=0"})
    overrides.push_back(fmt::format("walls.{}.{}", wall, fixed));
  overrides.push_back("run.until=beats");
  overrides.push_back("run.beats=1");
  overrides.push_back(fmt::format("run.stop_after_ms={}", window_ms));
  overrides.push_back(fmt::format("run.checkpoint_every_ms={}", 2 * window_ms));
  HeartRun run(read_scene(file, overrides));
  run.prepare(Progress::Style::quiet);
  run.advance(Progress::Style::quiet, {});
  const Table& trace = run.trace();
  const auto column = [&](const std::string& name) -> const std::vector<double>& {
    for (const Column& c : trace.columns)
      if (c.name == name) return c.values;
    throw std::logic_error("no column " + name);
  };
  const auto& potential = column(wall + ".membrane_potential");
  const auto& time = column("t_s");
  // When the mean potential passes -40 mV: half of the tissue is activated then.
  double activated_ms = std::nan("");
  for (std::size_t k = 1; k < time.size() && std::isnan(activated_ms); ++k)
    if (potential[k - 1] < -40 && potential[k] >= -40)
      activated_ms = units::ms_per_s * (time[k - 1] + (time[k] - time[k - 1]) * (-40 - potential[k - 1]) /
                                                          (potential[k] - potential[k - 1]));
  const auto& flow = column("Q_AV");
  return {{activated_ms, column("p_LV").back(), column("V_LV").back(),
           column(wall + ".active_tension").back(), *std::max_element(flow.begin(), flow.end())},
          run.cost().heart_s,
          static_cast<long>(time.size()) - 1};
}

}  // namespace

bool has_tissue(const std::filesystem::path& scene, const std::vector<std::string>& overrides) {
  const Scene read = read_scene(scene, overrides);
  return read.physics == Physics::heart && !tissue_wall(read).empty();
}

TradeStudy trade_tissue(const std::filesystem::path& scene, const std::vector<std::string>& overrides,
                        Progress& progress) {
  TradeStudy study;
  const std::string wall = "walls." + tissue_wall(read_scene(scene, overrides)) + ".";
  study.subject = fmt::format("3D tissue, {}: the first {} ms", scene.filename().string(), window_ms);
  study.costed = fmt::format("these {} ms", window_ms);
  study.protocol =
      "from the scene's initial state with the mesh taken as unloaded; values at the end, activation and "
      "peak flow "
      "compared";
  study.measures = trade_measures("tissue");
  struct Job {
    std::string method, setting;
    std::vector<std::string> overrides;
  };
  const std::string ep = wall + "electrophysiology.", mechanics = wall + "mechanics.",
                    coarse = wall + "size_mm=8";
  const auto with = [&](const std::vector<std::string>& more) {
    std::vector<std::string> all = overrides;
    all.insert(all.end(), more.begin(), more.end());
    return all;
  };
  // On so coarse a mesh conduction fails: where steps and tolerances are compared, all tissue conducts better
  // and stimuli reach more nodes.
  std::vector<std::string> conductive;
  for (const char* direction : {"fibre", "sheet", "normal"})
    conductive.push_back(fmt::format("{}conductivity.{}_mm2_per_ms=0.8", ep, direction));
  const std::string text = read_scene(scene, overrides).text(), table = "[" + wall + "stimuli.";
  for (std::size_t at = text.find(table); at != std::string::npos; at = text.find(table, at + 1))
    conductive.push_back(text.substr(at + 1, text.find(']', at) - at - 1) + ".radius_mm=8");
  const std::vector<std::string> fine_steps = {coarse,
                                               ep + "tau_ms=0.0125",
                                               ep + "table_spacing_mV=0",
                                               ep + "relative_tolerance=1e-10",
                                               mechanics + "residual_tolerance=1e-8",
                                               mechanics + "linear_tolerance=1e-6",
                                               "solver.dt_s=2.5e-4"};
  const std::vector<Job> steps = {
      {"steps", "as set", {coarse}},
      {"steps", "dt 2 ms", {coarse, "solver.dt_s=2e-3"}},
      {"steps", "dt 0.5 ms", {coarse, "solver.dt_s=5e-4"}},
      {"steps", "tau 0.1 ms", {coarse, ep + "tau_ms=0.1"}},
      {"steps", "tau 0.025 ms", {coarse, ep + "tau_ms=0.025"}},
      {"steps", "tau 0.025, dt 0.5 ms", {coarse, ep + "tau_ms=0.025", "solver.dt_s=5e-4"}},
      {"tables", "none", {coarse, ep + "table_spacing_mV=0"}},
      {"tables", "1 mV", {coarse, ep + "table_spacing_mV=1"}},
      {"potential's solver", "1e-6", {coarse, ep + "relative_tolerance=1e-6"}},
      {"potential's solver", "1e-10", {coarse, ep + "relative_tolerance=1e-10"}},
      {"potential's solver", "Jacobi", {coarse, ep + "solver=cg-jacobi"}},
      {"Newton", "1e-3", {coarse, mechanics + "residual_tolerance=1e-3"}},
      {"Newton", "1e-8", {coarse, mechanics + "residual_tolerance=1e-8"}},
      {"Krylov", "1e-1", {coarse, mechanics + "linear_tolerance=0.1"}},
      {"Krylov", "1e-6", {coarse, mechanics + "linear_tolerance=1e-6"}},
      {"Krylov", "direct", {coarse, mechanics + "solver=direct"}},
      {"tangent kept", "4 steps", {coarse, mechanics + "tangent_every=4"}},
      {"tangent kept", "20 steps", {coarse, mechanics + "tangent_every=20"}},
      {"ionic currents", "SVI", {coarse, ep + "ionic_currents=svi"}},
      {"feedback", "none", {coarse, ep + "mechano_electric_feedback=false"}}};
  const std::string linear = mechanics + "order=1", quadratic = mechanics + "order=2";
  // 5 mm has two elements across the wall, 8 and 6 mm have one.
  const std::vector<std::string> fine_displacement = {wall + "size_mm=5", quadratic};
  const std::vector<Job> displacements = {{"displacement, P1", "8 mm", {coarse, linear}},
                                          {"displacement, P1", "6 mm", {wall + "size_mm=6", linear}},
                                          {"displacement, P1", "5 mm", {wall + "size_mm=5", linear}},
                                          {"displacement, P1", "4 mm", {wall + "size_mm=4", linear}},
                                          {"displacement, P2", "8 mm", {coarse, quadratic}}};
  const std::vector<std::string> fine_mesh = {wall + "size_mm=4"};
  const std::vector<Job> meshes = {
      {"mesh, P2 potential, P1", "8 mm", {coarse}},
      {"mesh, P2 potential, P1", "6 mm", {wall + "size_mm=6"}},
      {"mesh, P2 potential, P1", "5 mm", {wall + "size_mm=5"}},
      {"mesh, P1 potential, P1", "6 mm", {wall + "size_mm=6", ep + "order=1"}},
      {"mesh, P1 potential, P1", "4 mm", {wall + "size_mm=4", ep + "order=1"}},
      {"mesh, SVI, P1", "8 mm", {coarse, ep + "ionic_currents=svi"}},
      {"mesh, SVI, P1", "6 mm", {wall + "size_mm=6", ep + "ionic_currents=svi"}}};
  struct Family {
    const std::vector<Job>& jobs;
    const std::vector<std::string>& reference;
    const char* what;
    bool conducts_better;
  };
  const std::vector<Family> families = {
      {steps, fine_steps,
       "steps: 8 mm, conductivities of 0.8 mm2/ms, stimuli of 8 mm, tau 0.0125 ms, dt 0.25 ms, no tables, "
       "tight tolerances",
       true},
      {displacements, fine_displacement,
       "displacement: P2 with mean dilatation at 5 mm, conductivities and stimuli as there", true},
      {meshes, fine_mesh, "mesh: 4 mm", false}};
  std::size_t n_all = families.size(), n_done = 0;
  for (const Family& family : families) n_all += family.jobs.size();
  const auto advance = [&](const std::string& what) {
    progress.update(static_cast<double>(n_done++) / static_cast<double>(n_all), what);
  };
  for (const auto& [jobs, reference, what, conducts_better] : families) {
    advance("reference");
    const auto all_of = [&, better = conducts_better](std::vector<std::string> changes) {
      if (better) changes.insert(changes.end(), conductive.begin(), conductive.end());
      return with(changes);
    };
    const Window finest = run_window(scene, all_of(reference));
    const std::vector<double>& exact = finest.values;
    study.reference += fmt::format("{}{} (cost {:.3g} ms)", study.reference.empty() ? "" : "; ", what,
                                   units::ms_per_s * finest.cost_s);
    for (const Job& job : jobs) {
      advance(job.method + " " + job.setting);
      TradeRow row{job.method, job.setting, {}, 0, 0, 0, {}};
      try {
        const Window window = run_window(scene, all_of(job.overrides));
        for (std::size_t m = 0; m < exact.size(); ++m)
          row.errors.push_back(std::abs(window.values[m] - exact[m]));
        row.cost_s = window.cost_s;
        row.steps = window.steps;
      } catch (const NumericalFailure& failure) {
        row.errors.clear();
        row.failure = failure.what();
      } catch (const InputError& refusal) {
        // A mesh so coarse that no node is stimulated.
        row.errors.clear();
        row.failure = refusal.what();
      }
      study.rows.push_back(row);
    }
  }
  return study;
}

}  // namespace wiggers
