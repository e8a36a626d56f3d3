#include "application.hpp"

#include <cstdio>
#include <exception>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/progress.hpp>
#include <wiggers/heart/run/summary.hpp>
#include <wiggers/heart/scene/tissue_services.hpp>

#include "verbs.hpp"

namespace wiggers::command {

namespace {

// The first word that is no verb or option where it stands, with the nearest that is; empty if all are known.
std::string unknown_word(const CLI::App& app, const std::vector<std::string>& words) {
  const CLI::App* at = &app;
  std::string said = "wiggers";
  const auto refuse = [&](const char* kind, const std::string& word, const std::vector<std::string>& known) {
    const std::string nearest = nearest_name(word, known);
    return std::string("unknown ") + kind + " '" + word + "'" +
           (nearest.empty() ? "." : "; did you mean '" + nearest + "'?") + " See " + said + " --help";
  };
  for (const std::string& word : words) {
    const bool option =
        word.size() > 1 && word[0] == '-' && !(word[1] >= '0' && word[1] <= '9') && word[1] != '.';
    if (option) {
      const std::string name = word.substr(0, word.find('='));
      if (word.starts_with("--") ? at->get_option_no_throw(name) != nullptr
                                 : at->get_option_no_throw(word.substr(0, 2)) != nullptr)
        continue;
      std::vector<std::string> known;
      for (const CLI::Option* o : at->get_options())
        for (const std::string& one : o->get_lnames()) known.push_back("--" + one);
      return refuse("option", name, known);
    }
    const std::vector<const CLI::App*> verbs = at->get_subcommands({});
    if (verbs.empty()) continue;
    std::vector<std::string> known;
    const CLI::App* next = nullptr;
    for (const CLI::App* verb : verbs) {
      known.push_back(verb->get_name());
      if (verb->get_name() == word) next = verb;
    }
    if (!next) return refuse("command", word, known);
    said += " " + word;
    at = next;
  }
  return {};
}

}  // namespace

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
    if (const std::string better = unknown_word(app, {argv + 1, argv + argc}); !better.empty())
      message = better;
    std::fprintf(stderr, "wiggers: bad input: %s\n", presentable(message).c_str());
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
