// Where the report's Python programs and their interpreter are, and how their answer is taken: they draw,
// this command writes (see heart/report/answer.py).
#pragma once

#include <filesystem>
#include <string>
#include <vector>

namespace wiggers::command {

// WIGGERS_PYTHON from the environment, else the interpreter of the project's own setup, else python3.
std::string report_python();
// The folder of make_report.py: beside an installed command, else in the source tree.
std::filesystem::path report_folder();

// Runs one of the programs on `subject` and writes the files that it sends into `folder`, the page last, then
// shows its lines. Nothing is written unless the program came to its end. Throws InputError where the subject
// is at fault and ResourceError otherwise, with the reason.
void write_report(const std::string& program, const std::filesystem::path& subject,
                  const std::filesystem::path& folder);

// Runs a program whose output is of no interest; its exit status, 127 if it could not be started.
int run_program(const std::vector<std::string>& words);

}  // namespace wiggers::command
