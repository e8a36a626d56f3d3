// Is the tissue of this build healthy? One exact problem through all that it stands on.
#pragma once

#include <string>

namespace wiggers {

// The affine patch test on a mesh of gmsh's: the inside of a body follows a boundary that is moved affinely,
// whatever the tetrahedra are. Goes through gmsh, deal.II's partition and PETSc's solver, in about a second,
// on this process alone. Returns what was found, for people; throws NumericalFailure where it is wrong.
std::string check_tissue();

}  // namespace wiggers
