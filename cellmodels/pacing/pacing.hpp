// One paced cell: beats, sampled traces, limit cycles; with any adaptive or fixed-step integrator.
#pragma once

#include <functional>
#include <optional>
#include <string>
#include <vector>
#include <wiggers/cellmodels/catalogue/catalogue.hpp>
#include <wiggers/core/limit_cycle_solve.hpp>

namespace wiggers {

struct CellIntegrator {
  std::string name = "cvode";         // an adaptive or a fixed-step integrator of the catalogue
  double relative_tolerance = 1e-8;   // adaptive
  double absolute_tolerance = 1e-10;  // adaptive; of a state of size one, see CellModel::absolute_tolerances
  double dt_ms = 0.02;                // fixed steps: the largest step; spans between edges are divided evenly

  static constexpr double tightest_tolerance = 1e-12;
  void tighten(
      double relative);  // to this relative tolerance, if it is looser, as far as double precision allows
};

struct PacingProtocol {
  double period_ms = 1000;
  StimulusPulse stimulus;
};

// Refuses impossible protocols: a period that is not longer than the pulse, steps of no use, ...
void check_protocol(const CellModel& model, const PacingProtocol& protocol, const CellIntegrator& integrator);

// Rows of a beat for its features (beat_features.hpp).
struct BeatRows {
  std::vector<double> t_ms, potential_mV, calcium_mM;
  std::vector<double> stimulus_edges_ms;
};

class PacedCell {
 public:
  PacedCell(const CellModel& model, std::vector<double> parameters, PacingProtocol protocol,
            CellIntegrator integrator);

  // Called at t = 0, sample_ms, ... and at the end of the beat: (time in the beat [ms], state, stimulus).
  using Sampler = std::function<void(double, const double*, double)>;

  // Advances `state` by one period. Throws NumericalFailure naming time and state if a state leaves its
  // range.
  void beat(std::vector<double>& state, double sample_ms = 0, const Sampler& sampler = {});

  // The same at given times; the end of the beat is added.
  void beat_at(std::vector<double>& state, const std::vector<double>& times, const Sampler& sampler);

  // Rows of the beat from a state, from the integrator's dense output and as close together as the features
  // need, whatever the spacing of anybody's output.
  BeatRows feature_rows(std::vector<double> state);

  // Scales of the limit cycle's distance: |x0| + 1e-3, membrane potential 10 mV.
  std::vector<double> scales(const std::vector<double>& start) const;

  // Paces to the limit cycle on the leaf of the start's conserved charge. `state` ends on it. The callback is
  // called after every beat. Refuses a model whose charge is not conserved: it has no cycle. An adaptive
  // integrator is tightened for the search as far as the distance asked for needs it.
  LimitCycleCertificate to_limit_cycle(
      std::vector<double>& state, LimitCycleSettings settings,
      const std::function<void(const LimitCycleCertificate&)>& after_beat = {});

  // The search's frame from a start: scales, positive components and what keeps proposals on the start's
  // leaf; its beat is for the caller to fill in. Refers to this cell.
  BeatMap beat_map(const std::vector<double>& start) const;

  // Throws NumericalFailure naming a state that left its range, and t.
  void check_range(double t, const double* state) const;

  // Work of an adaptive integrator so far.
  AdaptiveCounts counts() const { return adaptive_ ? adaptive_->counts() : AdaptiveCounts{}; }

  // How far the cycle itself moves, in scaled units, if the step is halved (adaptive: the tolerance divided
  // by ten, or by more for a slow cell whose distance could not be told from noise): the finer integrator is
  // brought to its own cycle from this one, to a distance of 1e-5. Nothing if it finds none.
  std::optional<double> integrator_shift(const std::vector<double>& on_cycle,
                                         const std::function<void()>& between_beats = {}) const;

  // Drift of the charge over the last beat, before it was held (mV).
  double charge_drift() const { return charge_drift_; }

  const CellModel& model() const { return model_; }
  const std::vector<double>& parameters() const { return parameters_; }

 private:
  LimitCycleCertificate search(std::vector<double>& state, LimitCycleSettings settings,
                               const std::function<void(const LimitCycleCertificate&)>& after_beat,
                               PacedCell* coarse = nullptr);

  const CellModel& model_;
  std::vector<double> parameters_;
  PacingProtocol protocol_;
  CellIntegrator integrator_;
  std::unique_ptr<AdaptiveIntegrator> adaptive_;
  double charge_drift_ = 0;
  double multiplier_ = 0;  // of the cycle found last
};

// Refuses parameters with which a model loses or gains charge every beat: it has no cycle.
void require_limit_cycle(const CellModel& model, const std::vector<double>& parameters);

// Brings a proposed state back to where it has a meaning: gates to [0, 1], concentrations positive.
void make_admissible(const CellModel& model, std::vector<double>& state);

}  // namespace wiggers
