// The same mesh on all ranks: one reads or makes it, all get it.
#pragma once

#include <mpi.h>

#include <wiggers/tissue/mesh/mesh.hpp>

namespace wiggers {

// From rank 0 to all. Collective.
void broadcast_mesh(TetMesh& mesh, MPI_Comm communicator);

}  // namespace wiggers
