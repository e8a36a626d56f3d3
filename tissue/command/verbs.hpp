// The verbs of the `wiggers` command that the tissue brings.
#pragma once

#include <CLI/CLI.hpp>

namespace wiggers::command {

void add_mesh(CLI::App& app);
void add_fibres(CLI::App& app);
void add_benchmark(CLI::App& app);

}  // namespace wiggers::command
