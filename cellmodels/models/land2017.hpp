// Land2017: active force of human cardiac muscle, the model of Land and colleagues.
//
// S. Land, S.-J. Park-Holohan, N. P. Smith, C. G. dos Remedios, J. C. Kentish, S. A. Niederer, "A model of
// cardiac contraction based on novel measurements of tension development in human cardiomyocytes", J Mol Cell
// Cardiol 106:68-83, 2017. Units: s, um, uM, kPa; lambda = SL/SL0.
//
//   troponin:    Ca + free <-> CaTRPN, half bound at Ca50(lambda)
//   crossbridges:   B (blocked) <-> U (unbound) -> W (weak, before the stroke) -> S (strong) -> U
//   distortion:  zeta_w, zeta_s, stretched with the filaments, relaxing as bridges turn over
//
// B + U + W + S = 1. Tension is h(lambda) T_ref/r_s ((zeta_s + 1) S + zeta_w W).
//
// Notes on the equations:
//  * Bound troponin enters unblocking as CaTRPN^(n_Tm/2) and blocking as its inverse, which is bounded by 100
//  as in the
//    authors' program: without a bound a muscle without calcium has no rate.
//  * The paper's k_uw and k_ws of intact muscle, 182 and 12 1/s, are seven and three times those of skinned
//  muscle.
//  * Set `margara2021`: n_Tm and k_u as later refitted by Margara et al. (Prog Biophys Mol Biol 159:58-74,
//  2021).
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

struct Land2017 {
  static constexpr std::string_view name = "land2017";
  static constexpr std::string_view title = "Land et al. 2017, active force of human cardiac muscle";
  static constexpr std::string_view source = "S. Land et al., J Mol Cell Cardiol 106:68-83, 2017";
  static constexpr std::string_view time_unit = "s";

  enum State { CaTRPN, B, W, S, zeta_w, zeta_s };
  static constexpr std::array states = {
      facts::probability("CaTRPN", 0, "troponin with calcium bound"),
      facts::probability("B", 1, "crossbridges blocked by tropomyosin"),
      facts::probability("W", 0, "crossbridges weakly bound, before the stroke"),
      facts::probability("S", 0, "crossbridges strongly bound, after the stroke"),
      Quantity{"zeta_w", "1", 0, -50, 50, "distortion of the weakly bound"},
      Quantity{"zeta_s", "1", 0, -50, 50, "distortion of the strongly bound"},
  };
  static_assert(well_formed(states));
  static_assert(named_as<State>(states));

  enum Parameter {
    SL0,
    Ca50,
    beta_1,
    n_TRPN,
    k_TRPN,
    TRPN50,
    n_Tm,
    k_u,
    k_uw,
    k_ws,
    r_w,
    r_s,
    gamma_w,
    gamma_s,
    phi,
    A_eff,
    beta_0,
    T_ref
  };
  static constexpr std::array parameters = {
      facts::reference_length(1.9),
      facts::positive("Ca50", "uM", 0.805, "calcium at which half the troponin is bound, at SL0"),
      Quantity{"beta_1", "uM", -2.4, -3.5, 0, "change of Ca50 with stretch"},
      Quantity{"n_TRPN", "1", 2, 1, 6, "cooperativity of calcium and troponin"},
      facts::positive("k_TRPN", "1/s", 100, "unbinding of calcium from troponin"),
      Quantity{"TRPN50", "1", 0.35, 0.05, 0.9, "bound troponin at half activation"},
      Quantity{"n_Tm", "1", 5, 1, 10, "cooperativity of tropomyosin"},
      Quantity{"k_u", "1/s", 1000, 10, 10000, "unblocking"},
      facts::positive("k_uw", "1/s", 182, "weak binding"),
      Quantity{"k_ws", "1/s", 12, 0.1, 100, "stroke"},
      Quantity{"r_w", "1", 0.5, 0.1, 0.8,
               "share of the weakly bound at full activation, of what is not strongly bound"},
      Quantity{"r_s", "1", 0.25, 0.05, 0.8, "share of the strongly bound at full activation"},
      facts::non_negative("gamma_w", "1/s", 615, "detachment of distorted weak bridges"),
      facts::non_negative("gamma_s", "1/s", 8.5, "detachment of distorted strong bridges"),
      facts::positive("phi", "1", 2.23, "relaxation of distortion over the turnover"),
      facts::non_negative("A_eff", "1", 25, "distortion by a stretch of the filaments"),
      Quantity{"beta_0", "1", 2.3, 0, 5, "change of the overlap with stretch"},
      marked(Role::strength, Quantity{"T_ref", "kPa", 120, 0, 5000, "tension at full activation and SL0"}),
  };
  static_assert(well_formed(parameters));
  static_assert(named_as<Parameter>(parameters));

  enum Input { Ca, SL, dSL_dt };
  static constexpr auto inputs = facts::force_inputs;
  static_assert(named_as<Input>(inputs));

  enum Observable { permissivity, Ta, Ka };
  static constexpr std::array observables = {facts::output("permissivity", "1", "crossbridges not blocked"),
                                             facts::active_tension, facts::active_stiffness};
  static_assert(named_as<Observable>(observables));

  static constexpr ParameterChange skinned[] = {
      {"n_Tm", 2.2}, {"Ca50", 2.5}, {"T_ref", 40.5}, {"k_uw", 26}, {"k_ws", 4}};
  static constexpr ParameterChange margara[] = {{"n_Tm", 2.4}, {"k_u", 40}};
  static constexpr std::array parameter_sets = {
      ParameterSet{"intact", "human, intact muscle at body temperature: 2017 paper (default)", "1"},
      ParameterSet{"skinned", "human, skinned cells: 2017 paper", "1", skinned, 5},
      ParameterSet{"margara2021", "intact, n_Tm and k_u refitted by Margara et al. 2021", "1", margara, 2},
  };

  template <class P>
  struct Constants {
    P p[parameters.size()];
    P k_b;                   // blocking
    P k_wu, k_su, c_w, c_s;  // unbinding of weak and strong bridges, relaxation of their distortions
    P A;                     // distortion by stretch
    P half_Tm;               // n_Tm/2
  };
  template <class P>
  static Constants<P> constants(const P* parameter) {
    Constants<P> c;
    for (std::size_t i = 0; i < parameters.size(); ++i) c.p[i] = parameter[i];
    const P not_strong = 1.0 - c.p[r_s];
    c.half_Tm = 0.5 * c.p[n_Tm];
    c.k_b = c.p[k_u] * pow(c.p[TRPN50], c.p[n_Tm]) / (not_strong * (1.0 - c.p[r_w]));
    c.k_wu = c.p[k_uw] * (1.0 / c.p[r_w] - 1.0) - c.p[k_ws];
    c.k_su = c.p[k_ws] * c.p[r_w] * (1.0 / c.p[r_s] - 1.0);
    c.c_w = c.p[phi] * c.p[k_uw] * (1.0 - c.p[r_w]) / c.p[r_w];
    c.c_s = c.p[phi] * c.p[k_ws] * not_strong * c.p[r_w] / c.p[r_s];
    c.A = c.p[A_eff] * c.p[r_s] / (not_strong * c.p[r_w] + c.p[r_s]);
    return c;
  }

  // Calcium at half binding and overlap, at a sarcomere length.
  template <class N, class P>
  static N half_calcium(const N& sarcomere_length, const P* p) {
    const N stretch = sarcomere_length / p[SL0];
    return p[Ca50] + p[beta_1] * (select(stretch < 1.2, stretch, N(1.2)) - 1.0);
  }
  template <class N, class P>
  static N overlap(const N& sarcomere_length, const P* p) {
    const N stretch = sarcomere_length / p[SL0];
    const N most = select(stretch < 1.2, stretch, N(1.2));
    const N h = 1.0 + p[beta_0] * (most + select(most < 0.87, most, N(0.87)) - 1.87);
    return select(h > 0.0, h, N(0.0));
  }

  // What bound troponin makes of the tropomyosin: rates of blocking and unblocking.
  template <class N>
  struct Regulation {
    std::array<N, 1> derivative;
    N block, unblock;
  };
  template <class N, class P>
  static N half_power(const N& troponin, const Constants<P>& c) {
    // 100^(-2/n_Tm) is where the inverse meets its bound; below that its logarithm is of no use.
    const N some = select(troponin > 1e-12, troponin, N(1e-12));
    return exp(N(c.half_Tm * log(some)));
  }
  template <class N, class P>
  static Regulation<N> at_troponin(const N& troponin, const Constants<P>& c) {
    Regulation<N> regulation;
    const N power = half_power(troponin, c);
    const N inverse = 1.0 / power;
    regulation.block = c.k_b * select(inverse < 100.0, inverse, N(100.0));
    regulation.unblock = c.p[k_u] * power;
    return regulation;
  }
  // Of calcium binding: to its steady value with this rate.
  template <class N, class P>
  static N binding(const N& calcium, const N& sarcomere_length, const Constants<P>& c) {
    const N ratio = calcium / half_calcium(sarcomere_length, c.p);
    const N some = select(ratio > 1e-9, ratio, N(1e-9));
    return exp(N(c.p[n_TRPN] * log(some)));
  }
  template <class N, class P>
  static Regulation<N> regulation(const N* y, const N& calcium, const N& sarcomere_length,
                                  const Constants<P>& c) {
    Regulation<N> result = at_troponin(y[CaTRPN], c);
    const N bind = binding(calcium, sarcomere_length, c);
    result.derivative[0] = c.p[k_TRPN] * (bind * (1.0 - y[CaTRPN]) - y[CaTRPN]);
    return result;
  }

  static constexpr int n_regulated = 1;

  // Troponin exactly over h at calcium and length of the middle of the step; what it makes of tropomyosin is
  // that of the middle.
  template <class H, class N, class P>
  static bool regulate(const H& h, N* y, const N& calcium, const N& sarcomere_length, const Constants<P>& c,
                       Regulation<N>& at_middle) {
    const N bind = binding(calcium, sarcomere_length, c);
    const N steady = bind / (1.0 + bind), rate = c.p[k_TRPN] * (1.0 + bind);
    const N half = exp(N(-0.5 * h * rate));
    at_middle = at_troponin(N(steady + (y[CaTRPN] - steady) * half), c);
    y[CaTRPN] = steady + (y[CaTRPN] - steady) * half * half;
    return true;
  }

  // The chain U, B, W, S as propagate() asks for it.
  template <class N>
  struct Turnover {
    N block, unblock, uw, wu, ws, su;
    N exit(int i) const { return i == 0 ? block + uw : i == 1 ? unblock : i == 2 ? wu + ws : su; }
    void scale(double factor) {
      for (N* rate : {&block, &unblock, &uw, &wu, &ws, &su}) *rate = *rate * factor;
    }
    N inflow(int i, const N& kept, const N* x) const {
      return i == 0   ? N(kept + x[1] * unblock + x[2] * wu + x[3] * su)
             : i == 1 ? N(kept + x[0] * block)
             : i == 2 ? N(kept + x[0] * uw)
                      : N(kept + x[2] * ws);
    }
  };
  // Rates of the crossbridges at distortions.
  template <class N, class P>
  static Turnover<N> turnover(const Regulation<N>& regulation, const N& weak, const N& strong,
                              const Constants<P>& c) {
    const N backwards = -strong - 1.0;
    const N beyond_stroke = select(backwards > 0.0, backwards, select(strong > 0.0, strong, N(0.0)));
    return {regulation.block, regulation.unblock,
            N(c.p[k_uw]),     c.k_wu + c.p[gamma_w] * abs(weak),
            N(c.p[k_ws]),     c.k_su + c.p[gamma_s] * beyond_stroke};
  }

  // Crossbridges over h for frozen regulation: distortions exactly for the shortening velocity v =
  // -(dSL/dt)/SL0, the chain by uniformisation at the distortions that v_detaching makes in the middle of the
  // step.
  template <class H, class N, class P>
  static bool cycle(const H& h, N* y, const Regulation<N>& regulation, const N& v, const N& v_detaching,
                    const Constants<P>& c) {
    const auto distorted = [&](const N& from, const N& velocity, const P& relaxation, const H& time) {
      const N steady = -c.A * velocity / relaxation;
      return N(steady + (from - steady) * exp(N(-relaxation * time)));
    };
    const H half = 0.5 * h;
    const auto rates = turnover(regulation, distorted(y[zeta_w], v_detaching, c.c_w, half),
                                distorted(y[zeta_s], v_detaching, c.c_s, half), c);
    N chain[4] = {N(1.0 - y[B] - y[W] - y[S]), y[B], y[W], y[S]};
    if (!propagate<4>(h, chain, rates)) return false;
    y[B] = chain[1];
    y[W] = chain[2];
    y[S] = chain[3];
    y[zeta_w] = distorted(y[zeta_w], v, c.c_w, h);
    y[zeta_s] = distorted(y[zeta_s], v, c.c_s, h);
    return true;
  }

  // At a sarcomere length, kPa.
  template <class N, class P>
  static N tension(const N* y, const N& sarcomere_length, const Constants<P>& c) {
    return c.p[T_ref] / c.p[r_s] * overlap(sarcomere_length, c.p) *
           ((y[zeta_s] + 1.0) * y[S] + y[zeta_w] * y[W]);
  }
  template <class N, class P>
  static N stiffness(const N* y, const N& sarcomere_length, const Constants<P>& c) {
    return c.p[T_ref] / c.p[r_s] * overlap(sarcomere_length, c.p) * c.A * (y[S] + y[W]);
  }

  template <class N, class P>
  static bool holds_at(const N& sarcomere_length, const P* p) {
    return half_calcium(sarcomere_length, p) > 0.0 && p[k_uw] * (1.0 / p[r_w] - 1.0) >= p[k_ws];
  }
  static std::string beyond(double sarcomere_length_um, const double* p) {
    const double half = half_calcium(sarcomere_length_um, p);
    if (!(half > 0))
      return fmt::format("the calcium at half binding, {:.4g} uM, is not positive there", half);
    return "weak bridges would unbind at a negative rate: k_uw (1/r_w - 1) must be at least k_ws";
  }

  template <class N, class P>
  static Evaluation<N, states.size(), observables.size()> evaluate(const N* y, const N* in,
                                                                   const Constants<P>& c) {
    Evaluation<N, states.size(), observables.size()> e;
    const Regulation<N> troponin = regulation(y, in[Ca], in[SL], c);
    const Turnover<N> k = turnover(troponin, y[zeta_w], y[zeta_s], c);
    const N U = 1.0 - y[B] - y[W] - y[S];
    const N stretching = c.A * in[dSL_dt] / c.p[SL0];
    e.derivative[CaTRPN] = troponin.derivative[0];
    e.derivative[B] = k.block * U - k.unblock * y[B];
    e.derivative[W] = k.uw * U - (k.wu + k.ws) * y[W];
    e.derivative[S] = k.ws * y[W] - k.su * y[S];
    e.derivative[zeta_w] = stretching - c.c_w * y[zeta_w];
    e.derivative[zeta_s] = stretching - c.c_s * y[zeta_s];
    e.observable = {N(1.0 - y[B]), tension(y, in[SL], c), stiffness(y, in[SL], c)};
    return e;
  }

  static constexpr std::string_view no_invariants = "the unbound crossbridges are what is left of one";
};

}  // namespace wiggers
