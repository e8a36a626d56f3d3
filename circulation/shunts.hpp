// Shunts: holes and ducts that join two nodes of the circulation beside the valves. mmHg, mL, s, cm2.
//
//   p1 - p2 = R Q + 4 (Q/(100 A))^2 sign(Q)
//
// a resistance, and the orifice of effective area A whose jet of v m/s has a gradient of 4 v^2 mmHg (the
// simplified Bernoulli equation),
// solved for Q. The resistance keeps the flow's slope finite where it turns: dQ/d(p1 - p2) <= 1/R.
#pragma once

#include <array>
#include <wiggers/core/numbers.hpp>
#include <wiggers/core/quantity.hpp>

namespace wiggers {

template <class P>
struct ShuntParametersOf {
  bool present = false;
  P area_cm2 = 1, R = 7.5e-3;
};
using ShuntParameters = ShuntParametersOf<double>;
inline constexpr std::array shunt_quantities = {
    Quantity{"area_cm2", "cm2", 1, 1e-3, 20, "effective orifice area"},
    Quantity{"R", "mmHg s/mL", 7.5e-3, 2e-4, 100, "resistance in series with the orifice"},
};
static_assert(well_formed(shunt_quantities));
template <class Shunt>
auto fields_of(Shunt& s) requires requires {
  s.area_cm2;
}
{ return std::array{&s.area_cm2, &s.R}; }

template <class T, class P>
T shunt_flow(const ShuntParametersOf<P>& shunt, const T& p1, const T& p2) {
  const T dp = p1 - p2;
  const T size = select(dp > 0.0, dp, T(-dp));
  return 2.0 * dp / (shunt.R + sqrt(T(square(shunt.R) + 16e-4 * size / square(shunt.area_cm2))));
}

}  // namespace wiggers
