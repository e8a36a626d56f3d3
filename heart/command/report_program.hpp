// Where the report's Python program and its interpreter are.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

namespace wiggers::command {

// WIGGERS_PYTHON from the environment, else the interpreter of the project's own setup, else python3.
std::string report_python();
// The folder of make_report.py: beside an installed command, else in the source tree.
std::filesystem::path report_folder();
// Runs a program with the terminal's input and output; its exit status, 127 if it could not be started.
int run_program(const std::vector<std::string>& words);

}  // namespace wiggers::command
