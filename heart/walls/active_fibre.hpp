// The active stress of one piece of wall in a staggered step: cell -> calcium -> force model -> tension and
// stiffness. Shared by every reduced kind of wall that is driven by cells; how the force model steps is
// cellmodels/schemes/force_step.hpp, for these walls and for tissue.
#pragma once

#include <memory>
#include <string>
#include <wiggers/cellmodels/catalogue/force_stepper.hpp>
#include <wiggers/heart/walls/cell_source.hpp>
#include <wiggers/heart/walls/wall.hpp>

namespace wiggers {

struct ActiveFibreSettings {
  bool active = true;                 // false: no active stress at all
  bool subtract_rest_tension = true;  // T_eff = max(0, T - steady tension at rest_calcium)
  ForceScheme scheme = {RegulationScheme::forward_euler, 40, RateScheme::lagged};
  bool stabilise = true;  // the wall sees T + K (lambda - lambda^n); without, K is 0
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
  ActiveFibreOf(ActiveFibreSettings settings, const CellModel& force, const std::vector<T>& force_parameters,
                const T& rest_calcium_uM, std::unique_ptr<CellSourceOf<T>> cell, std::string place);

  void start(const T& stretch);
  void begin_step(const T& t, const T& dt);
  FibreLaw<T> law() const { return {settings_.active, forces_.tension_kPa, forces_.stiffness_kPa, stretch_}; }
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
  const CellModel& model_;
  std::unique_ptr<ForceStepperOf<T>> force_;
  std::unique_ptr<CellSourceOf<T>> cell_;
  std::string place_;
  std::vector<T> rest_;  // state whose tension is removed

  // State.
  std::vector<T> bridges_;
  T stretch_ = 1, stretch_before_ = 1;  // at the start of the step, and one step earlier
  T calcium_before_ = -1;               // at the start of the step; negative: not known yet
  // Of the current step.
  ForcesOf<T> forces_;         // kPa, rest tension removed
  T dt_ = 1, dt_before_ = -1;  // of this step and the one before it; negative: the same
};
using ActiveFibre = ActiveFibreOf<double>;

}  // namespace wiggers
