// Names and order of chambers, valves and circulation states, shared by all that follows.
//
//   lungs -> VEN_PUL -> LA -MV-> LV -AV-> AR_SYS -> VEN_SYS -> RA -TV-> RV -PV-> AR_PUL -> lungs
#pragma once

#include <array>
#include <string_view>

namespace wiggers {

enum Chamber { LA, LV, RA, RV };
inline constexpr int n_chambers = 4;
inline constexpr std::array<std::string_view, n_chambers> chamber_names = {"LA", "LV", "RA", "RV"};

enum ValveIndex { MV, AV, TV, PV };
inline constexpr int n_valves = 4;
inline constexpr std::array<std::string_view, n_valves> valve_names = {"MV", "AV", "TV", "PV"};

enum CircuitIndex { SYS, PUL };
inline constexpr std::array<std::string_view, 2> circuit_names = {"SYS", "PUL"};

// The twelve states of the closed loop, in the order of all files.
enum CirculationState {
  V_LA,
  V_LV,
  V_RA,
  V_RV,
  p_AR_SYS,
  p_VEN_SYS,
  p_AR_PUL,
  p_VEN_PUL,
  Q_AR_SYS,
  Q_VEN_SYS,
  Q_AR_PUL,
  Q_VEN_PUL
};
inline constexpr int n_circulation_states = 12;

}  // namespace wiggers
