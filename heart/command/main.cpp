// wiggers: from a single heart cell to a full beat. This executable starts at once because it links none of
// the libraries of the 3D tissue; where those are asked for, it hands over to wiggers-3d beside it.
#include <fmt/core.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cstdio>
#include <cstdlib>
#include <string_view>
#include <wiggers/core/files.hpp>
#include <wiggers/heart/scene/tissue_services.hpp>

#include "application.hpp"
#include "tissue_program.hpp"

namespace {

// Returns only if there is no such executable.
void hand_over(char** argv) {
  if (wiggers::special_file_was_read()) {
    std::fprintf(
        stderr,
        "wiggers: bad input: this scene needs wiggers-3d, which cannot read a pipe once more: write the "
        "scene to a file\n");
    std::exit(2);
  }
  std::fflush(nullptr);
  execv(wiggers::command::tissue_program().c_str(), argv);
}

}  // namespace

int main(int argc, char** argv) {
  constexpr std::array<std::string_view, 3> verbs_3d = {"mesh", "fibres", "benchmark"};
  std::string refusal;
  if (argc > 1 && std::find(verbs_3d.begin(), verbs_3d.end(), argv[1]) != verbs_3d.end()) {
    hand_over(argv);
    refusal = fmt::format("{}: {}", argv[1], wiggers::TissueNeeded::reason);
  } else {
    try {
      return wiggers::command::run_application(argc, argv, [](CLI::App&) {});
    } catch (const wiggers::TissueNeeded& needed) {
      hand_over(argv);
      refusal = needed.what();
    }
  }
  std::fprintf(stderr, "wiggers: bad input: %s\n", refusal.c_str());
  return 2;
}
