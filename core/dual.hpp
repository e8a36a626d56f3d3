// Dual numbers: a value with N first derivatives, for exact Jacobians and sensitivities (forward mode).
#pragma once

#include <array>
#include <wiggers/core/numbers.hpp>

namespace wiggers {

template <int N>
struct Dual {
  double value;
  std::array<double, N> derivative;

  Dual() : Dual(0.0) {}
  Dual(double constant) : value(constant) {
    derivative.fill(0.0);
  }  // NOLINT: constants mix freely with duals
  // Derivatives left for the caller to fill.
  struct Unfilled {};
  Dual(double result, Unfilled) : value(result) {}

  // The independent variable number `index`.
  static Dual variable(double value, int index) {
    Dual x(value);
    x.derivative[index] = 1;
    return x;
  }

  Dual& operator+=(const Dual& other) { return *this = *this + other; }
  Dual& operator-=(const Dual& other) { return *this = *this - other; }
  Dual& operator*=(const Dual& other) { return *this = *this * other; }
  Dual& operator/=(const Dual& other) { return *this = *this / other; }

  // f(x) given f and f' at the value: the chain rule.
  Dual chain(double f, double slope) const {
    Dual r(f, Unfilled{});
    for (int k = 0; k < N; ++k) r.derivative[k] = slope * derivative[k];
    return r;
  }

  friend Dual operator-(const Dual& a) { return a.chain(-a.value, -1); }
  friend Dual operator+(const Dual& a, const Dual& b) {
    Dual r(a.value + b.value, Unfilled{});
    for (int k = 0; k < N; ++k) r.derivative[k] = a.derivative[k] + b.derivative[k];
    return r;
  }
  friend Dual operator-(const Dual& a, const Dual& b) {
    Dual r(a.value - b.value, Unfilled{});
    for (int k = 0; k < N; ++k) r.derivative[k] = a.derivative[k] - b.derivative[k];
    return r;
  }
  friend Dual operator*(const Dual& a, const Dual& b) {
    Dual r(a.value * b.value, Unfilled{});
    for (int k = 0; k < N; ++k) r.derivative[k] = a.derivative[k] * b.value + a.value * b.derivative[k];
    return r;
  }
  friend Dual operator/(const Dual& a, const Dual& b) {
    const double inverse = 1 / b.value;
    Dual r(a.value * inverse, Unfilled{});
    for (int k = 0; k < N; ++k) r.derivative[k] = (a.derivative[k] - r.value * b.derivative[k]) * inverse;
    return r;
  }
  // Mixed forms with constants avoid the work on zero derivatives.
  friend Dual operator+(const Dual& a, double b) {
    Dual r(a);
    r.value += b;
    return r;
  }
  friend Dual operator+(double a, const Dual& b) { return b + a; }
  friend Dual operator-(const Dual& a, double b) { return a + (-b); }
  friend Dual operator-(double a, const Dual& b) { return b.chain(a - b.value, -1); }
  friend Dual operator*(const Dual& a, double b) { return a.chain(a.value * b, b); }
  friend Dual operator*(double a, const Dual& b) { return b * a; }
  friend Dual operator/(const Dual& a, double b) { return a.chain(a.value / b, 1 / b); }

  friend bool operator<(const Dual& a, const Dual& b) { return a.value < b.value; }
  friend bool operator>(const Dual& a, const Dual& b) { return a.value > b.value; }
  friend bool operator<=(const Dual& a, const Dual& b) { return a.value <= b.value; }
  friend bool operator>=(const Dual& a, const Dual& b) { return a.value >= b.value; }

  friend Dual select(bool mask, const Dual& if_true, const Dual& if_false) {
    return mask ? if_true : if_false;
  }
  friend Dual exp(const Dual& x) {
    const double e = std::exp(x.value);
    return x.chain(e, e);
  }
  friend Dual expm1(const Dual& x) {
    const double e = std::expm1(x.value);
    return x.chain(e, e + 1);
  }
  friend Dual log(const Dual& x) { return x.chain(std::log(x.value), 1 / x.value); }
  friend Dual sqrt(const Dual& x) {
    const double root = std::sqrt(x.value);
    return x.chain(root, 0.5 / root);
  }
  friend Dual tanh(const Dual& x) {
    const double t = std::tanh(x.value);
    return x.chain(t, 1 - t * t);
  }
  friend Dual atan(const Dual& x) { return x.chain(std::atan(x.value), 1 / (1 + x.value * x.value)); }
  friend Dual cos(const Dual& x) { return x.chain(std::cos(x.value), -std::sin(x.value)); }
  friend Dual quarter_cosine(const Dual& x) {
    constexpr double half_pi = 1.57079632679489661923;
    return x.chain(wiggers::quarter_cosine(x.value), -half_pi * std::sin(half_pi * x.value));
  }
  friend Dual abs(const Dual& x) { return x.chain(std::abs(x.value), x.value < 0 ? -1.0 : 1.0); }
  friend Dual cbrt(const Dual& x) {
    const double root = std::cbrt(x.value);
    return x.chain(root, root / (3 * x.value));
  }
  friend Dual pow(const Dual& x, double exponent) {
    const double power = std::pow(x.value, exponent);
    return x.chain(power, exponent * power / x.value);
  }
  friend Dual pow(const Dual& x, const Dual& exponent) { return exp(log(x) * exponent); }
  friend Dual floor(const Dual& x) { return Dual(std::floor(x.value)); }
  friend double value_of(const Dual& x) { return x.value; }
};

}  // namespace wiggers
