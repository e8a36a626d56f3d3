#include <wiggers/cellmodels/action_potential.hpp>

namespace wiggers {

std::optional<double> upward_crossing(const std::vector<double>& t, const std::vector<double>& V,
                                      double potential) {
  for (std::size_t k = 1; k < V.size(); ++k)
    if (V[k - 1] < potential && V[k] >= potential)
      return t[k - 1] + (t[k] - t[k - 1]) * (potential - V[k - 1]) / (V[k] - V[k - 1]);
  return {};
}

}  // namespace wiggers
