// Where a wall's calcium comes from: an ionic cell that is paced, or a prescribed transient.
#pragma once

#include <algorithm>
#include <memory>
#include <string>
#include <vector>
#include <wiggers/cellmodels/catalogue/catalogue.hpp>
#include <wiggers/cellmodels/models/calcium.hpp>
#include <wiggers/circulation/elastance.hpp>
#include <wiggers/core/units.hpp>
#include <wiggers/heart/walls/wall.hpp>

namespace wiggers {

template <class T>
class CellSourceOf {
 public:
  virtual ~CellSourceOf() = default;
  // Advances from t to t + dt (s, within the beat).
  virtual void advance(const T& t, const T& dt) = 0;
  // Calcium that the force model sees (uM).
  virtual T calcium_uM() const = 0;
  // Membrane potential (mV), for the ECG surrogate; a prescribed transient has none.
  virtual bool has_potential() const = 0;
  virtual double potential_mV() const = 0;
  virtual void save(std::vector<T>& out) const = 0;
  virtual void restore(std::span<const T>& in) = 0;
};
using CellSource = CellSourceOf<double>;

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

  void advance(const double& t, const double& dt) override;
  const std::vector<double>& state() const { return state_; }  // at the grid point reached
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
  long n_on_, n_off_;         // steps during the pulse, and after it
  double h_on_, h_off_;       // their lengths (ms)
  std::vector<double> held_;  // invariants of the start; held at each stimulus, so that no drift accumulates
  long step_ = 0;             // grid steps done in this cycle
  double calcium_before_ = 0, potential_before_ = 0;  // one grid point earlier
  double calcium_mM_ = 0, potential_mV_ = 0;          // at the heart's time
};

// c0 + (c_peak - c0)/B (exp(-s/tau_decay) - exp(-s/tau_rise)), s the time since activation, B its peak.
template <class T>
struct CalciumShapeOf {
  T rest_uM = 0.05, peak_uM = 0.38, rise_ms = 20, decay_ms = 60;

  T at(const T& ms) const {
    const T q = rise_ms / decay_ms;
    // Maximum of exp(-s/decay) - exp(-s/rise).
    const T peak = pow(q, T(q / (1.0 - q))) - pow(q, T(1.0 / (1.0 - q)));
    return rest_uM + (peak_uM - rest_uM) / peak * (exp(T(-ms / decay_ms)) - exp(T(-ms / rise_ms)));
  }
};
using CalciumShape = CalciumShapeOf<double>;

template <class T>
class PrescribedCalciumOf final : public CellSourceOf<T> {
 public:
  using Shape = CalciumShapeOf<T>;
  PrescribedCalciumOf(Shape shape, T period_ms, T activation_ms)
      : shape_(shape), period_ms_(period_ms), activation_ms_(activation_ms), calcium_(shape.rest_uM) {}

  void advance(const T& t, const T& dt) override {
    calcium_ = shape_.at(wrapped(T((t + dt) * units::ms_per_s - activation_ms_), period_ms_));
  }
  T calcium_uM() const override { return calcium_; }
  bool has_potential() const override { return false; }
  double potential_mV() const override { return 0; }
  void save(std::vector<T>& out) const override { out.push_back(calcium_); }
  void restore(std::span<const T>& in) override { calcium_ = take_saved(in); }

 private:
  Shape shape_;
  T period_ms_, activation_ms_, calcium_;
};
using PrescribedCalcium = PrescribedCalciumOf<double>;

// The calcium of a cell on its limit cycle, as it was computed once: rows from stimulus onset over one
// period, cubics with continuous slopes between them (so that a time that moves across a row makes no kink).
// Nothing feeds back to the cell, so every wall and beat may share it.
template <class T>
struct CalciumCycle {
  std::vector<T> t_ms, calcium_uM;  // after rescaling
  T lowest_uM = 0;
};
template <class T>
class CyclicCalcium final : public CellSourceOf<T> {
 public:
  CyclicCalcium(std::shared_ptr<const CalciumCycle<T>> cycle, T period_ms, T activation_ms)
      : cycle_(std::move(cycle)), period_ms_(period_ms), activation_ms_(activation_ms) {}

  void advance(const T& t, const T& dt) override {
    const T when = wrapped(T((t + dt) * units::ms_per_s - activation_ms_), period_ms_);
    const auto& rows = cycle_->t_ms;
    const auto next = std::upper_bound(rows.begin(), rows.end(), when);
    if (next == rows.end()) {
      calcium_ = cycle_->calcium_uM.back();
      return;
    }
    const auto k = static_cast<std::size_t>(std::max<long>(1, next - rows.begin()));
    const auto& y = cycle_->calcium_uM;
    const T h = rows[k] - rows[k - 1], s = (when - rows[k - 1]) / h;
    const T left = h * slope_at(k - 1), right = h * slope_at(k), rise = y[k] - y[k - 1];
    calcium_ =
        y[k - 1] + s * (left + s * (3.0 * rise - 2.0 * left - right + s * (left + right - 2.0 * rise)));
  }
  T calcium_uM() const override { return calcium_; }
  bool has_potential() const override { return false; }
  double potential_mV() const override { return 0; }
  void save(std::vector<T>& out) const override { out.push_back(calcium_); }
  void restore(std::span<const T>& in) override { calcium_ = take_saved(in); }

 private:
  // Of the parabola through a row and its neighbours; at the ends of the straight line.
  T slope_at(std::size_t k) const {
    const auto &t = cycle_->t_ms, &y = cycle_->calcium_uM;
    if (k == 0) return (y[1] - y[0]) / (t[1] - t[0]);
    if (k + 1 == t.size()) return (y[k] - y[k - 1]) / (t[k] - t[k - 1]);
    const T left = t[k] - t[k - 1], right = t[k + 1] - t[k];
    return ((y[k] - y[k - 1]) / left * right + (y[k + 1] - y[k]) / right * left) / (left + right);
  }

  std::shared_ptr<const CalciumCycle<T>> cycle_;
  T period_ms_, activation_ms_, calcium_ = 0.0;
};

}  // namespace wiggers
