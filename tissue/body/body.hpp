// A body of tissue as its plan says: mesh, fibres, what is excitable, what it is made of and held by, its
// unloaded shape. For walls in the closed loop and for bodies alone.
#pragma once

#include <map>
#include <memory>
#include <string>
#include <vector>
#include <wiggers/core/progress.hpp>
#include <wiggers/heart/run/paced_cells.hpp>
#include <wiggers/tissue/body/plan.hpp>
#include <wiggers/tissue/body/reference_configuration.hpp>

namespace wiggers {

// The mesh a plan names, made or read by one rank, checked, on all ranks. Collective.
std::shared_ptr<const TetMesh> make_mesh(const TissuePlan& plan, const std::vector<int>& chambers,
                                         const std::string& place, MPI_Comm communicator);

// Puts stimuli that are named by anatomy where their sites are on the mesh.
void place_stimuli(TissuePlan& plan, const TetMesh& mesh, const std::string& place, MPI_Comm communicator);

// Surface tag of a chamber's endocardium.
int endocardium_of(int chamber);

FibreField make_fibres(const TissuePlan& plan, const TetMesh& mesh);

// Says, on the first rank, where linear tetrahedra will lock.
void say_of_locking(const TissuePlan& plan, const std::string& place, MPI_Comm communicator);
// Says, on the first rank, where a file's fibres turn too far between cells to be resolved.
void say_of_fibres(const TissuePlan& plan, const TetMesh& mesh, const FibreField& fibres,
                   const std::string& place, MPI_Comm communicator);

// What is excitable, with the state that the cells have at the beat's start; `place` for messages. Refuses
// cells without an ionic model and those whose tissue the mesh does not have. Cells that were not paced (a
// run that is resumed) begin in their published state.
std::vector<IonicRegion> ionic_regions(const Scene& scene, const WallPlan& wall, const TetMesh& mesh,
                                       const std::map<std::string, PacedCellType>& cells,
                                       const std::string& place);

// Arteries whose inner surface the mesh has, indexes of `arteries`.
std::vector<int> arteries_of(const TetMesh& mesh);

// The plan's mechanics with its surfaces under pressure: endocardia of the chambers, then arteries_of(mesh).
// Materials and supports that the plan only might need and the mesh does not have are left out.
MechanicsSettings mechanics_of(const TissuePlan& plan, const std::vector<int>& chambers, const TetMesh& mesh);

// The linear solver that the plan names, or the one that suits the body: complete factors for quadratic
// tetrahedra, which incomplete ones do not solve; multigrid where a good part of the body is stiff beside its
// muscle (valves, arteries), where incomplete factors fail; incomplete factors else.
SolverKind solver_of(const TissuePlan& plan, const TetMesh& mesh);

// The unloaded points of a mesh that was imaged under the plan's pressures; the mesh itself if the plan wants
// no recovery. Collective.
std::shared_ptr<const TetMesh> unloaded_shape(const TissuePlan& plan, const std::vector<int>& chambers,
                                              const std::shared_ptr<const TetMesh>& image,
                                              const std::string& place, Progress::Style style,
                                              MPI_Comm communicator, RecoveryReport& report);

}  // namespace wiggers
