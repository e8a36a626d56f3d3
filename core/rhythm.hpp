// The rhythm of a paced system: after how many beats it does the same again, seen in the states at the starts
// of its beats while slow quantities still drift.
#pragma once

#include <deque>
#include <vector>
#include <wiggers/core/limit_cycle.hpp>

namespace wiggers {

// Rhythms longer than the cycles that are searched for are told, up to this one.
inline constexpr int longest_rhythm_beats = 64;

class Rhythm {
 public:
  // States that differ by less than the noise (scaled) are the same.
  explicit Rhythm(std::vector<double> scales, double noise = 0) : scales_(std::move(scales)), noise_(noise) {}

  // The states at the starts of successive plain beats.
  void see(const std::vector<double>& state);
  void forget() { states_.clear(); }

  // The smallest number of beats, 1 to 8, after which the state comes back much nearer than after any fewer,
  // and did so all through the `watched` beats before; 0 while that is not clear. One beat is the rhythm of
  // what does not alternate, drift or not.
  int period(int watched = 0) const;
  // The same of rhythms from 9 to 64 beats, watched through one round.
  int longer_period() const;

  // Largest scaled difference between states this many beats apart, the latest of which is `before` beats
  // old.
  double change(int beats, int before = 0) const;
  // How much that change differs from the one before, relative to it: small for a drift, large for noise.
  double bend(int beats) const;
  int size() const { return static_cast<int>(states_.size()); }

 private:
  bool comes_back(int period, int before) const;
  bool jumps(int watched) const;

  std::vector<double> scales_;
  double noise_;
  std::deque<std::vector<double>> states_;
};

// What is to be said of beats that found no cycle: alternating, drifting or irregular, in words with numbers.
std::string describe(const Rhythm& rhythm);

double scaled_distance(const std::vector<double>& a, const std::vector<double>& b,
                       const std::vector<double>& scales);

}  // namespace wiggers
