// Limit cycles: fixed points of a beat map P, by plain pacing or by safeguarded Anderson acceleration, with a
// certificate that states the distance to the cycle rather than the last change.
//
// Let r = max_i |P(x)_i - x_i| / s_i with scales s. With lambda the largest multiplier of P on the leaf of
// its invariants, the distance to the cycle is about r / (1 - lambda): for slow cells hundreds of times r.
#pragma once

#include <array>
#include <limits>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace wiggers {

class SavedNumbers;

enum class LimitCycleMethod { anderson, newton, kinsol, pacing };
// Refuses an unknown name with the nearest.
LimitCycleMethod limit_cycle_method(std::string_view name);

// Which of several attractors: the one that plain pacing from the start is heading for, or any.
enum class Attractor { any, paced };
// Refuses an unknown name with the nearest.
Attractor attractor_named(std::string_view name);

struct LimitCycleSettings {
  LimitCycleMethod method = LimitCycleMethod::anderson;
  Attractor attractor = Attractor::any;
  double distance = 1e-6;    // stop when the estimated scaled distance to the cycle is below this
  double map_noise = 1e-13;  // relative accuracy of P itself; no residual below it is asked for
  int depth = 10;            // Anderson's memory, in beats
  int plain_beats = 3;       // beats before acceleration starts; the fast transient would spoil the model
  int relaxing_beats = 1;    // plain beats after each jump, in which the fast directions catch up
  int max_beats = 2000;
  double known_multiplier = 0;  // of an earlier search near this cycle; the distance counts with it
  // Differences between beats that a search must have seen before it believes its own multiplier: fewer may
  // hide the slowest direction.
  int fewest_differences = 1;
};

// period_1: a cycle of one beat. period_n: one of several beats, two of them are alternans (the certificate
// says how many). drifting: the state moves along one line without slowing down. not_converged: none of these
// within the beats allowed. unphysical: the equations have this cycle, but no heart or cell can be in it.
enum class LimitCycleVerdict { running, period_1, period_n, drifting, not_converged, unphysical };
inline constexpr int longest_cycle_beats = 8;  // of period_n

// Words of a certificate: "period-1", "period-3", "unphysical", ...; the period counts for period_n only.
std::string to_string(LimitCycleVerdict verdict, int period = 2);
// The reverse, with the period; refuses other words with the nearest.
std::pair<LimitCycleVerdict, int> limit_cycle_verdict(std::string_view text);

// A multiplier that is negative or beyond one, and larger than this, asks for a look at the cycle's
// stability.
inline constexpr double suspicious_multiplier = 0.9;

// A search that its map's noise ends farther from the cycle than this has not found it.
inline constexpr double largest_noisy_distance = 1e-4;

struct LimitCycleCertificate {
  LimitCycleVerdict verdict = LimitCycleVerdict::running;
  double distance = 0;    // estimated scaled distance of the last P(x) to the cycle
  double residual = 0;    // scaled change over the last beat
  double multiplier = 0;  // estimated leading multiplier on the leaf
  int beats = 0;          // beats spent, Newton's perturbed ones included
  int period = 1;         // beats after which the state repeats itself; not_converged: 9 or more, if it does
  bool noisy = false;     // the map's noise ended the search short of the distance asked for
  std::string reason;     // why the verdict is not period_1, or what else there is to know; empty: nothing
  // What the cycle is like where it can be, but is no good one: a heart that hardly ejects.
  std::vector<std::string> warnings = {};

  bool good() const { return verdict == LimitCycleVerdict::period_1; }
  // Of one beat or of several.
  bool is_cycle() const { return good() || verdict == LimitCycleVerdict::period_n; }
  std::string text() const { return to_string(verdict, period); }
  // For people: "period-1, with warnings: LV hardly ejects ...; ...".
  std::string text_with_warnings() const;
};

// The verdict as a number of a saved state.
double saved_verdict(const LimitCycleCertificate& certificate);
void take_verdict(SavedNumbers& in, LimitCycleCertificate& certificate);

// Why a search ended without a cycle of one beat, what was seen, and what to try.
std::string limit_cycle_failure(const LimitCycleCertificate& certificate);

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

  // The smallest change over a beat so far (scaled), and the state after that beat.
  double best_residual() const { return best_residual_; }
  std::vector<double> best_state() const { return unscaled(best_.x, best_.f); }
  // The largest multiplier, in modulus, that is negative or beyond one: a sign that the cycle may be
  // unstable. Infinite while no multiplier is known.
  double suspicious_multiplier() const { return suspicious_multiplier_; }

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
  double reach_ = 1;     // share of a jump that is dared: less after one that went astray
  double suspicious_multiplier_ = std::numeric_limits<double>::infinity(),
         latest_suspicious_ = suspicious_multiplier_;
  LimitCycleCertificate certificate_;
};

}  // namespace wiggers
