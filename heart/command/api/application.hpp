// The wiggers command without its main(): the light executable and the one with 3D tissue share it.
#pragma once

#include <CLI/CLI.hpp>
#include <functional>

namespace wiggers::command {

// Parses and runs; `add_more` adds verbs. Exit status: 0 done; 1 the computation failed or the machine
// refused; 2 bad input, nothing computed and nothing written. Throws TissueNeeded where 3D tissue is asked
// for and absent.
int run_application(int argc, char** argv, const std::function<void(CLI::App&)>& add_more);

}  // namespace wiggers::command
