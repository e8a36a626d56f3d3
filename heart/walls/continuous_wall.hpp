// A wall of one cavity as equations in continuous time, for the heart as one system (run/monolithic.hpp).
// Volumes mL, pressures mmHg, tensions kPa, times s.
#pragma once

#include <vector>

namespace wiggers {

class ContinuousWall {
 public:
  virtual ~ContinuousWall() = default;
  // Pressure at a volume, its rate, and the tension of the wall's fibre above rest (0 without one).
  virtual double pressure(double t, double volume, double volume_rate, double tension) const = 0;
  // Whether the rate matters.
  virtual bool damped() const { return false; }
  // Stretch of the fibre and its derivative by the volume (null: not asked for).
  virtual double stretch(double volume, double* slope) const {
    (void)volume;
    if (slope) *slope = 0;
    return 1;
  }
  // Times within a beat at which the pressure has a kink.
  virtual std::vector<double> kinks() const { return {}; }
};

}  // namespace wiggers
