# Result files are all of core that needs HDF5. They are a library of their own, installed with the heart, so that
# cells and circulation can be embedded where there is no HDF5, or another one.
find_package(HDF5 REQUIRED COMPONENTS C)
wiggers_library(result_files ${CMAKE_SOURCE_DIR}/core/result_file.cpp)
# Installed, the library is named by the package's own configuration: CMake's module wants the language C.
target_link_libraries(wiggers_result_files PUBLIC wiggers::core
                      PRIVATE $<BUILD_INTERFACE:hdf5::hdf5> $<INSTALL_INTERFACE:wiggers::hdf5>)
if(WIGGERS_TISSUE_FOUND)
  target_link_libraries(wiggers_result_files PRIVATE $<BUILD_INTERFACE:MPI::MPI_C>)  # this flavour of HDF5 includes mpi.h
endif()
list(GET HDF5_C_LIBRARIES 0 WIGGERS_HDF5_LIBRARY)
