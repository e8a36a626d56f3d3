// The door through which 3D tissue enters scenes. heart/ knows no deal.II: where the tissue was built and
// linked, it registers how its tables are read, its walls are made and bodies of tissue alone are run.
#pragma once

#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/settings.hpp>
#include <wiggers/heart/walls/wall.hpp>

namespace wiggers {

struct Scene;
struct WallPlan;
struct PacedCellType;

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

struct TissueKind {
  // Reads the table of a wall or body, but for its cells, into plan.tissue; of a body also its cavities.
  std::function<void(SettingsReader& table, const Scene& scene, WallPlan& plan)> read;
  std::function<std::unique_ptr<Wall>(const Scene& scene, const WallPlan& plan,
                                      const std::map<std::string, PacedCellType>& cells)>
      make;
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

// `read`, `make`, `run_body` and `check` are empty where no tissue is linked.
TissueKind& tissue_kind();

}  // namespace wiggers
