# A room of the house: one folder, one library, one exported target wiggers::NAME.
# Headers stand beside their sources; <wiggers/NAME/header.hpp> is the same inside and after installation.

file(MAKE_DIRECTORY ${CMAKE_BINARY_DIR}/include/wiggers)
set(WIGGERS_ROOMS "")

function(wiggers_room name)
  cmake_parse_arguments(ARG "" "" "USES" ${ARGN})
  file(GLOB sources CONFIGURE_DEPENDS ${CMAKE_SOURCE_DIR}/${name}/*.cpp)
  file(GLOB headers CONFIGURE_DEPENDS ${CMAKE_SOURCE_DIR}/${name}/*.hpp)
  file(CREATE_LINK ${CMAKE_SOURCE_DIR}/${name} ${CMAKE_BINARY_DIR}/include/wiggers/${name} SYMBOLIC)
  add_library(wiggers_${name} STATIC ${sources})
  add_library(wiggers::${name} ALIAS wiggers_${name})
  set_target_properties(wiggers_${name} PROPERTIES EXPORT_NAME ${name} POSITION_INDEPENDENT_CODE ON)
  target_include_directories(wiggers_${name} PUBLIC
    $<BUILD_INTERFACE:${CMAKE_BINARY_DIR}/include> $<INSTALL_INTERFACE:${CMAKE_INSTALL_INCLUDEDIR}>)
  target_compile_features(wiggers_${name} PUBLIC cxx_std_20)
  target_link_libraries(wiggers_${name} PUBLIC ${ARG_USES})
  wiggers_flags(wiggers_${name})
  install(TARGETS wiggers_${name} EXPORT wiggers-targets ARCHIVE DESTINATION ${CMAKE_INSTALL_LIBDIR})
  install(FILES ${headers} DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}/wiggers/${name})
endfunction()

# Warnings are errors in our own builds; errno and trapping are not used, which lets loops vectorise. No
# -ffast-math: results must not depend on how a compiler reorders sums.
function(wiggers_flags target)
  target_compile_options(${target} PRIVATE -Wall -Wextra -Werror -fno-math-errno -fno-trapping-math)
  if(WIGGERS_SANITIZE)
    target_compile_options(${target} PUBLIC -fsanitize=address,undefined -fno-omit-frame-pointer)
    target_link_options(${target} PUBLIC -fsanitize=address,undefined)
  endif()
endfunction()

function(wiggers_install)
  include(CMakePackageConfigHelpers)
  set(destination ${CMAKE_INSTALL_LIBDIR}/cmake/wiggers)
  install(EXPORT wiggers-targets NAMESPACE wiggers:: DESTINATION ${destination})
  configure_package_config_file(${CMAKE_SOURCE_DIR}/cmake/wiggers-config.cmake.in
    ${CMAKE_BINARY_DIR}/wiggers-config.cmake INSTALL_DESTINATION ${destination})
  write_basic_package_version_file(${CMAKE_BINARY_DIR}/wiggers-config-version.cmake COMPATIBILITY SameMinorVersion)
  install(FILES ${CMAKE_BINARY_DIR}/wiggers-config.cmake ${CMAKE_BINARY_DIR}/wiggers-config-version.cmake
          DESTINATION ${destination})
endfunction()
