// Potentials at which a model's rates jump, and integrators that look ahead: these keep to the rates of one
// interval between such potentials over a step, wherever its stages go, and stop at a crossing.
//
// A model lists branch_potentials, ascending; its derived constants hold them as branch[k], and its rates ask
// V < branch[k].
#pragma once

#include <cmath>
#include <cstddef>

namespace wiggers {

template <class Model>
inline constexpr std::size_t n_branches = [] {
  if constexpr (requires { Model::branch_potentials; })
    return Model::branch_potentials.size();
  else
    return std::size_t{0};
}();

// The interval that a potential is in: the number of branch potentials at or below it.
template <class Model>
int interval_of(double V) {
  int interval = 0;
  if constexpr (n_branches < Model >> 0)
    for (double branch : Model::branch_potentials) interval += V >= branch ? 1 : 0;
  return interval;
}

template <class Model, class Constants>
void keep_to_interval(Constants& constants, int interval) {
  if constexpr (n_branches < Model >> 0)
    for (std::size_t k = 0; k < n_branches<Model>; ++k)
      constants.branch[k] = static_cast<int>(k) < interval ? -1e9 : 1e9;
}

// The branch potential that is crossed first on the way from an interval to another.
template <class Model>
double first_crossed(int from, int to) {
  if constexpr (n_branches < Model >> 0)
    return Model::branch_potentials[static_cast<std::size_t>(to > from ? from : from - 1)];
  return NAN;
}

}  // namespace wiggers
