// Valve laws: flow Q from the upstream pressure p1 to the downstream pressure p2. mmHg, mL, s.
//
//   diode        Q = (p1 - p2)/Rmin if p1 > p2, else (p1 - p2)/Rmax          (Regazzoni et al. 2022)
//   log-arctan   log10 R runs from Rmin to Rmax with 1/2 + arctan(100 pi (p2 - p1))/pi: smooth, fat tails
//   tanh         R runs from Rmin to Rmax with (1 + tanh(k (p2 - p1)))/2
//   ideal        Q = max(p1 - p2, 0)/Rmin: no leak
//
// The whole-heart paper (Fedele et al. 2023) prints the diode with its branches swapped: read literally the
// valve would block forward and pass backward flow. Rmin belongs to p1 > p2. Laws differ visibly in a limit
// cycle (up to 0.2 mL): never compare runs with different laws at integration accuracy.
#pragma once

#include <array>
#include <string>
#include <string_view>
#include <type_traits>
#include <wiggers/core/numbers.hpp>
#include <wiggers/core/quantity.hpp>

namespace wiggers {

enum class ValveLaw { diode, log_arctan, tanh, ideal };
inline constexpr std::array<std::string_view, 4> valve_law_names = {"diode", "log-arctan", "tanh", "ideal"};

template <class P>
struct ValveParametersOf {
  P Rmin = 0.0075;
  P Rmax = 75000;
};
using ValveParameters = ValveParametersOf<double>;
inline constexpr std::array valve_quantities = {
    Quantity{"Rmin", "mmHg s/mL", 0.0075, 2e-4, 5, "resistance of the open valve"},
    Quantity{"Rmax", "mmHg s/mL", 75000, 1e-3, 1e9, "resistance of the closed valve"},
};
static_assert(well_formed(valve_quantities));
// Copies values between fields of two kinds of number.
template <class From, class To>
void copy_values(const From& from, const To& to) {
  for (std::size_t k = 0; k < from.size(); ++k) *to[k] = value_of(*from[k]);
}
// The fields in the order of the quantities.
template <class Valve>
auto fields_of(Valve& v) requires requires {
  v.Rmin;
}
{ return std::array{&v.Rmin, &v.Rmax}; }
inline constexpr Quantity tanh_steepness_quantity = {
    "tanh_steepness", "1/mmHg", 20, 0.1, 1e4, "steepness k of the tanh valve law"};

// Laws whose resistance jumps where p1 = p2; the flow is continuous there.
inline bool has_kink(ValveLaw law) { return law == ValveLaw::diode || law == ValveLaw::ideal; }

// The flow of such a valve that is known to be open or closed.
template <class T, class P>
T valve_flow_when(bool open, ValveLaw law, const ValveParametersOf<P>& valve, const T& dp) {
  if (open) return dp / valve.Rmin;
  return law == ValveLaw::ideal ? T(0.0) : T(dp / valve.Rmax);
}

template <class T, class P>
T valve_flow(ValveLaw law, const ValveParametersOf<P>& valve, const std::type_identity_t<P>& tanh_steepness,
             const T& p1, const T& p2) {
  constexpr double pi = 3.14159265358979323846;
  const T dp = p1 - p2;
  switch (law) {
    case ValveLaw::diode:
      return select(dp > 0.0, T(dp / valve.Rmin), T(dp / valve.Rmax));
    case ValveLaw::ideal:
      return select(dp > 0.0, T(dp / valve.Rmin), T(0.0));
    case ValveLaw::log_arctan: {
      const T closed = 0.5 + atan(T(-100.0 * pi * dp)) * (1.0 / pi);
      const P low = log(valve.Rmin), high = log(valve.Rmax);
      return dp * exp(T(-(low + (high - low) * closed)));
    }
    case ValveLaw::tanh:
      break;
  }
  const T closed = 0.5 * (1.0 + tanh(T(-tanh_steepness * dp)));
  return dp / (valve.Rmin + (valve.Rmax - valve.Rmin) * closed);
}

}  // namespace wiggers
