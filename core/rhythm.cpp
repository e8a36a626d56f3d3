#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <wiggers/core/rhythm.hpp>

namespace wiggers {

namespace {
// A return counts as one if it is nearer than every earlier state by this factor. A decaying alternation of
// ratio 0.7 or less passes for a rhythm of one beat; a slower one is taken for two, which does no harm: its
// cycle of two beats is found to be one of one.
constexpr double nearer = 0.5;
constexpr std::size_t remembered = 2 * longest_rhythm_beats + 2;
// Beats that still differ by more than this (scaled) have no rhythm yet: blocks of every second beat may show
// after several that pass for regular ones.
constexpr double settled = 1;
// A beat that differs from the last by more than this (scaled), and by so many times more than the beat
// before did, is none of a rhythm of one beat: a calcium release that is missed now and then.
constexpr double jump = 1e-3;
constexpr double sudden = 4;
}  // namespace

double scaled_distance(const std::vector<double>& a, const std::vector<double>& b,
                       const std::vector<double>& scales) {
  double largest = 0;
  for (std::size_t i = 0; i < a.size(); ++i) largest = std::max(largest, std::abs(a[i] - b[i]) / scales[i]);
  return largest;
}

void Rhythm::see(const std::vector<double>& state) {
  states_.push_back(state);
  if (states_.size() > remembered) states_.pop_front();
}

double Rhythm::change(int beats, int before) const {
  const int last = size() - 1 - before;
  return scaled_distance(states_[static_cast<std::size_t>(last)],
                         states_[static_cast<std::size_t>(last - beats)], scales_);
}

double Rhythm::bend(int beats) const {
  const auto n = states_.size(), step = static_cast<std::size_t>(beats);
  const auto &now = states_[n - 1], &before = states_[n - 1 - step], &earlier = states_[n - 1 - 2 * step];
  double largest = 0;
  for (std::size_t i = 0; i < now.size(); ++i)
    largest = std::max(largest, std::abs(now[i] - 2 * before[i] + earlier[i]) / scales_[i]);
  return largest / std::max(change(beats), std::numeric_limits<double>::min());
}

bool Rhythm::comes_back(int period, int before) const {
  const double returned = change(period, before);
  for (int fewer = 1; fewer < period; ++fewer)
    if (returned > nearer * change(fewer, before)) return false;
  return true;
}

int Rhythm::longer_period() const {
  for (int period = longest_cycle_beats + 1; period <= longest_rhythm_beats; ++period) {
    bool clear = size() > 2 * period;
    for (int before = 0; before < period && clear; ++before) clear = comes_back(period, before);
    if (clear) return period;
  }
  return 0;
}

bool Rhythm::jumps(int watched) const {
  for (int before = 0; before < watched; ++before)
    if (change(1, before) > std::max(jump, sudden * change(1, before + 1))) return true;
  return false;
}

int Rhythm::period(int watched) const {
  // A return counts if it was one all through a period before, and through two where it is longer than
  // alternation: transients pass through such patterns.
  for (int period = 2; period <= longest_cycle_beats; ++period) {
    const int returns = std::max(watched, period > 2 ? 2 * period : period);
    bool clear = size() > period + returns;
    for (int before = 0; before < returns && clear; ++before) clear = comes_back(period, before);
    if (clear) return period;
  }
  if (size() < std::max(3, watched + 2) || change(1) > settled || jumps(watched)) return 0;
  // One beat: the latest state is not nearer to an older one than to the last.
  for (int older = 2; older < std::min(size(), longest_cycle_beats + 1); ++older)
    if (change(1) > noise_ && change(older) < change(1)) return 0;
  return 1;
}

std::string describe(const Rhythm& rhythm) {
  if (rhythm.size() < 4) return "";
  if (const int longer = rhythm.longer_period())
    return fmt::format("The beats repeat every {} beats but for {:.1e} (scaled) a round.", longer,
                       rhythm.change(longer));
  const int period = rhythm.period();
  const bool steady = period > 0 && rhythm.size() > 2 * period && rhythm.bend(period) < 0.5;
  if (period > 1 && steady)
    return fmt::format("The beats repeat every {} beats but for a drift of {:.1e} a round.", period,
                       rhythm.change(period));
  const double last = rhythm.change(1), before = rhythm.change(1, 1);
  if (rhythm.bend(1) < 1e-2 && last > 0.999 * before)
    return fmt::format("The state drifts by {:.1e} (scaled) a beat without slowing down.", last);
  if (last < settled && rhythm.bend(1) < 0.5)
    return fmt::format("The state still moves by {:.1e} (scaled) a beat, {:.3g} times the beat before.", last,
                       last / before);
  return fmt::format(
      "The beats follow no rhythm of up to {} beats: successive ones differ by {:.1e} (scaled).",
      longest_cycle_beats, last);
}

}  // namespace wiggers
