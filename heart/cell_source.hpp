// Where a wall's calcium comes from: an ionic cell that is paced, or a prescribed transient.
#pragma once

#include <memory>
#include <string>
#include <vector>
#include <wiggers/cellmodels/calcium.hpp>
#include <wiggers/cellmodels/catalogue.hpp>
#include <wiggers/heart/wall.hpp>

namespace wiggers {

class CellSource {
 public:
  virtual ~CellSource() = default;
  // Advances from t to t + dt (s, within the beat).
  virtual void advance(double t, double dt) = 0;
  // Calcium that the force model sees (uM).
  virtual double calcium_uM() const = 0;
  // Membrane potential (mV), for the ECG surrogate; a prescribed transient has none.
  virtual bool has_potential() const = 0;
  virtual double potential_mV() const = 0;
  virtual void save(std::vector<double>& out) const = 0;
  virtual void restore(std::span<const double>& in) = 0;
};

// An ionic cell: sub-stepped under the heart's step, stimulated once a beat at its activation time.
//
// It keeps its own grid of time, from stimulus onset to the end of the period, the same on which its limit
// cycle was found: the pulse and the rest of the period are each divided evenly. Where the heart's step ends
// between two points of the grid, calcium and potential are interpolated.
class IonicCellSource final : public CellSource {
 public:
  struct Pacing {
    double period_ms = 800;
    double activation_ms = 0;
    StimulusPulse stimulus{-25.71, 3, 0};
    std::string integrator = "rush-larsen";
    double substep_ms = 0.05;
  };
  // `state_at_onset`: the state at stimulus onset; the cell is brought to phase (-activation) of its beat.
  IonicCellSource(const CellModel& model, std::vector<double> parameters, std::vector<double> state_at_onset,
                  Pacing pacing, CalciumRescaling rescaling);

  void advance(double t, double dt) override;
  double calcium_uM() const override;
  bool has_potential() const override { return true; }
  double potential_mV() const override { return potential_mV_; }
  void save(std::vector<double>& out) const override;
  void restore(std::span<const double>& in) override;

 private:
  double grid_time(long step) const;  // ms since stimulus onset
  void advance_to(double local_ms);   // to the first grid point not before
  void read_out(double local_ms);     // calcium and potential at a time up to the grid point reached

  const CellModel& model_;
  std::vector<double> parameters_;
  std::vector<double> state_;
  Pacing pacing_;
  CalciumRescaling rescaling_;
  std::unique_ptr<CellStepper> stepper_;
  long n_on_, n_off_;    // steps during the pulse, and after it
  double h_on_, h_off_;  // their lengths (ms)
  double charge_ = 0;    // of the start; held at each stimulus, so that a scheme's drift cannot accumulate
  long step_ = 0;        // grid steps done in this cycle
  double calcium_before_ = 0, potential_before_ = 0;  // one grid point earlier
  double calcium_mM_ = 0, potential_mV_ = 0;          // at the heart's time
};

// c0 + (c_peak - c0)/B (exp(-s/tau_decay) - exp(-s/tau_rise)), s the time since activation, B its peak.
class PrescribedCalcium final : public CellSource {
 public:
  struct Shape {
    double rest_uM = 0.05, peak_uM = 0.38, rise_ms = 20, decay_ms = 60;
  };
  PrescribedCalcium(Shape shape, double period_ms, double activation_ms);

  void advance(double t, double dt) override;
  double calcium_uM() const override { return calcium_; }
  bool has_potential() const override { return false; }
  double potential_mV() const override { return 0; }
  void save(std::vector<double>& out) const override { out.push_back(calcium_); }
  void restore(std::span<const double>& in) override { calcium_ = take_saved(in); }

 private:
  double at(double local_ms) const;

  Shape shape_;
  double period_ms_, activation_ms_, calcium_;
};

}  // namespace wiggers
