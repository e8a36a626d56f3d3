// One beat of the elastance loop by classical Runge-Kutta steps that end where the equations have kinks: at
// the break points of the activations and, for valve laws with a kink, where a valve opens or closes. So the
// scheme keeps its fourth order, and its result is a smooth function of the parameters: with dual numbers the
// same text gives exact derivatives, event times included.
//
// Where the loop reacts faster than the steps wanted can follow (stiffness.hpp) they are divided, to stay
// well inside the scheme's stability; a loop that would take absurdly many is refused.
#pragma once

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <wiggers/circulation/loop.hpp>
#include <wiggers/circulation/stiffness.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/fixed_step.hpp>
#include <wiggers/core/progress.hpp>
#include <wiggers/core/root.hpp>

namespace wiggers {

using ValveStates = std::array<bool, n_valves>;  // open?

template <class T, class P>
void loop_pressures(const LoopOf<P>& loop, const P& t, const T* y, T* p) {
  for (int c = 0; c < n_chambers; ++c)
    p[c] = elastance(loop.elastance[c], t, loop.period_s) * (y[c] - loop.elastance[c].V0);
}

template <class T, class P>
std::array<T, n_valves> flows_when(const LoopOf<P>& loop, const ValveStates& open, const T* p, const T* y) {
  const CirculationParametersOf<P>& c = loop.circulation;
  if (!has_kink(c.valve_law)) return valve_flows(c, p, y);
  const auto drops = valve_drops(p, y);
  std::array<T, n_valves> Q;
  for (int v = 0; v < n_valves; ++v) Q[v] = valve_flow_when(open[v], c.valve_law, c.valves[v], drops[v]);
  return Q;
}

// Rates with every valve in a known state (laws without a kink do not look at it).
template <bool with_shunts, class T, class P>
void loop_rates_when(const LoopOf<P>& loop, const ValveStates& open, const P& t, const T* y, T* dy) {
  T p[n_chambers];
  loop_pressures(loop, t, y, p);
  if constexpr (with_shunts)
    circulation_rates(loop.circulation, y, p, flows_when(loop, open, p, y), dy);
  else
    rates_without_shunts(loop.circulation, y, p, flows_when(loop, open, p, y), dy);
}

// The step, compiled for loops with shunts and for those without, which pay nothing for them.
template <bool with_shunts, class T>
void runge_kutta_4_of(const LoopOf<T>& loop, const ValveStates& open, const T& t, const T& h, const T* y,
                      T* end, T* middle) {
  constexpr int n = n_circulation_states;
  T k1[n], k2[n], k3[n], k4[n], at[n];
  const T half = 0.5 * h;
  loop_rates_when<with_shunts>(loop, open, t, y, k1);
  for (int i = 0; i < n; ++i) at[i] = y[i] + half * k1[i];
  loop_rates_when<with_shunts>(loop, open, T(t + half), at, k2);
  for (int i = 0; i < n; ++i) at[i] = y[i] + half * k2[i];
  loop_rates_when<with_shunts>(loop, open, T(t + half), at, k3);
  for (int i = 0; i < n; ++i) at[i] = y[i] + h * k3[i];
  loop_rates_when<with_shunts>(loop, open, T(t + h), at, k4);
  const T sixth = h / 6.0;
  for (int i = 0; i < n; ++i) end[i] = y[i] + sixth * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i]);
  if (!middle) return;
  const T part = h / 24.0;
  for (int i = 0; i < n; ++i) middle[i] = y[i] + part * (5.0 * k1[i] + 4.0 * (k2[i] + k3[i]) - k4[i]);
}

// `middle`, if asked for: the state at t + h/2, to fourth order locally.
template <class T>
void runge_kutta_4(const LoopOf<T>& loop, const ValveStates& open, const T& t, const T& h, const T* y, T* end,
                   T* middle = nullptr) {
  if (loop.circulation.has_shunts())
    runge_kutta_4_of<true>(loop, open, t, h, y, end, middle);
  else
    runge_kutta_4_of<false>(loop, open, t, h, y, end, middle);
}

struct PlainStep {
  template <class T>
  static void step(const LoopOf<T>& loop, const ValveStates& open, const T& t, const T& h, const T* y, T* end,
                   T* middle) {
    runge_kutta_4(loop, open, t, h, y, end, middle);
  }
};

// `Step` may compile the step apart, for wider registers.
template <class T, class Step>
class LoopBeat {
 public:
  LoopBeat(const LoopOf<T>& loop, double dt_s) : loop_(loop), dt_(dt_s) {
    for (const auto& e : loop_.elastance)
      for (const T& offset : {T(0.0), e.TC, T(e.TC + e.TR)})
        breaks_.push_back(wrapped(T(e.tC + offset), loop_.period_s));
    breaks_.push_back(loop_.period_s);
    std::sort(breaks_.begin(), breaks_.end());
    // Instants that differ by rounding only are one, their mean; the beat's ends are no breaks.
    const double tiny = 1e-9 * value_of(loop_.period_s);
    std::vector<T> kept;
    double same = 1;
    for (const T& t : breaks_) {
      if (value_of(t) <= tiny || value_of(t) > value_of(loop_.period_s) - tiny) continue;
      if (!kept.empty() && value_of(t) - value_of(kept.back()) <= tiny) {
        kept.back() += (t - kept.back()) / ++same;
      } else {
        kept.push_back(t);
        same = 1;
      }
    }
    breaks_ = kept;
    plain_ = converted<double>(loop_);
    steepest_ = steepest_conductances(plain_.circulation);
    if constexpr (std::is_same_v<T, double>) moving_ = converted<Dual<1>>(loop_);
  }

  const LoopOf<T>& loop() const { return loop_; }
  // The break points of the activations within the beat, and its end.
  std::vector<T> ends() const {
    std::vector<T> list = breaks_;
    list.push_back(loop_.period_s);
    return list;
  }

  // Advances y by one period; on_step(t, y, p, open) with the chambers' pressures after the start, after
  // every step and at every event, and, if asked for, in the middle of every step. `stops`, sorted: more
  // instants at which steps end.
  template <bool with_middles = false, class OnStep>
  void run(T* y, OnStep on_step, const std::vector<double>& stops = {}) const {
    std::vector<T> ends = breaks_;
    const double tiny = 1e-9 * value_of(loop_.period_s);
    for (double stop : stops) {
      bool there = stop <= tiny || stop >= value_of(loop_.period_s) - tiny;
      for (const T& t : breaks_) there = there || std::abs(value_of(t) - stop) <= tiny;
      if (!there) ends.push_back(T(stop));
    }
    std::sort(ends.begin(), ends.end());
    ends.push_back(loop_.period_s);
    T t(0.0), p[n_chambers];
    ValveStates open = states_at(t, y, p);
    on_step(t, y, p, open);
    unsigned steps = 0;
    for (const T& end : ends) {
      int events = 0;
      ValveStates bounded = open;
      double longest = longest_step(value_of(t), value_of(end), open);
      for (bool reached = false; !reached;) {
        if ((++steps & 63) == 0) check_interrupt();
        if (open != bounded) longest = longest_step(value_of(t), value_of(end), bounded = open);
        T h = next_step(T(end - t), longest);
        reached = value_of(h) >= value_of(end) - value_of(t);
        T next[n_circulation_states], middle[n_circulation_states];
        Step::step(loop_, open, t, h, y, next, with_middles ? middle : nullptr);
        T event(0.0);
        int valve = -1;
        if (has_kink(loop_.circulation.valve_law) && events < largest_number_of_events)
          valve = first_event(t, h, y, next, open, event);
        if (valve >= 0) {
          ++events;
          Step::step(loop_, open, t, event, y, next, with_middles ? middle : nullptr);
          reached = false;
          h = event;
        }
        [[maybe_unused]] const T start = t;
        t = reached ? end : T(t + h);
        if (value_of(end) - value_of(t) < 1e-12) reached = true;
        const ValveStates before = open;
        if constexpr (with_middles) {
          const T half_way = 0.5 * (start + t);
          loop_pressures(loop_, half_way, middle, p);
          on_step(half_way, middle, p, open);
        }
        for (int i = 0; i < n_circulation_states; ++i) y[i] = next[i];
        open = states_at(t, y, p);
        // The valve of the event sits at zero: it is what it has just become, whatever rounding says.
        if (valve >= 0) open[valve] = !before[valve];
        on_step(t, y, p, open);
      }
    }
  }

 private:
  // In one span between two ends; chatter beyond is stepped over.
  static constexpr int largest_number_of_events = 64;

  // Steps times the fastest rate: 2.6 is the radius of the half disc in which the scheme is stable; at this
  // it also damps what it cannot resolve.
  static constexpr double longest_reach = 1.5;
  static constexpr double most_parts = 1000;  // of a step wanted

  // The step for a span between two ends with the valves as they are: the wanted one, or an even part of it.
  // Elastances rise or fall all the way through a span, so its ends bound them.
  double longest_step(double begin, double end, const ValveStates& open) const {
    ChamberElastances E;
    for (int c = 0; c < n_chambers; ++c)
      E[c] = std::max(elastance(plain_.elastance[c], begin, plain_.period_s),
                      elastance(plain_.elastance[c], end, plain_.period_s));
    ValveConductances g = steepest_;
    if (has_kink(plain_.circulation.valve_law))
      for (int v = 0; v < n_valves; ++v)
        if (!open[v])
          g[v] = valve_flow_when(false, plain_.circulation.valve_law, plain_.circulation.valves[v], 1.0);
    const double parts = dt_ * fastest_rate(plain_.circulation, E, g) / longest_reach;
    if (!(parts > 1)) return dt_;
    if (!(parts <= most_parts))
      throw NumericalFailure(
          fmt::format("runge-kutta-4 would need steps of {:.2g} s in this loop: {} is too stiff for an "
                      "explicit scheme. Take "
                      "integrator cvode.",
                      dt_ / parts, stiffest_branch(plain_.circulation, E, g)));
    return dt_ / std::ceil(parts);
  }

  ValveStates states_at(const T& t, const T* y, T* p) const {
    loop_pressures(loop_, t, y, p);
    const auto drops = valve_drops(p, y);
    ValveStates open;
    for (int v = 0; v < n_valves; ++v) open[v] = value_of(drops[v]) > 0;
    return open;
  }

  // Drop over one valve after a step of h, by numbers of any kind.
  template <class U>
  static U drop_after(const LoopOf<U>& loop, const ValveStates& open, const U& t, const U& h, const U* y,
                      int valve) {
    U end[n_circulation_states], p[n_chambers];
    Step::step(loop, open, t, h, y, end, static_cast<U*>(nullptr));
    loop_pressures(loop, U(t + h), end, p);
    return valve_drops(p, end)[valve];
  }

  // The first valve to change within the step, or -1; `event`: time from the step's start.
  int first_event(const T& t, const T& h, const T* y, const T* next, const ValveStates& open,
                  T& event) const {
    T p[n_chambers];
    const ValveStates after = states_at(T(t + h), next, p);
    if (after == open) return -1;
    int first = -1;
    double earliest = value_of(h);
    Plain plain(*this, t, y);
    for (int v = 0; v < n_valves; ++v) {
      if (after[v] == open[v]) continue;
      const double root = plain.root(open, earliest, v);
      if (root < 0 || (first >= 0 && root >= earliest)) continue;
      earliest = root;
      first = v;
    }
    if (first < 0) return -1;
    const double slope = plain.slope(open, earliest, first);
    if (!(std::abs(slope) > 1e-9)) return -1;  // grazing: nothing to gain
    // One Newton step in full arithmetic: its derivatives are those of the event's time.
    event = T(earliest) - drop_after(loop_, open, t, T(earliest), y, first) / slope;
    return first;
  }

  // The step without derivatives, and with the one by its length.
  struct Plain {
    const Loop* loop;
    const LoopOf<Dual<1>>* moving;
    Loop own;
    LoopOf<Dual<1>> own_moving;
    double t, y[n_circulation_states];
    Plain(const LoopBeat& beat, const T& at, const T* state) : t(value_of(at)) {
      for (int i = 0; i < n_circulation_states; ++i) y[i] = value_of(state[i]);
      if constexpr (std::is_same_v<T, double>) {
        loop = &beat.loop_;
        moving = &beat.moving_;
      } else {
        own = converted<double>(beat.loop_);
        own_moving = converted<Dual<1>>(own);
        loop = &own;
        moving = &own_moving;
      }
    }
    double drop(const ValveStates& open, double h, int valve) const {
      return drop_after<double>(*loop, open, t, h, y, valve);
    }
    double slope(const ValveStates& open, double h, int valve) const {
      Dual<1> state[n_circulation_states];
      for (int i = 0; i < n_circulation_states; ++i) state[i] = y[i];
      return drop_after<Dual<1>>(*moving, open, t, Dual<1>::variable(h, 0), state, valve).derivative[0];
    }
    // Where the drop changes sign in (0, h]; -1 if it does not.
    double root(const ValveStates& open, double h, int valve) const {
      const double sign = open[valve] ? 1 : -1;
      double a = 0, b = h;
      double fa = sign * drop(open, 0, valve), fb = sign * drop(open, h, valve);
      if (fb > 0) return -1;
      // Just after an event of this valve it starts from zero: look for the sign it should have first.
      for (int halving = 0; fa <= 0; ++halving) {
        if (halving == 20) return -1;
        a = (a == 0 ? b : a) * 0.5;
        fa = sign * drop(open, a, valve);
      }
      return bracketed_root([&](double c) { return sign * drop(open, c, valve); }, a, b, fa, fb, 1e-13,
                            1e-15);
    }
  };
  LoopOf<T> loop_;
  Loop plain_;  // the same without derivatives
  ValveConductances steepest_{};
  double dt_;
  std::vector<T> breaks_;
  LoopOf<Dual<1>> moving_;  // for slopes, where T itself is plain
};

}  // namespace wiggers
