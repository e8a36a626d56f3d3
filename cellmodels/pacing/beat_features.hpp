// The features of one paced beat, from rows of its solution (times ms, potential mV, calcium mM), once for
// every caller: command, studies, Python, batches. Numbers of any kind.
#pragma once

#include <algorithm>
#include <optional>
#include <string>
#include <vector>
#include <wiggers/cellmodels/pacing/action_potential.hpp>
#include <wiggers/core/units.hpp>

namespace wiggers {

// Time and value of the extreme at row k: the vertex of the parabola through it and its neighbours, so that
// it moves smoothly with everything; the row itself where it stands on a kink or at an end.
template <class T>
T parabola_vertex(const std::vector<T>& t, const std::vector<T>& y, std::size_t k, T& value,
                  const std::vector<double>& kinks = {}) {
  value = y[k];
  if (k == 0 || k + 1 >= y.size()) return t[k];
  for (double kink : kinks)
    if (std::abs(value_of(t[k]) - kink) < 1e-9 * value_of(t.back())) return t[k];
  const T left = t[k] - t[k - 1], right = t[k + 1] - t[k];
  const T rise = (y[k] - y[k - 1]) / left, fall = (y[k + 1] - y[k]) / right;
  const T curvature = (fall - rise) / (left + right);
  if (value_of(curvature) == 0) return t[k];
  const T slope = (rise * right + fall * left) / (left + right);
  const T shift = -0.5 * slope / curvature;
  value = y[k] + 0.5 * slope * shift;
  return t[k] + shift;
}

// visit(name, unit, value) for the features that the beat has; `kinks`: where the stimulus begins and ends.
template <class T, class Visit>
void visit_features(const std::vector<T>& t, const std::vector<T>& V, const std::vector<T>& calcium_mM,
                    const std::vector<double>& kinks, Visit visit) {
  const auto at = [](const auto& series, auto compare) {
    return static_cast<std::size_t>(std::max_element(series.begin(), series.end(), compare) - series.begin());
  };
  const auto less = [](const T& a, const T& b) { return a < b; };
  const auto more = [](const T& a, const T& b) { return b < a; };
  T V_peak(0.0), V_low(0.0), low(0.0), high(0.0);
  parabola_vertex(t, V, at(V, less), V_peak, kinks);
  parabola_vertex(t, V, at(V, more), V_low, kinks);
  if (no_action_potential(V).empty()) {
    if (const auto apd = action_potential_duration(t, V, 0.9, V_peak)) visit("APD90_ms", "ms", *apd);
    if (const auto apd = action_potential_duration(t, V, 0.5, V_peak)) visit("APD50_ms", "ms", *apd);
  }
  visit("V_rest_mV", "mV", V.back() < V.front() ? V.back() : V.front());
  visit("V_peak_mV", "mV", V_peak);
  visit("V_min_mV", "mV", V_low);
  std::vector<T> slope, middle;
  for (std::size_t k = 1; k < t.size(); ++k) {
    slope.push_back((V[k] - V[k - 1]) / (t[k] - t[k - 1]));
    middle.push_back(0.5 * (t[k] + t[k - 1]));
  }
  T steepest(0.0);
  const std::size_t steep = at(slope, less);
  parabola_vertex(middle, slope, steep, steepest);
  // Beside an edge of the stimulus the slope jumps: no parabola goes through that.
  for (double kink : kinks)
    for (std::size_t k = steep; k < steep + 2; ++k)
      if (std::abs(value_of(t[k]) - kink) < 1e-9 * value_of(t.back())) steepest = slope[steep];
  visit("dVdt_max_mV_per_ms", "mV/ms", steepest);
  if (calcium_mM.empty()) return;  // of a model without calcium
  parabola_vertex(t, calcium_mM, at(calcium_mM, more), low);
  const T when = parabola_vertex(t, calcium_mM, at(calcium_mM, less), high);
  visit("calcium_diastolic_uM", "uM", T(units::uM_per_mM * low));
  visit("calcium_peak_uM", "uM", T(units::uM_per_mM * high));
  visit("calcium_amplitude_uM", "uM", T(units::uM_per_mM * (high - low)));
  visit("calcium_time_to_peak_ms", "ms", when);
}

// The highest potential and calcium of a beat, from its rows.
struct BeatPeaks {
  double potential_mV = 0;
  std::optional<double> calcium_uM;  // nothing of a model without calcium
};
BeatPeaks peaks_of(const std::vector<double>& potential_mV, const std::vector<double>& calcium_mM);
// What the beats of a cycle of several do, in words.
std::string words_of_beats(const std::vector<BeatPeaks>& beats);

}  // namespace wiggers
