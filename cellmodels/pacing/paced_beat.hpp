// One beat of a paced cell by Rush-Larsen steps, for numbers of any kind; with dual numbers its derivatives
// by state, parameters, period and pulse.
//
// Where the potential crosses a value at which the model's rates jump (branch_potentials) the step is split,
// so that the image is a smooth function of everything: without it, a crossing that moves from one step to
// the next is a jump, and difference quotients of the cycle see noise of 1e-4.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>
#include <wiggers/cellmodels/models/ionic_model.hpp>
#include <wiggers/cellmodels/schemes/branches.hpp>
#include <wiggers/core/dual.hpp>
#include <wiggers/core/fixed_step.hpp>
#include <wiggers/core/progress.hpp>
#include <wiggers/core/root.hpp>

namespace wiggers {

template <class T>
struct PacedBeatInputs {
  std::vector<T> parameters;  // of the model
  T period_ms = 0, amplitude_A_per_F = 0, duration_ms = 0;
  std::vector<T> invariants;  // held at the end of the beat
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
        within_(in_intervals(constants_)),
        plain_within_(in_intervals(Model::constants(plain_parameters().data()))),
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
    if constexpr (HasInvariants<Model>) hold_invariants<Model>(y, constants_, in_.invariants.data());
  }
  std::vector<double> stimulus_edges() const { return {onset_, onset_ + value_of(in_.duration_ms)}; }

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
    int interval = interval_of<Model>(value_of(y[V]));
    unsigned steps = 0;
    for (bool reached = false; !reached;) {
      if ((++steps & 63) == 0) check_interrupt();
      const T h = next_step(T(end - t), dt_);
      reached = value_of(h) >= value_of(end) - value_of(t);
      T left = h;
      // A step that crosses is split there; a way back over the same potential within the step is not looked
      // for.
      for (std::size_t split = 0; split <= n_branches<Model>; ++split) {
        std::array<T, n_states> next;
        std::copy(y, y + n_states, next.begin());
        step(left, next.data(), stimulus, within(interval));
        const int ahead = interval_of<Model>(value_of(next[V]));
        const bool crosses = ahead != interval && split < n_branches<Model>;
        T part = left;
        if (crosses) {
          part = crossing(value_of(left), y, stimulus, interval, first_crossed<Model>(interval, ahead));
          std::copy(y, y + n_states, next.begin());
          step(part, next.data(), stimulus, within(interval));
        }
        std::copy(next.begin(), next.end(), y);
        if (!crosses) break;
        interval += ahead > interval ? 1 : -1;
        left = left - part;
        if (value_of(left) < 1e-12 * value_of(h)) break;
      }
      t = reached ? end : T(t + h);
      on_step(t, y);
    }
  }

  // Time from the step's start to the crossing of a branch potential.
  T crossing(double h, const T* y, const T* stimulus, int interval, double branch) const {
    std::array<double, n_states> start;
    for (std::size_t i = 0; i < n_states; ++i) start[i] = value_of(y[i]);
    const double current[1] = {value_of(stimulus[0])};
    const Constants<double>& plain = plain_within_[static_cast<std::size_t>(interval)];
    const auto distance = [&](double part) {
      auto state = start;
      step(part, state.data(), current, plain);
      return state[V] - branch;
    };
    const double b = bracketed_root(distance, 0, h, start[V] - branch, distance(h), 1e-12, 1e-14 * h);
    std::array<Dual<1>, n_states> moving;
    for (std::size_t i = 0; i < n_states; ++i) moving[i] = start[i];
    const Dual<1> moving_current[1] = {current[0]};
    step(Dual<1>::variable(b, 0), moving.data(), moving_current, plain);
    const double slope = moving[V].derivative[0];
    if (!(std::abs(slope) > 1e-9)) return T(b);
    // One Newton step in full arithmetic: its derivatives are those of the crossing's time.
    std::array<T, n_states> state;
    std::copy(y, y + n_states, state.begin());
    step(b, state.data(), stimulus, within(interval));
    return b - (state[V] - branch) / slope;
  }

  static constexpr int V = potential_of<Model>;
  // Constants that keep to the rates of each interval between branch potentials.
  template <class P>
  using InIntervals = std::array<Constants<P>, n_branches<Model> + 1>;
  template <class P>
  static InIntervals<P> in_intervals(const Constants<P>& constants) {
    InIntervals<P> all;
    for (std::size_t k = 0; k < all.size(); ++k) {
      all[k] = constants;
      keep_to_interval<Model>(all[k], static_cast<int>(k));
    }
    return all;
  }
  const Constants<T>& within(int interval) const { return within_[static_cast<std::size_t>(interval)]; }
  std::vector<double> plain_parameters() const {
    std::vector<double> values;
    for (const T& p : in_.parameters) values.push_back(value_of(p));
    return values;
  }

  PacedBeatInputs<T> in_;
  Constants<T> constants_;
  InIntervals<T> within_;
  InIntervals<double> plain_within_;
  double onset_, dt_;
  bool second_order_;
};

}  // namespace wiggers
