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
#include <wiggers/cellmodels/rdq20_stepper.hpp>
#include <wiggers/heart/cell_source.hpp>
#include <wiggers/heart/wall.hpp>

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
  double rest_calcium_uM = 0.1;
  RegulationScheme regulation = RegulationScheme::forward_euler;
  int regulatory_substeps = 40;  // forward_euler
  RateScheme rate = RateScheme::lagged;
  bool stabilise = true;
};

class ActiveFibre {
 public:
  // `place` names the piece of wall in messages.
  ActiveFibre(ActiveFibreSettings settings, const std::vector<double>& force_parameters,
              std::unique_ptr<CellSource> cell, std::string place);

  void start(double stretch);
  void begin_step(double t, double dt);
  // Nominal tension (kPa) at a trial stretch of this step.
  template <class T>
  T tension_kPa(const T& stretch) const {
    return tension_ + stiffness_ * (stretch - stretch_);
  }
  void accept_step(double stretch);
  // Another stretch between two beats; the rate is kept.
  void move_to(double stretch);

  bool is_active() const { return settings_.active; }
  double stretch() const { return stretch_; }  // at the start of the step
  double mu1_rest() const { return mu1_rest_; }

  void save(std::vector<double>& out) const;
  void restore(std::span<const double>& in);
  std::vector<WallOutput> outputs() const;
  void output_values(double* values) const;

 private:
  ActiveFibreSettings settings_;
  Rdq20Stepper force_;
  std::unique_ptr<CellSource> cell_;
  std::string place_;
  double mu1_rest_ = 0;

  // State.
  std::array<double, 20> bridges_{};
  double stretch_ = 1, stretch_before_ = 1;  // at the start of the step, and one step earlier
  double calcium_before_ = -1;               // at the start of the step; negative: not known yet
  // Of the current step.
  double tension_ = 0, stiffness_ = 0;  // kPa, rest tension removed
  double dt_ = 1;
  Rdq20::Regulation<double> regulation_{};  // implicit rate: to repeat the bridge step
  std::array<double, 4> moments_before_{};
};

}  // namespace wiggers
