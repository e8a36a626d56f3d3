// What the equations of a model keep, whatever the inputs, and the state that is moved to hold it: schemes
// and accelerated searches let it drift.
#pragma once

#include <cstddef>
#include <string_view>
#include <wiggers/core/quantity.hpp>

namespace wiggers {

struct Invariant {
  std::string_view name, unit, meaning;
  int balance;             // the state, in which it is linear, that is moved to hold it
  bool is_charge = false;  // of the membrane: a cell has as many cycles as it has charges
};

constexpr Invariant membrane_charge(int balance) {
  return {"charge", "mV", "membrane charge minus the ions' charge, over capacitance", balance, true};
}

// Whether a model with these parameters keeps its invariants: it does not where a part of the stimulus is
// carried by no ion.
template <class Model>
bool keeps_invariants(const double* parameters) {
  for (std::size_t k = 0; k < Model::parameters.size(); ++k)
    if (Model::parameters[k].role == Role::stimulus_share && parameters[k] != 1.0) return false;
  return true;
}

// Moves the balancing states of a model so that its invariants have the given values.
template <class Model, class T, class Constants>
void hold_invariants(T* y, const Constants& constants, const T* values) {
  const auto now = Model::invariant_values(y, constants);
  const auto slopes = Model::invariant_slopes(constants);
  for (std::size_t k = 0; k < now.size(); ++k)
    y[Model::invariants[k].balance] += (values[k] - now[k]) / slopes[k];
}

}  // namespace wiggers
