// How fast the loop can react, so that explicit steps know their limit.
//
// In coordinates whose square is stored energy (x = sqrt(E) V, sqrt(C) p, sqrt(L) Q) the loop's matrix is a
// symmetric part, valves and resistances, and an antisymmetric one, inertances between compliances. So no
// eigenvalue is larger than the norm of the first plus that of the second, and row sums bound both.
#pragma once

#include <array>
#include <string>
#include <wiggers/circulation/circulation.hpp>

namespace wiggers {

using ChamberElastances = std::array<double, n_chambers>;  // mmHg/mL
using ValveConductances = std::array<double, n_valves>;    // dQ/d(dp), mL/(s mmHg)

// The steepest that each valve's flow grows with its pressure drop, over all drops.
ValveConductances steepest_conductances(const CirculationParameters& c);

// Upper bound of the moduli of the loop's eigenvalues (1/s).
double fastest_rate(const CirculationParameters& c, const ChamberElastances& E, const ValveConductances& g);

// The branch that contributes most to it, in words: "valve AV (Rmin 0.0012 mmHg s/mL)".
std::string stiffest_branch(const CirculationParameters& c, const ChamberElastances& E,
                            const ValveConductances& g);

// Explicit Euler of the vessels that open valves and shunts fill (2 R C of one valve and one vessel): the
// largest stable step, where chambers follow implicitly, and the branch that bounds it.
struct FillingLimit {
  double step_s = 1e9;
  std::string branch;
};
FillingLimit largest_filling_step(const CirculationParameters& c);

}  // namespace wiggers
