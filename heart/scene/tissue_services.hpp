// What only a program with 3D tissue can do, besides its kind of wall (scene/wall_kind.hpp): bodies of tissue
// alone, its own check, and work among MPI's ranks. heart/ knows no deal.II.
#pragma once

#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <wiggers/core/errors.hpp>

namespace wiggers {

struct Scene;

// A scene, or a verb, that needs the tissue where there is none.
struct TissueNeeded : InputError {
  static constexpr const char* reason =
      "this build has no 3D tissue (it was configured without deal.II, PETSc and gmsh): install "
      "libdeal.ii-dev "
      "and libgmsh-dev and build again, or use kind = \"reduced\"";
  explicit TissueNeeded(const std::string& place) : InputError(place + ": " + reason) {}
};

// How a body of tissue alone is to be run, and what is said of it afterwards.
struct BodyRequest {
  std::optional<std::filesystem::path> result;  // also the checkpoint
  std::optional<std::filesystem::path> resume;  // go on from this result of the same scene
  bool quiet = false;
};
struct BodyOutcome {
  std::string text;  // for people
  std::string json;  // one line
};

struct TissueServices {
  // Runs a scene's body of tissue alone.
  std::function<BodyOutcome(const Scene& scene, const BodyRequest& request)> run_body;
  // Solves a small problem whose answer is known; says what was found, throws where it is wrong.
  std::function<std::string()> check;
  bool quiet = false;  // walls and bodies show no progress of their start and no notes on their mesh
  // Under MPI: does the work on the first rank; what it throws is thrown on all.
  std::function<void(const std::function<void()>& work)> on_first_rank = [](const auto& work) { work(); };
  // Under MPI: whether it is so on any rank.
  std::function<bool(bool)> any_rank = [](bool value) { return value; };
};

// `run_body` and `check` are empty where no tissue is linked.
TissueServices& tissue_services();

}  // namespace wiggers
