#include <fmt/core.h>
#include <fmt/format.h>

#include <filesystem>
#include <memory>
#include <wiggers/cellmodels/catalogue/force_stepper.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/files.hpp>
#include <wiggers/core/settings.hpp>
#include <wiggers/heart/measure/trade.hpp>

#include "report_program.hpp"
#include "shared.hpp"
#include "verbs.hpp"

namespace wiggers::command {

namespace {

struct Options {
  std::string subject, parameters, model, output;
  std::vector<std::string> set, tolerances;
  bool quiet = false;
};

void finish(const TradeStudy& study, const Options& o) {
  const auto tolerances = read_tolerances(study.measures, o.tolerances);
  const auto chosen = recommended(study, tolerances);
  fmt::print("{}", trade_table(study, tolerances.empty() ? std::nullopt : chosen));
  if (!o.output.empty()) {
    write_trade(study, tolerances, o.output);
    try {
      write_report("make_trade.py", std::filesystem::path(o.output) / "trade.json", o.output);
    } catch (const std::runtime_error& error) {
      fmt::print(stderr, "wiggers: no picture: {}\n", error.what());
    }
    fmt::print("\nwritten: {}\n", (std::filesystem::path(o.output) / "trade.json").string());
  }
  if (tolerances.empty()) return;
  if (!chosen) throw NumericalFailure("no setting meets these tolerances; the table shows what each reaches");
  fmt::print("\nrecommended: {}, {} ({:.3g} ms a beat)\n", study.rows[*chosen].method,
             study.rows[*chosen].setting, 1e3 * study.rows[*chosen].cost_s);
}

CLI::App* common(CLI::App* verb, const std::shared_ptr<Options>& o) {
  verb->add_option("--tolerance", o->tolerances,
                   "recommend the cheapest setting within: apd90=0.1ms; repeatable, see the table's measures")
      ->take_all();
  verb->add_option("-o,--output", o->output, "folder for trade.json, trade.md and trade.png");
  verb->add_flag("--quiet", o->quiet, "no progress");
  return verb;
}

// Refuses what could only fail after the work.
Progress progress_of(const Options& o, const std::string& name) {
  (void)read_tolerances(trade_measures(name.substr(name.find(' ') + 1)), o.tolerances);
  if (!o.output.empty() && std::filesystem::exists(o.output) && !std::filesystem::is_directory(o.output))
    throw InputError(fmt::format("-o: '{}' is a file; name a folder", o.output));
  if (!o.output.empty()) {
    std::error_code code;
    std::filesystem::create_directories(o.output, code);
    for (const char* name : {"trade.json", "trade.md"})
      require_writable(std::filesystem::path(o.output) / name, "-o", FileKind::study);
    for (const char* name : {"trade.png", "trade.svg"})
      require_writable(std::filesystem::path(o.output) / name, "-o", FileKind::picture);
  }
  return {name, o.quiet ? Progress::Style::quiet : Progress::Style::automatic};
}

}  // namespace

void add_trade(CLI::App& app) {
  CLI::App* trade =
      app.add_subcommand("trade", "Error against cost: every setting of a method, measured here and now");
  trade->require_subcommand(1);
  {
    auto o = std::make_shared<Options>();
    CLI::App* verb = common(
        trade->add_subcommand("cell", "Integrators, steps, tables and precisions of an ionic cell"), o);
    verb->add_option("model", o->subject, "cell model, see wiggers models")->required();
    verb->add_option("--parameters", o->parameters, "named parameter set [the model's first]");
    verb->add_option("--set", o->set, "change a parameter: name=value")->take_all();
    verb->callback([o] {
      const CellModel& model = find_model(o->subject);
      if (!model.is_ionic())
        throw InputError(fmt::format("{} is a force model: see wiggers trade force", model.name));
      const auto parameters = parameters_from(model, o->parameters, o->set);
      Progress progress = progress_of(*o, "trade cell");
      const TradeStudy study = trade_cell(model, parameters, progress);
      progress.finish();
      finish(study, *o);
    });
  }
  {
    auto o = std::make_shared<Options>();
    o->subject = "fedele2023-ventricles";
    CLI::App* verb =
        common(trade->add_subcommand("force", "Schemes, steps and sub-steps of a force model"), o);
    verb->add_option("parameters", o->subject, "parameter set of a force model [fedele2023-ventricles]");
    verb->add_option("--model", o->model, "force model [the one that has the set]");
    verb->callback([o] {
      const CellModel* model = nullptr;
      std::vector<std::string> known;
      for (const CellModel* candidate : force_models())
        for (const ParameterSet& set : candidate->parameter_sets) {
          if (!o->model.empty() && candidate->name != o->model) continue;
          known.emplace_back(set.name);
          if (set.name != o->subject) continue;
          if (model)
            throw InputError(fmt::format("{} and {} both have a set '{}': give --model", model->name,
                                         candidate->name, o->subject));
          model = candidate;
        }
      if (!model) refuse_unknown("parameter set of a force model", o->subject, known);
      Progress progress = progress_of(*o, "trade force");
      const TradeStudy study = trade_force(*model, o->subject, progress);
      progress.finish();
      finish(study, *o);
    });
  }
  {
    auto o = std::make_shared<Options>();
    CLI::App* verb =
        common(trade->add_subcommand("loop", "Integrators, steps and tolerances of a 0D loop"), o);
    verb->add_option("file", o->subject, "loop file (TOML) [the set wiggers-healthy-0d]");
    verb->add_option("--set", o->set, "change a key of the file: elastance.LV.EA=3")->take_all();
    verb->callback([o] {
      Loop loop = find_circulation_set("wiggers-healthy-0d").loop;
      if (o->subject.empty() && !o->set.empty()) throw InputError("--set changes a loop file: name the file");
      if (!o->subject.empty()) {
        auto table = parse_settings_file(o->subject);
        for (const std::string& assignment : o->set) override_setting(*table, assignment);
        SettingsReader reader(table, std::filesystem::path(o->subject).filename().string());
        loop = read_loop(reader);
      }
      Progress progress = progress_of(*o, "trade loop");
      const TradeStudy study = trade_loop(loop, progress);
      progress.finish();
      finish(study, *o);
    });
  }
  {
    auto o = std::make_shared<Options>();
    CLI::App* verb = common(trade->add_subcommand("heart", "Steps and schemes of a scene"), o);
    verb->add_option("scene", o->subject, "scene file (TOML)")->required();
    verb->add_option("--set", o->set, "change a key of the scene")->take_all();
    verb->callback([o] {
      const bool tissue = has_tissue(o->subject, o->set);
      Progress progress = progress_of(*o, tissue ? "trade tissue" : "trade heart");
      const TradeStudy study = (tissue ? trade_tissue : trade_heart)(o->subject, o->set, progress);
      progress.finish();
      finish(study, *o);
    });
  }
}

}  // namespace wiggers::command
