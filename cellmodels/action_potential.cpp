#include <algorithm>
#include <wiggers/cellmodels/action_potential.hpp>

namespace wiggers {

std::optional<double> action_potential_duration(const std::vector<double>& t, const std::vector<double>& V,
                                                double repolarised) {
  const auto peak = std::max_element(V.begin(), V.end());
  const double threshold = *peak - repolarised * (*peak - V.back());
  const auto peak_index = static_cast<std::size_t>(peak - V.begin());
  std::optional<double> up, down;
  const auto crossing = [&](std::size_t k) {
    return t[k - 1] + (t[k] - t[k - 1]) * (threshold - V[k - 1]) / (V[k] - V[k - 1]);
  };
  for (std::size_t k = 1; k <= peak_index && !up; ++k)
    if (V[k - 1] < threshold && V[k] >= threshold) up = crossing(k);
  for (std::size_t k = peak_index + 1; k < V.size() && !down; ++k)
    if (V[k - 1] >= threshold && V[k] < threshold) down = crossing(k);
  if (!up || !down) return {};
  return *down - *up;
}

std::optional<double> upward_crossing(const std::vector<double>& t, const std::vector<double>& V,
                                      double potential) {
  for (std::size_t k = 1; k < V.size(); ++k)
    if (V[k - 1] < potential && V[k] >= potential)
      return t[k - 1] + (t[k] - t[k - 1]) * (potential - V[k - 1]) / (V[k] - V[k - 1]);
  return {};
}

}  // namespace wiggers
