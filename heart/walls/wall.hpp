// The seam: a wall encloses one to four cavities and answers the same few questions, whatever it is made of.
//
// Order of calls in a step t -> t + dt, by the driver:
//
//   set_arterial_pressures()   those of the great arteries, for walls that carry them
//   begin_step(t, dt)          electrophysiology and active force, which do not depend on the pressure
//   repeat: linearise(p, V, C) volumes after the wall's own Newton correction at pressures p, and dV/dp
//           admissible_share(dp)   of the correction that the wall can follow; the least of all walls counts
//           update(dp, share)  take that share of the correction
//   confirm_step()             may still refuse what Newton found
//   accept_step()              keep it      (or reject_step(): back to the state before begin_step)
//
// save() and restore() carry everything the future depends on. Volumes mL, pressures mmHg, times s.
#pragma once

#include <cmath>
#include <map>
#include <span>
#include <string>
#include <string_view>
#include <vector>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/quantity.hpp>

namespace wiggers {

// A value a wall can show for traces and reports.
struct WallOutput {
  std::string name;  // without the wall's name, e.g. "active_tension"
  std::string unit;
  std::string meaning;
  // Outside these no heart can be; what a beat shows there is never called good.
  double lower = -unbounded, upper = unbounded;
};
// Fibre stretch: sarcomeres of 0.9 to 4 um, beyond which no filaments overlap.
inline constexpr double smallest_stretch = 0.4, largest_stretch = 1.8;

// A number that a wall reports of its work: costs, sizes, extremes.
struct WallFigure {
  double value = 0;
  std::string unit, meaning;
};

// Numbers are plain, or dual to carry sensitivities.
template <class T>
class WallOf {
 public:
  virtual ~WallOf() = default;

  // The cavities (indexes of chambers) in the order of all arrays below.
  virtual std::span<const int> cavities() const = 0;

  // Sets the starting volumes and whatever else a first step needs; returns a first guess of the pressures.
  virtual void start(const T& t, const T* volumes, T* pressures) = 0;

  // For walls that also carry the pressure of the great arteries: mmHg, before start(), move_to() and each
  // begin_step().
  virtual void set_arterial_pressures(const double* systemic_and_pulmonary_mmHg) {
    (void)systemic_and_pulmonary_mmHg;
  }

  virtual void begin_step(const T& t, const T& dt) = 0;
  // dV_dp is n x n, row-major.
  virtual void linearise(const T* pressures, T* volumes, double* dV_dp) = 0;
  // How much of Newton's correction the wall can follow, from 0 to 1.
  virtual double admissible_share(const T* pressure_change) {
    (void)pressure_change;
    return 1;
  }
  // The pressures change by this, which is already `share` of the whole correction.
  virtual void update(const T* pressure_change, double share) = 0;
  // Throws NumericalFailure if the balance that Newton found is beyond what the wall's models describe; the
  // step is then rejected.
  virtual void confirm_step() {}
  virtual void accept_step() = 0;
  virtual void reject_step() = 0;

  // For walls with many unknowns of their own. Whether those were balanced at the last linearise(); the
  // largest mismatch of volumes that Newton may leave; whether a step that failed may be tried again in
  // halves.
  virtual bool balanced() const { return true; }
  virtual double volume_tolerance_mL() const { return 0; }
  virtual bool may_halve_steps() const { return false; }
  // Of a Newton that does not converge: where it is worst, as a sentence; may be empty.
  virtual std::string trouble() const { return {}; }

  // Moves the wall to other volumes between two beats (limit-cycle acceleration), rates kept (3D tissue: at
  // rest).
  virtual void move_to(const T* volumes) = 0;

  virtual void save(std::vector<T>& out) const = 0;
  virtual void restore(std::span<const T>& in) = 0;

  virtual std::vector<WallOutput> outputs() const { return {}; }
  virtual void output_values(double* values) const { (void)values; }

  // Fields in space, for walls that have them: opened beside the result (resumed from a time, or anew with a
  // negative one), written when their time has come.
  virtual void open_fields(const std::string& folder, double resume_at_s) { (void)folder, (void)resume_at_s; }
  virtual void write_fields(double time_s) { (void)time_s; }
  // What the wall did and what it cost, by name.
  virtual void report(std::map<std::string, WallFigure>& figures) const { (void)figures; }
};
using Wall = WallOf<double>;

// Takes the next value off a saved state.
template <class T>
T take_saved(std::span<const T>& in) {
  if (in.empty()) throw InputError("the saved state is damaged: it ends early");
  const T value = in.front();
  in = in.subspan(1);
  return value;
}

// The same for a whole number from 0 to `most`.
inline long take_saved_count(std::span<const double>& in, long most) {
  const double value = take_saved(in);
  if (!(value >= 0 && value <= static_cast<double>(most) && value == std::floor(value)))
    throw InputError("the saved state is damaged: a count is none");
  return static_cast<long>(value);
}

}  // namespace wiggers
