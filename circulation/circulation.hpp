// The closed RLC circulation: twelve states, four valves, chamber pressures from outside. mmHg, mL, s.
//
//   each circuit (SYS, PUL):   Q_in --+--[R_AR L_AR]--+--[R_VEN L_VEN]--> atrium
//                                     |               |
//                                    C_AR            C_VEN          (C first, then R and L in series)
//
//   dV/dt of a chamber = inflow - outflow;  C dp/dt = inflow - outflow of the node;
//   L dQ/dt = pressure before - pressure after - R Q.
// Sources: Regazzoni et al., J Comput Phys 457:111083, 2022; Fedele et al. 2023 (whole-heart paper).
// Invariant: total stressed volume = chamber volumes + sum of C p; constant without external flow.
#pragma once

#include <array>
#include <string_view>
#include <wiggers/circulation/names.hpp>
#include <wiggers/circulation/valves.hpp>
#include <wiggers/core/quantity.hpp>

namespace wiggers {

template <class P>
struct CircuitParametersOf {
  P R_AR = 0, C_AR = 0, L_AR = 0, R_VEN = 0, C_VEN = 0, L_VEN = 0;
};
using CircuitParameters = CircuitParametersOf<double>;
// From an infant's circulation to a large adult's, ill or not; the same for the body and the lungs.
inline constexpr std::array circuit_quantities = {
    Quantity{"R_AR", "mmHg s/mL", 0.48, 1e-4, 20, "arterial resistance"},
    Quantity{"C_AR", "mL/mmHg", 1.5, 0.02, 200, "arterial compliance"},
    Quantity{"L_AR", "mmHg s^2/mL", 5e-3, 1e-5, 0.1, "arterial inertance"},
    Quantity{"R_VEN", "mmHg s/mL", 0.26, 1e-4, 20, "venous resistance"},
    Quantity{"C_VEN", "mL/mmHg", 60, 0.2, 600, "venous compliance"},
    Quantity{"L_VEN", "mmHg s^2/mL", 5e-4, 1e-5, 0.1, "venous inertance"},
};
static_assert(well_formed(circuit_quantities));
template <class Circuit>
auto fields_of(Circuit& c) requires requires {
  c.R_AR;
}
{ return std::array{&c.R_AR, &c.C_AR, &c.L_AR, &c.R_VEN, &c.C_VEN, &c.L_VEN}; }

// The states as quantities; defaults: the start of the set wiggers-healthy-0d.
inline constexpr std::array circulation_state_quantities = {
    Quantity{"V_LA", "mL", 65, 0, 2000, "volume of the left atrium"},
    Quantity{"V_LV", "mL", 120, 0, 2000, "volume of the left ventricle"},
    Quantity{"V_RA", "mL", 65, 0, 2000, "volume of the right atrium"},
    Quantity{"V_RV", "mL", 145, 0, 2000, "volume of the right ventricle"},
    Quantity{"p_AR_SYS", "mmHg", 80, -60, 500, "systemic arterial pressure"},
    Quantity{"p_VEN_SYS", "mmHg", 28, -60, 500, "systemic venous pressure"},
    Quantity{"p_AR_PUL", "mmHg", 18, -60, 500, "pulmonary arterial pressure"},
    Quantity{"p_VEN_PUL", "mmHg", 12, -60, 500, "pulmonary venous pressure"},
    Quantity{"Q_AR_SYS", "mL/s", 0, -5000, 5000, "systemic arterial flow"},
    Quantity{"Q_VEN_SYS", "mL/s", 0, -5000, 5000, "systemic venous flow, into the right atrium"},
    Quantity{"Q_AR_PUL", "mL/s", 0, -5000, 5000, "pulmonary arterial flow"},
    Quantity{"Q_VEN_PUL", "mL/s", 0, -5000, 5000, "pulmonary venous flow, into the left atrium"},
};
static_assert(well_formed(circulation_state_quantities));

// Parameters may be plain, or dual to carry sensitivities.
template <class P>
struct CirculationParametersOf {
  ValveLaw valve_law = ValveLaw::diode;
  P tanh_steepness = tanh_steepness_quantity.default_value;
  std::array<ValveParametersOf<P>, n_valves> valves;
  std::array<CircuitParametersOf<P>, 2> circuits;  // SYS, PUL
};
using CirculationParameters = CirculationParametersOf<double>;

using CirculationValues = std::array<double, n_circulation_states>;

// Flows through MV, AV, TV, PV for chamber pressures p[LA, LV, RA, RV].
template <class T, class P>
std::array<T, n_valves> valve_flows(const CirculationParametersOf<P>& c, const T* p, const T& p_ar_sys,
                                    const T& p_ar_pul) {
  const auto flow = [&](int valve, const T& p1, const T& p2) {
    return valve_flow<T, P>(c.valve_law, c.valves[valve], c.tanh_steepness, p1, p2);
  };
  return {flow(MV, p[LA], p[LV]), flow(AV, p[LV], p_ar_sys), flow(TV, p[RA], p[RV]),
          flow(PV, p[RV], p_ar_pul)};
}

// Time derivatives of the twelve states for given chamber pressures and valve flows.
template <class T, class P>
void circulation_rates(const CirculationParametersOf<P>& c, const T* y, const T* p,
                       const std::array<T, n_valves>& Q, T* dy) {
  const CircuitParametersOf<P>& s = c.circuits[SYS];
  const CircuitParametersOf<P>& l = c.circuits[PUL];
  dy[V_LA] = y[Q_VEN_PUL] - Q[MV];
  dy[V_LV] = Q[MV] - Q[AV];
  dy[V_RA] = y[Q_VEN_SYS] - Q[TV];
  dy[V_RV] = Q[TV] - Q[PV];
  dy[p_AR_SYS] = (Q[AV] - y[Q_AR_SYS]) / s.C_AR;
  dy[p_VEN_SYS] = (y[Q_AR_SYS] - y[Q_VEN_SYS]) / s.C_VEN;
  dy[p_AR_PUL] = (Q[PV] - y[Q_AR_PUL]) / l.C_AR;
  dy[p_VEN_PUL] = (y[Q_AR_PUL] - y[Q_VEN_PUL]) / l.C_VEN;
  dy[Q_AR_SYS] = (y[p_AR_SYS] - y[p_VEN_SYS] - s.R_AR * y[Q_AR_SYS]) / s.L_AR;
  dy[Q_VEN_SYS] = (y[p_VEN_SYS] - p[RA] - s.R_VEN * y[Q_VEN_SYS]) / s.L_VEN;
  dy[Q_AR_PUL] = (y[p_AR_PUL] - y[p_VEN_PUL] - l.R_AR * y[Q_AR_PUL]) / l.L_AR;
  dy[Q_VEN_PUL] = (y[p_VEN_PUL] - p[LA] - l.R_VEN * y[Q_VEN_PUL]) / l.L_VEN;
}

// Total stressed blood volume (mL).
template <class T, class P>
T total_volume(const CirculationParametersOf<P>& c, const T* y) {
  T sum = y[V_LA] + y[V_LV] + y[V_RA] + y[V_RV];
  sum = sum + c.circuits[SYS].C_AR * y[p_AR_SYS] + c.circuits[SYS].C_VEN * y[p_VEN_SYS];
  return sum + c.circuits[PUL].C_AR * y[p_AR_PUL] + c.circuits[PUL].C_VEN * y[p_VEN_PUL];
}

// Sets the systemic venous pressure so that the total volume has the given value.
template <class T, class P>
void hold_total_volume(const CirculationParametersOf<P>& c, T* y, const std::type_identity_t<T>& volume_mL) {
  y[p_VEN_SYS] = y[p_VEN_SYS] + (volume_mL - total_volume(c, y)) / c.circuits[SYS].C_VEN;
}

// Power lost in resistors and valves (mmHg mL/s): what the chambers' work must equal over a periodic beat.
double dissipated_power(const CirculationParameters& c, const double* y, const double* p,
                        const std::array<double, n_valves>& Q);

// Explicit Euler of the venous branch is stable for steps below 2 L_VEN/R_VEN; the smaller one of the two
// circuits (s).
double largest_explicit_step(const CirculationParameters& c);
// The same for the arteries, which the open outlet valve fills: below 2 Rmin C_AR (s).
double largest_arterial_step(const CirculationParameters& c);

}  // namespace wiggers
