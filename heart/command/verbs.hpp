// The verbs of the `wiggers` command: each adds itself to the command line; what it does runs in its
// callback.
#pragma once

#include <CLI/CLI.hpp>

namespace wiggers::command {

void add_run(CLI::App& app);
void add_check(CLI::App& app);
void add_cell(CLI::App& app);
void add_force(CLI::App& app);
void add_loop(CLI::App& app);
void add_models(CLI::App& app);
void add_report(CLI::App& app);
void add_doctor(CLI::App& app);
void add_trade(CLI::App& app);
void add_extremes(CLI::App& app);

}  // namespace wiggers::command
