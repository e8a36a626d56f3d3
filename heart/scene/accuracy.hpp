// Named settings of cells, loops and hearts: the points on the trade curves that the toolkit offers by one
// word. The expected errors are what `wiggers trade` measures for them (docs/trade.md has the tables); beside
// each stands what it is meant to keep.
#pragma once

#include <string>
#include <string_view>
#include <vector>
#include <wiggers/cellmodels/pacing/pacing.hpp>
#include <wiggers/circulation/loop.hpp>

namespace wiggers {

struct CellAccuracy {
  std::string_view name;
  CellIntegrator integrator;
  std::string_view expected;  // error of one beat, all ionic models
  double distance;            // to the limit cycle, that its noise allows
};
struct LoopAccuracy {
  std::string_view name;
  LoopIntegrator integrator;
  std::string_view expected;
};
struct HeartAccuracy {
  std::string_view name;
  std::vector<std::string> overrides;  // of the scene's [solver]
  std::string_view expected;
};

// draft | standard | reference; hearts also know `founding`, the scheme of the whole-heart paper. Each
// refuses an unknown name with the nearest.
const CellAccuracy& cell_accuracy(std::string_view name);
const LoopAccuracy& loop_accuracy(std::string_view name);
const HeartAccuracy& heart_accuracy(std::string_view name);

}  // namespace wiggers
