// Rosenbrock method of order 4 with an embedded one of order 3 for the error; four stages, three evaluations,
// one exact Jacobian (dual numbers) and one factorisation a step, L-stable. The coefficients are the L-stable
// set of E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, section IV.7, in the form without
// matrix-vector products. Inputs are constant over a step, so the system is autonomous.
//
// Step control: err = rms of error / (atol + rtol |y|), h <- h min(5, max(0.2, 0.9 err^(-1/4))).
#pragma once

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <span>
#include <vector>
#include <wiggers/cellmodels/schemes/branches.hpp>
#include <wiggers/cellmodels/schemes/jacobian.hpp>
#include <wiggers/core/adaptive.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/evaluation.hpp>
#include <wiggers/core/progress.hpp>

namespace wiggers {

template <class Model>
class Rosenbrock4 final : public AdaptiveIntegrator {
 public:
  static constexpr std::string_view name = "rosenbrock";
  static constexpr int n = static_cast<int>(Model::states.size());
  using Constants = typename Model::template Constants<double>;
  using State = std::array<double, Model::states.size()>;

  Rosenbrock4(const Constants& constants, double relative, const std::vector<double>& absolute)
      : constants_(constants), relative_(relative) {
    std::copy(absolute.begin(), absolute.end(), absolute_.begin());
  }

  void restart() override { h_ = 0; }
  AdaptiveCounts counts() const override { return counts_; }

  void advance(double span, double* y, const double* inputs, std::span<const double> samples = {},
               const OnSample& on_sample = {}) override {
    double t = 0;
    std::size_t next_sample = 0;
    State f0{}, before{}, f_before{};
    choose_interval(interval_at(y));
    differentiate(y, inputs, f0);
    unsigned steps = 0;
    while (t < span) {
      if ((++steps & 63) == 0) check_interrupt();
      if (h_ <= 0) h_ = first_step(y, f0, span);
      double h = std::min(h_, span - t);
      if (span - t - h < 0.1 * h) h = span - t;  // no crumb at the end
      State proposal{};
      const double error = attempt(h, y, inputs, f0, proposal);
      const bool accepted = error <= 1.0;
      if (accepted) {
        const int ahead = interval_at(proposal.data());
        const bool crossed = ahead != interval_;
        const double branch = crossed ? first_crossed<Model>(interval_, ahead) : 0;
        const int beyond = interval_ + (ahead > interval_ ? 1 : -1);
        const double asked = h;
        if (crossed && std::abs(y[V] - branch) < 1e-8) {
          // The step began on the branch potential and leaves it to the other side: those rates from the
          // start.
          choose_interval(beyond);
          differentiate(y, inputs, f0);
          continue;
        }
        if (crossed) h = step_to_branch(branch, h, y, inputs, f0, proposal);
        std::copy(y, y + n, before.begin());
        f_before = f0;
        std::copy(proposal.begin(), proposal.end(), y);
        const double begin = t;
        t = h >= span - t ? span : t + h;
        ++counts_.steps;
        if (crossed) choose_interval(beyond);
        if (t < span || (next_sample < samples.size() && samples[next_sample] <= t))
          differentiate(y, inputs, f0);
        for (; next_sample < samples.size() && samples[next_sample] <= t; ++next_sample)
          on_sample(next_sample,
                    interpolate((samples[next_sample] - begin) / h, h, before, f_before, y, f0).data());
        h = asked;
      } else {
        ++counts_.rejected;
      }
      // A last step cut short by the span's end says little about the next.
      const double factor = std::isfinite(error)
                                ? std::min(5.0, std::max(0.2, 0.9 * std::pow(std::max(error, 1e-10), -0.25)))
                                : 0.2;
      if (!accepted || h >= h_)
        h_ = h * factor;
      else if (factor < 1)
        h_ = std::min(h_, h * factor);
      if (!(h_ > 1e-13 * span))
        throw NumericalFailure(
            fmt::format("the step fell to {:.3g} at {:.6g} of {:.6g} (error test fails repeatedly); try a "
                        "looser tolerance",
                        h_, t, span));
    }
  }

 private:
  static constexpr double gamma = 0.57282;
  static constexpr int V = std::max(0, potential_of<Model>);  // without a membrane nothing is crossed

  // Cubic Hermite interpolation inside a step.
  static State interpolate(double s, double h, const State& y0, const State& f0, const double* y1,
                           const State& f1) {
    State y;
    for (int i = 0; i < n; ++i) {
      const double rise = y1[i] - y0[i];
      const double a = h * f0[i] - rise, b = rise - h * f1[i];
      y[i] = y0[i] + s * (rise + (1 - s) * (a * (1 - s) + b * s));
    }
    return y;
  }

  static int interval_at(const double* y) { return interval_of<Model>(y[V]); }
  void choose_interval(int interval) {
    interval_ = interval;
    keep_to_interval<Model>(constants_, interval);
  }
  // The step that ends on a branch potential, by the Illinois variant of false position; proposal is its end.
  double step_to_branch(double branch, double h, const double* y, const double* inputs, const State& f0,
                        State& proposal) {
    const auto distance = [&](const double* state) { return state[V] - branch; };
    double lower = 0, upper = h, at_lower = distance(y), at_upper = distance(proposal.data()), trial = h;
    for (int iteration = 0; iteration < 60; ++iteration) {
      trial = (lower * at_upper - upper * at_lower) / (at_upper - at_lower);
      attempt(trial, y, inputs, f0, proposal);
      const double d = distance(proposal.data());
      if (std::abs(d) < 1e-9 || upper - lower < 1e-13 * h) break;
      if ((d > 0) == (at_upper > 0)) {
        upper = trial;
        at_upper = d;
        at_lower *= 0.5;
      } else {
        lower = trial;
        at_lower = d;
        at_upper *= 0.5;
      }
    }
    return trial;
  }

  double first_step(const double* y, const State& f, double span) const {
    double size = 0, speed = 0;
    for (int i = 0; i < n; ++i) {
      const double scale = absolute_[i] + relative_ * std::abs(y[i]);
      size += (y[i] / scale) * (y[i] / scale);
      speed += (f[i] / scale) * (f[i] / scale);
    }
    return std::min(span, speed > 0 ? 0.01 * std::sqrt(size / speed) : span);
  }

  void differentiate(const double* y, const double* inputs, State& f0) {
    rates_and_jacobian<Model>(y, inputs, constants_, f0.data(), jacobian_.data());
    ++counts_.jacobians;
    ++counts_.evaluations;
  }

  void evaluate(const State& y, const double* inputs, State& f) {
    rates_from<Model, double>(Model::template evaluate<double>(y.data(), inputs, constants_), y.data(),
                              f.data());
    ++counts_.evaluations;
  }

  // Returns the error in units of the tolerance; not finite if the stages are not.
  double attempt(double h, const double* y, const double* inputs, const State& f0, State& result) {
    factorise(1.0 / (h * gamma));
    ++counts_.factorisations;
    constexpr double a21 = 2.0, a31 = 1.867943637803922, a32 = 0.2344449711399156;
    constexpr double c21 = -7.137615036412310, c31 = 2.580708087951457, c32 = 0.6515950076447975,
                     c41 = -2.137148994382534, c42 = -0.3214669691237626, c43 = -0.6949742501781779;
    constexpr double m1 = 2.255570073418735, m2 = 0.2870493262186792, m3 = 0.4353179431840180,
                     m4 = 1.093502252409163;
    constexpr double e1 = -0.2815431932141155, e2 = -0.07276199124934920, e3 = -0.1082196201495311,
                     e4 = -1.093502252409163;
    State k1 = f0, k2{}, k3{}, k4{}, stage{}, f{};
    const double per_h = 1.0 / h;
    solve(k1);
    for (int i = 0; i < n; ++i) stage[i] = y[i] + a21 * k1[i];
    evaluate(stage, inputs, f);
    for (int i = 0; i < n; ++i) k2[i] = f[i] + per_h * c21 * k1[i];
    solve(k2);
    for (int i = 0; i < n; ++i) stage[i] = y[i] + a31 * k1[i] + a32 * k2[i];
    evaluate(stage, inputs, f);
    for (int i = 0; i < n; ++i) k3[i] = f[i] + per_h * (c31 * k1[i] + c32 * k2[i]);
    solve(k3);
    for (int i = 0; i < n; ++i) k4[i] = f[i] + per_h * (c41 * k1[i] + c42 * k2[i] + c43 * k3[i]);
    solve(k4);
    double sum = 0;
    for (int i = 0; i < n; ++i) {
      result[i] = y[i] + m1 * k1[i] + m2 * k2[i] + m3 * k3[i] + m4 * k4[i];
      const double scale = absolute_[i] + relative_ * std::max(std::abs(y[i]), std::abs(result[i]));
      const double share = (e1 * k1[i] + e2 * k2[i] + e3 * k3[i] + e4 * k4[i]) / scale;
      sum += share * share;
    }
    return std::sqrt(sum / n);
  }

  // Gates of V alone couple to V and themselves: they are eliminated by hand, which leaves a small system of
  // the other states. LU of that with partial pivoting; sizes are fixed, no general matrix class in the loop.
  static constexpr auto eliminated = is_voltage_gate<Model>;
  static constexpr int n_left = [] {
    int count = 0;
    for (bool gone : eliminated) count += gone ? 0 : 1;
    return count;
  }();
  static constexpr std::array<int, n_left> left = [] {
    std::array<int, n_left> indexes{};
    int at = 0;
    for (int i = 0; i < n; ++i)
      if (!eliminated[i]) indexes[at++] = i;
    return indexes;
  }();
  static constexpr int potential_left = [] {  // where V is among them
    int at = 0;
    while (left[at] != V) ++at;
    return at;
  }();

  void factorise(double diagonal) {
    for (int a = 0; a < n_left; ++a)
      for (int b = 0; b < n_left; ++b) lu_[a][b] = (a == b ? diagonal : 0.0) - jacobian_[left[a]][left[b]];
    for (int g = 0; g < n; ++g) {
      if (!eliminated[g]) continue;
      gate_inverse_[g] = 1.0 / (diagonal - jacobian_[g][g]);
      gate_slope_[g] = jacobian_[g][V] * gate_inverse_[g];
      for (int a = 0; a < n_left; ++a) lu_[a][potential_left] -= jacobian_[left[a]][g] * gate_slope_[g];
    }
    for (int k = 0; k < n_left; ++k) {
      int pivot = k;
      for (int i = k + 1; i < n_left; ++i)
        if (std::abs(lu_[i][k]) > std::abs(lu_[pivot][k])) pivot = i;
      pivot_[k] = pivot;
      if (pivot != k) std::swap(lu_[k], lu_[pivot]);
      const double inverse = 1.0 / lu_[k][k];
      inverse_[k] = inverse;
      for (int i = k + 1; i < n_left; ++i) {
        const double factor = lu_[i][k] * inverse;
        lu_[i][k] = factor;
        for (int j = k + 1; j < n_left; ++j) lu_[i][j] -= factor * lu_[k][j];
      }
    }
  }
  void solve(State& b) const {
    std::array<double, n_left> x;
    for (int a = 0; a < n_left; ++a) x[a] = b[left[a]];
    for (int g = 0; g < n; ++g) {
      if (!eliminated[g]) continue;
      const double share = gate_inverse_[g] * b[g];
      for (int a = 0; a < n_left; ++a) x[a] += jacobian_[left[a]][g] * share;
    }
    for (int k = 0; k < n_left; ++k) std::swap(x[k], x[pivot_[k]]);
    for (int k = 0; k < n_left; ++k)
      for (int i = k + 1; i < n_left; ++i) x[i] -= lu_[i][k] * x[k];
    for (int k = n_left - 1; k >= 0; --k) {
      for (int j = k + 1; j < n_left; ++j) x[k] -= lu_[k][j] * x[j];
      x[k] *= inverse_[k];
    }
    for (int g = 0; g < n; ++g)
      if (eliminated[g]) b[g] = gate_inverse_[g] * b[g] + gate_slope_[g] * x[potential_left];
    for (int a = 0; a < n_left; ++a) b[left[a]] = x[a];
  }

  Constants constants_;
  int interval_ = 0;
  double relative_;
  State absolute_{};
  double h_ = 0;
  AdaptiveCounts counts_;
  std::array<State, Model::states.size()> jacobian_{};
  std::array<std::array<double, n_left>, n_left> lu_{};
  std::array<double, n_left> inverse_{};
  std::array<int, n_left> pivot_{};
  State gate_inverse_{}, gate_slope_{};
};

}  // namespace wiggers
