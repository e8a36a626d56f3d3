// The active stress of one piece of wall in a staggered step: cell -> calcium -> RDQ20 -> tension and
// stiffness.
//
// Shared by every kind of wall that is driven by cells. The wall sees the stress T + K (lambda - lambda^n):
// attached bridges are stretched at once by the strain of the step (the stabilised active stress). Switched
// off, K is 0.
#pragma once

#include <array>
#include <memory>
#include <string>
#include <wiggers/cellmodels/catalogue/rdq20_stepper.hpp>
#include <wiggers/heart/walls/cell_source.hpp>
#include <wiggers/heart/walls/wall.hpp>

namespace wiggers {

// How strain reaches the crossbridges in a step.
enum class RateScheme {
  lagged,    // the strain rate of the previous step; T + K (lambda - lambda^n) if stabilised
  implicit,  // bridges predicted without sliding, stiffness averaged over the step, repeated with the true
             // rate
  none       // no stretch-rate feedback: rate and K are zero
};
inline constexpr std::array<std::string_view, 3> rate_scheme_names = {"lagged", "implicit", "none"};

// How the regulatory units of RDQ20 step.
enum class RegulationScheme {
  midpoint,      // frozen rates in two stages: second order, positive and conserving for every step
  forward_euler  // sub-stepped, inputs held at the new time: the founding paper's
};
inline constexpr std::array<std::string_view, 2> regulation_scheme_names = {"frozen-midpoint",
                                                                            "forward-euler"};

struct ActiveFibreSettings {
  bool active = true;                 // false: no active stress at all
  bool subtract_rest_tension = true;  // T_eff = max(0, T - steady tension at rest_calcium)
  RegulationScheme regulation = RegulationScheme::forward_euler;
  int regulatory_substeps = 40;  // forward_euler
  RateScheme rate = RateScheme::lagged;
  bool stabilise = true;
};

// Tension in a step as a function of the stretch at its end.
template <class T>
struct FibreLaw {
  bool active = false;
  T tension_kPa = 0, stiffness_kPa = 0;  // rest tension removed
  T stretch = 1;                         // at the start of the step

  // Nominal tension (kPa) at a trial stretch of this step.
  template <class U>
  U operator()(const U& trial) const {
    return tension_kPa + stiffness_kPa * (trial - stretch);
  }
};

// Numbers are plain, or dual to carry sensitivities.
template <class T>
class ActiveFibreOf {
 public:
  // `rest_calcium_uM`: whose steady tension is removed; `place` names the piece of wall in messages.
  ActiveFibreOf(ActiveFibreSettings settings, const std::vector<T>& force_parameters,
                const T& rest_calcium_uM, std::unique_ptr<CellSourceOf<T>> cell, std::string place);

  void start(const T& stretch);
  void begin_step(const T& t, const T& dt);
  FibreLaw<T> law() const { return {settings_.active, tension_, stiffness_, stretch_}; }
  void accept_step(const T& stretch);
  // Another stretch between two beats; the rate is kept.
  void move_to(const T& stretch);

  T stretch() const { return stretch_; }  // at the start of the step

  void save(std::vector<T>& out) const;
  void restore(std::span<const T>& in);
  std::vector<WallOutput> outputs() const;
  void output_values(double* values) const;

 private:
  ActiveFibreSettings settings_;
  Rdq20StepperOf<T> force_;
  std::unique_ptr<CellSourceOf<T>> cell_;
  std::string place_;
  T mu1_rest_ = 0;

  // State.
  std::array<T, 20> bridges_{};
  T stretch_ = 1, stretch_before_ = 1;  // at the start of the step, and one step earlier
  T calcium_before_ = -1;               // at the start of the step; negative: not known yet
  // Of the current step.
  T tension_ = 0, stiffness_ = 0;      // kPa, rest tension removed
  T dt_ = 1, dt_before_ = -1;          // of this step and the one before it; negative: the same
  Rdq20::Regulation<T> regulation_{};  // implicit rate: to repeat the bridge step
  std::array<T, 4> moments_before_{};
};
using ActiveFibre = ActiveFibreOf<double>;

}  // namespace wiggers
