// The elastance loop as a function from parameters to indexes: its parameters as one list, its indexes on the
// limit cycle, and their derivatives.
#pragma once

#include <span>
#include <string>
#include <vector>
#include <wiggers/circulation/loop.hpp>
#include <wiggers/core/sensitivity.hpp>
#include <wiggers/heart/indexes/indexes.hpp>

namespace wiggers {

// All parameters by their names in a loop file; the last is initial.total_volume, which is held when others
// change (p_VEN_SYS follows).
std::vector<NamedParameter> loop_parameters(const Loop& loop);
// The loop with one parameter changed; refuses unknown names and values out of range.
void set_loop_parameter(Loop& loop, std::string_view name, double value);
// Sets all of loop_parameters() at once; checks ranges and what must hold between parameters.
void set_loop_parameters(Loop& loop, std::span<const double> values);

// The indexes of the beat from a state, by the solver's own integrator: those of the trajectory that its
// limit cycle was certified on.
BeatIndexes loop_indexes(const LoopSolver& solver, const CirculationValues& start);

// Derivatives of every index on the limit cycle by every parameter, with the integrator runge-kutta-4 at
// steps of dt_s. `on_cycle`: its limit cycle, as close as to_limit_cycle() gets.
Sensitivities loop_sensitivities(const Loop& loop, const CirculationValues& on_cycle, double dt_s);

// The cross-check: derivatives of the state on the cycle, [state][parameter], by CVODES' forward
// sensitivities of the differential equations at a relative tolerance, from the cycle of integrator cvode.
// Any valve law.
std::vector<double> loop_cycle_derivatives_by_cvodes(const Loop& loop, const CirculationValues& on_cycle,
                                                     double relative_tolerance);

}  // namespace wiggers
