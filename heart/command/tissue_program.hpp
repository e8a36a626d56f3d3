// Where the command with 3D tissue is, and what it says.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

namespace wiggers::command {

// wiggers-3d beside the executable that is running, whether it is there or not.
std::filesystem::path tissue_program();

struct ProgramOutput {
  int status = 0;  // 127: it could not be started; 128 + the signal that ended it
  bool timed_out = false;
  std::string text;               // standard output and error
  std::string last_line() const;  // that is not empty
};
// Runs a program without input; ends it after so many seconds.
ProgramOutput read_program(const std::vector<std::string>& words, int limit_s);

}  // namespace wiggers::command
