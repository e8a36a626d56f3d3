// Elastance chambers: p = p_ex + E(t) (V - V0), E(t) = EB + EA phi(t). mmHg, mL, s.
//
// phi rises from 0 to 1 by half a cosine over TC from tC, falls back over TR, and is 0 for the rest of the
// period (TC + TR <= period). It is C1; its second derivative jumps at tC, tC + TC and tC + TC + TR, where
// integrators restart. EA is the amplitude: the peak elastance is EA + EB. (Regazzoni et al. 2022,
// circulation appendix.)
#pragma once

#include <array>
#include <cmath>
#include <wiggers/core/numbers.hpp>
#include <wiggers/core/quantity.hpp>

namespace wiggers {

template <class P>
struct ElastanceParametersOf {
  P EA = 0, EB = 0, tC = 0, TC = 0, TR = 0, V0 = 0;
};
using ElastanceParameters = ElastanceParametersOf<double>;
// Defaults: left ventricle of the set wiggers-healthy-0d.
inline constexpr std::array elastance_quantities = {
    Quantity{"EA", "mmHg/mL", 2.75, 0, 50, "amplitude of the elastance (peak: EA + EB)"},
    Quantity{"EB", "mmHg/mL", 0.08, 1e-3, 20, "elastance at rest"},
    Quantity{"tC", "s", 0, 0, 20, "onset of contraction within the period (taken modulo the period)"},
    Quantity{"TC", "s", 0.272, 0.01, 5, "duration of contraction"},
    Quantity{"TR", "s", 0.136, 0.01, 5, "duration of relaxation"},
    Quantity{"V0", "mL", 5, -100, 500, "volume at zero pressure"},
};
static_assert(well_formed(elastance_quantities));
template <class Elastance>
auto fields_of(Elastance& e) requires requires {
  e.EA;
}
{ return std::array{&e.EA, &e.EB, &e.tC, &e.TC, &e.TR, &e.V0}; }

// Remainder in [0, period], for negative times too; below the period but for rounding.
template <class T>
T wrapped(const T& t, const T& period) {
  return t - period * floor(T(t / period));
}
inline double wrapped(double t, double period) {
  const double r = std::fmod(t, period);
  return r < 0 ? r + period : r;
}

// phi(t) in [0, 1].
template <class T>
T elastance_activation(const ElastanceParametersOf<T>& e, const T& t, const T& period) {
  const T m = wrapped(T(t - e.tC), period);
  // -1 at the onset, 0 at the peak, 1 when relaxed; phi = (1 + cos(pi x))/2.
  const T falling = (m - e.TC) / e.TR;
  const T phi =
      square(quarter_cosine(select(m < e.TC, T(m / e.TC - 1.0), select(falling < 1.0, falling, T(1.0)))));
  return select(falling < 1.0, phi, T(0.0));
}

template <class T>
T elastance(const ElastanceParametersOf<T>& e, const T& t, const T& period) {
  return e.EB + e.EA * elastance_activation(e, t, period);
}

// Refuses TC + TR > period, naming `place`.
void check_elastance(const ElastanceParameters& e, double period, const char* place);

}  // namespace wiggers
