#include <fmt/core.h>

#include <filesystem>
#include <memory>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/files.hpp>
#include <wiggers/core/result_file.hpp>

#include "report_program.hpp"
#include "verbs.hpp"

namespace wiggers::command {

namespace fs = std::filesystem;

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
      file.require_sensible_sizes();
      if (!file.has("/time") && !file.has("/load"))
        throw InputError(fmt::format("'{}' holds no beat yet: resume the run first", o->result));
      // What was changed since it was written is not drawn as if it were a result. Others may write results,
      // too.
      if (file.has("/provenance/checksums")) file.verify();
    }
    if (o->folder.empty()) o->folder = fs::path(o->result).replace_extension("").string() + "-report";
    std::error_code code;
    if (fs::exists(o->folder, code) && !fs::is_directory(o->folder, code))
      throw InputError(fmt::format("-o: '{}' is a file; name a folder", o->folder));
    if (fs::is_directory(o->folder, code))
      require_writable(fs::path(o->folder) / "index.html", "-o", FileKind::page);
    write_report("make_report.py", o->result, o->folder);
  });
}

}  // namespace wiggers::command
