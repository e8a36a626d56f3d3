// The reduced heart as a function from parameters to indexes: the scene's numbers as one list, its indexes on
// the limit cycle, and their derivatives.
//
// Cells of a study are on their limit cycles (nothing feeds back to them), so their calcium is computed once
// and shared by beats and walls: a beat costs a third of the driver's that steps its cells. Ionic cells are
// solved by Rush-Larsen steps with the scene's sub-step.
#pragma once

#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>
#include <wiggers/cellmodels/pacing/cell_study.hpp>
#include <wiggers/core/sensitivity.hpp>
#include <wiggers/heart/coupling/driver.hpp>
#include <wiggers/heart/indexes/indexes.hpp>
#include <wiggers/heart/scene/scene.hpp>

namespace wiggers {

// A solved heart: enough to continue from, for the same scene or one with other numbers.
struct HeartState {
  std::vector<double> driver;  // of HeartDriver::save()
  LimitCycleCertificate certificate;
};

class HeartStudy {
 public:
  // Refuses what a study has no text for: 3D tissue, cells that start from their published state.
  explicit HeartStudy(Scene scene);

  // The same numbers; cells that are solved already stay so.
  HeartStudy copy() const;

  const Scene& scene() const { return scene_; }

  // Called between beats of cells on their way to their cycles; may throw to stop.
  void set_between_beats(std::function<void(const LimitCycleCertificate&)> call) {
    between_beats_ = std::move(call);
  }

  // Every number of the scene that the indexes depend on, by its key: "walls.LV.a_XB_kPa",
  // "cells.atria.ionic_changes.g_CaL", "circulation.circuit.SYS.R_AR", "circulation.initial.total_volume".
  // The blood volume is held when others change.
  std::vector<NamedParameter> parameters() const;
  // All of parameters() at once, checked as a scene file is.
  void set_parameters(std::span<const double> values);
  void set_parameter(std::string_view name, double value);

  // The limit cycle, from the scene's initial state or from a state nearby.
  HeartState to_limit_cycle(const LimitCycleSettings& settings, const HeartState* near,
                            const std::function<void(const LimitCycleCertificate&)>& after_beat = {});
  // Derivatives of the beat map by the state alone, and the state brought onto the cycle to rounding by
  // Newton with them; those of a neighbouring cycle do.
  FixedPointDerivatives newton_at(const HeartState& state);
  HeartState refined(const HeartState& state, const FixedPointDerivatives& derivatives);

  BeatIndexes indexes(const HeartState& state);
  // What stands beside the verdict of a cycle (rate_warnings.hpp).
  std::vector<std::string> warnings(const HeartState& on_cycle);
  // One beat as a table, columns as of a driver's trace; `state` becomes that at its end.
  Table beat(HeartState& state);

  // Derivatives of every index on the cycle by the named parameters (empty: all).
  Sensitivities sensitivities(const HeartState& on_cycle, const std::vector<std::string>& wanted = {},
                              const std::function<void(double)>& after_pass = {});

  // Refuses a state of another number of values.
  void check_size(const HeartState& state);

 private:
  template <class T>
  struct Numbers;
  template <class T>
  using CalciumOf = std::map<std::string, std::shared_ptr<const CalciumCycle<T>>>;
  // Cells of one type on their limit cycle.
  struct SolvedCell {
    CellStudy study;
    std::vector<double> state;
    CalciumCycle<double> raw;  // rows of one beat, before rescaling (uM)
    // [row][parameter of the study]; empty until asked for
    std::vector<double> calcium_derivatives, time_derivatives;
  };

  template <class T>
  Numbers<T> numbers() const;
  template <class AnyNumbers, class Visit>
  void for_each_number(AnyNumbers& numbers, Visit visit) const;
  template <class T>
  std::unique_ptr<HeartDriverOf<T>> build(const Numbers<T>& numbers, const CalciumOf<T>& calcium) const;
  void divide_period(double period_s, std::vector<std::pair<std::string, double>>& changes) const;
  void solve_cells();
  void differentiate(SolvedCell& cell) const;
  template <class T>
  CalciumOf<T> calcium(const Numbers<T>& numbers);
  HeartDriver& driver();
  FixedPointDerivatives cycle_derivatives(const std::vector<double>& state,
                                          const std::vector<std::size_t>& active,
                                          const std::function<void(double)>& after_pass);
  std::unique_ptr<HeartDriverOf<Tangent>> moving_heart(const std::vector<std::size_t>& active,
                                                       const std::vector<Tangent>& parameter, Tangent& volume,
                                                       AtrialActivationsOf<Tangent>& atria);

  Scene scene_;
  struct {
    double a_period, dt_s, substep_us;
  } steps_;  // of the scene as it was given: other periods are divided as it was
  std::map<std::string, SolvedCell> cells_;
  std::unique_ptr<HeartDriver> driver_;
  std::function<void(const LimitCycleCertificate&)> between_beats_;
};

}  // namespace wiggers
