// Eigen's dense matrices, without the false positives of GCC 12 inside Eigen 3.4.
#pragma once

#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC diagnostic ignored "-Wmaybe-uninitialized"
#endif
#include <Eigen/Dense>
