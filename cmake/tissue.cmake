# The 3D tissue stands on deal.II, PETSc, MPI and gmsh. Where they are missing, everything else is built.
set(WIGGERS_TISSUE_FOUND OFF)
if(WIGGERS_COMMAND AND NOT WIGGERS_TISSUE STREQUAL "OFF")
  find_package(deal.II 9.4 QUIET)
  find_library(WIGGERS_GMSH gmsh)
  if(deal.II_FOUND AND DEAL_II_WITH_PETSC AND DEAL_II_WITH_MPI AND WIGGERS_GMSH)
    set(WIGGERS_TISSUE_FOUND ON)
    # Debian's deal.II links the Open MPI flavour of HDF5, and one process must hold one HDF5: ours is the same.
    set(HDF5_PREFER_PARALLEL ON)
    find_package(MPI REQUIRED COMPONENTS C CXX)
    include(${DEAL_II_TARGET_CONFIG})  # the imported target
  elseif(WIGGERS_TISSUE STREQUAL "ON")
    message(FATAL_ERROR "WIGGERS_TISSUE=ON needs deal.II 9.4 with PETSc and MPI, and libgmsh: "
                        "apt-get install libdeal.ii-dev libgmsh-dev, or configure with WIGGERS_TISSUE=OFF")
  endif()
endif()
set(WIGGERS_HAS_TISSUE ${WIGGERS_TISSUE_FOUND} CACHE INTERNAL "whether this build has the 3D tissue")

macro(wiggers_tissue_room)
  # deal.II's target names no folder of headers: the package's configuration adds those of the machine it is used on.
  wiggers_room(tissue USES wiggers::heart Eigen3::Eigen MPI::MPI_CXX ${DEAL_II_TARGET_RELEASE}
               $<BUILD_INTERFACE:${WIGGERS_GMSH}> $<INSTALL_INTERFACE:wiggers::gmsh>)
  target_include_directories(wiggers_tissue SYSTEM PUBLIC "$<BUILD_INTERFACE:${DEAL_II_INCLUDE_DIRS}>")
endmacro()
