// SIMD batch: several cells in one number. xsimd supplies the vector type and its functions for the
// instruction set this translation unit is compiled for.
#pragma once

#include <wiggers/core/numbers.hpp>
#include <xsimd/xsimd.hpp>

namespace wiggers {

using Batch = xsimd::batch<double>;
inline constexpr int batch_lanes = static_cast<int>(Batch::size);

inline Batch select(const Batch::batch_bool_type& mask, const Batch& if_true, const Batch& if_false) {
  return xsimd::select(mask, if_true, if_false);
}
inline Batch exp(const Batch& x) { return xsimd::exp(x); }
inline Batch expm1(const Batch& x) { return xsimd::expm1(x); }
inline Batch log(const Batch& x) { return xsimd::log(x); }
inline Batch sqrt(const Batch& x) { return xsimd::sqrt(x); }
inline Batch tanh(const Batch& x) { return xsimd::tanh(x); }
inline Batch abs(const Batch& x) { return xsimd::abs(x); }
inline Batch pow(const Batch& x, double exponent) { return xsimd::pow(x, Batch(exponent)); }

}  // namespace wiggers
