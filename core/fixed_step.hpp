// Fixed-step integrators for models with gates; one small class each, for any model and number type.
//
//   ForwardEuler      first order, explicit in everything: the baseline
//   RushLarsen1       gates exactly for frozen rates, the rest by forward Euler; first order
//   RushLarsen2       the same in a midpoint frame; second order, two evaluations
//   GeneralisedRushLarsen1, 2   gates as above, every other state exponentially with its own derivative d
//   f_i/d y_i
//                     (dual numbers): no step limit from fast concentrations; orders 1 and 2
//   Bdf2Imex          the founding paper's step: gates implicitly (linear), the rest explicitly, BDF2
//
// The step h is plain, or dual where its length is to be differentiated (the first three).
//
// step(h, y, inputs, constants) advances y by h with the inputs held. Callers split steps at stimulus edges
// and call restart() there (only Bdf2Imex has a memory). Schemes as in the docs page on integrators.
#pragma once

#include <array>
#include <cmath>
#include <string_view>
#include <wiggers/core/dual.hpp>
#include <wiggers/core/evaluation.hpp>
#include <wiggers/core/numbers.hpp>

namespace wiggers {

// Number of equal steps, none longer than wanted, for a span.
inline long whole_steps(double span, double wanted) {
  return static_cast<long>(std::ceil(span / wanted * (1 - 1e-12)));
}

// The next step in a span of which `left` is left: the wanted length, and what remains as the last step. Only
// the last one moves with the span's end, so that the image of the span is a smooth function of the end and
// its derivative is not that of every step's error.
template <class T>
T next_step(const T& left, double wanted) {
  return value_of(left) > wanted * (1 + 1e-9) ? T(wanted) : left;
}

template <class Model, class T>
struct ForwardEuler {
  static constexpr std::string_view name = "forward-euler";
  void restart() {}
  template <class H, class Constants>
  void step(const H& h, T* y, const T* inputs, const Constants& constants) {
    std::array<T, Model::states.size()> rates;
    rates_from<Model, T>(Model::template evaluate<T>(y, inputs, constants), y, rates.data());
    for (std::size_t i = 0; i < rates.size(); ++i) y[i] += h * rates[i];
  }
};

// One Rush-Larsen update of `y` over h with the rates in `e` (shared by both orders).
template <class Model, class T, class H>
inline void rush_larsen_update(const H& h, const EvaluationOf<Model, T>& e, const T* from, T* y) {
  for (std::size_t i = 0; i < Model::states.size(); ++i)
    y[i] = is_gate<Model>[i] ? T(e.steady[i] + (from[i] - e.steady[i]) * exp(T(-h / e.tau[i])))
                             : T(from[i] + h * e.derivative[i]);
}

template <class Model, class T>
struct RushLarsen1 {
  static constexpr std::string_view name = "rush-larsen";
  void restart() {}
  template <class H, class Constants>
  void step(const H& h, T* y, const T* inputs, const Constants& constants) {
    rush_larsen_update<Model, T>(h, Model::template evaluate<T>(y, inputs, constants), y, y);
  }
};

template <class Model, class T>
struct RushLarsen2 {
  static constexpr std::string_view name = "rush-larsen-2";
  void restart() {}
  template <class H, class Constants>
  void step(const H& h, T* y, const T* inputs, const Constants& constants) {
    std::array<T, Model::states.size()> middle;
    rush_larsen_update<Model, T>(H(0.5 * h), Model::template evaluate<T>(y, inputs, constants), y,
                                 middle.data());
    rush_larsen_update<Model, T>(h, Model::template evaluate<T>(middle.data(), inputs, constants), y, y);
  }
};

// One generalised Rush-Larsen update of `y` over h from `from`, with rates and own derivatives at `at`.
template <class Model, class Constants>
inline void generalised_rush_larsen_update(double h, const double* at, const double* inputs,
                                           const Constants& constants, const double* from, double* y) {
  constexpr std::size_t n = Model::states.size();
  constexpr int n_others = [] {
    int count = 0;
    for (bool gate : is_gate<Model>) count += gate ? 0 : 1;
    return count;
  }();
  using D = Dual<n_others>;
  std::array<D, n> yd;
  int seed = 0;
  for (std::size_t i = 0; i < n; ++i) yd[i] = is_gate<Model>[i] ? D(at[i]) : D::variable(at[i], seed++);
  std::array<D, Model::inputs.size()> in;
  for (std::size_t i = 0; i < in.size(); ++i) in[i] = D(inputs[i]);
  const auto e = Model::template evaluate<D>(yd.data(), in.data(), constants);
  seed = 0;
  for (std::size_t i = 0; i < n; ++i) {
    if (is_gate<Model>[i]) {
      const double steady = e.steady[i].value;
      y[i] = steady + (from[i] - steady) * exp(-h / e.tau[i].value);
    } else {
      const double own = e.derivative[i].derivative[seed++];
      // Linearised about `at`: the rate at `from` is f + own (from - at).
      const double rate = e.derivative[i].value + own * (from[i] - at[i]);
      y[i] = from[i] + h * expm1_over_x(h * own) * rate;
    }
  }
}

template <class Model, class T>
struct GeneralisedRushLarsen1 {
  static constexpr std::string_view name = "generalised-rush-larsen";
  void restart() {}
  template <class Constants>
  void step(double h, T* y, const T* inputs, const Constants& constants) {
    generalised_rush_larsen_update<Model>(h, y, inputs, constants, y, y);
  }
};

template <class Model, class T>
struct GeneralisedRushLarsen2 {
  static constexpr std::string_view name = "generalised-rush-larsen-2";
  void restart() {}
  template <class Constants>
  void step(double h, T* y, const T* inputs, const Constants& constants) {
    std::array<T, Model::states.size()> middle;
    generalised_rush_larsen_update<Model>(0.5 * h, y, inputs, constants, y, middle.data());
    generalised_rush_larsen_update<Model>(h, middle.data(), inputs, constants, y, y);
  }
};

template <class Model, class T>
struct Bdf2Imex {
  static constexpr std::string_view name = "bdf2-imex";
  static constexpr std::size_t n = Model::states.size();

  void restart() { has_history_ = false; }

  template <class Constants>
  void step(double h, T* y, const T* inputs, const Constants& constants) {
    std::array<T, n> before;
    for (std::size_t i = 0; i < n; ++i) before[i] = y[i];
    // Steps that differ by rounding are equal.
    if (!has_history_ || std::abs(h - last_h_) > 1e-9 * h) {
      RushLarsen2<Model, T>().step(h, y, inputs, constants);
    } else {
      // Extrapolate what is no gate; a concentration must not leave its positive range on the way.
      std::array<T, n> star;
      for (std::size_t i = 0; i < n; ++i) {
        star[i] = y[i];
        if (!is_gate<Model>[i]) {
          const T ahead = 2.0 * y[i] - previous_[i];
          star[i] = Model::states[i].lower >= 0 ? select(ahead > 0.0, ahead, y[i]) : ahead;
        }
      }
      const auto rates = Model::template evaluate<T>(star.data(), inputs, constants);
      for (std::size_t i = 0; i < n; ++i)
        if (is_gate<Model>[i])
          star[i] = (2.0 * y[i] - 0.5 * previous_[i] + h * rates.steady[i] / rates.tau[i]) /
                    (1.5 + h / rates.tau[i]);
      // Currents with the new gates and the extrapolated concentrations: one more evaluation keeps the
      // order and needs no splitting of the model into its parts.
      const auto fluxes = Model::template evaluate<T>(star.data(), inputs, constants);
      for (std::size_t i = 0; i < n; ++i)
        y[i] = is_gate<Model>[i] ? star[i]
                                 : T((2.0 * y[i] - 0.5 * previous_[i] + h * fluxes.derivative[i]) / 1.5);
    }
    previous_ = before;
    last_h_ = h;
    has_history_ = true;
  }

 private:
  std::array<T, n> previous_{};
  double last_h_ = 0;
  bool has_history_ = false;
};

}  // namespace wiggers
