# A room of the house: one folder, one library, one exported target wiggers::NAME, one component of the package.
# Headers stand beside their sources, in the sub-folder of what they are for; <wiggers/NAME/FOLDER/header.hpp> is the
# same inside and after installation. Programs (command/) are no part of a room's library.

file(MAKE_DIRECTORY ${CMAKE_BINARY_DIR}/include/wiggers)
set(WIGGERS_ROOMS "")  # those that are built, each after the rooms that it uses

# wiggers_room(NAME USES LIBRARY... [EXCEPT SOURCE...])
function(wiggers_room name)
  cmake_parse_arguments(ARG "" "" "USES;EXCEPT" ${ARGN})
  file(GLOB_RECURSE sources CONFIGURE_DEPENDS ${CMAKE_SOURCE_DIR}/${name}/*.cpp)
  list(FILTER sources EXCLUDE REGEX "/${name}/command/")
  foreach(source ${ARG_EXCEPT})
    list(REMOVE_ITEM sources ${CMAKE_SOURCE_DIR}/${name}/${source})
  endforeach()
  file(CREATE_LINK ${CMAKE_SOURCE_DIR}/${name} ${CMAKE_BINARY_DIR}/include/wiggers/${name} SYMBOLIC)
  wiggers_library(${name} ${sources})
  target_link_libraries(wiggers_${name} PUBLIC ${ARG_USES})
  install(TARGETS wiggers_${name} EXPORT wiggers-${name}-targets ARCHIVE DESTINATION ${CMAKE_INSTALL_LIBDIR})
  install(DIRECTORY ${CMAKE_SOURCE_DIR}/${name} DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}/wiggers
          FILES_MATCHING PATTERN "*.hpp" PATTERN command EXCLUDE PATTERN report EXCLUDE)
  set(WIGGERS_ROOMS ${WIGGERS_ROOMS} ${name} PARENT_SCOPE)
endfunction()

# wiggers_library(NAME SOURCE...): a static library wiggers::NAME of our own sources.
function(wiggers_library name)
  add_library(wiggers_${name} STATIC ${ARGN})
  add_library(wiggers::${name} ALIAS wiggers_${name})
  set_target_properties(wiggers_${name} PROPERTIES EXPORT_NAME ${name} POSITION_INDEPENDENT_CODE ON)
  target_include_directories(wiggers_${name} PUBLIC
    $<BUILD_INTERFACE:${CMAKE_BINARY_DIR}/include> $<INSTALL_INTERFACE:${CMAKE_INSTALL_INCLUDEDIR}>)
  target_compile_features(wiggers_${name} PUBLIC cxx_std_20)
  wiggers_flags(wiggers_${name})
endfunction()

# Warnings are errors in our own builds; errno and trapping are not used, which lets loops vectorise. No
# -ffast-math: results must not depend on how a compiler reorders sums.
function(wiggers_flags target)
  target_compile_options(${target} PRIVATE -Wall -Wextra -Werror -fno-math-errno -fno-trapping-math)
  if(WIGGERS_SANITIZE)
    target_compile_options(${target} PUBLIC -fsanitize=address,undefined -fno-omit-frame-pointer)
    target_link_options(${target} PUBLIC -fsanitize=address,undefined)
  endif()
  if(WIGGERS_FUZZ)
    target_compile_options(${target} PUBLIC -fsanitize=fuzzer-no-link)
  endif()
endfunction()

function(wiggers_install)
  include(CMakePackageConfigHelpers)
  set(destination ${CMAKE_INSTALL_LIBDIR}/cmake/wiggers)
  foreach(room ${WIGGERS_ROOMS})
    install(EXPORT wiggers-${room}-targets NAMESPACE wiggers:: DESTINATION ${destination})
  endforeach()
  if(WIGGERS_COMMAND)
    get_filename_component(WIGGERS_HDF5_FOLDER ${WIGGERS_HDF5_LIBRARY} DIRECTORY)
    set(WIGGERS_HDF5_FLAVOUR hdf5_serial)
    if(WIGGERS_TISSUE_FOUND)
      set(WIGGERS_HDF5_FLAVOUR hdf5_openmpi)
    endif()
  endif()
  configure_package_config_file(${CMAKE_SOURCE_DIR}/cmake/wiggers-config.cmake.in
    ${CMAKE_BINARY_DIR}/wiggers-config.cmake INSTALL_DESTINATION ${destination})
  write_basic_package_version_file(${CMAKE_BINARY_DIR}/wiggers-config-version.cmake COMPATIBILITY SameMinorVersion)
  install(FILES ${CMAKE_BINARY_DIR}/wiggers-config.cmake ${CMAKE_BINARY_DIR}/wiggers-config-version.cmake
          DESTINATION ${destination})
endfunction()
