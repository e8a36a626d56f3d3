// The number vocabulary that models are written in. Model equations use these functions, unqualified,
// on a type T that may be double, Dual<N> (dual.hpp) or a SIMD batch (simd.hpp).
//
// Two habits make one text serve all three: branches are select(mask, a, b), and removable singularities
// are library functions below.
#pragma once

#include <algorithm>
#include <cmath>

namespace wiggers {

// Plain numbers.
inline double select(bool mask, double if_true, double if_false) { return mask ? if_true : if_false; }
inline double exp(double x) { return std::exp(x); }
inline double expm1(double x) { return std::expm1(x); }
inline double log(double x) { return std::log(x); }
inline double sqrt(double x) { return std::sqrt(x); }
inline double tanh(double x) { return std::tanh(x); }
inline double atan(double x) { return std::atan(x); }
inline double abs(double x) { return std::abs(x); }
inline double cbrt(double x) { return std::cbrt(x); }
inline double cos(double x) { return std::cos(x); }
inline double pow(double x, double exponent) { return std::pow(x, exponent); }
inline double floor(double x) { return std::floor(x); }

// The plain value under a number (identity here; the value part of a dual).
inline double value_of(double x) { return x; }

template <class T>
inline T square(const T& x) {
  return x * x;
}
template <class T>
inline T cube(const T& x) {
  return x * x * x;
}

// 1 / (1 + exp(-x)), by an exponential that cannot overflow, nor can its derivative.
template <class T>
inline T logistic(const T& x) {
  const T e = exp(T(-abs(x)));
  return select(x < 0.0, e, T(1.0)) / (1.0 + e);
}

// x / (exp(x) - 1), and its limit 1 at x = 0. For |x| < 0.1 the Bernoulli series to x^8, whose first dropped
// term is x^10/47900160 < 1e-17; beyond, exp(x) - 1 loses at most a digit.
template <class T>
inline T x_over_expm1(const T& x) {
  const auto near_zero = abs(x) < 0.1;
  const T safe = select(near_zero, T(1.0), x);
  const T q = x * x;
  const T series =
      1.0 - 0.5 * x + q * (1.0 / 12.0 + q * (-1.0 / 720.0 + q * (1.0 / 30240.0 + q * (-1.0 / 1209600.0))));
  return select(near_zero, series, T(safe / (exp(safe) - 1.0)));
}

// cos(pi x / 2) for |x| <= 1, absolute error below 4e-16: the Taylor series to x^22.
template <class T>
inline T quarter_cosine(const T& x) {
  constexpr double half_pi = 1.57079632679489661923;
  const T q = (half_pi * half_pi) * (x * x);
  T sum(1.0);
  for (int n = 22; n > 0; n -= 2) sum = 1.0 - q * sum * (1.0 / (n * (n - 1)));
  return sum;
}

// x / (1 - exp(-x)), and its limit 1 at x = 0.
template <class T>
inline T x_over_one_minus_exp(const T& x) {
  return x_over_expm1(T(-x));
}

// (exp(x) - 1) / x, and its limit 1 at x = 0.
template <class T>
inline T expm1_over_x(const T& x) {
  return 1.0 / x_over_expm1(x);
}

}  // namespace wiggers
