// Short spellings for the fact sheets of the cell models. A range is a promise: its ends can be, in a cell
// that is ill, poisoned, or changed to see what a parameter does. Constants of nature are what they are.
#pragma once

#include <array>
#include <wiggers/core/quantity.hpp>

namespace wiggers::facts {

// A probability, or a gate with a rate equation of its own.
constexpr Quantity probability(std::string_view name, double start, std::string_view meaning) {
  return {name, "1", start, 0, 1, meaning};
}
// A Hodgkin-Huxley gate; and one whose steady value and time constant are functions of the potential alone.
constexpr Quantity gate(std::string_view name, double start, std::string_view meaning) {
  return marked(Role::gate, probability(name, start, meaning));
}
constexpr Quantity voltage_gate(std::string_view name, double start, std::string_view meaning) {
  return marked(Role::voltage_gate, probability(name, start, meaning));
}
constexpr Quantity membrane_potential(double start) {
  return {"V", "mV", start, -150, 150, "membrane potential", Role::potential};
}
// Concentrations within a cell. Their ranges also bound what integrators may pass through: where pumps are
// blocked sodium and potassium come to those of the surroundings, and calcium does in cytosol and dyads.
constexpr Quantity sodium_or_potassium(std::string_view name, double start, std::string_view meaning) {
  return {name, "mM", start, 0.1, 300, meaning};
}
constexpr Quantity free_calcium(std::string_view name, double start, std::string_view meaning) {
  return {name, "mM", start, 1e-9, 20, meaning};
}
constexpr Quantity stored_calcium(std::string_view name, double start, std::string_view meaning) {
  return {name, "mM", start, 1e-9, 100, meaning};
}
// What a living cell's beat keeps to, whatever ails it: narrower than the ranges above; by the state's role,
// the other ions by their names.
inline constexpr std::array living = {
    Quantity{"V", "mV", -80, -150, 100, "membrane potential", Role::potential},
    Quantity{"Na_i", "mM", 10, 0.5, 100, "intracellular sodium"},
    Quantity{"K_i", "mM", 140, 10, 250, "intracellular potassium"},
    Quantity{"Ca_i", "uM", 0.1, 1e-5, 50, "free cytosolic calcium", Role::calcium},
};
// The lowest of a beat: above, nothing relaxes any more.
inline constexpr Quantity living_diastolic_calcium{"Ca_i", "uM", 0.1, 1e-5, 10, "diastolic calcium"};
// Constants of nature, within a thousandth: sources differ in their digits.
constexpr Quantity gas_constant(double value) {
  return {"R", "J/mol/K", value, 8.3062, 8.3227, "gas constant"};
}
constexpr Quantity faraday_constant(double value) {
  return {"F", "C/mmol", value, 96.3889, 96.5818, "Faraday constant"};
}
// From ice to where proteins fall apart.
constexpr Quantity temperature(double value, std::string_view meaning) {
  return {"T", "K", value, 273.15, 323.15, meaning};
}
// Baths, from nearly free of the ion to contracture.
constexpr Quantity potassium_outside(double value) {
  return {"K_o", "mM", value, 0.5, 150, "extracellular potassium"};
}
constexpr Quantity sodium_outside(double value) {
  return {"Na_o", "mM", value, 1, 300, "extracellular sodium"};
}
constexpr Quantity calcium_outside(double value) {
  return {"Ca_o", "mM", value, 0.1, 20, "extracellular calcium"};
}
// A conductance, pump or buffer: from none to twenty times the default.
constexpr Quantity non_negative(std::string_view name, std::string_view unit, double value,
                                std::string_view meaning) {
  return {name, unit, value, 0, value > 0 ? 20 * value : 1, meaning};
}
// What must not vanish, sizes of the cell, half saturations, rates: from a tenth of the default to ten times
// it.
constexpr Quantity positive(std::string_view name, std::string_view unit, double value,
                            std::string_view meaning) {
  return {name, unit, value, value / 10, value * 10, meaning};
}
inline constexpr Quantity stimulus_K_fraction{
    "stimulus_K_fraction", "1", 1, 0, 1, "share of the stimulus charge carried by potassium",
    Role::stimulus_share};
inline constexpr Quantity stimulus{
    "i_stim", "A/F", 0, -1000, 1000, "stimulus current, depolarising if negative", Role::stimulus};
constexpr Quantity reference_length(double value) {
  return {"SL0",
          "um",
          value,
          1.5,
          3,
          "sarcomere length to which strain and its rate are referred",
          Role::reference_length};
}
// What drives every force model, in this order.
inline constexpr std::array force_inputs = {
    Quantity{"Ca", "uM", 0.1, 0, 1000, "free calcium at troponin"},
    Quantity{"SL", "um", 2.2, 0.5, 4, "sarcomere length"},
    Quantity{"dSL/dt", "um/s", 0, -100, 100, "rate of sarcomere length, shortening negative"},
};
constexpr Quantity active_tension{"Ta", "kPa", 0, -unbounded, unbounded, "active tension", Role::tension};
constexpr Quantity active_stiffness{
    "Ka",
    "kPa",
    0,
    -unbounded,
    unbounded,
    "active stiffness: change of tension with strain SL/SL0 at attached crossbridges",
    Role::stiffness};
constexpr Quantity output(std::string_view name, std::string_view unit, std::string_view meaning) {
  return {name, unit, 0, -unbounded, unbounded, meaning};
}

}  // namespace wiggers::facts
