// The unloaded shape of a body that was imaged under load.
//
// Given the loaded coordinates x~ and the pressures p~, find X with X + d(X; p~) = x~: the fixed point
// X <- X + (x~ - X - d(X)) with Anderson mixing, the load raised in steps (halved when an element turns
// inside out or the fixed point does not settle), the secant through the last two results as start. Without
// active tension. Fibres are computed anew on X by the caller.
#pragma once

#include <functional>
#include <memory>
#include <vector>
#include <wiggers/tissue/physics/equilibrium.hpp>

namespace wiggers {

struct RecoverySettings {
  // Largest change of a coordinate: what is aimed at, and what is good enough where a few soft elements do
  // not settle, as a share of the mesh's mean edge.
  double aim_m = 1e-6, good_enough = 5e-3;
  int patience = 4;         // iterations in which the change has not halved: it does not settle
  int max_iterations = 30;  // at each share of the load
  double first_step = 0.25, smallest_step = 1e-2;
};

struct RecoveryReport {
  int load_steps = 0, fixed_point_iterations = 0, newton_iterations = 0;
  double residual_m = 0;             // largest |X + d - x~| at the end
  double smallest_volume_ratio = 0;  // reference over image, of a tetrahedron
  double smallest_dihedral_deg = 0;
};

// Makes the mechanics of a body with these unloaded points (m).
using MakeMechanics = std::function<std::unique_ptr<Mechanics>(std::shared_ptr<const TetMesh>)>;

// Returns the mesh with the unloaded points. `pressures_Pa` of the mechanics' surfaces. Collective. Throws
// NumericalFailure when the smallest load step fails, with the load reached.
std::shared_ptr<const TetMesh> recover_reference(const std::shared_ptr<const TetMesh>& image,
                                                 const std::vector<double>& pressures_Pa,
                                                 const MakeMechanics& make, const RecoverySettings& settings,
                                                 RecoveryReport& report,
                                                 const std::function<void(double share)>& on_step = {});

}  // namespace wiggers
