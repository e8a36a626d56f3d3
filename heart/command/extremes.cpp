#include <fmt/core.h>
#include <fmt/format.h>

#include <filesystem>
#include <memory>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/files.hpp>
#include <wiggers/core/settings.hpp>
#include <wiggers/heart/measure/extremes.hpp>

#include "shared.hpp"
#include "verbs.hpp"

namespace wiggers::command {

void add_extremes(CLI::App& app) {
  struct Options {
    std::string subject, output;
    std::vector<std::string> set;
    ExtremesSettings settings;
    bool quiet = false;
  };
  auto o = std::make_shared<Options>();
  CLI::App* verb = app.add_subcommand(
      "extremes", "Largest stable and largest accurate steps, and random draws far outside the usual");
  verb->add_option("subject", o->subject, "cell or force model, 'loop', a loop file or a scene (TOML)")
      ->required();
  verb->add_option("--set", o->set, "change a key of the scene or loop file")->take_all();
  verb->add_option("--beats", o->settings.beats, "beats that a stable step completes [10; hearts at most 3]");
  CLI::Option* draws = verb->add_option("--draws", o->settings.draws, "random draws [1000; hearts 100]");
  verb->add_option("--seed", o->settings.seed, "seed of the draws [1]");
  verb->add_option("-o,--output", o->output, "JSON file of the study");
  verb->add_flag("--quiet", o->quiet, "no progress");
  verb->callback([o, draws] {
    check_option("--beats", o->settings.beats, 1, 1000);
    check_option("--draws", o->settings.draws, 0, 1e6);
    if (!o->output.empty()) require_writable(o->output, "-o", FileKind::study);
    Progress progress("extremes", o->quiet ? Progress::Style::quiet : Progress::Style::automatic);
    ExtremesStudy study;
    if (!o->set.empty() && !o->subject.ends_with(".toml"))
      throw InputError("--set changes a scene or a loop file: name the file");
    if (o->subject == "loop") {
      study = extremes_loop(find_circulation_set("wiggers-healthy-0d").loop, o->settings, progress);
    } else if (o->subject.ends_with(".toml")) {
      auto table = parse_settings_file(o->subject);
      const bool is_scene =
          SettingsReader(table, o->subject).has("walls") || SettingsReader(table, o->subject).has("base");
      if (is_scene) {
        if (draws->count() == 0) o->settings.draws = 100;
        study = extremes_heart(o->subject, o->set, o->settings, progress);
      } else {
        for (const std::string& assignment : o->set) override_setting(*table, assignment);
        SettingsReader reader(table, std::filesystem::path(o->subject).filename().string());
        study = extremes_loop(read_loop(reader), o->settings, progress);
      }
    } else {
      const CellModel& model = find_model(o->subject);
      study = model.is_ionic() ? extremes_cell(model, o->settings, progress)
                               : extremes_force(model, o->settings, progress);
    }
    progress.finish();
    fmt::print("{}", extremes_table(study));
    if (!o->output.empty()) {
      write_extremes(study, o->output);
      fmt::print("written: {}\n", o->output);
    }
    if (!study.draws.unexplained.empty())
      throw NumericalFailure(
          fmt::format("{} draws ended without an explanation", study.draws.unexplained.size()));
  });
}

}  // namespace wiggers::command
