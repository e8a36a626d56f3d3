// Measures of one action potential.
#pragma once

#include <algorithm>
#include <optional>
#include <string>
#include <vector>
#include <wiggers/core/numbers.hpp>

namespace wiggers {

// Where a series crosses `level` between rows k - 1 and k: on the cubic through these and their neighbours
// where there are any and it stays between the rows, else on the straight line. Numbers of any kind.
template <class T>
T crossing_time(const std::vector<T>& t, const std::vector<T>& y, std::size_t k, const T& level) {
  const T span = t[k] - t[k - 1];
  T s = (level - y[k - 1]) / (y[k] - y[k - 1]);  // share of the span
  if (k < 2 || k + 1 >= y.size()) return t[k - 1] + s * span;
  const T a = (t[k - 2] - t[k - 1]) / span, b = (t[k + 1] - t[k - 1]) / span;  // nodes a < 0 < 1 < b
  // Newton's form on the nodes 0, 1, a, b.
  const T d01 = y[k] - y[k - 1];
  const T d0a = (y[k - 2] - y[k - 1]) / a;
  const T d1b = (y[k + 1] - y[k]) / (b - 1.0), dab = (y[k + 1] - y[k - 2]) / (b - a);
  const T d01a = (d0a - d01) / (a - 1.0), d1ab = (dab - d1b) / (a - 1.0);
  const T cubic = (d1ab - d01a) / b;
  // The last iterate carries the derivatives.
  T root = s;
  for (int iteration = 0; iteration < 20; ++iteration) {
    const T value = y[k - 1] + root * (d01 + (root - 1.0) * (d01a + (root - a) * cubic)) - level;
    const T slope =
        d01 + (2.0 * root - 1.0) * d01a + ((root - 1.0) * (root - a) + root * (2.0 * root - 1.0 - a)) * cubic;
    if (!(abs(slope) > 0.0)) return t[k - 1] + s * span;
    const T change = value / slope;
    root = root - change;
    if (iteration > 0 && abs(change) < 1e-13) break;
  }
  if (!(root >= 0.0 && root <= 1.0)) root = s;
  return t[k - 1] + root * span;
}

// A cell above this is not at rest (mV): between the resting potentials and the thresholds of all models.
inline constexpr double depolarised_mV = -60;
// An upstroke is at least so high, and reaches at least this (mV): less is the stimulus and what it stirs.
inline constexpr double smallest_upstroke_mV = 30, smallest_peak_mV = 0;

// Why a beat from stimulus to stimulus is no action potential, in words; empty if it is one.
template <class T>
std::string no_action_potential(const std::vector<T>& V) {
  const double begin = value_of(V.front()), end = value_of(V.back());
  double peak = begin, low = begin;
  for (const T& v : V) {
    peak = std::max(peak, value_of(v));
    low = std::min(low, value_of(v));
  }
  if (begin > depolarised_mV && end > depolarised_mV && low > depolarised_mV) return "did not repolarise";
  if (begin > depolarised_mV) return "blocked: the stimulus came while the cell was depolarised";
  if (peak - begin < smallest_upstroke_mV && peak < smallest_peak_mV)
    return "did not depolarise: the stimulus is below threshold";
  if (peak - begin < smallest_upstroke_mV || peak < smallest_peak_mV)
    return "blocked: no full upstroke followed the stimulus";
  if (end > begin + 0.1 * (peak - begin)) return "did not repolarise by 90 % before the next stimulus";
  return "";
}

// Time (unit of t) between the upstroke's and the repolarisation's crossing of V_peak - share (V_peak -
// V_rest); nothing if there is no such crossing. Rest is the lower end of the beat, which runs from stimulus
// to stimulus: before the upstroke, or after repolarisation. Numbers of any kind.
template <class T>
std::optional<T> action_potential_duration(const std::vector<T>& t, const std::vector<T>& V,
                                           double repolarised, const T& V_peak) {
  const auto peak = std::max_element(V.begin(), V.end());
  const T rest = V.back() < V.front() ? V.back() : V.front();
  const T threshold = V_peak - repolarised * (V_peak - rest);
  const auto peak_index = static_cast<std::size_t>(peak - V.begin());
  std::optional<T> up, down;
  for (std::size_t k = 1; k <= peak_index && !up; ++k)
    if (V[k - 1] < threshold && V[k] >= threshold) up = crossing_time(t, V, k, threshold);
  for (std::size_t k = peak_index + 1; k < V.size() && !down; ++k)
    if (V[k - 1] >= threshold && V[k] < threshold) down = crossing_time(t, V, k, threshold);
  if (!up || !down) return {};
  return T(*down - *up);
}

// The same with the highest row as peak.
template <class T>
std::optional<T> action_potential_duration(const std::vector<T>& t, const std::vector<T>& V,
                                           double repolarised) {
  return action_potential_duration(t, V, repolarised, T(*std::max_element(V.begin(), V.end())));
}

// First upward crossing of a potential, interpolated linearly.
std::optional<double> upward_crossing(const std::vector<double>& t, const std::vector<double>& V,
                                      double potential);

}  // namespace wiggers
