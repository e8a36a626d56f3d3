// The whole-heart driver: walls and circulation, one step after another. Knows no kind of wall.
//
// One step t -> t + dt (staggered scheme of the founding paper):
//   1. every wall: begin_step (cells, active force)
//   2. Newton on the cavity pressures p: wall volumes = volumes the circulation wants, with
//        plain:       V = V_0D^n
//        stabilised:  V = V_0D^n + dt (venous inflow^n +- valve flows at p^{n+1})
//   3. every wall: accept_step
//   4. circulation by explicit Euler with the new pressures. Its inductors limit the step to 2 L/R (3.85 ms
//   for the
//      systemic veins of the founding paper); damped implicitly, dQ = dt (dp - R Q)/(L + dt R), they do not.
// Stabilised, the wall's volumes equal the circulation's new ones to Newton's tolerance at every step.
#pragma once

#include <functional>
#include <memory>
#include <string>
#include <vector>
#include <wiggers/circulation/circulation.hpp>
#include <wiggers/circulation/physical_sense.hpp>
#include <wiggers/core/table.hpp>
#include <wiggers/heart/walls/pericardium.hpp>
#include <wiggers/heart/walls/wall.hpp>

namespace wiggers {

template <class P>
struct DriverSettingsOf {
  P period_s = 0.8;
  P dt_s = 1e-3;  // divides the period
  bool stabilise_volumes = true;
  bool implicit_inductors = false;
  PericardiumOf<P> pericardium;
};
using DriverSettings = DriverSettingsOf<double>;

// What a beat reports beside its trace.
struct BeatAudit {
  double chamber_work_mmHg_mL = 0;    // work of the four chambers on the blood
  double dissipated_mmHg_mL = 0;      // in resistors and valves
  double blood_volume_change_mL = 0;  // over the beat
  double volume_mismatch_mL = 0;      // largest |wall volume - circulation volume| after a step
  long newton_iterations = 0;
  int most_newton_iterations = 0;
  std::array<double, n_valves> valve_volume_mL{};  // net volume through each valve
};

// A beat under way: may be left after any step, saved, and gone on with.
struct BeatUnderWay {
  long steps = 0;
  BeatAudit audit;
  double blood_volume_mL = 0;  // at its start
  Table trace;                 // rows up to the present
};

// Numbers are plain, or dual to carry sensitivities.
template <class T>
class HeartDriverOf {
 public:
  HeartDriverOf(DriverSettingsOf<T> settings, CirculationParametersOf<T> circulation,
                std::vector<std::unique_ptr<WallOf<T>>> walls);

  using Values = std::array<T, n_circulation_states>;

  void start(const Values& initial);

  long steps_per_beat() const { return n_steps_; }
  const DriverSettingsOf<T>& settings() const { return settings_; }
  const CirculationParametersOf<T>& circulation() const { return circulation_; }
  const Values& values() const { return y_; }
  const std::array<T, n_chambers>& pressures() const { return p_; }
  const std::array<T, n_valves>& flows() const { return Q_; }

  // Replaces the circulation's state between two beats and moves the walls to its volumes.
  void move_to(const Values& values);

  // Empty trace with all columns: time, circulation, pressures, valve flows, wall outputs ("LV.stretch").
  Table trace() const;

  // One beat; rows of the trace at every step, both ends included.
  BeatAudit beat(Table* trace);
  // One beat; on_row(t) at the start and after every step.
  BeatAudit beat_rows(const std::function<void(const T&)>& on_row);

  // The same step by step: begin, then step until it says that the beat is done. Rows at every step, or at
  // every n-th and the last where a beat would have more than most_rows_per_beat.
  BeatUnderWay begin_beat() const;
  bool step_beat(BeatUnderWay& beat);
  static constexpr long most_rows_per_beat = 200'000;
  long rows_after(long steps) const;

  // One step from time t within the beat. If Newton fails and a wall allows it, in halves.
  void step(const T& t, BeatAudit& audit);

  const std::vector<std::unique_ptr<WallOf<T>>>& walls() const { return walls_; }

  // Shows the present state to a check of physical sense, what the walls know of themselves included; and the
  // rows of a beat.
  void show(double t, PhysicalSense& sense) const;
  PhysicalSense sense_of(const Table& trace) const;

  std::vector<T> save() const;
  void restore(const std::vector<T>& saved);

 private:
  void record(Table& trace, double t) const;
  std::vector<WallOutput> wall_outputs() const;
  long steps_per_row() const;
  void tell_arterial_pressures();
  void wanted_volumes(const T* p, const T& dt, T* volumes, double* slopes) const;
  void step_over(const T& t, const T& dt, int halvings, BeatAudit& audit);
  void balance(const T& t, const T& dt, BeatAudit& audit, std::array<T, n_chambers>& p,
               std::array<double, n_chambers>& wall_volume);

  DriverSettingsOf<T> settings_;
  CirculationParametersOf<T> circulation_;
  CirculationParameters plain_;  // the same without derivatives, for Newton's slopes
  Pericardium plain_bag_;
  std::vector<std::unique_ptr<WallOf<T>>> walls_;
  std::vector<WallOutput> outputs_;     // of all walls, with their names
  std::vector<std::size_t> n_outputs_;  // by wall
  long n_steps_;
  Values y_{};
  std::array<T, n_chambers> p_{};
  std::array<T, n_valves> Q_{};
};
using HeartDriver = HeartDriverOf<double>;

}  // namespace wiggers
