// What the methods bear: the largest stable and the largest accurate step of every scheme under harsh
// conditions, and random draws far outside the usual, each of which must end in a physical answer or an
// explained failure.
#pragma once

#include <filesystem>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <vector>
#include <wiggers/cellmodels/catalogue/catalogue.hpp>
#include <wiggers/circulation/loop.hpp>
#include <wiggers/core/progress.hpp>

namespace wiggers {

// One scheme under one condition. Steps in the subject's unit; nothing if no step of the search serves.
struct StabilityRow {
  std::string scheme, condition;
  std::optional<double> stable;    // completes with physical states
  std::optional<double> accurate;  // the first measure within its first bar
  std::optional<double> roughly;   // within its second bar
  std::string note;                // why the step above the stable one fails
};

struct DrawOutcome {
  long draws = 0, completed = 0, refused = 0, failed = 0;
  std::map<std::string, long> reasons;  // of refusals and failures, shortened, with their number
  std::vector<std::string>
      unexplained;  // what must not be: a value that is no number, an unknown exception, a hang
};

struct ExtremesStudy {
  std::string subject, step_unit, accurate_means, roughly_means;
  std::vector<StabilityRow> rows;
  DrawOutcome draws;
};

struct ExtremesSettings {
  int beats = 10;  // a step is stable if so many beats complete
  int draws = 1000;
  unsigned seed = 1;
};

ExtremesStudy extremes_cell(const CellModel& model, const ExtremesSettings& settings, Progress& progress);
ExtremesStudy extremes_force(const CellModel& model, const ExtremesSettings& settings, Progress& progress);
ExtremesStudy extremes_loop(const Loop& loop, const ExtremesSettings& settings, Progress& progress);
ExtremesStudy extremes_heart(const std::filesystem::path& scene, const std::vector<std::string>& overrides,
                             const ExtremesSettings& settings, Progress& progress);

std::string extremes_table(const ExtremesStudy& study);
void write_extremes(const ExtremesStudy& study, const std::filesystem::path& path);  // JSON

// The largest step in (smallest, largest) for which `good` holds, to 10 %: descends by halves, then bisects.
std::optional<double> largest_step(double smallest, double largest, const std::function<bool(double)>& good);

// Runs one draw and books its outcome; `work` throws InputError or NumericalFailure, or returns whether all
// its numbers are finite and physical. `what` describes the draw.
void book_draw(DrawOutcome& outcome, const std::string& what, const std::function<bool()>& work);

}  // namespace wiggers
