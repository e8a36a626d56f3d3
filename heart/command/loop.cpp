#include <fmt/core.h>
#include <fmt/format.h>

#include <chrono>
#include <cmath>
#include <memory>
#include <wiggers/circulation/loop.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/files.hpp>
#include <wiggers/core/memory.hpp>
#include <wiggers/core/progress.hpp>
#include <wiggers/heart/run/rate_warnings.hpp>
#include <wiggers/heart/run/summary.hpp>
#include <wiggers/heart/scene/accuracy.hpp>
#include <wiggers/heart/study/loop_study.hpp>

#include "shared.hpp"
#include "verbs.hpp"

namespace wiggers::command {

void add_loop(CLI::App& app) {
  struct Options {
    std::string accuracy, file, until, output, method = "anderson";
    std::vector<std::string> set;
    LoopIntegrator integrator;
    double sample_ms = 1, distance = 1e-8;
    int beats = 0, max_beats = 500;
    bool quiet = false, json = false;
  };
  auto o = std::make_shared<Options>();
  CLI::App* verb = app.add_subcommand("loop", "0D circulation with elastance chambers");
  verb->add_option("file", o->file, "loop file (TOML), see docs/formats.md")->required();
  verb->add_option("--set", o->set, "change a key of the file: elastance.LV.EA=3")->take_all();
  verb->add_option("--beats", o->beats, "number of beats");
  verb->add_option("--until", o->until, "limit-cycle: run until the loop repeats itself");
  verb->add_option("--method", o->method,
                   "limit-cycle search: anderson | newton | kinsol | pacing [anderson]");
  verb->add_option("--distance", o->distance, "scaled distance to the limit cycle, 1 [1e-8]");
  verb->add_option("--max-beats", o->max_beats, "give up on the limit cycle after so many beats [500]");
  CLI::Option* accuracy = verb->add_option(
      "--accuracy", o->accuracy, "draft | standard | reference: integrator and step together [standard]");
  CLI::Option* integrator =
      verb->add_option("--integrator", o->integrator.name, "cvode | forward-euler | runge-kutta-4 [cvode]");
  CLI::Option* dt =
      verb->add_option("--dt-s", o->integrator.dt_s, "step of the fixed-step integrators, s [1e-3]");
  CLI::Option* rtol =
      verb->add_option("--rtol", o->integrator.relative_tolerance, "relative tolerance of cvode, 1 [1e-9]");
  CLI::Option* atol = verb->add_option("--atol", o->integrator.absolute_tolerance,
                                       "absolute tolerance of cvode, mmHg, mL, mL/s [1e-9]");
  verb->add_option("--sample-ms", o->sample_ms, "spacing of the output rows, ms [1]");
  verb->add_option("-o,--output", o->output, "CSV file of the last beat");
  verb->add_flag("--quiet", o->quiet, "no progress");
  verb->add_flag("--json", o->json, "end standard output with one line of JSON");
  accuracy->excludes(integrator)->excludes(dt)->excludes(rtol)->excludes(atol);
  verb->callback([o] {
    if (!o->accuracy.empty()) {
      const LoopAccuracy& chosen = loop_accuracy(o->accuracy);
      o->integrator = chosen.integrator;
      fmt::print("accuracy {}: {}\n", chosen.name, chosen.expected);
    }
    const bool to_cycle = end_of_run(o->until, o->beats);
    const LimitCycleMethod method = limit_cycle_method(o->method);
    if (!o->output.empty()) require_writable(o->output, "-o", FileKind::table);
    check_limit_cycle_options(o->distance, o->max_beats);
    check_option("--sample-ms", o->sample_ms, 1e-3, 1e5);
    check_option("--rtol", o->integrator.relative_tolerance, 1e-13, 0.1);
    check_option("--atol", o->integrator.absolute_tolerance, 1e-14, 1);
    auto table = parse_settings_file(o->file);
    for (const std::string& assignment : o->set) override_setting(*table, assignment);
    SettingsReader reader(table, std::filesystem::path(o->file).filename().string());
    const Loop loop = read_loop(reader);
    if (!(o->sample_ms >= 1e-3 && o->sample_ms * 1e-3 <= loop.period_s))
      throw InputError(fmt::format("--sample-ms {} is outside 0.001 to the period", o->sample_ms));
    require_memory(1e3 * loop.period_s / std::min(o->sample_ms, 1.0),
                   static_cast<double>(circulation_columns(loop.circulation)),
                   fmt::format("--sample-ms {} over a period of {} s", o->sample_ms, loop.period_s),
                   "Take a larger --sample-ms.");
    const LoopSolver solver(loop, o->integrator);

    const auto begin = std::chrono::steady_clock::now();
    Progress progress("loop", o->quiet ? Progress::Style::quiet : Progress::Style::automatic);
    CirculationValues state = loop.initial;
    LoopSummary summary;
    summary.title = std::filesystem::path(o->file).stem().string();
    summary.circulation = loop.circulation;
    summary.limit_cycle_wanted = to_cycle;
    summary.wanted_distance = o->distance;
    const double volume = total_volume(loop.circulation, state.data());
    if (to_cycle) {
      LimitCycleSettings settings = loop_cycle_settings(o->distance);
      settings.max_beats = o->max_beats;
      settings.method = method;
      summary.certificate = solver.to_limit_cycle(state, settings, [&](const LimitCycleCertificate& c) {
        progress.update(-1, fmt::format("beat {}, distance {:.1e}", c.beats, c.distance));
      });
      summary.beats = summary.certificate.beats;
      if (summary.certificate.verdict == LimitCycleVerdict::period_1)
        summary.integrator_shift = solver.integrator_shift(state);
    } else {
      for (; summary.beats < o->beats - 1; ++summary.beats) {
        solver.beat(state);
        progress.update(static_cast<double>(summary.beats) / o->beats);
      }
    }
    // Indexes are of the solution, whatever the spacing of the output.
    summary.indexes = loop_indexes(solver, state);
    if (to_cycle && summary.certificate.good())
      summary.certificate.warnings = ejection_warnings(summary.indexes);
    Table output = circulation_table(loop.circulation);
    summary.trace = circulation_table(loop.circulation);
    if (o->sample_ms > 1) {
      CirculationValues same = state;
      solver.beat(same, o->sample_ms * 1e-3, &output);
    }
    PhysicalSense sense;
    solver.beat(state, std::min(o->sample_ms, 1.0) * 1e-3, &summary.trace, &sense);
    ++summary.beats;
    if (!to_cycle && sense.finding()) {
      summary.certificate.verdict = LimitCycleVerdict::unphysical;
      summary.certificate.reason = sense.finding()->text();
    }
    summary.blood_volume_drift_mL = std::abs(total_volume(loop.circulation, state.data()) - volume);
    summary.wall_s = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
    progress.finish(fmt::format("{} beats", summary.beats));

    fmt::print("{}\n{}", index_table(summary.indexes, 1.9), shunt_lines(summary.trace));
    if (to_cycle)
      fmt::print("limit cycle: {}, distance {:.1e} after {} beats (leading multiplier {:.3f})\n",
                 summary.certificate.text_with_warnings(), summary.certificate.distance,
                 summary.certificate.beats, summary.certificate.multiplier);
    if (summary.integrator_shift)
      fmt::print("  {} moves the cycle by {:.1e}; blood volume held, drift of the last beat {:.1e} mL\n",
                 o->integrator.name == "cvode" ? "a tolerance ten times smaller" : "half the step",
                 *summary.integrator_shift, summary.blood_volume_drift_mL);
    if (!o->output.empty()) {
      write_csv(o->output, o->sample_ms > 1 ? output : summary.trace, false);
      fmt::print("last beat: {}\n", o->output);
    }
    if (o->json) fmt::print("{}\n", summarise(summary).dump());
    if (summary.certificate.verdict == LimitCycleVerdict::unphysical ||
        (to_cycle && !summary.certificate.good()))
      throw NumericalFailure(limit_cycle_failure(summary.certificate));
  });
}

}  // namespace wiggers::command
