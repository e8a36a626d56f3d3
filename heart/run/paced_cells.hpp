// The cells of a scene, each brought to its own limit cycle before they drive anything.
#pragma once

#include <map>
#include <string>
#include <vector>
#include <wiggers/core/progress.hpp>
#include <wiggers/heart/scene/scene.hpp>

namespace wiggers {

// What is known of a cell type once it has been paced.
struct PacedCellType {
  std::vector<double> state_at_onset;
  LimitCycleCertificate certificate;  // verdict running: started from the published state
  double calcium_min_uM = 0;          // of one beat, after rescaling
  double calcium_max_uM = 0;
  double calcium_max_where_chosen_uM = 0;  // at the period for which the factor was chosen; 0: it is this one
  double charge_drift_mV = 0;              // of the scheme in one beat
  double potential_max_mV = 0;             // highest membrane potential of that beat
};

// All cells of the scene, by name. Throws NumericalFailure when one does not reach its limit cycle.
std::map<std::string, PacedCellType> pace_cells(const Scene& scene, Progress::Style style);

// Throws NumericalFailure, with what the cell does instead, unless it repeats itself every beat: a heart
// whose cells do not has no beat to be certified.
void require_one_beat_cycle(const LimitCycleCertificate& certificate, const std::string& name,
                            const CellModel& model, double period_s);

}  // namespace wiggers
