// TTP06: human ventricular myocyte of ten Tusscher and Panfilov, in endocardial, midmyocardial (M) and
// epicardial version.
//
// K. H. W. J. ten Tusscher, A. V. Panfilov, "Alternans and spiral breakup in a human ventricular tissue
// model", Am J Physiol Heart Circ Physiol 291:H1088-H1100, 2006. Units: ms, mV, mM, A/F, um^3.
//
//            I_Na I_K1 I_to I_Kr I_Ks I_CaL I_NaK I_NaCa I_pCa I_pK I_bCa I_bNa
//   outside -------------------------------------------------------------------
//   dyadic subspace: Ca_ss <--- i_xfer ---> cytosol: Na_i, K_i, Ca_i
//        ^ i_rel (O, R')                       | i_up  ^ i_leak
//        +----------------  SR: Ca_SR  <-------+-------+
//
// Notes on the equations:
//  * (V - 15)/(exp(2(V-15)F/RT) - 1) in i_CaL is evaluated with x/expm1(x): exact through V = 15 mV.
//  * tau_f2: curated encodings and the authors' own program differ; default curated, set `tau-f2-authors`
//    the other (APD90 changes by less than 0.2 ms).
//  * Stimulus charge is carried by K+, as in the curated encodings: charge is an exact invariant.
//  * The 2006 model has g_Kr = 0.153 in all cell types; the endo default initial state is not at rest.
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

enum class Ttp06Type { endo, mid, epi };

// The value that belongs to a cell type.
template <Ttp06Type type>
constexpr double by_type(double in_endo, double in_mid, double in_epi) {
  return type == Ttp06Type::endo ? in_endo : type == Ttp06Type::mid ? in_mid : in_epi;
}

template <Ttp06Type type>
struct Ttp06 {
  // The midmyocardial cell differs from the epicardial by numbers alone: they share their kernels.
  using SameEquations = Ttp06<type == Ttp06Type::mid ? Ttp06Type::epi : type>;
  static constexpr bool endo = type == Ttp06Type::endo;
  static constexpr std::string_view name = type == Ttp06Type::endo  ? "ttp06-endo"
                                           : type == Ttp06Type::mid ? "ttp06-mid"
                                                                    : "ttp06-epi";
  static constexpr std::string_view title =
      type == Ttp06Type::endo  ? "ten Tusscher-Panfilov 2006, human ventricular cell, endocardial"
      : type == Ttp06Type::mid ? "ten Tusscher-Panfilov 2006, human ventricular cell, midmyocardial"
                               : "ten Tusscher-Panfilov 2006, human ventricular cell, epicardial";
  static constexpr std::string_view source =
      "K. H. W. J. ten Tusscher, A. V. Panfilov, Am J Physiol Heart Circ Physiol 291:H1088-H1100, 2006";
  static constexpr std::string_view time_unit = "ms";
  static constexpr StimulusPulse default_stimulus{-52, 1, 0};

  enum State { V, Xr1, Xr2, Xs, m, h, j, d, f, f2, fCass, s, r, Ca_i, Ca_SR, Ca_ss, R_prime, Na_i, K_i };
  static constexpr std::array states = {
      facts::membrane_potential(by_type<type>(-86.709, -85.423, -85.23)),
      facts::voltage_gate("Xr1", by_type<type>(0.00448, 0.0165, 0.00621), "activation of i_Kr"),
      facts::voltage_gate("Xr2", by_type<type>(0.476, 0.473, 0.4712), "inactivation of i_Kr"),
      facts::voltage_gate("Xs", by_type<type>(0.0087, 0.0174, 0.0095), "activation of i_Ks"),
      facts::voltage_gate("m", by_type<type>(0.00155, 0.00165, 0.00172), "activation of i_Na"),
      facts::voltage_gate("h", by_type<type>(0.7573, 0.749, 0.7444), "fast inactivation of i_Na"),
      facts::voltage_gate("j", by_type<type>(0.7225, 0.6788, 0.7045), "slow inactivation of i_Na"),
      facts::voltage_gate("d", by_type<type>(3.164e-5, 3.288e-5, 3.373e-5), "activation of i_CaL"),
      facts::voltage_gate("f", by_type<type>(0.8009, 0.7026, 0.7888), "slow voltage inactivation of i_CaL"),
      facts::voltage_gate("f2", by_type<type>(0.9778, 0.9526, 0.9755), "fast voltage inactivation of i_CaL"),
      facts::gate("fCass", by_type<type>(0.9953, 0.9942, 0.9953), "subspace calcium inactivation of i_CaL"),
      facts::voltage_gate("s", by_type<type>(0.3212, 0.999998, 0.999998), "inactivation of i_to"),
      facts::voltage_gate("r", by_type<type>(2.235e-8, 2.347e-8, 2.42e-8), "activation of i_to"),
      marked(Role::calcium, facts::free_calcium("Ca_i", by_type<type>(0.00013, 0.000153, 0.000126),
                                                "free cytosolic calcium")),
      facts::stored_calcium("Ca_SR", by_type<type>(3.715, 4.272, 3.64),
                            "free calcium of the sarcoplasmic reticulum"),
      facts::free_calcium("Ca_ss", by_type<type>(0.00036, 0.00042, 0.00036),
                          "free calcium of the dyadic subspace"),
      facts::probability("R_prime", by_type<type>(0.9068, 0.8978, 0.9073),
                         "release channels not inactivated"),
      facts::sodium_or_potassium("Na_i", by_type<type>(10.355, 10.132, 8.604), "intracellular sodium"),
      marked(Role::stimulus_ion, facts::sodium_or_potassium("K_i", by_type<type>(138.4, 138.52, 136.89),
                                                            "intracellular potassium")),
  };
  static_assert(well_formed(states));
  static_assert(named_as<State>(states));

  enum Parameter {
    R,
    T,
    F,
    Cm,
    V_c,
    V_sr,
    V_ss,
    K_o,
    Na_o,
    Ca_o,
    g_Na,
    g_K1,
    g_to,
    g_Kr,
    g_Ks,
    p_KNa,
    g_CaL,
    g_bNa,
    g_bCa,
    g_pK,
    g_pCa,
    K_pCa,
    P_NaK,
    K_mK,
    K_mNa,
    k_NaCa,
    gamma,
    alpha,
    k_sat,
    K_mNai,
    K_mCa,
    V_max_up,
    K_up,
    V_rel,
    V_leak,
    V_xfer,
    k1_prime,
    k2_prime,
    k3,
    k4,
    EC,
    max_sr,
    min_sr,
    Buf_c,
    K_buf_c,
    Buf_sr,
    K_buf_sr,
    Buf_ss,
    K_buf_ss,
    f2_amplitude,
    f2_centre,
    f2_width,
    f2_slow,
    stimulus_K_fraction
  };
  static constexpr std::array parameters = {
      facts::gas_constant(8.314472),
      facts::temperature(310, "temperature (enters Nernst potentials and i_CaL only)"),
      facts::faraday_constant(96.4853415),
      facts::positive("Cm", "pF", 185, "membrane capacitance"),
      facts::positive("V_c", "um^3", 16404, "cytosolic volume"),
      facts::positive("V_sr", "um^3", 1094, "volume of the sarcoplasmic reticulum"),
      facts::positive("V_ss", "um^3", 54.68, "volume of the dyadic subspace"),
      facts::potassium_outside(5.4),
      facts::sodium_outside(140),
      facts::calcium_outside(2),
      facts::non_negative("g_Na", "nS/pF", 14.838, "conductance of the fast sodium current"),
      facts::non_negative("g_K1", "nS/pF", 5.405, "conductance of the inward rectifier"),
      facts::non_negative("g_to", "nS/pF", by_type<type>(0.073, 0.294, 0.294),
                          "conductance of the transient outward current"),
      facts::non_negative("g_Kr", "nS/pF", 0.153, "conductance of the rapid delayed rectifier"),
      facts::non_negative("g_Ks", "nS/pF", by_type<type>(0.392, 0.098, 0.392),
                          "conductance of the slow delayed rectifier"),
      Quantity{"p_KNa", "1", 0.03, 0, 1, "relative sodium permeability of i_Ks"},
      facts::non_negative("g_CaL", "L/F/s", 0.0398, "permeability of i_CaL (3.98e-5 cm^3/ms/uF as printed)"),
      facts::non_negative("g_bNa", "nS/pF", 0.00029, "conductance of background sodium"),
      facts::non_negative("g_bCa", "nS/pF", 0.000592, "conductance of background calcium"),
      facts::non_negative("g_pK", "nS/pF", 0.0146, "conductance of plateau potassium"),
      facts::non_negative("g_pCa", "A/F", 0.1238, "maximal sarcolemmal calcium pump current"),
      facts::positive("K_pCa", "mM", 0.0005, "half saturation of the calcium pump"),
      facts::non_negative("P_NaK", "A/F", 2.724, "maximal sodium-potassium pump current"),
      facts::positive("K_mK", "mM", 1, "half saturation of the pump, potassium"),
      facts::positive("K_mNa", "mM", 40, "half saturation of the pump, sodium"),
      facts::non_negative("k_NaCa", "A/F", 1000, "maximal exchanger current"),
      Quantity{"gamma", "1", 0.35, 0, 1, "position of the exchanger's energy barrier"},
      facts::non_negative("alpha", "1", 2.5, "factor of the exchanger's outward mode"),
      Quantity{"k_sat", "1", 0.1, 0, 1, "saturation of the exchanger at negative potentials"},
      facts::positive("K_mNai", "mM", 87.5, "half saturation of the exchanger, sodium"),
      facts::positive("K_mCa", "mM", 1.38, "half saturation of the exchanger, calcium"),
      facts::non_negative("V_max_up", "mM/ms", 0.006375, "maximal uptake into the sarcoplasmic reticulum"),
      facts::positive("K_up", "mM", 0.00025, "half saturation of the uptake"),
      facts::non_negative("V_rel", "1/ms", 0.102, "maximal release rate"),
      facts::non_negative("V_leak", "1/ms", 0.00036, "leak rate of the sarcoplasmic reticulum"),
      facts::non_negative("V_xfer", "1/ms", 0.0038, "transfer rate between subspace and cytosol"),
      facts::positive("k1_prime", "1/mM^2/ms", 0.15, "release channel: opening"),
      facts::positive("k2_prime", "1/mM/ms", 0.045, "release channel: inactivation"),
      facts::positive("k3", "1/ms", 0.06, "release channel: closing"),
      facts::positive("k4", "1/ms", 0.005, "release channel: recovery"),
      facts::positive("EC", "mM", 1.5, "half saturation of the SR-calcium sensor"),
      facts::positive("max_sr", "1", 2.5, "largest effect of the SR-calcium sensor"),
      facts::positive("min_sr", "1", 1, "smallest effect of the SR-calcium sensor"),
      facts::non_negative("Buf_c", "mM", 0.2, "cytosolic buffer"),
      facts::positive("K_buf_c", "mM", 0.001, "half saturation of the cytosolic buffer"),
      facts::non_negative("Buf_sr", "mM", 10, "buffer of the sarcoplasmic reticulum"),
      facts::positive("K_buf_sr", "mM", 0.3, "half saturation of the SR buffer"),
      facts::non_negative("Buf_ss", "mM", 0.4, "buffer of the subspace"),
      facts::positive("K_buf_ss", "mM", 0.00025, "half saturation of the subspace buffer"),
      facts::positive("f2_amplitude", "ms", 562, "tau_f2: height of its bell curve"),
      Quantity{"f2_centre", "mV", 27, -100, 100, "tau_f2: minus the centre of its bell curve"},
      facts::positive("f2_width", "mV^2", 240, "tau_f2: width of its bell curve"),
      facts::positive("f2_slow", "ms", 80, "tau_f2: contribution at negative potentials"),
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
      facts::output("i_Kr", "A/F", "rapid delayed rectifier"),
      facts::output("i_Ks", "A/F", "slow delayed rectifier"),
      facts::output("i_CaL", "A/F", "L-type calcium current"),
      facts::output("i_NaK", "A/F", "sodium-potassium pump"),
      facts::output("i_NaCa", "A/F", "sodium-calcium exchanger"),
      facts::output("i_p_Ca", "A/F", "sarcolemmal calcium pump"),
      facts::output("i_p_K", "A/F", "plateau potassium current"),
      facts::output("i_b_Ca", "A/F", "background calcium"),
      facts::output("i_b_Na", "A/F", "background sodium"),
      facts::output("i_rel", "mM/ms", "release"),
      facts::output("i_up", "mM/ms", "uptake"),
      facts::output("i_leak", "mM/ms", "leak of the sarcoplasmic reticulum"),
      facts::output("i_xfer", "mM/ms", "transfer from subspace to cytosol"),
  };
  static_assert(well_formed(observables));

  static constexpr ParameterChange tau_f2_authors[] = {
      {"f2_amplitude", 600}, {"f2_centre", 25}, {"f2_width", 170}, {"f2_slow", 16}};
  static constexpr std::array parameter_sets = {
      ParameterSet{"default", "curated constants of the 2006 paper", "1"},
      ParameterSet{"tau-f2-authors", "time constant of f2 as in codes that derive from the authors' program",
                   "1", tau_f2_authors, 4},
  };

  static constexpr std::array branch_potentials = {-40.0};  // of the rates of h and j

  template <class P>
  struct Constants {
    P p[parameters.size()];
    P branch[branch_potentials.size()];
    P RTF, half_RTF, FRT, charge_to_concentration, calcium_charge, subspace_charge, pump, exchanger,
        Na_o_cubed;
    P E_Na_outside, E_K_outside, E_Ca_outside, E_Ks_outside;  // reversal potentials at 1 mM inside
    P K1_scale, Kr_scale, CaL_scale, EC_square, K_up_square, buffer_c, buffer_sr, buffer_ss;
    P sr_per_c, sr_per_ss, c_per_ss;  // ratios of volumes
  };
  template <class P>
  static Constants<P> constants(const P* parameter) {
    Constants<P> c;
    for (std::size_t i = 0; i < parameters.size(); ++i) c.p[i] = parameter[i];
    c.branch[0] = branch_potentials[0];
    c.RTF = c.p[R] * c.p[T] / c.p[F];
    c.FRT = 1.0 / c.RTF;
    c.charge_to_concentration = c.p[Cm] / (c.p[V_c] * c.p[F]);
    c.half_RTF = 0.5 * c.RTF;
    c.calcium_charge = 0.5 * c.charge_to_concentration;
    c.subspace_charge = 0.5 * c.p[Cm] / (c.p[V_ss] * c.p[F]);
    const P K_o_root = sqrt(c.p[K_o] / 5.4);
    c.K1_scale = c.p[g_K1] * K_o_root;
    c.Kr_scale = c.p[g_Kr] * K_o_root;
    c.CaL_scale = c.p[g_CaL] * (2.0 * c.p[F]);
    c.EC_square = square(c.p[EC]);
    c.K_up_square = square(c.p[K_up]);
    c.buffer_c = c.p[Buf_c] * c.p[K_buf_c];
    c.buffer_sr = c.p[Buf_sr] * c.p[K_buf_sr];
    c.buffer_ss = c.p[Buf_ss] * c.p[K_buf_ss];
    c.sr_per_c = c.p[V_sr] / c.p[V_c];
    c.sr_per_ss = c.p[V_sr] / c.p[V_ss];
    c.c_per_ss = c.p[V_c] / c.p[V_ss];
    c.pump = c.p[P_NaK] * c.p[K_o] / (c.p[K_o] + c.p[K_mK]);
    c.Na_o_cubed = cube(c.p[Na_o]);
    c.exchanger = c.p[k_NaCa] / ((cube(c.p[K_mNai]) + c.Na_o_cubed) * (c.p[K_mCa] + c.p[Ca_o]));
    c.E_Na_outside = c.RTF * log(c.p[Na_o]);
    c.E_K_outside = c.RTF * log(c.p[K_o]);
    c.E_Ca_outside = c.half_RTF * log(c.p[Ca_o]);
    c.E_Ks_outside = c.RTF * log(P(c.p[K_o] + c.p[p_KNa] * c.p[Na_o]));
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
    // Curves that share a slope share their exponential: with e = exp(V/k),
    //   opens(e, V0/k) = logistic((V - V0)/k),   closes(e, V0/k) = logistic(-(V - V0)/k).
    const N e20 = exp(N(Vm / 20.0)), e10 = square(e20), e5 = square(e10);
    const N e14 = exp(N(Vm / 14.0)), e7 = square(e14);
    const N e15 = exp(N(Vm / 15.0)), e7_5 = square(e15);
    const N e6 = exp(N(Vm / 6.0));
    const auto opens = [](const N& e, double at) { return N(e / (e + std::exp(at))); };
    const auto closes = [](const N& e, double at) { return N(std::exp(at) / (e + std::exp(at))); };

    gate(m, square(logistic(N((Vm + 56.86) / 9.03))),
         opens(e5, -60.0 / 5.0) * (0.1 * closes(e5, -35.0 / 5.0) + 0.1 * logistic(N((Vm - 50.0) / -200.0))));
    const N hj_steady = square(logistic(N((Vm + 71.55) / -7.43)));
    const auto lower_branch = Vm < c.branch[0];
    const N zero(0.0);
    const N h_a = select(lower_branch, N(0.057 * exp(N((Vm + 80.0) / -6.8))), zero);
    const N h_b = select(lower_branch, N(2.7 * exp(N(0.079 * Vm)) + 3.1e5 * exp(N(0.3485 * Vm))),
                         N((0.77 / 0.13) * logistic(N((Vm + 10.66) / 11.1))));
    gate(h, hj_steady, 1.0 / (h_a + h_b));
    const N j_a = select(lower_branch,
                         N((-25428.0 * exp(N(0.2444 * Vm)) - 6.948e-6 * exp(N(-0.04391 * Vm))) *
                           (Vm + 37.78) / (1.0 + exp(N(0.311 * (Vm + 79.23))))),
                         zero);
    const N j_b =
        select(lower_branch, N(0.02424 * exp(N(-0.01052 * Vm)) / (1.0 + exp(N(-0.1378 * (Vm + 40.14))))),
               N(0.6 * exp(N(0.057 * Vm)) * opens(e10, -32.0 / 10.0)));
    gate(j, hj_steady, 1.0 / (j_a + j_b));
    gate(Xr1, opens(e7, -26.0 / 7.0),
         450.0 * opens(e10, -45.0 / 10.0) * 6.0 / (1.0 + exp(N((Vm + 30.0) / 11.5))));
    gate(Xr2, logistic(N((Vm + 88.0) / -24.0)),
         3.0 * opens(e20, -60.0 / 20.0) * 1.12 * closes(e20, 60.0 / 20.0));
    gate(Xs, opens(e14, -5.0 / 14.0), 1400.0 * sqrt(opens(e6, 5.0 / 6.0)) * closes(e15, 35.0 / 15.0) + 80.0);
    gate(d, opens(e7_5, -8.0 / 7.5),
         (1.4 * logistic(N((Vm + 35.0) / 13.0)) + 0.25) * 1.4 * closes(e5, -5.0 / 5.0) +
             opens(e20, 50.0 / 20.0));
    const N slow_negative = closes(e10, -30.0 / 10.0);
    gate(f, closes(e7, -20.0 / 7.0),
         1102.5 * exp(N(-square(N(Vm + 27.0)) / 225.0)) + 200.0 * opens(e10, 13.0 / 10.0) +
             180.0 * slow_negative + 20.0);
    gate(f2, 0.67 * closes(e7, -35.0 / 7.0) + 0.33,
         p[f2_amplitude] * exp(N(-square(N(Vm + p[f2_centre])) / p[f2_width])) +
             31.0 * opens(e10, 25.0 / 10.0) + p[f2_slow] * slow_negative);
    if constexpr (endo) {
      gate(s, closes(e5, -28.0 / 5.0), 1000.0 * exp(N(-square(N(Vm + 67.0)) / 1000.0)) + 8.0);
    } else {
      gate(s, closes(e5, -20.0 / 5.0),
           85.0 * exp(N(-square(N(Vm + 45.0)) / 320.0)) + 5.0 * closes(e5, 20.0 / 5.0) + 3.0);
    }
    gate(r, opens(e6, 20.0 / 6.0), 9.5 * exp(N(-square(N(Vm + 40.0)) / 1800.0)) + 0.8);
  }

  enum VoltageFactor { CaL_inside, CaL_outside, NaK_factor, NaCa_forward, NaCa_reverse, pK_opening };
  static constexpr std::size_t n_voltage_factors = 6;
  template <class N, class P>
  static std::array<N, n_voltage_factors> voltage_factors(const N& Vm, const Constants<P>& c) {
    const auto& p = c.p;
    const N z = 2.0 * (Vm - 15.0) * c.FRT;
    const N CaL_out = x_over_expm1(z);
    const N barrier = exp(N((p[gamma] - 1.0) * Vm * c.FRT));
    const N exchange = 1.0 / (1.0 + p[k_sat] * barrier);
    return {N(CaL_out + z),  // z exp(z) / (exp(z) - 1)
            CaL_out,
            N(1.0 / (1.0 + 0.1245 * exp(N(-0.1 * Vm * c.FRT)) + 0.0353 * exp(N(-Vm * c.FRT)))),
            N(exp(N(p[gamma] * Vm * c.FRT)) * exchange),
            N(barrier * exchange),
            N(logistic(N((Vm - 25.0) / 5.98)))};
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

    const N E_Na = c.E_Na_outside - c.RTF * log(y[Na_i]);
    const N E_K = c.E_K_outside - c.RTF * log(y[K_i]);
    const N E_Ca = c.E_Ca_outside - c.half_RTF * log(y[Ca_i]);
    const N E_Ks = c.E_Ks_outside - c.RTF * log(N(y[K_i] + p[p_KNa] * y[Na_i]));

    const N iNa = p[g_Na] * cube(y[m]) * y[h] * y[j] * (Vm - E_Na);
    // Steady rectification a/(a + b), with a = 0.1/(1 + exp(0.06(x - 200))) and b = (3 exp(0.0002(x + 100)) +
    // exp(0.1(x - 10)))/(1 + exp(-x/2)), x = V - E_K, brought to one fraction and multiplied by exp(-x/10).
    const N x_K = Vm - E_K;
    const N K1_e = exp(N(-0.1 * x_K));
    const N K1_a = 0.1 * K1_e * (1.0 + square(square(K1_e)) * K1_e);
    const N K1_b =
        (3.0 * K1_e * exp(N(0.0002 * x_K + 0.02)) + std::exp(-1.0)) * (1.0 + exp(N(0.06 * x_K - 12.0)));
    const N iK1 = c.K1_scale * (K1_a / (K1_a + K1_b)) * x_K;
    const N ito = p[g_to] * y[r] * y[s] * (Vm - E_K);
    const N iKr = c.Kr_scale * y[Xr1] * y[Xr2] * (Vm - E_K);
    const N iKs = p[g_Ks] * square(y[Xs]) * (Vm - E_Ks);
    const N iCaL = c.CaL_scale * y[d] * y[f] * y[f2] * y[fCass] *
                   (0.25 * y[Ca_ss] * factor[CaL_inside] - p[Ca_o] * factor[CaL_outside]);
    const N iNaK = c.pump * y[Na_i] / (y[Na_i] + p[K_mNa]) * factor[NaK_factor];
    const N iNaCa = c.exchanger * (factor[NaCa_forward] * cube(y[Na_i]) * p[Ca_o] -
                                   factor[NaCa_reverse] * c.Na_o_cubed * y[Ca_i] * p[alpha]);
    const N ipCa = p[g_pCa] * y[Ca_i] / (p[K_pCa] + y[Ca_i]);
    const N ipK = p[g_pK] * (Vm - E_K) * factor[pK_opening];
    const N ibNa = p[g_bNa] * (Vm - E_Na);
    const N ibCa = p[g_bCa] * (Vm - E_Ca);

    const N ss_saturation = 1.0 / (1.0 + square(N(y[Ca_ss] * 20.0)));
    gate(fCass, 0.6 * ss_saturation + 0.4, 80.0 * ss_saturation + 2.0);

    // Calcium handling.
    const N SR_square = square(y[Ca_SR]);
    const N kcasr = p[max_sr] - (p[max_sr] - p[min_sr]) * SR_square / (SR_square + c.EC_square);
    const N k1 = p[k1_prime] / kcasr;
    const N k2 = p[k2_prime] * kcasr;
    const N opening = k1 * square(y[Ca_ss]);
    const N O = opening * y[R_prime] / (p[k3] + opening);
    const N i_rel = p[V_rel] * O * (y[Ca_SR] - y[Ca_ss]);
    const N i_leak = p[V_leak] * (y[Ca_SR] - y[Ca_i]);
    const N i_up = p[V_max_up] * square(y[Ca_i]) / (square(y[Ca_i]) + c.K_up_square);
    const N i_xfer = p[V_xfer] * (y[Ca_ss] - y[Ca_i]);
    // d(free)/d(total) of a buffered calcium, 1/(1 + B K/(Ca + K)^2).
    const auto free_share = [](const N& calcium, const P& half, const P& product) {
      const N q = square(N(calcium + half));
      return N(q / (q + product));
    };
    e.derivative[V] =
        -(iNa + iK1 + ito + iKr + iKs + iCaL + iNaK + iNaCa + ipCa + ipK + ibNa + ibCa + in[i_stim]);
    e.derivative[R_prime] = -k2 * y[Ca_ss] * y[R_prime] + p[k4] * (1.0 - y[R_prime]);
    e.derivative[Ca_i] =
        free_share(y[Ca_i], p[K_buf_c], c.buffer_c) *
        ((i_leak - i_up) * c.sr_per_c + i_xfer - c.calcium_charge * (ibCa + ipCa - 2.0 * iNaCa));
    e.derivative[Ca_SR] = free_share(y[Ca_SR], p[K_buf_sr], c.buffer_sr) * (i_up - i_rel - i_leak);
    e.derivative[Ca_ss] = free_share(y[Ca_ss], p[K_buf_ss], c.buffer_ss) *
                          (i_rel * c.sr_per_ss - i_xfer * c.c_per_ss - c.subspace_charge * iCaL);
    e.derivative[Na_i] = -c.charge_to_concentration * (iNa + ibNa + 3.0 * iNaK + 3.0 * iNaCa);
    e.derivative[K_i] = -c.charge_to_concentration *
                        (iK1 + ito + iKr + iKs + ipK - 2.0 * iNaK + p[stimulus_K_fraction] * in[i_stim]);

    e.observable = {iNa,  iK1, ito,  iKr,  iKs,   iCaL, iNaK,   iNaCa,
                    ipCa, ipK, ibCa, ibNa, i_rel, i_up, i_leak, i_xfer};
  }

  template <class N, class P>
  static Evaluation<N, states.size(), observables.size()> evaluate(const N* y, const N* in,
                                                                   const Constants<P>& c) {
    return evaluate_in_parts<Ttp06, N>(y, in, c);
  }

  // The charge is kept exactly, with and without stimulus, if K+ carries the stimulus.
  static constexpr std::array invariants = {membrane_charge(K_i)};
  template <class N, class P>
  static std::array<N, 1> invariant_values(const N* y, const Constants<P>& c) {
    const auto& p = c.p;
    const auto total = [](const N& calcium, const P& buffer, const P& half) {
      return N(calcium + buffer * calcium / (calcium + half));
    };
    return {
        N(y[V] - (p[F] / p[Cm]) * (p[V_c] * (y[Na_i] + y[K_i] + 2.0 * total(y[Ca_i], p[Buf_c], p[K_buf_c])) +
                                   2.0 * p[V_sr] * total(y[Ca_SR], p[Buf_sr], p[K_buf_sr]) +
                                   2.0 * p[V_ss] * total(y[Ca_ss], p[Buf_ss], p[K_buf_ss])))};
  }
  template <class P>
  static std::array<P, 1> invariant_slopes(const Constants<P>& c) {
    return {P(-c.p[F] / c.p[Cm] * c.p[V_c])};
  }
};

}  // namespace wiggers
