// A pericardial bag around all chambers: one pressure on every outer surface, from the sum of the cavities'
// volumes (the walls keep theirs),  p_bag = p0 ((V/V_ref)^n - 1) above V_ref, 0 below.  It couples the
// chambers: what one gains in a full bag the others must give.
#pragma once

#include <wiggers/core/numbers.hpp>

namespace wiggers {

template <class P>
struct PericardiumOf {
  P pressure_mmHg = 0;          // p0; 0: no bag
  P reference_volume_mL = 600;  // V_ref, of the four cavities together
  P exponent = 10;

  bool present() const { return pressure_mmHg > 0.0; }
  template <class T>
  T pressure(const T& volume_mL) const {
    const auto slack = volume_mL <= reference_volume_mL;
    const T ratio = select(slack, T(1.0), T(volume_mL / reference_volume_mL));
    return pressure_mmHg * (pow(ratio, exponent) - 1.0);
  }
};
using Pericardium = PericardiumOf<double>;

}  // namespace wiggers
