// RDQ20 by a two-stage midpoint rule with frozen rates: second order, positive and conserving for every step.
//
// With the conditional rates of neighbours frozen the regulatory units obey dx/dt = A x with a generator A
// (columns sum to zero, off-diagonals are not negative). Stage one takes x over h/2 with A(x_n); stage two
// takes x_n over h with A(x_m). Each uses exp(kA) by uniformisation: with L >= the largest exit rate,
//   exp(kA) x = sum_n  e^{-kL} (kL)^n / n!  (I + A/L)^n x,
// a mean of non-negative vectors with weights that sum to one. The number of terms grows as kL + 8 sqrt(kL):
// about 60 for 1 ms of the atrial set. The crossbridges then move exactly for the midpoint's regulation.
//
// Inputs are those of the middle of the step (second order); held ones give first order in them.
#pragma once

#include <cmath>
#include <wiggers/cellmodels/models/rdq20.hpp>

namespace wiggers {

inline double largest_lane(double x) { return x; }
inline double max(double a, double b) { return a > b ? a : b; }
template <class V>
inline double largest_lane(const V& x) {
  double largest = static_cast<double>(x[0]);
  for (int lane = 1; lane < V::lanes; ++lane) {
    const double value = static_cast<double>(x[lane]);
    if (!(value <= largest)) largest = value;
  }
  return largest;
}

template <class N>
class Rdq20Midpoint {
 public:
  static constexpr std::string_view name = "frozen-midpoint";
  static constexpr int n = Rdq20::n_probabilities;
  // No sensible step needs more; a state that does (calcium of millimolar) is refused, not ground through.
  static constexpr double largest_exponent = 2e4;

  void restart() {}

  // False if the rates are not finite or beyond what the method should be asked for; y is then untouched.
  template <class Constants>
  bool step(double h, N* y, const N* inputs, const Constants& c) const {
    const N v = -inputs[Rdq20::dSL_dt] / c.p[Rdq20::SL0];
    Rdq20::Regulation<N> middle;
    if (!step_regulation(h, y, inputs[Rdq20::Ca], inputs[Rdq20::SL], c, middle)) return false;
    Rdq20::step_crossbridges(h, y, middle, v, c);
    return true;
  }

  // The probabilities y[0..15] alone, and the regulation in the middle of the step.
  template <class Constants>
  bool step_regulation(double h, N* y, const N& calcium, const N& sarcomere_length, const Constants& c,
                       Rdq20::Regulation<N>& at_middle) const {
    N middle[n];
    for (int i = 0; i < n; ++i) middle[i] = y[i];
    if (!propagate(0.5 * h, middle, Rdq20::frozen_rates(y, calcium, sarcomere_length, c), c)) return false;
    const auto rates = Rdq20::frozen_rates(middle, calcium, sarcomere_length, c);
    at_middle = Rdq20::flow(middle, rates, c);
    return propagate(h, y, rates, c);
  }

 private:
  template <class Constants>
  static bool propagate(double k, N* x, const Rdq20::FrozenRates<N>& rates, const Constants& c) {
    N exit[n], stay[n], centre[n], calcium[n];
    N fastest(0.0);
    for (int i = 0; i < n; ++i) {
      const int a = i >> 3, b = (i >> 2) & 1, cc = (i >> 1) & 1, B = i & 1;
      centre[i] = N(Rdq20::centre_rate(a, b, cc, B, c));
      calcium[i] = Rdq20::calcium_rate(b, B, rates, c);
      exit[i] = rates.left[a][b] + centre[i] + rates.right[b][cc] + calcium[i];
      fastest = max(fastest, exit[i]);
    }
    // max() may drop a NaN; a sum does not.
    N all(0.0);
    for (int i = 0; i < n; ++i) all = all + exit[i];
    if (!std::isfinite(largest_lane(all))) return false;
    const double L = largest_lane(fastest);
    const double exponent = k * L;
    if (!(exponent <= largest_exponent)) return false;
    if (!(L > 0)) return true;
    // Long exponents in parts, each of which neither underflows nor needs more than some hundred terms.
    const int parts = 1 + static_cast<int>(exponent / 100.0);
    const double z = exponent / parts;
    const int terms = static_cast<int>(z + 8.0 * std::sqrt(z) + 10.0);
    const double per_L = 1.0 / L;
    N left[2][2], right[2][2];
    for (int s = 0; s < 2; ++s)
      for (int t = 0; t < 2; ++t) {
        left[s][t] = rates.left[s][t] * per_L;
        right[s][t] = rates.right[s][t] * per_L;
      }
    for (int i = 0; i < n; ++i) {
      stay[i] = 1.0 - exit[i] * per_L;
      centre[i] = centre[i] * per_L;
      calcium[i] = calcium[i] * per_L;
    }
    // The weights sum to one, up to rounding in every term; the sum of the probabilities is kept exactly.
    N before(0.0);
    for (int i = 0; i < n; ++i) before = before + x[i];
    for (int part = 0; part < parts; ++part) {
      N power[n], sum[n];
      double weight = std::exp(-z);
      for (int i = 0; i < n; ++i) {
        power[i] = x[i];
        sum[i] = weight * x[i];
      }
      for (int term = 1; term < terms; ++term) {
        weight *= z / term;
        N next[n];
        for (int i = 0; i < n; ++i) {
          const int a = i >> 3, b = (i >> 2) & 1, cc = (i >> 1) & 1;
          next[i] = stay[i] * power[i] + power[i ^ 8] * left[1 - a][b] + power[i ^ 4] * centre[i ^ 4] +
                    power[i ^ 2] * right[b][1 - cc] + power[i ^ 1] * calcium[i ^ 1];
        }
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
};

}  // namespace wiggers
