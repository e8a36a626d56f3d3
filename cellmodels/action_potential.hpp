// Measures of one action potential.
#pragma once

#include <optional>
#include <vector>

namespace wiggers {

// Time (unit of t) between the upstroke's and the repolarisation's crossing of V_max - share (V_max - V_end),
// both interpolated linearly; nothing if there is no such crossing.
std::optional<double> action_potential_duration(const std::vector<double>& t, const std::vector<double>& V,
                                                double repolarised);

// First upward crossing of a potential, interpolated linearly.
std::optional<double> upward_crossing(const std::vector<double>& t, const std::vector<double>& V,
                                      double potential);

}  // namespace wiggers
