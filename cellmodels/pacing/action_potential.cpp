#include <fmt/format.h>

#include <wiggers/cellmodels/pacing/action_potential.hpp>
#include <wiggers/cellmodels/pacing/beat_features.hpp>

namespace wiggers {

std::optional<double> upward_crossing(const std::vector<double>& t, const std::vector<double>& V,
                                      double potential) {
  for (std::size_t k = 1; k < V.size(); ++k)
    if (V[k - 1] < potential && V[k] >= potential)
      return t[k - 1] + (t[k] - t[k - 1]) * (potential - V[k - 1]) / (V[k] - V[k - 1]);
  return {};
}

BeatPeaks peaks_of(const std::vector<double>& potential_mV, const std::vector<double>& calcium_mM) {
  BeatPeaks peaks{*std::max_element(potential_mV.begin(), potential_mV.end()), {}};
  if (!calcium_mM.empty())
    peaks.calcium_uM = units::uM_per_mM * *std::max_element(calcium_mM.begin(), calcium_mM.end());
  return peaks;
}

std::string words_of_beats(const std::vector<BeatPeaks>& beats) {
  std::string text = fmt::format("The cell repeats itself every {} beats: peaks of", beats.size());
  for (std::size_t k = 0; k < beats.size(); ++k) {
    text += fmt::format("{} {:.3g} mV", k == 0 ? "" : ",", beats[k].potential_mV);
    if (beats[k].calcium_uM) text += fmt::format(" and {:.4g} uM calcium", *beats[k].calcium_uM);
  }
  return text + ".";
}

}  // namespace wiggers
