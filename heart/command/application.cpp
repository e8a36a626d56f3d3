#include "application.hpp"

#include <cstdio>
#include <exception>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/progress.hpp>
#include <wiggers/heart/summary.hpp>
#include <wiggers/heart/tissue_kind.hpp>

#include "verbs.hpp"

namespace wiggers::command {

int run_application(int argc, char** argv, const std::function<void(CLI::App&)>& add_more) {
  catch_interrupts();
  CLI::App app("wiggers: from a single heart cell to a full beat");
  app.require_subcommand(1);
  app.set_version_flag("--version", version_text());
  app.failure_message(CLI::FailureMessage::help);
  command::add_run(app);
  command::add_check(app);
  command::add_cell(app);
  command::add_force(app);
  command::add_loop(app);
  command::add_models(app);
  command::add_report(app);
  command::add_doctor(app);
  command::add_trade(app);
  command::add_extremes(app);
  add_more(app);
  const auto say = [](const char* kind, const std::exception& error) {
    std::fflush(stdout);
    std::fprintf(stderr, "wiggers: %s: %s\n", kind, error.what());
  };
  try {
    app.parse(argc, argv);
    if (std::fflush(stdout) != 0) throw ResourceError("cannot write to standard output");
    return 0;
  } catch (const CLI::ParseError& error) {
    if (error.get_exit_code() == 0) return app.exit(error);  // --help, --version
    std::string message = error.what();
    if (argc > 1 && argv[1][0] != '-' && app.get_subcommands().empty()) {
      std::vector<std::string> verbs;
      for (const CLI::App* verb : app.get_subcommands({})) verbs.push_back(verb->get_name());
      const std::string nearest = nearest_name(argv[1], verbs);
      message = "unknown command '" + std::string(argv[1]) + "'" +
                (nearest.empty() ? "" : "; did you mean '" + nearest + "'?") + " See wiggers --help";
    }
    std::fprintf(stderr, "wiggers: bad input: %s\n", message.c_str());
    return 2;
  } catch (const TissueNeeded&) {
    throw;
  } catch (const InputError& error) {
    say("bad input", error);
    return 2;
  } catch (const Interrupted& error) {
    say("interrupted", error);
    return 1;
  } catch (const NumericalFailure& error) {
    say("the computation failed", error);
    return 1;
  } catch (const std::exception& error) {
    say("failed", error);
    return 1;
  }
}

}  // namespace wiggers::command
