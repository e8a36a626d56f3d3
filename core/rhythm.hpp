// The rhythm of a paced system: after how many beats it does the same again, seen in the states at the starts
// of its beats while slow quantities still drift.
#pragma once

#include <deque>
#include <vector>
#include <wiggers/core/limit_cycle.hpp>

namespace wiggers {

class Rhythm {
 public:
  explicit Rhythm(std::vector<double> scales) : scales_(std::move(scales)) {}

  // The states at the starts of successive plain beats.
  void see(const std::vector<double>& state);
  void forget() { states_.clear(); }

  // The smallest number of beats after which the state comes back much nearer than after any fewer, and did
  // so before; 0 while that is not clear. One beat is the rhythm of what does not alternate, drift or not.
  int period() const;

  // Largest scaled difference between states this many beats apart, the latest of which is `before` beats
  // old.
  double change(int beats, int before = 0) const;
  // How much that change differs from the one before, relative to it: small for a drift, large for noise.
  double bend(int beats) const;
  int size() const { return static_cast<int>(states_.size()); }

 private:
  bool comes_back(int period, int before) const;

  std::vector<double> scales_;
  std::deque<std::vector<double>> states_;
};

// What is to be said of beats that found no cycle: alternating, drifting or irregular, in words with numbers.
std::string describe(const Rhythm& rhythm);

double scaled_distance(const std::vector<double>& a, const std::vector<double>& b,
                       const std::vector<double>& scales);

}  // namespace wiggers
