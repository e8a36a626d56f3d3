// Continuous-time Markov chains: exp(kA) x for a generator A (columns sum to zero, what is off the diagonal
// is not negative), by uniformisation. With L >= the largest exit rate,
//   exp(kA) x = sum_n  e^{-kL} (kL)^n / n!  (I + A/L)^n x,
// a mean of non-negative vectors with weights that sum to one: positive and conserving for every k. The
// number of terms grows as kL + 8 sqrt(kL).
#pragma once

#include <cmath>
#include <wiggers/core/dual.hpp>
#include <wiggers/core/numbers.hpp>

namespace wiggers {

inline double largest_lane(double x) { return x; }
template <int n>
double largest_lane(const Dual<n>& x) {
  return x.value;
}
template <class V>
inline double largest_lane(const V& x) {
  double largest = static_cast<double>(x[0]);
  for (int lane = 1; lane < V::lanes; ++lane) {
    const double value = static_cast<double>(x[lane]);
    if (!(value <= largest)) largest = value;
  }
  return largest;
}

// No sensible step needs a larger exponent; a state that does (calcium of millimolar) is refused, not ground
// through.
inline constexpr double largest_exponent = 2e4;

// x[0..n-1] over k. `flow` has exit(i), the rate out of state i; scale(factor), which multiplies all rates;
// and inflow(i, kept, x): `kept`, what stays in i, and what comes to it from the others. False if the rates
// are not finite or beyond largest_exponent; x is then untouched.
template <int n, class H, class N, class Flow>
bool propagate(const H& k, N* x, Flow flow) {
  N exit[n], stay[n];
  N fastest(0.0);
  for (int i = 0; i < n; ++i) {
    exit[i] = flow.exit(i);
    fastest = select(exit[i] > fastest, exit[i], fastest);
  }
  // The largest may drop a NaN; a sum does not.
  N all(0.0);
  for (int i = 0; i < n; ++i) all = all + exit[i];
  if (!std::isfinite(largest_lane(all))) return false;
  const double L = largest_lane(fastest);
  const double exponent = value_of(k) * L;
  if (!(exponent <= largest_exponent)) return false;
  if (!(L > 0)) return true;
  // Long exponents in parts, each of which neither underflows nor needs more than some hundred terms.
  const int parts = 1 + static_cast<int>(exponent / 100.0);
  const H z = k * L / static_cast<double>(parts);
  const double plain_z = exponent / parts;
  const int terms = static_cast<int>(plain_z + 8.0 * std::sqrt(plain_z) + 10.0);
  const double per_L = 1.0 / L;
  flow.scale(per_L);
  for (int i = 0; i < n; ++i) stay[i] = 1.0 - exit[i] * per_L;
  // The weights sum to one, up to rounding in every term; the sum of the probabilities is kept exactly.
  N before(0.0);
  for (int i = 0; i < n; ++i) before = before + x[i];
  for (int part = 0; part < parts; ++part) {
    N power[n], sum[n];
    H weight = exp(H(-z));
    for (int i = 0; i < n; ++i) {
      power[i] = x[i];
      sum[i] = weight * x[i];
    }
    for (int term = 1; term < terms; ++term) {
      weight = weight * (z / static_cast<double>(term));
      N next[n];
#pragma GCC unroll 16
      for (int i = 0; i < n; ++i) next[i] = flow.inflow(i, N(stay[i] * power[i]), power);
      for (int i = 0; i < n; ++i) {
        power[i] = next[i];
        sum[i] = sum[i] + weight * next[i];
      }
    }
    N after(0.0);
    for (int i = 0; i < n; ++i) after = after + sum[i];
    const N normalise = before / after;
    for (int i = 0; i < n; ++i) x[i] = sum[i] * normalise;
  }
  return true;
}

}  // namespace wiggers
