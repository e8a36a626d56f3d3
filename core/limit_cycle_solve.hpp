// From a beat map to its limit cycle, by any of the methods. For callers that need no checkpoint between
// beats; those drive a LimitCycleSearch themselves.
//
//   anderson   safeguarded Anderson acceleration (limit_cycle.hpp); the default
//   newton     after a few accelerated beats, Newton with the beat map's Jacobian from perturbed beats,
//   reused while it
//              contracts (chord iterations). The multipliers are then eigenvalues, not estimates.
//   kinsol     KINSOL's fixed-point iteration with Anderson acceleration: no safeguards, for comparison
//   pacing     beat after beat
//
// A paced cell may have several attractors: the same cell under the same stimuli follows every one of them,
// or every second one only. With Attractor::paced, anderson first paces until the rhythm is clear
// (rhythm.hpp), then accelerates the map of so many beats; a jump that changes the rhythm is taken back, a
// search that gets nowhere goes back to pacing, and a cycle of one beat that alternation would leave is not
// taken for one.
#pragma once

#include <functional>
#include <vector>
#include <wiggers/core/limit_cycle.hpp>

namespace wiggers {

struct BeatMap {
  using State = std::vector<double>;
  std::vector<double> scales;               // of the distance, one a component
  std::vector<bool> positive;               // components that must stay positive; empty: none
  std::function<State(const State&)> beat;  // one period; throws NumericalFailure
  std::function<void(State&)> admit;        // brings a proposal back to the admissible set and the leaf
  std::function<std::vector<State>(const std::vector<State>&)> beats;  // several at once; empty: one by one
};

using AfterBeat = std::function<void(const LimitCycleCertificate&)>;

// `state` ends on the cycle, or where the search gave up: the verdict says which.
LimitCycleCertificate find_limit_cycle(const BeatMap& map, const LimitCycleSettings& settings,
                                       BeatMap::State& state, const AfterBeat& after_beat = {});

}  // namespace wiggers
