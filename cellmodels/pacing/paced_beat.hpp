// One beat of a paced cell by Rush-Larsen steps, for numbers of any kind; with dual numbers its derivatives
// by state, parameters, period and pulse.
//
// Where the potential crosses the value at which the model's rates jump (branch_potential) the step is split,
// so that the image is a smooth function of everything: without it, a crossing that moves from one step to
// the next is a jump, and difference quotients of the cycle see noise of 1e-4.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>
#include <wiggers/core/dual.hpp>
#include <wiggers/core/fixed_step.hpp>
#include <wiggers/core/progress.hpp>
#include <wiggers/core/root.hpp>

namespace wiggers {

template <class T>
struct PacedBeatInputs {
  std::vector<T> parameters;  // of the model
  T period_ms = 0, amplitude_A_per_F = 0, duration_ms = 0;
  T charge_mV = 0;  // held at the end of the beat
};

template <class Model, class T>
class PacedBeat {
  static constexpr std::size_t n_states = Model::states.size();
  template <class P>
  using Constants = typename Model::template Constants<P>;

 public:
  PacedBeat(PacedBeatInputs<T> inputs, double onset_ms, double dt_ms, bool second_order)
      : in_(std::move(inputs)),
        constants_(Model::constants(in_.parameters.data())),
        below_(on_side(constants_, true)),
        above_(on_side(constants_, false)),
        plain_below_(on_side(Model::constants(plain_parameters().data()), true)),
        plain_above_(on_side(Model::constants(plain_parameters().data()), false)),
        onset_(onset_ms),
        dt_(dt_ms),
        second_order_(second_order) {}

  // on_step(t, y) at the start and after every step.
  template <class OnStep>
  void run(T* y, OnStep on_step) const {
    T t(0.0);
    on_step(t, y);
    span(t, T(onset_), T(0.0), y, on_step);
    span(t, T(onset_ + in_.duration_ms), in_.amplitude_A_per_F, y, on_step);
    span(t, in_.period_ms, T(0.0), y, on_step);
    y[Model::balancing_ion] += (in_.charge_mV - charge(y)) / Model::invariant_slope(constants_);
  }
  std::vector<double> stimulus_edges() const { return {onset_, onset_ + value_of(in_.duration_ms)}; }
  T charge(const T* y) const { return Model::invariant(y, constants_); }

 private:
  template <class N, class H, class P>
  void step(const H& h, N* y, const N* stimulus, const Constants<P>& constants) const {
    if (second_order_)
      RushLarsen2<Model, N>().step(h, y, stimulus, constants);
    else
      RushLarsen1<Model, N>().step(h, y, stimulus, constants);
  }

  template <class OnStep>
  void span(T& t, const T& end, const T& current, T* y, OnStep& on_step) const {
    if (!(value_of(end) > value_of(t))) {
      t = end;
      return;
    }
    const T stimulus[1] = {current};
    bool below = value_of(y[Model::membrane_potential]) < Model::branch_potential;
    unsigned steps = 0;
    for (bool reached = false; !reached;) {
      if ((++steps & 63) == 0) check_interrupt();
      const T h = next_step(T(end - t), dt_);
      reached = value_of(h) >= value_of(end) - value_of(t);
      T left = h;
      // A step that crosses is split there; more than one crossing a step is not looked for.
      for (int split = 0; split < 2; ++split) {
        std::array<T, n_states> next;
        std::copy(y, y + n_states, next.begin());
        step(left, next.data(), stimulus, side(below));
        const bool crosses =
            (value_of(next[Model::membrane_potential]) < Model::branch_potential) != below && split == 0;
        T part = left;
        if (crosses) {
          part = crossing(value_of(left), y, stimulus, below);
          std::copy(y, y + n_states, next.begin());
          step(part, next.data(), stimulus, side(below));
        }
        std::copy(next.begin(), next.end(), y);
        if (!crosses) break;
        below = !below;
        left = left - part;
        if (value_of(left) < 1e-12 * value_of(h)) break;
      }
      t = reached ? end : T(t + h);
      on_step(t, y);
    }
  }

  // Time from the step's start to the crossing.
  T crossing(double h, const T* y, const T* stimulus, bool below) const {
    constexpr int V = Model::membrane_potential;
    std::array<double, n_states> start;
    for (std::size_t i = 0; i < n_states; ++i) start[i] = value_of(y[i]);
    const double current[1] = {value_of(stimulus[0])};
    const Constants<double>& plain = below ? plain_below_ : plain_above_;
    const auto distance = [&](double part) {
      auto state = start;
      step(part, state.data(), current, plain);
      return state[V] - Model::branch_potential;
    };
    const double b =
        bracketed_root(distance, 0, h, start[V] - Model::branch_potential, distance(h), 1e-12, 1e-14 * h);
    std::array<Dual<1>, n_states> moving;
    for (std::size_t i = 0; i < n_states; ++i) moving[i] = start[i];
    const Dual<1> moving_current[1] = {current[0]};
    step(Dual<1>::variable(b, 0), moving.data(), moving_current, plain);
    const double slope = moving[V].derivative[0];
    if (!(std::abs(slope) > 1e-9)) return T(b);
    // One Newton step in full arithmetic: its derivatives are those of the crossing's time.
    std::array<T, n_states> state;
    std::copy(y, y + n_states, state.begin());
    step(b, state.data(), stimulus, side(below));
    return b - (state[V] - Model::branch_potential) / slope;
  }

  const Constants<T>& side(bool below) const { return below ? below_ : above_; }
  template <class P>
  static Constants<P> on_side(Constants<P> constants, bool below) {
    constants.rate_branch = below ? 1e9 : -1e9;
    return constants;
  }
  std::vector<double> plain_parameters() const {
    std::vector<double> values;
    for (const T& p : in_.parameters) values.push_back(value_of(p));
    return values;
  }

  PacedBeatInputs<T> in_;
  Constants<T> constants_, below_, above_;  // as they are, and kept to one branch of the rates
  Constants<double> plain_below_, plain_above_;
  double onset_, dt_;
  bool second_order_;
};

}  // namespace wiggers
