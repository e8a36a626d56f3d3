// CRN: human atrial myocyte of Courtemanche, Ramirez and Nattel.
//
// M. Courtemanche, R. J. Ramirez, S. Nattel, "Ionic mechanisms underlying human atrial action potential
// properties: insights from a mathematical model", Am J Physiol 275:H301-H321, 1998. Equation numbers below
// are those of the paper's appendix. Units: ms, mV, mM, A/F, um^3.
//
//            I_Na I_K1 I_to I_Kur I_Kr I_Ks I_Ca,L I_p,Ca I_NaK I_NaCa I_b,Na I_b,Ca
//   outside ------------------------------------------------------------------------
//   cytosol     Na_i, K_i, Ca_i (calmodulin, troponin)
//                 | i_up ^ i_leak               ^ i_rel (gates u, v, w)
//               NSR: Ca_up  --- i_tr --->  JSR: Ca_rel (calsequestrin)
//
// Departures from the printed paper, and why:
//  * beta_ui = exp((V - 158)/16): the printed exponent has the opposite sign, which contradicts the published
//    time-constant curve; curators report it as a misprint.
//  * Digits of g_Ca,L, I_NaK,max, g_Kr, g_Ks and g_b,Na are the curated ones (the paper rounds them).
//  * The stimulus current is carried by K+ (stimulus_K_fraction = 1). Left out of every ion balance it
//  removes
//    charge each beat and no limit cycle exists; set `stimulus-uncarried` offers that variant for comparison.
//  * Rates at removable singularities take their limits, not the fallback constants of common encodings.
// h and j rates jump at V = -40 mV (lower branch strictly below).
#pragma once

#include <array>
#include <wiggers/cellmodels/models/facts.hpp>
#include <wiggers/cellmodels/models/invariant.hpp>
#include <wiggers/cellmodels/models/stimulus.hpp>
#include <wiggers/core/enumerators.hpp>
#include <wiggers/core/evaluation.hpp>
#include <wiggers/core/numbers.hpp>

namespace wiggers {

struct Crn {
  static constexpr std::string_view name = "crn";
  static constexpr std::string_view title = "Courtemanche-Ramirez-Nattel 1998, human atrial cell";
  static constexpr std::string_view source =
      "M. Courtemanche, R. J. Ramirez, S. Nattel, Am J Physiol 275:H301-H321, 1998";
  static constexpr std::string_view time_unit = "ms";
  static constexpr StimulusPulse default_stimulus{-20, 2, 0};

  enum State { V, m, h, j, oa, oi, ua, ui, xr, xs, d, f, f_Ca, u, v, w, Na_i, Ca_i, K_i, Ca_rel, Ca_up };
  static constexpr std::array states = {
      facts::membrane_potential(-81.18),
      facts::voltage_gate("m", 2.908e-3, "activation of i_Na"),
      facts::voltage_gate("h", 0.9649, "fast inactivation of i_Na"),
      facts::voltage_gate("j", 0.9775, "slow inactivation of i_Na"),
      facts::voltage_gate("oa", 3.043e-2, "activation of i_to"),
      facts::voltage_gate("oi", 0.9992, "inactivation of i_to"),
      facts::voltage_gate("ua", 4.966e-3, "activation of i_Kur"),
      facts::voltage_gate("ui", 0.9986, "inactivation of i_Kur"),
      facts::voltage_gate("xr", 3.296e-5, "activation of i_Kr"),
      facts::voltage_gate("xs", 1.869e-2, "activation of i_Ks"),
      facts::voltage_gate("d", 1.367e-4, "activation of i_Ca_L"),
      facts::voltage_gate("f", 0.9996, "voltage inactivation of i_Ca_L"),
      facts::gate("f_Ca", 0.7755, "calcium inactivation of i_Ca_L"),
      facts::gate("u", 2.35e-112, "activation of release"),
      facts::gate("v", 1, "flux inactivation of release"),
      facts::voltage_gate("w", 0.9992, "voltage inactivation of release"),
      facts::sodium_or_potassium("Na_i", 11.17, "intracellular sodium"),
      marked(Role::calcium, facts::free_calcium("Ca_i", 1.013e-4, "free cytosolic calcium")),
      marked(Role::stimulus_ion, facts::sodium_or_potassium("K_i", 139.0, "intracellular potassium")),
      facts::stored_calcium("Ca_rel", 1.488, "free calcium of the release compartment"),
      facts::stored_calcium("Ca_up", 1.488, "calcium of the uptake compartment"),
  };
  static_assert(well_formed(states));
  static_assert(named_as<State>(states));

  enum Parameter {
    R,
    T,
    F,
    Cm,
    V_cell,
    K_o,
    Na_o,
    Ca_o,
    g_Na,
    g_K1,
    g_to,
    g_Kur,
    g_Kr,
    g_Ks,
    g_CaL,
    g_bNa,
    g_bCa,
    I_NaK_max,
    K_m_Nai,
    K_m_Ko,
    I_NaCa_max,
    K_m_Na,
    K_m_Ca,
    k_sat,
    gamma,
    I_pCa_max,
    K_mp_Ca,
    I_up_max,
    K_up,
    Ca_up_max,
    tau_tr,
    k_rel,
    CMDN_max,
    TRPN_max,
    CSQN_max,
    K_m_CMDN,
    K_m_TRPN,
    K_m_CSQN,
    K_Q10,
    stimulus_K_fraction
  };
  static constexpr std::array parameters = {
      facts::gas_constant(8.3143),
      facts::temperature(310, "temperature (enters the Nernst potentials only)"),
      facts::faraday_constant(96.4867),
      facts::positive("Cm", "pF", 100, "membrane capacitance"),
      facts::positive("V_cell", "um^3", 20100, "cell volume"),
      facts::potassium_outside(5.4),
      facts::sodium_outside(140),
      facts::calcium_outside(1.8),
      facts::non_negative("g_Na", "nS/pF", 7.8, "conductance of the fast sodium current"),
      facts::non_negative("g_K1", "nS/pF", 0.09, "conductance of the inward rectifier"),
      facts::non_negative("g_to", "nS/pF", 0.1652, "conductance of the transient outward current"),
      facts::non_negative("g_Kur", "1", 1, "scale of the ultrarapid potassium current (1: published)"),
      facts::non_negative("g_Kr", "nS/pF", 0.029411765, "conductance of the rapid delayed rectifier"),
      facts::non_negative("g_Ks", "nS/pF", 0.12941176, "conductance of the slow delayed rectifier"),
      facts::non_negative("g_CaL", "nS/pF", 0.12375, "conductance of the L-type calcium current"),
      facts::non_negative("g_bNa", "nS/pF", 0.0006744375, "conductance of background sodium"),
      facts::non_negative("g_bCa", "nS/pF", 0.001131, "conductance of background calcium"),
      facts::non_negative("I_NaK_max", "A/F", 0.59933874, "maximal sodium-potassium pump current"),
      facts::positive("K_m_Nai", "mM", 10, "half saturation of the pump, sodium"),
      facts::positive("K_m_Ko", "mM", 1.5, "half saturation of the pump, potassium"),
      facts::non_negative("I_NaCa_max", "A/F", 1600, "maximal exchanger current"),
      facts::positive("K_m_Na", "mM", 87.5, "half saturation of the exchanger, sodium"),
      facts::positive("K_m_Ca", "mM", 1.38, "half saturation of the exchanger, calcium"),
      Quantity{"k_sat", "1", 0.1, 0, 1, "saturation of the exchanger at negative potentials"},
      Quantity{"gamma", "1", 0.35, 0, 1, "position of the exchanger's energy barrier"},
      facts::non_negative("I_pCa_max", "A/F", 0.275, "maximal sarcolemmal calcium pump current"),
      facts::positive("K_mp_Ca", "mM", 0.0005, "half saturation of the calcium pump"),
      facts::non_negative("I_up_max", "mM/ms", 0.005, "maximal uptake into the uptake compartment"),
      facts::positive("K_up", "mM", 0.00092, "half saturation of the uptake"),
      facts::positive("Ca_up_max", "mM", 15, "uptake calcium at which leak balances maximal uptake"),
      facts::positive("tau_tr", "ms", 180, "time constant of transfer to the release compartment"),
      facts::non_negative("k_rel", "1/ms", 30, "maximal release rate"),
      facts::non_negative("CMDN_max", "mM", 0.05, "calmodulin"),
      facts::non_negative("TRPN_max", "mM", 0.07, "troponin"),
      facts::non_negative("CSQN_max", "mM", 10, "calsequestrin"),
      facts::positive("K_m_CMDN", "mM", 0.00238, "half saturation of calmodulin"),
      facts::positive("K_m_TRPN", "mM", 0.0005, "half saturation of troponin"),
      facts::positive("K_m_CSQN", "mM", 0.8, "half saturation of calsequestrin"),
      Quantity{"K_Q10", "1", 3, 0.3, 30, "temperature factor of i_to and i_Kur kinetics"},
      facts::stimulus_K_fraction,
  };
  static_assert(well_formed(parameters));
  static_assert(named_as<Parameter>(parameters));

  enum Input { i_stim };
  static constexpr std::array inputs = {facts::stimulus};
  static_assert(named_as<Input>(inputs));

  static constexpr std::array observables = {
      facts::output("i_Na", "A/F", "fast sodium current"),
      facts::output("i_K1", "A/F", "inward rectifier"),
      facts::output("i_to", "A/F", "transient outward current"),
      facts::output("i_Kur", "A/F", "ultrarapid delayed rectifier"),
      facts::output("i_Kr", "A/F", "rapid delayed rectifier"),
      facts::output("i_Ks", "A/F", "slow delayed rectifier"),
      facts::output("i_Ca_L", "A/F", "L-type calcium current"),
      facts::output("i_CaP", "A/F", "sarcolemmal calcium pump"),
      facts::output("i_NaK", "A/F", "sodium-potassium pump"),
      facts::output("i_NaCa", "A/F", "sodium-calcium exchanger"),
      facts::output("i_B_Na", "A/F", "background sodium"),
      facts::output("i_B_Ca", "A/F", "background calcium"),
      facts::output("i_rel", "mM/ms", "release"),
      facts::output("i_up", "mM/ms", "uptake"),
      facts::output("i_up_leak", "mM/ms", "leak of the uptake compartment"),
      facts::output("i_tr", "mM/ms", "transfer from uptake to release compartment"),
  };
  static_assert(well_formed(observables));

  static constexpr ParameterChange uncarried[] = {{"stimulus_K_fraction", 0}};
  static constexpr std::array parameter_sets = {
      ParameterSet{"default", "curated constants of the 1998 paper; stimulus carried by K+", "1"},
      ParameterSet{"stimulus-uncarried",
                   "common encoding: the stimulus enters no ion balance; has no limit cycle", "1", uncarried,
                   1},
  };

  static constexpr std::array branch_potentials = {-40.0};  // of the rates of h and j

  // Constants that follow from the parameters, computed once, not once a step.
  template <class P>
  struct Constants {
    P p[parameters.size()];
    P branch[branch_potentials.size()];
    P FRT, RTF, half_RTF, E_Na_outside, E_K_outside, E_Ca_outside, V_i, V_up, V_rel, charge_to_concentration,
        sigma, pump, exchanger, Na_o_cubed;
  };
  template <class P>
  static Constants<P> constants(const P* parameter) {
    Constants<P> c;
    for (std::size_t i = 0; i < parameters.size(); ++i) c.p[i] = parameter[i];
    c.branch[0] = branch_potentials[0];
    c.RTF = c.p[R] * c.p[T] / c.p[F];
    c.FRT = 1.0 / c.RTF;
    c.half_RTF = 0.5 * c.RTF;
    c.E_Na_outside = c.RTF * log(c.p[Na_o]);
    c.E_K_outside = c.RTF * log(c.p[K_o]);
    c.E_Ca_outside = c.half_RTF * log(c.p[Ca_o]);
    c.V_i = 0.68 * c.p[V_cell];
    c.V_up = 0.0552 * c.p[V_cell];
    c.V_rel = 0.0048 * c.p[V_cell];
    c.charge_to_concentration = c.p[Cm] / (c.V_i * c.p[F]);
    c.sigma = (exp(c.p[Na_o] / 67.3) - 1.0) / 7.0;
    c.pump = c.p[I_NaK_max] * c.p[K_o] / (c.p[K_o] + c.p[K_m_Ko]);
    c.Na_o_cubed = cube(c.p[Na_o]);
    c.exchanger = c.p[I_NaCa_max] / ((cube(c.p[K_m_Na]) + c.Na_o_cubed) * (c.p[K_m_Ca] + c.p[Ca_o]));
    return c;
  }

  // Functions of V alone, in three parts so that tables can stand in for the first two: gates, factors of
  // currents, and what needs the other states.
  template <class N, class P>
  static void voltage_gates(const N& Vm, const Constants<P>& c,
                            Evaluation<N, states.size(), observables.size()>& e) {
    const auto& p = c.p;
    const auto gate = [&e](int index, const N& steady, const N& tau) {
      e.steady[index] = steady;
      e.tau[index] = tau;
    };
    // Sodium gates (Eqs. 30-34).
    const N m_a = 3.2 * x_over_one_minus_exp(N(0.1 * (Vm + 47.13)));
    const N m_b = 0.08 * exp(N(Vm * (-1.0 / 11.0)));
    gate(m, m_a / (m_a + m_b), 1.0 / (m_a + m_b));
    const auto lower_branch = Vm < c.branch[0];
    const N zero(0.0);
    const N h_a = select(lower_branch, N(0.135 * exp(N((Vm + 80.0) / -6.8))), zero);
    const N h_b = select(lower_branch, N(3.56 * exp(N(0.079 * Vm)) + 3.1e5 * exp(N(0.35 * Vm))),
                         N(1.0 / (0.13 * (1.0 + exp(N((Vm + 10.66) / -11.1))))));
    gate(h, h_a / (h_a + h_b), 1.0 / (h_a + h_b));
    const N j_a = select(lower_branch,
                         N((-127140.0 * exp(N(0.2444 * Vm)) - 3.474e-5 * exp(N(-0.04391 * Vm))) *
                           (Vm + 37.78) / (1.0 + exp(N(0.311 * (Vm + 79.23))))),
                         zero);
    const N j_b =
        select(lower_branch, N(0.1212 * exp(N(-0.01052 * Vm)) / (1.0 + exp(N(-0.1378 * (Vm + 40.14))))),
               N(0.3 * exp(N(-2.535e-7 * Vm)) / (1.0 + exp(N(-0.1 * (Vm + 32.0))))));
    gate(j, j_a / (j_a + j_b), 1.0 / (j_a + j_b));

    // Transient outward and ultrarapid gates (Eqs. 37-47).
    const N act_a = 0.65 / (exp(N((Vm + 10.0) / -8.5)) + exp(N((Vm - 30.0) / -59.0)));
    const N act_b = 0.65 / (2.5 + exp(N((Vm + 82.0) / 17.0)));
    const N act_tau = 1.0 / (p[K_Q10] * (act_a + act_b));
    gate(oa, logistic(N((Vm + 20.47) / 17.54)), act_tau);
    const N oi_a = 1.0 / (18.53 + exp(N((Vm + 113.7) / 10.95)));
    const N oi_b = 1.0 / (35.56 + exp(N((Vm + 1.26) / -7.44)));
    gate(oi, logistic(N((Vm + 43.1) / -5.3)), 1.0 / (p[K_Q10] * (oi_a + oi_b)));
    gate(ua, logistic(N((Vm + 30.3) / 9.6)), act_tau);
    const N ui_a = 1.0 / (21.0 + exp(N((Vm - 185.0) / -28.0)));
    const N ui_b = exp(N((Vm - 158.0) / 16.0));
    gate(ui, logistic(N((Vm - 99.45) / -27.48)), 1.0 / (p[K_Q10] * (ui_a + ui_b)));

    // Delayed rectifiers (Eqs. 48-52).
    const N xr_a = 0.0015 * x_over_one_minus_exp(N((Vm + 14.1) / 5.0));
    const N xr_b = 7.3898e-5 * 5.1237 * x_over_expm1(N((Vm - 3.3328) / 5.1237));
    gate(xr, logistic(N((Vm + 14.1) / 6.5)), 1.0 / (xr_a + xr_b));
    const N xs_a = 4e-5 * 17.0 * x_over_one_minus_exp(N((Vm - 19.9) / 17.0));
    const N xs_b = 3.5e-5 * 9.0 * x_over_expm1(N((Vm - 19.9) / 9.0));
    gate(xs, sqrt(logistic(N((Vm - 19.9) / 12.7))), 0.5 / (xs_a + xs_b));

    // L-type calcium gates (Eqs. 54-56).
    const N d_arg = (Vm + 10.0) / 6.24;
    gate(d, logistic(N((Vm + 10.0) / 8.0)),
         1.0 / (0.035 * 6.24 * x_over_one_minus_exp(d_arg) * (1.0 + exp(N(-d_arg)))));
    gate(f, logistic(N((Vm + 28.0) / -6.9)),
         9.0 / (0.0197 * exp(N(-square(N(0.0337 * (Vm + 10.0))))) + 0.02));
    const N w_arg = (Vm - 7.9) / 5.0;
    gate(w, logistic(N((Vm - 40.0) / -17.0)),
         6.0 / (5.0 * (1.0 + 0.3 * exp(N(-w_arg))) * x_over_one_minus_exp(w_arg)));
  }

  enum VoltageFactor {
    K1_rectification,
    Kur_opening,
    Kr_rectification,
    NaK_factor,
    NaCa_forward,
    NaCa_reverse
  };
  static constexpr std::size_t n_voltage_factors = 6;
  template <class N, class P>
  static std::array<N, n_voltage_factors> voltage_factors(const N& Vm, const Constants<P>& c) {
    const auto& p = c.p;
    const N barrier = exp(N((p[gamma] - 1.0) * Vm * c.FRT));
    const N exchange = 1.0 / (1.0 + p[k_sat] * barrier);
    return {N(1.0 / (1.0 + exp(N(0.07 * (Vm + 80.0))))),
            N(0.005 + 0.05 * logistic(N((Vm - 15.0) / 13.0))),
            N(1.0 / (1.0 + exp(N((Vm + 15.0) / 22.4)))),
            N(1.0 / (1.0 + 0.1245 * exp(N(-0.1 * Vm * c.FRT)) + 0.0365 * c.sigma * exp(N(-Vm * c.FRT)))),
            N(exp(N(p[gamma] * Vm * c.FRT)) * exchange),
            N(barrier * exchange)};
  }

  // Currents, the other gates and the balances.
  template <class N, class P>
  static void balances(const N* y, const N* in, const std::array<N, n_voltage_factors>& factor,
                       const Constants<P>& c, Evaluation<N, states.size(), observables.size()>& e) {
    const auto& p = c.p;
    const N Vm = y[V];
    const auto gate = [&e](int index, const N& steady, const N& tau) {
      e.steady[index] = steady;
      e.tau[index] = tau;
    };

    // Reversal potentials (Eq. 28).
    const N E_Na = c.E_Na_outside - c.RTF * log(y[Na_i]);
    const N E_K = c.E_K_outside - c.RTF * log(y[K_i]);
    const N E_Ca = c.E_Ca_outside - c.half_RTF * log(y[Ca_i]);

    // Currents (Eqs. 29-63).
    const N iNa = p[g_Na] * cube(y[m]) * y[h] * y[j] * (Vm - E_Na);
    const N iK1 = p[g_K1] * (Vm - E_K) * factor[K1_rectification];
    const N ito = p[g_to] * cube(y[oa]) * y[oi] * (Vm - E_K);
    const N iKur = p[g_Kur] * factor[Kur_opening] * cube(y[ua]) * y[ui] * (Vm - E_K);
    const N iKr = p[g_Kr] * y[xr] * (Vm - E_K) * factor[Kr_rectification];
    const N iKs = p[g_Ks] * square(y[xs]) * (Vm - E_K);
    const N iCaL = p[g_CaL] * y[d] * y[f] * y[f_Ca] * (Vm - 65.0);
    const N iCaP = p[I_pCa_max] * y[Ca_i] / (p[K_mp_Ca] + y[Ca_i]);
    const N Na_ratio = p[K_m_Nai] / y[Na_i];
    const N iNaK = c.pump * factor[NaK_factor] / (1.0 + Na_ratio * sqrt(Na_ratio));
    const N iNaCa = c.exchanger * (factor[NaCa_forward] * cube(y[Na_i]) * p[Ca_o] -
                                   factor[NaCa_reverse] * c.Na_o_cubed * y[Ca_i]);
    const N iBNa = p[g_bNa] * (Vm - E_Na);
    const N iBCa = p[g_bCa] * (Vm - E_Ca);

    // Release (Eqs. 64-70). The flux signal is in mmol/ms times 1e-12 um^3.
    gate(f_Ca, 1.0 / (1.0 + y[Ca_i] / 0.00035), N(2.0));
    const N i_rel = p[k_rel] * square(y[u]) * y[v] * y[w] * (y[Ca_rel] - y[Ca_i]);
    const N Fn = 1e-12 * c.V_rel * i_rel - (5e-13 / p[F]) * p[Cm] * (0.5 * iCaL - 0.2 * iNaCa);
    const N open = logistic(N((Fn - 3.4175e-13) / 13.67e-16));
    gate(u, open, N(8.0));
    gate(v, logistic(N((Fn - 6.835e-14) / -13.67e-16)), 1.91 + 2.09 * open);

    // Sarcoplasmic reticulum (Eqs. 71-73) and balances (Eqs. 21-27).
    const N i_tr = (y[Ca_up] - y[Ca_rel]) / p[tau_tr];
    const N i_up = p[I_up_max] / (1.0 + p[K_up] / y[Ca_i]);
    const N i_leak = p[I_up_max] * y[Ca_up] / p[Ca_up_max];
    e.derivative[V] =
        -(iNa + iK1 + ito + iKur + iKr + iKs + iCaL + iCaP + iNaK + iNaCa + iBNa + iBCa + in[i_stim]);
    e.derivative[Na_i] = -c.charge_to_concentration * (3.0 * iNaK + 3.0 * iNaCa + iBNa + iNa);
    e.derivative[K_i] = -c.charge_to_concentration *
                        (iK1 + ito + iKur + iKr + iKs - 2.0 * iNaK + p[stimulus_K_fraction] * in[i_stim]);
    const N buffering = 1.0 + p[TRPN_max] * p[K_m_TRPN] / square(N(y[Ca_i] + p[K_m_TRPN])) +
                        p[CMDN_max] * p[K_m_CMDN] / square(N(y[Ca_i] + p[K_m_CMDN]));
    e.derivative[Ca_i] = (0.5 * c.charge_to_concentration * (2.0 * iNaCa - iCaP - iCaL - iBCa) +
                          (c.V_up * (i_leak - i_up) + c.V_rel * i_rel) / c.V_i) /
                         buffering;
    e.derivative[Ca_up] = i_up - i_leak - i_tr * c.V_rel / c.V_up;
    e.derivative[Ca_rel] =
        (i_tr - i_rel) / (1.0 + p[CSQN_max] * p[K_m_CSQN] / square(N(y[Ca_rel] + p[K_m_CSQN])));

    e.observable = {iNa,  iK1,   ito,  iKur, iKr,   iKs,  iCaL,   iCaP,
                    iNaK, iNaCa, iBNa, iBCa, i_rel, i_up, i_leak, i_tr};
  }

  template <class N, class P>
  static Evaluation<N, states.size(), observables.size()> evaluate(const N* y, const N* in,
                                                                   const Constants<P>& c) {
    return evaluate_in_parts<Crn, N>(y, in, c);
  }

  // The charge is kept exactly, with and without stimulus, if K+ carries the stimulus.
  static constexpr std::array invariants = {membrane_charge(K_i)};
  template <class N, class P>
  static std::array<N, 1> invariant_values(const N* y, const Constants<P>& c) {
    const auto& p = c.p;
    const N Ca_total = y[Ca_i] + p[TRPN_max] * y[Ca_i] / (y[Ca_i] + p[K_m_TRPN]) +
                       p[CMDN_max] * y[Ca_i] / (y[Ca_i] + p[K_m_CMDN]);
    const N Ca_rel_total = y[Ca_rel] + p[CSQN_max] * y[Ca_rel] / (y[Ca_rel] + p[K_m_CSQN]);
    return {N(y[V] - (p[F] / p[Cm]) * (c.V_i * (y[Na_i] + y[K_i] + 2.0 * Ca_total) +
                                       2.0 * c.V_rel * Ca_rel_total + 2.0 * c.V_up * y[Ca_up]))};
  }
  template <class P>
  static std::array<P, 1> invariant_slopes(const Constants<P>& c) {
    return {P(-c.p[F] / c.p[Cm] * c.V_i)};
  }
};

}  // namespace wiggers
