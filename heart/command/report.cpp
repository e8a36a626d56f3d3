#include <fmt/core.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstdlib>
#include <filesystem>
#include <memory>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/result_file.hpp>

#include "report_program.hpp"
#include "verbs.hpp"

namespace wiggers::command {

namespace fs = std::filesystem;

std::string report_python() {
  if (const char* chosen = std::getenv("WIGGERS_PYTHON")) return chosen;
  const std::string configured = WIGGERS_PYTHON_DEFAULT;
  std::error_code ignored;
  if (!configured.empty() && fs::exists(configured, ignored)) return configured;
  return "python3";
}

fs::path report_folder() {
  std::error_code ignored;
  const fs::path executable = fs::read_symlink("/proc/self/exe", ignored);
  const fs::path installed = executable.parent_path() / ".." / "share" / "wiggers" / "report";
  if (fs::is_directory(installed, ignored)) return fs::canonical(installed, ignored);
  return WIGGERS_REPORT_SOURCE;
}

int run_program(const std::vector<std::string>& words) {
  std::vector<char*> arguments;
  for (const std::string& word : words) arguments.push_back(const_cast<char*>(word.c_str()));
  arguments.push_back(nullptr);
  const pid_t child = fork();
  if (child < 0) throw ResourceError("cannot start another program");
  if (child == 0) {
    execvp(arguments[0], arguments.data());
    _exit(127);
  }
  int status = 0;
  if (waitpid(child, &status, 0) < 0) throw ResourceError("lost the report program");
  return WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
}

void add_report(CLI::App& app) {
  struct Options {
    std::string result, folder;
  };
  auto o = std::make_shared<Options>();
  CLI::App* verb = app.add_subcommand("report",
                                      "Wiggers diagram, PV loops and index table of a result, or the "
                                      "pictures of a body of tissue, one HTML file");
  verb->add_option("result", o->result, "result file of wiggers run (HDF5)")->required();
  verb->add_option("-o,--output", o->folder, "folder for the pictures and index.html [RESULT-report]");
  verb->callback([o] {
    {
      const ResultReader file(o->result);
      if (!file.has("/time") && !file.has("/load"))
        throw InputError(fmt::format("'{}' holds no beat yet: resume the run first", o->result));
    }
    if (o->folder.empty()) o->folder = fs::path(o->result).replace_extension("").string() + "-report";
    std::error_code code;
    if (fs::exists(o->folder, code) && !fs::is_directory(o->folder, code))
      throw InputError(fmt::format("-o: '{}' is a file; name a folder", o->folder));
    std::fflush(stdout);
    const std::string python = report_python();
    const int status =
        run_program({python, (report_folder() / "make_report.py").string(), o->result, o->folder});
    if (status == 127)
      throw ResourceError(fmt::format("cannot start Python as '{}'; set WIGGERS_PYTHON", python));
    if (status != 0)
      throw ResourceError(
          fmt::format("the report program ended with status {}; it needs Python with h5py and "
                      "matplotlib (make setup installs them)",
                      status));
  });
}

}  // namespace wiggers::command
