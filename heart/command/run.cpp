#include <fmt/core.h>

#include <memory>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/files.hpp>
#include <wiggers/heart/run/monolithic.hpp>
#include <wiggers/heart/run/rate_warnings.hpp>
#include <wiggers/heart/run/run.hpp>
#include <wiggers/heart/run/summary.hpp>
#include <wiggers/heart/scene/accuracy.hpp>
#include <wiggers/heart/scene/tissue_services.hpp>
#include <wiggers/heart/scene/wall_kind.hpp>

#include "shared.hpp"
#include "verbs.hpp"

namespace wiggers::command {

namespace {

struct Options {
  std::string accuracy, scene, output, resume;
  std::vector<std::string> set;
  bool quiet = false, json = false, monolithic = false;
};

// The result, and the folders beside it in which 3D tissue keeps its fields.
void require_result_writable(const Scene& scene, const std::filesystem::path& result) {
  require_writable(result, "-o", FileKind::result);
  if (is_special(result)) return;
  for (const WallPlan& wall : scene.walls)
    if (wall.recipe->in_space()) require_writable_folder(fields_folder(result, wall.name), "-o");
}

void run_monolithic(const Scene& scene, const Options& o) {
  if (o.json) throw InputError("--monolithic writes a table: --json has no place there");
  if (!o.resume.empty()) throw InputError("--monolithic starts from the scene: --resume has no place there");
  if (!o.output.empty() && !o.output.ends_with(".csv"))
    throw InputError(
        fmt::format("-o: '{}' must end in .csv: a monolithic run writes the beat as a table", o.output));
  Progress progress("monolithic", o.quiet ? Progress::Style::quiet : Progress::Style::automatic);
  progress.update(-1, "cells");
  MonolithicHeart heart(scene, {});
  progress.update(-1, "limit cycle");
  LimitCycleCertificate certificate = heart.to_limit_cycle(1e-5);
  const Table beat = heart.beat(2.5e-4);
  const BeatIndexes indexes = compute_indexes(beat, atrial_activations_s(scene));
  if (certificate.good()) certificate.warnings = verdict_warnings(beat, indexes);
  progress.finish();
  fmt::print("{}\n\n{}\n{}", scene.title, index_table(indexes, scene.body_surface_area_m2),
             shunt_lines(beat));
  fmt::print(
      "monolithic by {}; limit cycle: {}, distance {:.1e} after {} beats (leading multiplier {:.3f})\n",
      heart.uses_ida() ? "IDA" : "CVODE", certificate.text_with_warnings(), certificate.distance,
      certificate.beats, certificate.multiplier);
  if (!o.output.empty()) {
    write_csv(o.output, beat);
    fmt::print("beat: {}\n", o.output);
  }
  if (certificate.verdict != LimitCycleVerdict::period_1)
    throw NumericalFailure(limit_cycle_failure(certificate));
}

// A body of 3D tissue alone.
void run_body(const Scene& scene, const Options& o) {
  if (o.monolithic) throw InputError("--monolithic is of scenes with a circulation");
  BodyRequest request;
  if (!o.output.empty()) request.result = o.output;
  if (!o.resume.empty()) request.resume = o.resume;
  if (!request.result && request.resume) request.result = request.resume;
  if (request.result) require_result_writable(scene, *request.result);
  request.quiet = o.quiet;
  tissue_services().quiet = o.quiet;
  const BodyOutcome outcome = tissue_services().run_body(scene, request);
  for (const std::string& warning : scene.warnings) fmt::print("note: {}\n", warning);
  fmt::print("{}\n\n{}", scene.title, outcome.text);
  if (request.result)
    fmt::print("result: {}\n", request.result->string());
  else
    fmt::print("no -o was given: nothing was written\n");
  if (o.json) fmt::print("{}\n", outcome.json);
}

}  // namespace

void add_run(CLI::App& app) {
  auto o = std::make_shared<Options>();
  CLI::App* verb = app.add_subcommand("run", "Run a scene to its limit cycle or for a number of beats");
  verb->add_option("scene", o->scene, "scene file (TOML)")->required();
  verb->add_option("-o,--output", o->output, "result file (HDF5); also the checkpoint of the run");
  verb->add_option("--set", o->set, "change a key of the scene: walls.LV.activation_ms=150")->take_all();
  verb->add_option(
      "--accuracy", o->accuracy,
      "draft | standard | reference | founding: the scene's solver settings together; --set goes on top");
  verb->add_flag(
      "--monolithic", o->monolithic,
      "the reference: all equations as one system, integrated by CVODE or IDA; -o writes the beat as CSV");
  verb->add_option("--resume", o->resume, "continue from this result file of the same scene");
  verb->add_flag("--quiet", o->quiet, "no progress");
  verb->add_flag("--json", o->json, "end standard output with one line of JSON");
  verb->callback([o] {
    const auto style = o->quiet ? Progress::Style::quiet : Progress::Style::automatic;
    if (!o->resume.empty()) allow_going_on_in(o->resume);
    // Before anything is read: the readers then refuse what is to be written.
    if (!o->output.empty())
      require_writable(o->output, "-o", o->monolithic ? FileKind::table : FileKind::result);
    std::vector<std::string> overrides;
    if (!o->accuracy.empty()) {
      const HeartAccuracy& chosen = heart_accuracy(o->accuracy);
      if (read_scene(o->scene, o->set).physics != Physics::heart)
        throw InputError("--accuracy is of hearts in the closed loop: set the keys of [body] by --set");
      overrides = chosen.overrides;
      fmt::print("accuracy {}: {}\n", chosen.name, chosen.expected);
    }
    overrides.insert(overrides.end(), o->set.begin(), o->set.end());
    Scene scene = read_scene(o->scene, overrides);
    if (scene.physics != Physics::heart) {
      run_body(scene, *o);
      return;
    }
    if (o->monolithic) {
      run_monolithic(scene, *o);
      return;
    }
    HeartRun run(std::move(scene));
    // A resumed run goes on in the file it came from, unless another is named.
    std::optional<std::filesystem::path> result;
    if (!o->output.empty()) result = o->output;
    if (!result && !o->resume.empty()) result = o->resume;
    if (result) require_result_writable(run.scene(), *result);
    if (o->resume.empty())
      run.prepare(style);
    else
      run.resume(o->resume);
    run.advance(style, result);
    for (const std::string& warning : run.scene().warnings) fmt::print("note: {}\n", warning);
    fmt::print("{}\n", run.scene().title);
    if (run.has_whole_beat())
      fmt::print("\n{}\n{}", index_table(run.indexes(), run.scene().body_surface_area_m2),
                 shunt_lines(run.trace()));
    const auto& certificate = run.certificate();
    fmt::print("limit cycle: {}, distance {:.1e} after {} beats (leading multiplier {:.3f})\n",
               certificate.text_with_warnings(), certificate.distance, certificate.beats,
               certificate.multiplier);
    const auto summary = summarise(run);
    fmt::print("audits: blood volume drift {:.1e} mL, energy imbalance {:.2f} %\n",
               summary["audits"]["blood_volume_drift_mL"].get<double>(),
               100 * summary["audits"]["energy_imbalance"].get<double>());
    for (const auto& warning : summary["warnings"]) fmt::print("warning: {}\n", warning.get<std::string>());
    fmt::print("cost: cells {:.2f} s, heart {:.2f} s for {} beats\n", run.cost().cells_s, run.cost().heart_s,
               run.cost().beats);
    if (result)
      fmt::print("result: {}\n", result->string());
    else
      fmt::print("no -o was given: nothing was written\n");
    if (o->json) fmt::print("{}\n", summary.dump());
    if (certificate.verdict == LimitCycleVerdict::unphysical ||
        (run.scene().until_limit_cycle && !certificate.good()))
      throw NumericalFailure(limit_cycle_failure(certificate));
  });
}

void add_check(CLI::App& app) {
  struct Options {
    std::string scene;
    std::vector<std::string> set;
    bool full = false;
  };
  auto o = std::make_shared<Options>();
  CLI::App* verb = app.add_subcommand("check", "Check a scene without running it");
  verb->add_option("scene", o->scene, "scene file (TOML)")->required();
  verb->add_option("--set", o->set, "change a key of the scene")->take_all();
  verb->add_flag("--full", o->full, "print the scene with all defaults filled in");
  verb->callback([o] {
    const Scene scene = read_scene(o->scene, o->set);
    if (o->full) {
      fmt::print("{}", scene.text());
      return;
    }
    fmt::print("{}: good\n", o->scene);
    for (const WallPlan& wall : scene.walls) {
      fmt::print("  {}: {}", wall.name, wall.kind);
      if (scene.physics != Physics::heart)
        fmt::print(", {} alone", scene.physics == Physics::mechanics ? "mechanics" : "electrophysiology");
      for (const FibrePlan& fibre : wall.fibres)
        fmt::print(", cells {} activated at {} ms", fibre.cells, fibre.activation_ms);
      fmt::print("\n");
    }
    if (scene.physics == Physics::heart)
      fmt::print("  blood volume {:.1f} mL, period {} s, step {} s\n",
                 total_volume(scene.circulation, scene.initial.data()), scene.period_s, scene.dt_s);
    for (const std::string& warning : scene.warnings) fmt::print("note: {}\n", warning);
  });
}

}  // namespace wiggers::command
