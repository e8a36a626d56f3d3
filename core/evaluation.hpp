// What one evaluation of a model gives, and what follows from it without the model's help.
//
// A model is a type with constexpr fact sheets (states, parameters, inputs, observables), in which states are
// marked by their roles, and
//     template <class T, class P> static Evaluation<T, n, m> evaluate(y, inputs, derived constants)
// For a gate it sets (steady, tau); for every other state the derivative. Gates obey
//     dg/dt = (steady - g) / tau,
// with steady and tau independent of g: what Rush-Larsen and the implicit gate updates need.
#pragma once

#include <array>
#include <cstddef>
#include <wiggers/core/quantity.hpp>

namespace wiggers {

template <class T, std::size_t n_states, std::size_t n_observables>
struct Evaluation {
  std::array<T, n_states> derivative;  // of states that are no gates
  std::array<T, n_states> steady;      // of gates
  std::array<T, n_states> tau;         // of gates
  std::array<T, n_observables> observable;
};

template <class Model, class T>
using EvaluationOf = Evaluation<T, Model::states.size(), Model::observables.size()>;

// What is marked in a model's fact sheet, as arrays by state.
template <class Model>
inline constexpr std::array<bool, Model::states.size()> is_voltage_gate = [] {
  std::array<bool, Model::states.size()> is{};
  for (std::size_t i = 0; i < is.size(); ++i) is[i] = Model::states[i].role == Role::voltage_gate;
  return is;
}();
template <class Model>
inline constexpr std::array<bool, Model::states.size()> is_gate = [] {
  std::array<bool, Model::states.size()> is = is_voltage_gate<Model>;
  for (std::size_t i = 0; i < is.size(); ++i) is[i] = is[i] || Model::states[i].role == Role::gate;
  return is;
}();
// The states with these roles; -1 if the model has none.
template <class Model>
inline constexpr int potential_of = index_of(Model::states, Role::potential);
template <class Model>
inline constexpr int calcium_of = index_of(Model::states, Role::calcium);

// Whether a model's functions of the potential alone come apart from the rest: voltage_gates, voltage_factors
// and balances, see evaluate_in_parts. Tables can stand in for the first two.
template <class Model>
concept InParts = requires {
  Model::n_voltage_factors;
};

// The whole evaluation of a model that comes in parts: gates of V, factors of V, and what needs the other
// states.
template <class Model, class T, class Constants>
inline EvaluationOf<Model, T> evaluate_in_parts(const T* y, const T* inputs, const Constants& constants) {
  EvaluationOf<Model, T> e;
  const T& V = y[potential_of<Model>];
  Model::voltage_gates(V, constants, e);
  Model::balances(y, inputs, Model::voltage_factors(V, constants), constants, e);
  return e;
}

// Derivatives of all states, gates included.
template <class Model, class T>
inline void rates_from(const EvaluationOf<Model, T>& e, const T* y, T* rates) {
  for (std::size_t i = 0; i < Model::states.size(); ++i)
    rates[i] = is_gate<Model>[i] ? (e.steady[i] - y[i]) / e.tau[i] : e.derivative[i];
}

}  // namespace wiggers
