// A paced cell as a function from parameters to indexes: its parameters as one list, its indexes on the limit
// cycle, and their derivatives.
#pragma once

#include <functional>
#include <span>
#include <string>
#include <vector>
#include <wiggers/cellmodels/pacing/pacing.hpp>
#include <wiggers/core/sensitivity.hpp>

namespace wiggers {

struct CellStudy {
  const CellModel* model = nullptr;
  std::vector<double> parameters;
  PacingProtocol protocol;
  double dt_ms = 0.02;
  std::string integrator = "rush-larsen-2";  // or rush-larsen
  double charge_offset_mV = 0;               // added to the charge of the published state
};

// The study with a model's defaults (its set `set`) at a period.
CellStudy make_cell_study(const CellModel& model, std::string_view set = "default");

// The model's parameters; period_ms, stimulus_A_per_F, stimulus_ms; charge_offset_mV, which chooses the leaf:
// the cycle keeps the charge of the published state plus this.
std::vector<NamedParameter> cell_study_parameters(const CellStudy& study);
void set_cell_study_parameters(CellStudy& study, std::span<const double> values);
void set_cell_study_parameter(CellStudy& study, std::string_view name, double value);

// Refuses an integrator or a step that the study has no text for.
void check_study(const CellStudy& study);

// The published state on the study's leaf: where a search starts.
std::vector<double> start_of(const CellStudy& study);
// Moves the balancing ion of any state to the study's leaf.
void hold_charge(const CellStudy& study, std::vector<double>& state);
LimitCycleCertificate to_limit_cycle(
    const CellStudy& study, std::vector<double>& state, LimitCycleSettings settings,
    const std::function<void(const LimitCycleCertificate&)>& after_beat = {});

// The beat map's exact derivatives by the state, and a state near the cycle brought onto it, to rounding, by
// Newton with them; those of a neighbouring cycle do.
FixedPointDerivatives newton_at(const CellStudy& study, std::vector<double> state);
std::vector<double> refined_limit_cycle(const CellStudy& study, std::vector<double> state,
                                        const FixedPointDerivatives& newton);

// Why no cell can be in the beats (so many) from a state; empty: one can.
std::string unphysical_beats(const CellStudy& study, std::vector<double> state, int beats);

struct NamedValue {
  std::string name, unit;
  double value = 0;
};
// Indexes of the beat from a state: APD90_ms, APD50_ms, V_rest_mV, V_peak_mV, V_min_mV, dVdt_max_mV_per_ms,
// calcium_diastolic_uM, calcium_peak_uM, calcium_amplitude_uM, calcium_time_to_peak_ms, and the state at the
// beat's start ("start.Na_i"). What a beat does not have (no action potential) is absent.
// `words`, if given, gets what there is to say of the beat.
struct BeatWords {
  std::string no_action_potential, unphysical;  // why; empty: it is one, a cell can be in it
};
std::vector<NamedValue> cell_indexes(const CellStudy& study, const std::vector<double>& start,
                                     BeatWords* words = nullptr);

// Derivatives of every index on the limit cycle by every parameter but the share of the stimulus that its ion
// carries, which must be 1 for a cycle to exist. after_pass(share done) may throw to stop.
Sensitivities cell_sensitivities(const CellStudy& study, const std::vector<double>& on_cycle,
                                 const std::function<void(double)>& after_pass = {});

// Rows of the beat from a state.
struct PacedRows {
  std::vector<double> t_ms, calcium_mM, potential_mV;
};
PacedRows paced_rows(const CellStudy& study, const std::vector<double>& start);

// Calcium (mM) and potential (mV) of the beat on the cycle, with derivatives by the directions
// [first, first + tangent_lanes) of the study's parameters (the list above, nothing left out).
struct PacedTrace {
  std::vector<Tangent> t_ms, calcium_mM, potential_mV;
};
class PacedTangents {
 public:
  PacedTangents(const CellStudy& study, std::vector<double> on_cycle);
  PacedTrace trace(int first) const;

 private:
  CellStudy study_;
  std::vector<double> state_;
  Eigen::MatrixXd moves_;
};

}  // namespace wiggers
