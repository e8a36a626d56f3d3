// Short spellings for the fact sheets of the cell models.
#pragma once

#include <wiggers/core/quantity.hpp>

namespace wiggers::facts {

// A Hodgkin-Huxley gate or a probability.
constexpr Quantity gate(std::string_view name, double start, std::string_view meaning) {
  return {name, "1", start, 0, 1, meaning};
}
constexpr Quantity membrane_potential(double start) {
  return {"V", "mV", start, -150, 150, "membrane potential"};
}
constexpr Quantity concentration(std::string_view name, double start, std::string_view meaning) {
  return {name, "mM", start, 1e-9, 1000, meaning};
}
// A parameter that may be anything from zero to a hundred times its default.
constexpr Quantity non_negative(std::string_view name, std::string_view unit, double value,
                                std::string_view meaning) {
  return {name, unit, value, 0, value > 0 ? 100 * value : 1, meaning};
}
// A parameter that divides or scales a state and must not vanish.
constexpr Quantity positive(std::string_view name, std::string_view unit, double value,
                            std::string_view meaning) {
  return {name, unit, value, value / 1000, value * 1000, meaning};
}
constexpr Quantity output(std::string_view name, std::string_view unit, std::string_view meaning) {
  return {name, unit, 0, -unbounded, unbounded, meaning};
}

}  // namespace wiggers::facts
