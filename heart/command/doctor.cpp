#include <fmt/core.h>
#include <unistd.h>

#include <cmath>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <wiggers/cellmodels/pacing/pacing.hpp>
#include <wiggers/circulation/loop.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/result_file.hpp>
#include <wiggers/heart/run/summary.hpp>
#include <wiggers/heart/scene/tissue_services.hpp>

#include "report_program.hpp"
#include "tissue_program.hpp"
#include "verbs.hpp"

namespace wiggers::command {

namespace {

struct Finding {
  std::string name;
  bool good = false;
  std::string detail;
};

// A cell paced for one beat fires and keeps its charge, if it has one.
Finding check_cell(const CellModel& model) {
  const auto parameters = model.parameter_values("default");
  PacedCell cell(model, parameters, {1000, model.default_stimulus}, {"cvode", 1e-8, 1e-10, 0.02});
  std::vector<double> state = model.default_state();
  const double charge = model.charge(state.data(), parameters.data());
  double peak = -1e9;
  cell.beat(state, 1,
            [&](double, const double* y, double) { peak = std::max(peak, y[model.membrane_potential]); });
  const double drift = std::abs(model.charge(state.data(), parameters.data()) - charge);
  return {fmt::format("cell {}", model.name), peak > 0 && drift < 1e-2,
          fmt::format("peak {:.1f} mV, charge drift {:.1e} mV", peak, drift)};
}

Finding check_loop() {
  const LoopSolver solver(find_circulation_set("wiggers-healthy-0d").loop, {});
  CirculationValues state = solver.loop().initial;
  const double volume = total_volume(solver.loop().circulation, state.data());
  solver.beat(state);
  const double drift = std::abs(total_volume(solver.loop().circulation, state.data()) - volume);
  return {"circulation", drift < 1e-8, fmt::format("blood volume drift {:.1e} mL", drift)};
}

Finding check_files() {
  const auto path = std::filesystem::temp_directory_path() / fmt::format("wiggers-doctor-{}.h5", getpid());
  ResultWriter writer;
  writer.scalar("/x", 0.1, "1", "trial");
  writer.write(path);
  bool good = false;
  {
    const ResultReader reader(path);
    good = reader.scalar("/x") == 0.1;
  }
  std::filesystem::remove(path);
  return {"result files", good, "written and read back"};
}

// The 3D tissue is in the command that is running, or in the wiggers-3d that it hands over to, or nowhere.
bool has_tissue() { return tissue_services().check || std::filesystem::exists(tissue_program()); }

std::string check_tissue() {
  if (tissue_services().check) return tissue_services().check();
  const std::string program = tissue_program().string();
  const auto ask = [&](std::vector<std::string> words) {
    words.insert(words.begin(), program);
    const ProgramOutput said = read_program(words, 120);
    if (said.timed_out) throw ResourceError(fmt::format("{} does not end", program));
    if (said.status == 127) throw ResourceError(fmt::format("{} cannot be started", program));
    if (said.status != 0)
      throw ResourceError(fmt::format("{} ended with status {}: {}", program, said.status, said.last_line()));
    return said.last_line();
  };
  const std::string version = ask({"--version"});
  if (version != version_text())
    throw ResourceError(
        fmt::format("{} is of another build, {}: 3D scenes would run with that one", program, version));
  return ask({"doctor", "--tissue"});
}

}  // namespace

void add_doctor(CLI::App& app) {
  CLI::App* verb = app.add_subcommand("doctor", "What was built with what, and is it healthy");
  const auto tissue_alone = std::make_shared<bool>(false);
  verb->add_flag("--tissue", *tissue_alone, "check the 3D tissue alone and say in one line what was found");
  verb->callback([tissue_alone] {
    if (*tissue_alone) {
      if (!has_tissue()) throw ResourceError(TissueNeeded::reason);
      fmt::print("{}\n", check_tissue());
      return;
    }
    fmt::print("{}\n{}\n", version_text(), WIGGERS_BUILD_FACTS);
    std::vector<Finding> findings;
    const auto attempt = [&](const std::string& name, auto&& check) {
      try {
        findings.push_back(check());
      } catch (const std::exception& error) {
        findings.push_back({name, false, error.what()});
      }
    };
    for (const CellModel* model : catalogue())
      if (model->is_ionic()) attempt(std::string(model->name), [&] { return check_cell(*model); });
    attempt("circulation", check_loop);
    attempt("result files", check_files);
    if (has_tissue()) attempt("3D tissue", [] { return Finding{"3D tissue", true, check_tissue()}; });
    std::fflush(stdout);
    const int python = run_program({report_python(), "-c", "import h5py, matplotlib, numpy"});
    findings.push_back(
        {"report (Python)", python == 0,
         python == 0 ? report_python() : "needs Python with h5py, matplotlib and numpy: make setup"});
    bool healthy = true;
    for (const Finding& f : findings) {
      fmt::print("  {:<18} {:<6} {}\n", f.name, f.good ? "good" : "BAD", f.detail);
      healthy = healthy && f.good;
    }
    if (!has_tissue())
      fmt::print("  {:<18} {:<6} no wiggers-3d beside this command\n", "3D tissue", "absent");
    if (!healthy) throw ResourceError("not healthy: see the lines marked BAD");
    fmt::print("healthy\n");
  });
}

}  // namespace wiggers::command
