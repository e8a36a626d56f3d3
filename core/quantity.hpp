// Quantities: the one place where a number's name, unit, default, range and meaning stand.
//
// States, parameters, inputs and observables of every model, and every key of a scene, are constexpr
// arrays of Quantity. Code, --help, error messages, docs, result files and Python read them from here.
#pragma once

#include <array>
#include <cstddef>
#include <limits>
#include <string>
#include <string_view>

namespace wiggers {

inline constexpr double unbounded = std::numeric_limits<double>::infinity();

// What a state or an input is to the code that steps a model: marked where the quantity stands, never known
// by its position or spelling.
enum class Role : char {
  none,
  // States.
  gate,          // obeys dg/dt = (steady - g)/tau, both independent of g
  voltage_gate,  // the same, both functions of the potential alone
  potential,     // of the membrane
  calcium,       // in the cytosol, what drives a force model
  stimulus_ion,  // carries the stimulus current
  // Inputs.
  stimulus,  // the current that is paced
  // Parameters.
  stimulus_share,    // how much of the stimulus its ion carries; only all of it keeps the charge
  strength,          // scales the tension, and nothing else
  reference_length,  // of the sarcomere, to which strain is referred
  // Observables.
  tension,
  stiffness,
};

struct Quantity {
  std::string_view name;
  std::string_view unit;  // "1" for dimensionless
  double default_value = 0;
  double lower = -unbounded;  // admissible range, ends included
  double upper = unbounded;
  std::string_view meaning;
  Role role = Role::none;
};

constexpr Quantity marked(Role role, Quantity quantity) {
  quantity.role = role;
  return quantity;
}

// Position of the quantity with a role; -1 if there is none.
template <std::size_t N>
constexpr int index_of(const std::array<Quantity, N>& quantities, Role role) {
  for (std::size_t i = 0; i < N; ++i)
    if (quantities[i].role == role) return static_cast<int>(i);
  return -1;
}

// A parameter as a list shows it: its fact sheet, its full name (with the table it stands in) and its value.
struct NamedParameter {
  std::string name;
  Quantity quantity;
  double value = 0;
};

// True if every entry has a name (unique), a unit, a meaning and a default inside its range.
// Used in static_assert beside each array: a fact sheet with a gap does not compile.
template <std::size_t N>
consteval bool well_formed(const std::array<Quantity, N>& quantities) {
  for (std::size_t i = 0; i < N; ++i) {
    const Quantity& q = quantities[i];
    if (q.name.empty() || q.unit.empty() || q.meaning.empty()) return false;
    if (!(q.lower <= q.default_value && q.default_value <= q.upper)) return false;
    for (std::size_t k = 0; k < i; ++k)
      if (quantities[k].name == q.name) return false;
  }
  return true;
}

// Position of a name; N if there is none.
template <std::size_t N>
constexpr std::size_t index_of(const std::array<Quantity, N>& quantities, std::string_view name) {
  for (std::size_t i = 0; i < N; ++i)
    if (quantities[i].name == name) return i;
  return N;
}

// The default values, in order.
template <std::size_t N>
constexpr std::array<double, N> defaults_of(const std::array<Quantity, N>& quantities) {
  std::array<double, N> values{};
  for (std::size_t i = 0; i < N; ++i) values[i] = quantities[i].default_value;
  return values;
}

// A named, sourced deviation from the defaults of a model's parameters.
struct ParameterChange {
  std::string_view name;
  double value;
};

struct ParameterSet {
  std::string_view name;
  std::string_view source;   // paper and table, or who tuned it
  std::string_view version;  // changes whenever a value does
  const ParameterChange* changes = nullptr;
  std::size_t n_changes = 0;
};

}  // namespace wiggers
