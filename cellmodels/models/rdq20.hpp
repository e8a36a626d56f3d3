// RDQ20-MF: active force, the mean-field model of Regazzoni, Dede' and Quarteroni.
//
// F. Regazzoni, L. Dede', A. Quarteroni, "Biophysically detailed mathematical models of multiscale cardiac
// active mechanics", PLoS Comput Biol 16(10):e1008294, 2020 (mean-field model). Units: s, um, uM, kPa.
//
//   thin filament   ...[left a]---[centre b, troponin B]---[right c]...   states 0: non-permissive, 1:
//   permissive P[a,b,c,B]      joint probability of the triplet and of the centre's calcium binding; index 8a
//   + 4b + 2c + B mu_k,P  mu_k,N  zeroth and first moment of attached crossbridges on permissive /
//   non-permissive units
//
// The flux of an outer unit is closed by conditional independence given the overlapping pair. Invariants of
// the exact flow from the default state: sum P = 1, P[a,b,c,B] = P[c,b,a,B], P >= 0. Tension needs only S0 =
// mu0_P + mu0_N and S1 = mu1_P + mu1_N; four moments are kept so that states can be exchanged with other
// codes.
//
// Parameter sets `fedele2023-*`: a_XB is printed in Pa by the whole-heart paper and stands in kPa here.
// Values that paper does not list (mu, Q, r0, alpha, filament lengths) are those of the published mean-field
// model: an assumption, see docs/notes.md.
#pragma once

#include <fmt/format.h>

#include <array>
#include <string>
#include <wiggers/cellmodels/models/facts.hpp>
#include <wiggers/cellmodels/models/force_model.hpp>
#include <wiggers/core/enumerators.hpp>
#include <wiggers/core/evaluation.hpp>
#include <wiggers/core/markov.hpp>
#include <wiggers/core/numbers.hpp>

namespace wiggers {

namespace facts {
constexpr Quantity triplet(std::string_view name, double start) {
  return {name, "1", start, 0, 1, "probability of units (left, centre, right) and centre calcium binding"};
}
constexpr Quantity moment(std::string_view name, std::string_view meaning) {
  return {name, "1", 0, -10, 10, meaning};
}
}  // namespace facts

struct Rdq20 {
  static constexpr std::string_view name = "rdq20";
  static constexpr std::string_view title = "Regazzoni-Dede'-Quarteroni 2020, mean-field active force";
  static constexpr std::string_view source =
      "F. Regazzoni, L. Dede', A. Quarteroni, PLoS Comput Biol 16(10):e1008294, 2020";
  static constexpr std::string_view time_unit = "s";

  static constexpr int n_probabilities = 16;
  enum State { mu0_P = 16, mu1_P, mu0_N, mu1_N };
  static constexpr int P(int a, int b, int c, int B) { return 8 * a + 4 * b + 2 * c + B; }

  static constexpr std::array states = {
      facts::triplet("P0000", 1),
      facts::triplet("P0001", 0),
      facts::triplet("P0010", 0),
      facts::triplet("P0011", 0),
      facts::triplet("P0100", 0),
      facts::triplet("P0101", 0),
      facts::triplet("P0110", 0),
      facts::triplet("P0111", 0),
      facts::triplet("P1000", 0),
      facts::triplet("P1001", 0),
      facts::triplet("P1010", 0),
      facts::triplet("P1011", 0),
      facts::triplet("P1100", 0),
      facts::triplet("P1101", 0),
      facts::triplet("P1110", 0),
      facts::triplet("P1111", 0),
      facts::moment("mu0_P", "attached crossbridges on permissive units"),
      facts::moment("mu1_P", "their mean elongation times number"),
      facts::moment("mu0_N", "attached crossbridges on non-permissive units"),
      facts::moment("mu1_N", "their mean elongation times number"),
  };
  static_assert(well_formed(states));
  static_assert(named_as<State, mu0_P>(states));

  enum Parameter {
    LA,
    LM,
    LB,
    SL0,
    mu,
    Q,
    gamma,
    Kd0,
    alphaKd,
    Koff,
    Kbasic,
    mu0_fP,
    mu1_fP,
    r0,
    alpha,
    a_XB
  };
  static constexpr std::array parameters = {
      Quantity{"LA", "um", 1.25, 0.8, 1.8, "length of the thin filament"},
      Quantity{"LM", "um", 1.65, 1.2, 2.2, "length of the thick filament"},
      Quantity{"LB", "um", 0.18, 0.01, 0.5, "bare zone of the thick filament"},
      facts::reference_length(2.2),
      Quantity{"mu", "1", 10, 1, 200, "calcium affinity ratio of permissive and non-permissive units"},
      facts::positive("Q", "1", 2,
                      "ratio of permissive to non-permissive states, calcium bound, no neighbours"),
      Quantity{"gamma", "1", 12, 1, 300, "cooperativity between neighbouring units"},
      Quantity{"Kd0", "uM", 0.381, 0.02, 20, "calcium dissociation constant at sarcomere length 2.15 um"},
      Quantity{"alphaKd", "uM/um", -0.571, -13, 13, "length dependence of the dissociation constant"},
      Quantity{"Koff", "1/s", 100, 0.5, 2000, "calcium unbinding rate"},
      Quantity{"Kbasic", "1/s", 13, 0.3, 300, "basic rate of tropomyosin transitions"},
      facts::non_negative("mu0_fP", "1/s", 32.653, "attachment: rate of the zeroth moment"),
      facts::non_negative("mu1_fP", "1/s", 0.778, "attachment: rate of the first moment"),
      facts::positive("r0", "1/s", 134.31, "detachment rate without sliding"),
      facts::non_negative("alpha", "1", 25.184, "increase of detachment with sliding velocity"),
      marked(Role::strength, Quantity{"a_XB", "kPa", 22.894e3, 0, 2e7, "tension per unit of first moment"}),
  };
  static_assert(well_formed(parameters));
  static_assert(named_as<Parameter>(parameters));

  enum Input { Ca, SL, dSL_dt };
  static constexpr auto inputs = facts::force_inputs;
  static_assert(named_as<Input>(inputs));

  enum Observable { permissivity, Ta, Ka };
  static constexpr std::array observables = {
      facts::output("permissivity", "1", "probability that a regulatory unit is permissive"),
      facts::active_tension, facts::active_stiffness};
  static_assert(named_as<Observable>(observables));

  static constexpr ParameterChange rat[] = {{"Kd0", 0.835}, {"alphaKd", -1.258}, {"Koff", 120},
                                            {"Kbasic", 24}, {"mu0_fP", 32.708},  {"mu1_fP", 0.779}};
  static constexpr ParameterChange ventricles[] = {{"SL0", 1.9},         {"gamma", 30},     {"Kd0", 0.36},
                                                   {"alphaKd", -0.2083}, {"Koff", 8},       {"Kbasic", 4},
                                                   {"mu0_fP", 32.225},   {"mu1_fP", 0.768}, {"a_XB", 15.0e5}};
  static constexpr ParameterChange atria[] = {{"SL0", 1.9},       {"gamma", 20},     {"Kd0", 0.865},
                                              {"alphaKd", -1.25}, {"Koff", 180},     {"Kbasic", 20},
                                              {"mu0_fP", 32.225}, {"mu1_fP", 0.768}, {"a_XB", 3.0e5}};
  static constexpr std::array parameter_sets = {
      ParameterSet{"human37", "human, body temperature: 2020 paper, mean-field calibration (default)", "1"},
      ParameterSet{"rat-room", "rat, room temperature: 2020 paper, mean-field calibration", "1", rat, 6},
      ParameterSet{"fedele2023-ventricles",
                   "whole-heart paper (Fedele et al. 2023), left ventricle; RV: a_XB 10.5e5 kPa", "1",
                   ventricles, 9},
      ParameterSet{"fedele2023-atria", "whole-heart paper (Fedele et al. 2023), atria", "1", atria, 9},
  };

  template <class Pn>
  struct Constants {
    Pn p[parameters.size()];
    Pn up_bound[3], up_free[3], down[3];  // tropomyosin rates by number of permissive neighbours
  };
  template <class Pn>
  static Constants<Pn> constants(const Pn* parameter) {
    Constants<Pn> c;
    for (std::size_t i = 0; i < parameters.size(); ++i) c.p[i] = parameter[i];
    Pn power(1.0);
    for (int neighbours = 0; neighbours < 3; ++neighbours) {
      c.up_bound[neighbours] = c.p[Q] * c.p[Kbasic] * power;
      c.up_free[neighbours] = c.up_bound[neighbours] / c.p[mu];
      c.down[2 - neighbours] = c.p[Kbasic] * power;
      power = power * c.p[gamma];
    }
    return c;
  }

  // Calcium dissociation constant at a sarcomere length; the model holds only where it is positive.
  template <class N, class Pn>
  static N dissociation_constant(const N& sarcomere_length, const Pn* p) {
    return p[Kd0] - p[alphaKd] * (2.15 - sarcomere_length);
  }

  // Overlap of thick and thin filaments, 0 to 1.
  template <class N, class Pn>
  static N overlap(const N& x, const Pn* p) {
    const Pn half = 0.5 * (p[LM] - p[LB]);
    const N rising = select(x <= p[LM], N((x - p[LA]) / half), N((x + p[LM] - 2.0 * p[LA]) / (2.0 * half)));
    const N falling = (p[LM] + 2.0 * p[LA] - x) / (2.0 * half);
    const N inner =
        select(x <= 2.0 * p[LA] - p[LB], rising, select(x <= 2.0 * p[LA] + p[LB], N(1.0), falling));
    return select(inner > 0.0, inner, N(0.0));
  }

  // Fluxes of the regulatory units: everything the right-hand side and the crossbridges need.
  template <class N>
  struct Regulation {
    std::array<N, n_probabilities> derivative;
    N permissivity;
    N k_PN, k_NP;  // rates between permissive and non-permissive
  };

  // a / b, or 0 where b is below 1e-12 (the flux vanishes with it).
  template <class N>
  static N guarded_ratio(const N& a, const N& b) {
    const auto tiny = b < 1e-12;
    return select(tiny, N(0.0), N(a / select(tiny, N(1.0), b)));
  }

  // Transition rates with the neighbours' conditional rates frozen at one state: for it the regulatory units
  // obey a linear dx/dt = A x, with A the generator of a Markov chain.
  template <class N>
  struct FrozenRates {
    N left[2][2];   // of the left unit, in [its state][that of its right neighbour]
    N right[2][2];  // of the right unit, in [that of its left neighbour][its state]
    N bind;         // of calcium
  };
  template <class Pn>
  static Pn centre_rate(int a, int b, int cc, int B, const Constants<Pn>& c) {
    return b == 1 ? c.down[a + cc] : B == 1 ? c.up_bound[a + cc] : c.up_free[a + cc];
  }
  template <class N, class Pn>
  static N calcium_rate(int b, int B, const FrozenRates<N>& rates, const Constants<Pn>& c) {
    if (B == 0) return rates.bind;
    return b == 0 ? N(c.p[Koff]) : N(c.p[Koff] / c.p[mu]);
  }

  // The generator A of frozen rates, as propagate() asks for it.
  template <class N>
  struct Exchange {
    N left[2][2], right[2][2], centre[n_probabilities], calcium[n_probabilities];

    template <class Pn>
    Exchange(const FrozenRates<N>& rates, const Constants<Pn>& c) {
      for (int s = 0; s < 2; ++s)
        for (int t = 0; t < 2; ++t) {
          left[s][t] = rates.left[s][t];
          right[s][t] = rates.right[s][t];
        }
      for (int i = 0; i < n_probabilities; ++i) {
        const int a = i >> 3, b = (i >> 2) & 1, cc = (i >> 1) & 1, B = i & 1;
        centre[i] = N(centre_rate(a, b, cc, B, c));
        calcium[i] = calcium_rate(b, B, rates, c);
      }
    }
    N exit(int i) const {
      const int a = i >> 3, b = (i >> 2) & 1, cc = (i >> 1) & 1;
      return left[a][b] + centre[i] + right[b][cc] + calcium[i];
    }
    void scale(double factor) {
      for (int s = 0; s < 2; ++s)
        for (int t = 0; t < 2; ++t) {
          left[s][t] = left[s][t] * factor;
          right[s][t] = right[s][t] * factor;
        }
      for (int i = 0; i < n_probabilities; ++i) {
        centre[i] = centre[i] * factor;
        calcium[i] = calcium[i] * factor;
      }
    }
    N inflow(int i, const N& kept, const N* x) const {
      const int a = i >> 3, b = (i >> 2) & 1, cc = (i >> 1) & 1;
      return kept + x[i ^ 8] * left[1 - a][b] + x[i ^ 4] * centre[i ^ 4] + x[i ^ 2] * right[b][1 - cc] +
             x[i ^ 1] * calcium[i ^ 1];
    }
  };

  template <class N, class Pn>
  static FrozenRates<N> frozen_rates(const N* y, const N& calcium, const N& sarcomere_length,
                                     const Constants<Pn>& c) {
    FrozenRates<N> rates;
    rates.bind = c.p[Koff] / dissociation_constant(sarcomere_length, c.p) * calcium;
    N flux[n_probabilities];
    for (int a = 0; a < 2; ++a)
      for (int b = 0; b < 2; ++b)
        for (int cc = 0; cc < 2; ++cc)
          for (int B = 0; B < 2; ++B) flux[P(a, b, cc, B)] = y[P(a, b, cc, B)] * centre_rate(a, b, cc, B, c);
    for (int s = 0; s < 2; ++s)
      for (int t = 0; t < 2; ++t) {
        N left_flux(0.0), left_sum(0.0), right_flux(0.0), right_sum(0.0);
        for (int x = 0; x < 2; ++x)
          for (int B = 0; B < 2; ++B) {
            left_flux = left_flux + flux[P(x, s, t, B)];
            left_sum = left_sum + y[P(x, s, t, B)];
            right_flux = right_flux + flux[P(s, t, x, B)];
            right_sum = right_sum + y[P(s, t, x, B)];
          }
        rates.left[s][t] = guarded_ratio(left_flux, left_sum);
        rates.right[s][t] = guarded_ratio(right_flux, right_sum);
      }
    return rates;
  }

  // A x for frozen rates, and the rates of the crossbridges' exchange that x implies.
  template <class N, class Pn>
  static Regulation<N> flow(const N* x, const FrozenRates<N>& rates, const Constants<Pn>& c) {
    Regulation<N> result;
    N flux_T[n_probabilities], flux_C[n_probabilities];
    for (int a = 0; a < 2; ++a)
      for (int b = 0; b < 2; ++b)
        for (int cc = 0; cc < 2; ++cc)
          for (int B = 0; B < 2; ++B) {
            const int i = P(a, b, cc, B);
            flux_T[i] = x[i] * centre_rate(a, b, cc, B, c);
            flux_C[i] = x[i] * calcium_rate(b, B, rates, c);
          }
    N permissive(0.0), flux_PN(0.0), flux_NP(0.0);
    for (int a = 0; a < 2; ++a)
      for (int b = 0; b < 2; ++b)
        for (int cc = 0; cc < 2; ++cc)
          for (int B = 0; B < 2; ++B) {
            const int i = P(a, b, cc, B);
            const int il = P(1 - a, b, cc, B), it = P(a, 1 - b, cc, B), ir = P(a, b, 1 - cc, B);
            const int ic = P(a, b, cc, 1 - B);
            const N swap_right = x[ir] * rates.right[b][1 - cc] - x[i] * rates.right[b][cc];
            const N swap_left = x[il] * rates.left[1 - a][b] - x[i] * rates.left[a][b];
            result.derivative[i] =
                swap_left + (flux_T[it] - flux_T[i]) + swap_right + (flux_C[ic] - flux_C[i]);
            if (b == 1) {
              permissive = permissive + x[i];
              flux_PN = flux_PN + flux_T[i];
            } else {
              flux_NP = flux_NP + flux_T[i];
            }
          }
    result.permissivity = permissive;
    result.k_PN = guarded_ratio(flux_PN, permissive);
    result.k_NP = guarded_ratio(flux_NP, N(1.0 - permissive));
    return result;
  }

  template <class N, class Pn>
  static Regulation<N> regulation(const N* y, const N& calcium, const N& sarcomere_length,
                                  const Constants<Pn>& c) {
    return flow(y, frozen_rates(y, calcium, sarcomere_length, c), c);
  }

  static constexpr int n_regulated = n_probabilities;

  // The probabilities over h by a two-stage midpoint rule with frozen rates: second order, positive and
  // conserving for every step. Stage one takes x over h/2 with A(x_n); stage two x_n over h with A(x_m), each
  // by uniformisation (about 60 terms for 1 ms of the atrial set); calcium and length are those of the middle
  // of the step. False if the rates are not finite or beyond what the method should be asked for.
  template <class H, class N, class Pn>
  static bool regulate(const H& h, N* y, const N& calcium, const N& sarcomere_length, const Constants<Pn>& c,
                       Regulation<N>& at_middle) {
    N middle[n_probabilities];
    for (int i = 0; i < n_probabilities; ++i) middle[i] = y[i];
    if (!propagate<n_probabilities>(H(0.5 * h), middle,
                                    Exchange<N>(frozen_rates(y, calcium, sarcomere_length, c), c)))
      return false;
    const auto rates = frozen_rates(middle, calcium, sarcomere_length, c);
    at_middle = flow(middle, rates, c);
    return propagate<n_probabilities>(h, y, Exchange<N>(rates, c));
  }

  // Holds the sum of the probabilities, which schemes keep but for rounding: a perturbed sum is then no
  // neutral direction of the map of a beat.
  template <class N>
  static void normalise(N* y) {
    N sum = y[0];
    for (int i = 1; i < n_probabilities; ++i) sum = sum + y[i];
    const N per_sum = 1.0 / sum;
    for (int i = 0; i < n_probabilities; ++i) y[i] = y[i] * per_sum;
  }

  // Advances the moments y[16..19] exactly over dt for frozen regulation and shortening velocity
  // v = -(dSL/dt)/SL0. With r = r0 + alpha |v_detaching| and A = -r I + B, B = [[-k_PN, k_NP], [k_PN,
  // -k_NP]], B^2 = -k B, k = k_PN + k_NP:
  //   exp(A t) = e^{-rt} (I + B (1 - e^{-kt})/k),   A^{-1} = -(I + B/(r + k))/r.
  template <class H, class N, class Pn>
  static bool cycle(const H& dt, N* y, const Regulation<N>& ru, const N& v, const N& v_detaching,
                    const Constants<Pn>& c) {
    const auto& p = c.p;
    const N r = p[r0] + p[alpha] * abs(v_detaching);
    const N k = ru.k_PN + ru.k_NP;
    const N decay = exp(N(-r * dt));
    const N exchange = dt * expm1_over_x(N(-k * dt));  // (1 - e^{-k dt})/k
    struct Pair {
      N P, N_;
    };
    const auto B = [&](const Pair& x) {
      const N flow = ru.k_PN * x.P - ru.k_NP * x.N_;
      return Pair{N(-flow), flow};
    };
    const N inverse_r = 1.0 / r, inverse_rk = 1.0 / (r + k);
    const auto minus_inverse = [&](const Pair& x) {
      const Pair b = B(x);
      return Pair{N((x.P + b.P * inverse_rk) * inverse_r), N((x.N_ + b.N_ * inverse_rk) * inverse_r)};
    };
    const auto propagate = [&](const Pair& x) {
      const Pair b = B(x);
      return Pair{N(decay * (x.P + exchange * b.P)), N(decay * (x.N_ + exchange * b.N_))};
    };
    const Pair m0{y[mu0_P], y[mu0_N]};
    const Pair m1{y[mu1_P], y[mu1_N]};
    const Pair m0_inf = minus_inverse({N(p[mu0_fP] * ru.permissivity), N(0.0)});
    const Pair m1_inf = minus_inverse({N(p[mu1_fP] * ru.permissivity - v * m0_inf.P), N(-v * m0_inf.N_)});
    const Pair d0 = propagate({N(m0.P - m0_inf.P), N(m0.N_ - m0_inf.N_)});
    const Pair d1 = propagate({N(m1.P - m1_inf.P), N(m1.N_ - m1_inf.N_)});
    y[mu0_P] = m0_inf.P + d0.P;
    y[mu0_N] = m0_inf.N_ + d0.N_;
    y[mu1_P] = m1_inf.P + d1.P - v * dt * d0.P;
    y[mu1_N] = m1_inf.N_ + d1.N_ - v * dt * d0.N_;
    return true;
  }

  // At a sarcomere length, kPa.
  template <class N, class Pn>
  static N tension(const N* y, const N& sarcomere_length, const Constants<Pn>& c) {
    return c.p[a_XB] * overlap(sarcomere_length, c.p) * (y[mu1_P] + y[mu1_N]);
  }
  template <class N, class Pn>
  static N stiffness(const N* y, const N& sarcomere_length, const Constants<Pn>& c) {
    return c.p[a_XB] * overlap(sarcomere_length, c.p) * (y[mu0_P] + y[mu0_N]);
  }

  // Whether the model describes a sarcomere of this length, and what it says where not.
  template <class N, class Pn>
  static bool holds_at(const N& sarcomere_length, const Pn* p) {
    return dissociation_constant(sarcomere_length, p) > 0.0;
  }
  static std::string beyond(double sarcomere_length_um, const double* p) {
    return fmt::format(
        "the calcium dissociation constant Kd0 - alphaKd (2.15 - SL) = {:.4g} uM is not positive; with "
        "these parameters SL must stay {} {:.4g} um",
        dissociation_constant(sarcomere_length_um, p), p[alphaKd] < 0 ? "below" : "above",
        2.15 - p[Kd0] / p[alphaKd]);
  }

  // Where a search for a steady state starts: a little probability everywhere keeps the closure's quotients
  // defined.
  static void spread(double* y) {
    for (int i = 0; i < n_probabilities; ++i) y[i] = 1e-6;
    y[0] = 1 - 15e-6;
  }

  template <class N, class Pn>
  static Evaluation<N, states.size(), observables.size()> evaluate(const N* y, const N* in,
                                                                   const Constants<Pn>& c) {
    Evaluation<N, states.size(), observables.size()> e;
    const auto& p = c.p;
    const Regulation<N> ru = regulation(y, in[Ca], in[SL], c);
    for (int i = 0; i < n_probabilities; ++i) e.derivative[i] = ru.derivative[i];
    const N v = -in[dSL_dt] / p[SL0];
    const N r = p[r0] + p[alpha] * abs(v);
    e.derivative[mu0_P] = -(r + ru.k_PN) * y[mu0_P] + ru.k_NP * y[mu0_N] + p[mu0_fP] * ru.permissivity;
    e.derivative[mu1_P] =
        -(r + ru.k_PN) * y[mu1_P] + ru.k_NP * y[mu1_N] - v * y[mu0_P] + p[mu1_fP] * ru.permissivity;
    e.derivative[mu0_N] = -(r + ru.k_NP) * y[mu0_N] + ru.k_PN * y[mu0_P];
    e.derivative[mu1_N] = -(r + ru.k_NP) * y[mu1_N] + ru.k_PN * y[mu1_P] - v * y[mu0_N];
    e.observable = {ru.permissivity, tension(y, in[SL], c), stiffness(y, in[SL], c)};
    return e;
  }

  static constexpr std::array invariants = {
      Invariant{"probability", "1", "sum of the triplets' probabilities", 0}};
  template <class N, class Pn>
  static std::array<N, 1> invariant_values(const N* y, const Constants<Pn>&) {
    N sum(0.0);
    for (int i = 0; i < n_probabilities; ++i) sum = sum + y[i];
    return {sum};
  }
  template <class Pn>
  static std::array<Pn, 1> invariant_slopes(const Constants<Pn>&) {
    return {Pn(1.0)};
  }
};

}  // namespace wiggers
