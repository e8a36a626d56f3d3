// What no cell can be: bounds on a beat's potential and concentrations (facts::living), narrower than what
// integrators may pass through, that a beat must keep to before anything about it is called good. The
// equations know no such bounds: they go on with a cytosol full of calcium.
#pragma once

#include <limits>
#include <string>
#include <vector>
#include <wiggers/cellmodels/catalogue/catalogue.hpp>
#include <wiggers/core/limit_cycle.hpp>

namespace wiggers {

// Watches a beat row by row.
class CellSense {
 public:
  explicit CellSense(const CellModel& model);
  void see(double t_ms, const double* y);
  // Why no cell can be in this beat, a sentence with what to look at; empty: one can.
  std::string finding() const;

 private:
  struct Watched {
    int state;
    Quantity bounds;
    double factor;  // from the state's unit to that of the bounds
  };
  const CellModel& model_;
  std::vector<Watched> watched_;
  double calcium_low_ = std::numeric_limits<double>::infinity(), rows_end_ms_ = 0;
  int found_ = -1;
  double excess_ = 0;
  std::string finding_;
};

// Refuses values of a model's invariants, naming `place`, that are not the wanted ones; the charge only if it
// counts.
void require_invariants(const CellModel& model, const std::vector<double>& found,
                        const std::vector<double>& wanted, bool charge_too, const std::string& place);

// Refuses a saved state, naming `place`, that this model with these parameters never leaves on a cycle: one
// outside its states' ranges (integrators overshoot them by a little), or of other invariants than the
// published state's, the charge `charge_offset_mV` above it.
void require_saved_state(const CellModel& model, const std::vector<double>& parameters,
                         double charge_offset_mV, const std::vector<double>& state, const std::string& place);

// The certificate of a cycle of one or several beats whose finding is not empty becomes "unphysical".
void judge_cell(LimitCycleCertificate& certificate, const std::string& finding);

}  // namespace wiggers
