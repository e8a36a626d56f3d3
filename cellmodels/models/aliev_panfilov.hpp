// Aliev-Panfilov: two variables for excitable heart tissue, potential and recovery.
//
// R. R. Aliev, A. V. Panfilov, "A simple two-variable model of cardiac excitation", Chaos Solitons Fractals
// 7:293-301, 1996. With u = (V - V_rest)/V_amplitude and time in units of time_scale:
//     du/dt = -k u (u - a)(u - 1) - u v                                                      (Eq. 1)
//     dv/dt = (epsilon_0 + mu_1 v/(u + mu_2)) (-v - k u (u - a - 1))                         (Eqs. 2, 3)
// V = 100 u - 80 mV and 12.9 ms a unit of time are the paper's scales (its Eq. 4). It costs a tenth of an
// ionic model and has no ions: for conduction, spirals and meshes, not for calcium, force or drugs.
//
// Below rest the denominator of Eq. 3 takes u = 0: a cell that is hyperpolarised from outside must not meet
// the pole at u = -mu_2. Units: ms, mV, A/F.
#pragma once

#include <array>
#include <wiggers/cellmodels/models/facts.hpp>
#include <wiggers/cellmodels/models/stimulus.hpp>
#include <wiggers/core/enumerators.hpp>
#include <wiggers/core/evaluation.hpp>
#include <wiggers/core/numbers.hpp>

namespace wiggers {

struct AlievPanfilov {
  static constexpr std::string_view name = "aliev-panfilov";
  static constexpr std::string_view title = "Aliev-Panfilov 1996, two variables, no ions";
  static constexpr std::string_view source =
      "R. R. Aliev, A. V. Panfilov, Chaos Solitons Fractals 7:293-301, 1996";
  static constexpr std::string_view time_unit = "ms";
  static constexpr StimulusPulse default_stimulus{-20, 2, 0};

  enum State { V, v };
  static constexpr std::array states = {
      facts::membrane_potential(-80),
      // Where the potential is above its plateau the recovery goes below zero.
      Quantity{"v", "1", 0, -5, 100, "recovery"},
  };
  static_assert(well_formed(states));
  static_assert(named_as<State>(states));

  enum Parameter { k, a, epsilon_0, mu_1, mu_2, V_rest, V_amplitude, time_scale };
  static constexpr std::array parameters = {
      facts::positive("k", "1", 8, "strength of the excitation"),
      Quantity{"a", "1", 0.15, 0.015, 1, "threshold of the excitation, as a share of the amplitude"},
      facts::positive("epsilon_0", "1", 0.002, "rate of the recovery at rest"),
      facts::positive("mu_1", "1", 0.2, "dependence of the recovery's rate on itself"),
      facts::positive("mu_2", "1", 0.3, "dependence of the recovery's rate on the potential"),
      Quantity{"V_rest", "mV", -80, -100, -60, "resting potential"},
      facts::positive("V_amplitude", "mV", 100, "amplitude of the action potential"),
      facts::positive("time_scale", "ms", 12.9, "unit of time"),
  };
  static_assert(well_formed(parameters));
  static_assert(named_as<Parameter>(parameters));

  enum Input { i_stim };
  static constexpr std::array inputs = {facts::stimulus};
  static_assert(named_as<Input>(inputs));

  static constexpr std::array observables = {
      facts::output("i_excitation", "A/F", "current of the excitation"),
      facts::output("i_recovery", "A/F", "current of the recovery"),
  };
  static_assert(well_formed(observables));

  static constexpr std::array parameter_sets = {ParameterSet{"default", "the 1996 paper", "1"}};

  template <class P>
  struct Constants {
    P p[parameters.size()];
    P per_amplitude, per_time, current;  // 1/V_amplitude, 1/time_scale, V_amplitude/time_scale
  };
  template <class P>
  static Constants<P> constants(const P* parameter) {
    Constants<P> c;
    for (std::size_t i = 0; i < parameters.size(); ++i) c.p[i] = parameter[i];
    c.per_amplitude = 1.0 / c.p[V_amplitude];
    c.per_time = 1.0 / c.p[time_scale];
    c.current = c.p[V_amplitude] * c.per_time;
    return c;
  }

  template <class N, class P>
  static Evaluation<N, states.size(), observables.size()> evaluate(const N* y, const N* in,
                                                                   const Constants<P>& c) {
    Evaluation<N, states.size(), observables.size()> e;
    const auto& p = c.p;
    const N u = (y[V] - p[V_rest]) * c.per_amplitude;
    const N excitation = c.current * (p[k] * u * (u - p[a]) * (u - 1.0));
    const N recovery = c.current * (u * y[v]);
    const N above_rest = select(u > 0.0, u, N(0.0));
    const N rate = p[epsilon_0] + p[mu_1] * y[v] / (above_rest + p[mu_2]);
    e.derivative[V] = -(excitation + recovery + in[i_stim]);
    e.derivative[v] = c.per_time * (rate * (-y[v] - p[k] * u * (u - p[a] - 1.0)));
    e.observable = {excitation, recovery};
    return e;
  }

  static constexpr std::string_view no_invariants = "it has no ions, and so no charge to keep";
};

}  // namespace wiggers
