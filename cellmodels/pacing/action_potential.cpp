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

std::string words_of_beats(const std::vector<std::pair<double, double>>& peaks) {
  std::string text = fmt::format("The cell repeats itself every {} beats: peaks of", peaks.size());
  for (std::size_t k = 0; k < peaks.size(); ++k)
    text +=
        fmt::format("{} {:.3g} mV and {:.4g} uM calcium", k == 0 ? "" : ",", peaks[k].first, peaks[k].second);
  return text + ".";
}

}  // namespace wiggers
