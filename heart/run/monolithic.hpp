// The reduced heart as one system of equations: circulation, crossbridges and walls together, no staggering.
// The reference that the staggered driver is measured against.
//
// Unknowns: the circulation's, the force model's for every active wall, and the pressures. Calcium is
// that of each cell on its own limit cycle (nothing feeds back to it), as a smooth function of time. Where no
// wall is damped pressures are explicit in the volumes and CVODE integrates the rest; with wall viscosity or
// dashpots on the epicardium they depend on the volumes' rates, and IDA integrates the differential-algebraic
// system.
//
// The integrators stop at activation break points and, by root finding, where the pressure across a valve or
// the excess of tension over its rest value changes sign.
#pragma once

#include <functional>
#include <map>
#include <memory>
#include <string>
#include <vector>
#include <wiggers/core/limit_cycle.hpp>
#include <wiggers/core/table.hpp>
#include <wiggers/heart/scene/scene.hpp>

namespace wiggers {

struct MonolithicSettings {
  double relative_tolerance = 1e-8;
  bool as_dae = false;  // IDA even where CVODE would do
};

class MonolithicHeart {
 public:
  // Whether a wall is a plain ODE that this knows.
  static bool has_equations(const WallPlan& wall);

  // Brings the scene's cells to their limit cycles. Refuses walls it has no equations for.
  MonolithicHeart(const Scene& scene, MonolithicSettings settings);
  ~MonolithicHeart();

  // The limit cycle of the coupled system on the leaf of the scene's blood volume.
  LimitCycleCertificate to_limit_cycle(double distance = 1e-6);

  // One beat from the current state; rows every sample_s. Columns as of a 0D loop.
  Table beat(double sample_s);

  bool uses_ida() const;

 private:
  struct Implementation;
  std::unique_ptr<Implementation> implementation_;
};

}  // namespace wiggers
