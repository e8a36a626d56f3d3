// Limit cycles of many cells of one model with parameters of their own, paced side by side in SIMD lanes.
#pragma once

#include <functional>
#include <span>
#include <string>
#include <vector>
#include <wiggers/cellmodels/pacing/cell_study.hpp>

namespace wiggers {

struct LaneResult {
  std::vector<double> state;  // at stimulus onset
  LimitCycleCertificate certificate;
  bool settled = false;  // found, and as plain pacing would have; others are to be solved one by one
};

// How many studies fill the lanes.
inline constexpr std::size_t cells_in_lanes = 8;

// True if the studies have cycles to find and differ by their model's parameters and charge alone: they can
// then be paced together.
bool share_pacing(std::span<const CellStudy> studies);

// Paces the studies together, each from its own state, until every one's search has ended. Those whose rhythm
// is not plainly one beat, and those without a cycle, are for the search of single cells. Steps are those of
// the population kernels: not split where the model's rates jump. A cell that leaves its range ends the
// attempt with NumericalFailure for all; callers then solve them one by one.
std::vector<LaneResult> to_limit_cycles_in_lanes(std::span<const CellStudy> studies,
                                                 std::vector<std::vector<double>> states,
                                                 const LimitCycleSettings& settings);

}  // namespace wiggers
