// Limit cycles: fixed points of a beat map P, by plain pacing or by safeguarded Anderson acceleration, with a
// certificate that states the distance to the cycle rather than the last change.
//
// Let r = max_i |P(x)_i - x_i| / s_i with scales s. With lambda the largest multiplier of P on the leaf of
// its invariants, the distance to the cycle is about r / (1 - lambda): for slow cells hundreds of times r.
#pragma once

#include <array>
#include <string>
#include <string_view>
#include <vector>

namespace wiggers {

class SavedNumbers;

enum class LimitCycleMethod { anderson, newton, kinsol, pacing };
// Refuses an unknown name with the nearest.
LimitCycleMethod limit_cycle_method(std::string_view name);

struct LimitCycleSettings {
  LimitCycleMethod method = LimitCycleMethod::anderson;
  double distance = 1e-6;    // stop when the estimated scaled distance to the cycle is below this
  double map_noise = 1e-13;  // relative accuracy of P itself; no residual below it is asked for
  int depth = 10;            // Anderson's memory, in beats
  int plain_beats = 3;       // beats before acceleration starts; the fast transient would spoil the model
  int relaxing_beats = 1;    // plain beats after each jump, in which the fast directions catch up
  int max_beats = 2000;
};

// period_1: a cycle of one beat. period_2: alternans, every second beat agrees. drifting: the state moves
// along one line without slowing down. not_converged: none of these within the beats allowed.
enum class LimitCycleVerdict { running, period_1, period_2, drifting, not_converged };
std::string to_string(LimitCycleVerdict verdict);
inline constexpr std::array limit_cycle_verdicts = {LimitCycleVerdict::running, LimitCycleVerdict::period_1,
                                                    LimitCycleVerdict::period_2, LimitCycleVerdict::drifting,
                                                    LimitCycleVerdict::not_converged};
// The verdict with this text; refuses others with the nearest.
LimitCycleVerdict limit_cycle_verdict(std::string_view name);
// The verdict with this number in a saved state.
LimitCycleVerdict take_verdict(SavedNumbers& in);

// A search that its map's noise ends farther from the cycle than this has not found it.
inline constexpr double largest_noisy_distance = 1e-4;

struct LimitCycleCertificate {
  LimitCycleVerdict verdict = LimitCycleVerdict::running;
  double distance = 0;    // estimated scaled distance of the last P(x) to the cycle
  double residual = 0;    // scaled change over the last beat
  double multiplier = 0;  // estimated leading multiplier on the leaf
  int beats = 0;          // beats spent, Newton's perturbed ones included
};

// One beat at a time, so that the caller can checkpoint between beats and resume bit for bit:
//   while (search.running()) { P = beat(x); x = search.next(x, P); }
// After the last call, next() returns P itself: a state of the plain beat map, never an extrapolation.
class LimitCycleSearch {
 public:
  // positive[i]: component i (a concentration, a pressure head) must stay positive; a proposal changes it by
  // at most a factor of two, or is shortened as a whole. Empty: none.
  LimitCycleSearch(LimitCycleSettings settings, std::vector<double> scales, std::vector<bool> positive = {});

  bool running() const { return certificate_.verdict == LimitCycleVerdict::running; }
  const LimitCycleCertificate& certificate() const { return certificate_; }

  // Given x and P(x): records the beat and proposes the next start. The proposal may leave the admissible set
  // (probabilities, positive concentrations, the leaf of an invariant): the caller brings it back.
  std::vector<double> next(const std::vector<double>& x, const std::vector<double>& image);

  // The beat from an extrapolated start failed: go back to the best state and pace from there. Returns the
  // new start; false in `recovered` if there is nothing to go back to (the failure is genuine).
  std::vector<double> after_failure(bool& recovered);

  // Everything that the next beats depend on, as plain numbers.
  std::vector<double> save() const;
  // Refuses what no search over states of this size has saved.
  void restore(SavedNumbers saved);

 private:
  struct Pair {
    std::vector<double> x;  // scaled start
    std::vector<double> f;  // scaled P(x) - x
  };
  void judge(double step_to_fixed_point);
  std::vector<double> unscaled(const std::vector<double>& x, const std::vector<double>& f) const;

  LimitCycleSettings settings_;
  std::vector<double> scales_;
  std::vector<Pair> history_;
  Pair best_;
  double best_residual_ = 0;
  std::vector<bool> positive_;
  bool accelerated_ = false;  // the last proposal was an extrapolation
  int plain_left_ = 0;
  int relaxing_ = 0;     // plain beats left before the next jump
  bool jumped_ = false;  // there was a jump since the search last fell back to the best state
  LimitCycleCertificate certificate_;
};

}  // namespace wiggers
