// Runs of a body of tissue alone: its electrophysiology on the undeformed mesh, or its mechanics without
// cells, at rest under loads that are prescribed. Nothing of the other physics is built.
//
// Results are written as those of the heart: whole at any moment, resumed from on any number of ranks.
#pragma once

#include <wiggers/heart/scene/tissue_services.hpp>
#include <wiggers/tissue/body/plan.hpp>

namespace wiggers {

// Rows every run.rows_every_ms up to run.end_ms; the period repeats the stimuli. Datasets /time and
// /body/{activated_share, membrane_potential, calcium, lead_k}, and /body/activation: when each vertex of the
// mesh was activated in the present beat.
BodyOutcome run_body_electrophysiology(const Scene& scene, const BodyRequest& request, MPI_Comm communicator);

// Equilibria at equal shares of the load. Datasets /load (the share), /cavities/X/{pressure, volume} and
// /body/{stretch, myocardium_volume_ratio, smallest_volume_ratio}.
BodyOutcome run_body_mechanics(const Scene& scene, const BodyRequest& request, MPI_Comm communicator);

}  // namespace wiggers
