// SIMD numbers: Vec<Real, lanes, Isa> holds one number of several cells and speaks the number vocabulary of
// numbers.hpp, so that a model's text serves it unchanged.
//
// The vectors are the compiler's own vector types: any lane count compiles for any processor (wider ones
// are split), which is the portable fallback. The instruction set of a translation unit is its compiler
// flags; `Isa` only keeps templates of differently compiled units apart at link time.
//
// exp and log are ours, inlined: a call into a vector library would spill every register around it, and the
// models overlap dozens of them (measured against glibc's and xsimd's by bench_cells). Accuracy (tests):
//   exp   relative error < 2.5e-16 (double), < 1.5e-7 (float); saturates at exp(-708) and exp(709), float
//         exp(-87) and exp(88), instead of running into denormals and infinities
//   log   relative error < 3e-16 (double), < 1.5e-7 (float), of normal positive numbers; NaN for negative
//   ones pow   exp(exponent log x), positive x: error |exponent log x| times that of exp a/b   within 1 ulp
//   of the rounded quotient for |b| in 1e-300 .. 1e300 (float 1e-37 .. 1e37)
// Compile with -ffp-contract=fast where the processor has fused multiply-add.
#pragma once

#include <cstddef>
#include <cstdint>
#include <type_traits>
#include <utility>
#include <wiggers/core/numbers.hpp>
#if defined(__AVX512F__) && defined(__AVX512DQ__) && defined(__AVX512VL__)
#include <immintrin.h>
#define WIGGERS_HAVE_AVX512 1
#else
#define WIGGERS_HAVE_AVX512 0
#endif

// A vector as argument has one ABI with, another without wide registers; ours never cross a call.
#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC diagnostic ignored "-Wpsabi"
#endif
#define WIGGERS_INLINE [[gnu::always_inline]] inline

namespace wiggers {

namespace isa {
struct Baseline {};  // what every processor of the architecture has (x86-64: SSE2)
struct Avx2 {};      // AVX2 and FMA
struct Avx512 {};    // AVX-512 F, DQ, VL, BW
}  // namespace isa

template <class Real, int n_lanes, class Isa>
struct Vec {
  static constexpr int lanes = n_lanes;
  using Scalar = Real;
  using Integer = std::conditional_t<sizeof(Real) == 8, std::int64_t, std::int32_t>;
  typedef Real Native __attribute__((vector_size(sizeof(Real) * n_lanes)));
  typedef Integer NativeInteger __attribute__((vector_size(sizeof(Real) * n_lanes)));
  static constexpr bool is_double = sizeof(Real) == 8;
  static constexpr bool full_avx512 = WIGGERS_HAVE_AVX512 && sizeof(Real) * n_lanes == 64;

  struct Mask {
    NativeInteger bits;  // all ones or all zeros
    WIGGERS_INLINE static Mask none() { return {NativeInteger{}}; }
    WIGGERS_INLINE friend Vec select(const Mask& mask, const Vec& if_true, const Vec& if_false) {
      return Vec(mask.bits ? if_true.v : if_false.v);
    }
    WIGGERS_INLINE friend Mask operator&(const Mask& a, const Mask& b) { return {a.bits & b.bits}; }
    WIGGERS_INLINE friend Mask operator|(const Mask& a, const Mask& b) { return {a.bits | b.bits}; }
  };

  Native v;

  Vec() = default;
  WIGGERS_INLINE Vec(double constant) : v(static_cast<Real>(constant) - Native{}) {}  // NOLINT: constants mix
  WIGGERS_INLINE explicit Vec(const Native& native) : v(native) {}

  WIGGERS_INLINE static Vec load(const Real* from) {
    Vec x;
    __builtin_memcpy(&x.v, from, sizeof(x.v));
    return x;
  }
  WIGGERS_INLINE void store(Real* to) const { __builtin_memcpy(to, &v, sizeof(v)); }
  WIGGERS_INLINE Real operator[](int lane) const { return v[lane]; }

  WIGGERS_INLINE Vec& operator+=(const Vec& b) { return *this = *this + b; }
  WIGGERS_INLINE Vec& operator-=(const Vec& b) { return *this = *this - b; }
  WIGGERS_INLINE Vec& operator*=(const Vec& b) { return *this = *this * b; }

  WIGGERS_INLINE friend Vec operator-(const Vec& a) { return Vec(-a.v); }
  WIGGERS_INLINE friend Vec operator+(const Vec& a, const Vec& b) { return Vec(a.v + b.v); }
  WIGGERS_INLINE friend Vec operator-(const Vec& a, const Vec& b) { return Vec(a.v - b.v); }
  WIGGERS_INLINE friend Vec operator*(const Vec& a, const Vec& b) { return Vec(a.v * b.v); }
  WIGGERS_INLINE friend Vec operator/(const Vec& a, const Vec& b) {
#if WIGGERS_HAVE_AVX512
    // The divider of 512-bit registers is slow; the estimate with Newton steps keeps to the multipliers.
    if constexpr (full_avx512 && is_double) {
      const Native y0 = _mm512_rcp14_pd(b.v);
      const Native e0 = 1.0 - b.v * y0;
      const Native y1 = y0 + y0 * (e0 + e0 * e0);  // 14 bits -> 42
      const Native q = a.v * y1;
      return Vec(q + y1 * (a.v - b.v * q));
    } else if constexpr (full_avx512) {
      const Native y0 = _mm512_rcp14_ps(b.v);
      const Native q = a.v * y0;
      const Native q1 = q + y0 * (a.v - b.v * q);
      return Vec(q1);
    }
#endif
    return Vec(a.v / b.v);
  }
  // A constant divisor is a multiplication.
  WIGGERS_INLINE friend Vec operator/(const Vec& a, double b) { return a * Vec(1.0 / b); }

  WIGGERS_INLINE friend Mask operator<(const Vec& a, const Vec& b) { return {a.v < b.v}; }
  WIGGERS_INLINE friend Mask operator>(const Vec& a, const Vec& b) { return {a.v > b.v}; }
  WIGGERS_INLINE friend Mask operator<=(const Vec& a, const Vec& b) { return {a.v <= b.v}; }
  WIGGERS_INLINE friend Mask operator>=(const Vec& a, const Vec& b) { return {a.v >= b.v}; }

  WIGGERS_INLINE friend Vec abs(const Vec& a) {
    constexpr Integer magnitude =
        is_double ? static_cast<Integer>(~(std::uint64_t(1) << 63)) : static_cast<Integer>(0x7fffffff);
    return Vec(reinterpret_cast<Native>(reinterpret_cast<NativeInteger>(a.v) & magnitude));
  }
  WIGGERS_INLINE friend Vec min(const Vec& a, const Vec& b) { return Vec(a.v < b.v ? a.v : b.v); }
  WIGGERS_INLINE friend Vec max(const Vec& a, const Vec& b) { return Vec(a.v > b.v ? a.v : b.v); }
  WIGGERS_INLINE friend Vec sqrt(const Vec& a) {
#if WIGGERS_HAVE_AVX512
    if constexpr (full_avx512 && is_double) return Vec(Native(_mm512_sqrt_pd(a.v)));
    if constexpr (full_avx512 && !is_double) return Vec(Native(_mm512_sqrt_ps(a.v)));
#endif
    Vec root;
    for (int lane = 0; lane < n_lanes; ++lane)
      root.v[lane] = is_double ? static_cast<Real>(__builtin_sqrt(a.v[lane]))
                               : static_cast<Real>(__builtin_sqrtf(static_cast<float>(a.v[lane])));
    return root;
  }

  // x = n ln 2 + r, |r| <= ln(2)/2; exp(r) by a near-minimax polynomial; 2^n into the exponent.
  WIGGERS_INLINE friend Vec exp(const Vec& x_any) {
    constexpr Real log2_e = static_cast<Real>(1.4426950408889634074);
    // Adding and subtracting it rounds to the nearest integer, which then stands in its lowest bits.
    constexpr Real magic = is_double ? static_cast<Real>(6755399441055744.0) : static_cast<Real>(12582912.0f);
    const Vec x = max(Vec(is_double ? -708.0 : -87.0), min(Vec(is_double ? 709.0 : 88.0), x_any));
    const Native shifted = x.v * log2_e + magic;
    const Native n = shifted - magic;
    const auto c = [](double constant) { return static_cast<Real>(constant); };
    Native p, r;
    if constexpr (is_double) {
      r = (x.v - n * c(6.93147180369123816490e-01)) - n * c(1.90821492927058770002e-10);
      const Native r2 = r * r;
      // Two interleaved halves: half the latency of Horner's chain.
      const Native even = (((c(2.7620088445409748161e-7) * r2 + c(2.4801521295954375131e-5)) * r2 +
                            c(1.3888888917213716901e-3)) *
                               r2 +
                           c(0.041666666666624127873)) *
                              r2 +
                          c(0.50000000000000010221);
      const Native odd = (((c(2.5100385495510319078e-8) * r2 + c(2.7557268459997064772e-6)) * r2 +
                           c(1.9841269863053616878e-4)) *
                              r2 +
                          c(0.0083333333333300618325)) *
                             r2 +
                         c(0.16666666666666667453);
      p = (even + odd * r) * r2 + r + c(1.0);
    } else {
      r = (x.v - n * c(0.693359375)) - n * c(-2.12194440054690583e-4);
      const Native r2 = r * r;
      const Native even = (c(1.3926183587713494542e-3) * r2 + c(0.041666554617204574203)) * r2 + c(0.5);
      const Native odd = c(8.3631790527225773704e-3) * r2 + c(0.16666576989698775683);
      p = (even + odd * r) * r2 + r + c(1.0);
    }
#if WIGGERS_HAVE_AVX512
    if constexpr (full_avx512 && is_double) return Vec(Native(_mm512_scalef_pd(p, n)));
    if constexpr (full_avx512 && !is_double) return Vec(Native(_mm512_scalef_ps(p, n)));
#endif
    constexpr int mantissa_bits = is_double ? 52 : 23;
    const NativeInteger exponent = reinterpret_cast<NativeInteger>(shifted) << mantissa_bits;
    return Vec(reinterpret_cast<Native>(reinterpret_cast<NativeInteger>(p) + exponent));
  }

  // x = m 2^e, m in sqrt(1/2) .. sqrt(2); log m = 2 atanh(s), s = (m - 1)/(m + 1).
  WIGGERS_INLINE friend Vec log(const Vec& x) {
    constexpr int mantissa_bits = is_double ? 52 : 23;
    constexpr Integer half_root =
        is_double ? Integer(0x3fe6a09e667f3bcdLL) : Integer(0x3f3504f3);  // sqrt(1/2)
    const NativeInteger bits = reinterpret_cast<NativeInteger>(x.v);
    const NativeInteger e = (bits - half_root) >> mantissa_bits;
    const Native m = reinterpret_cast<Native>(bits - (e << mantissa_bits));
    const Native k = __builtin_convertvector(e, Native);
    const auto c = [](double constant) { return static_cast<Real>(constant); };
    const Native f = m - c(1.0);
    const Native s = (Vec(f) / Vec(f + c(2.0))).v;
    const Native z = s * s;
    Native tail;
    if constexpr (is_double) {
      tail =
          (((((c(0.14616585424888621989) * z + c(0.15331710618210771568)) * z + c(0.18182889455674946039)) *
                 z +
             c(0.22222211130259877029)) *
                z +
            c(0.28571428626003268742)) *
               z +
           c(0.39999999999899443233)) *
              z +
          c(0.66666666666666696883);
    } else {
      tail = (c(0.29580053043188442144) * z + c(0.39988778282162807727)) * z + c(0.66666685045156029067);
    }
    // 2 s = f - s f: what is large is added last, and exactly.
    const Native low =
        s * (z * tail) - s * f + k * c(is_double ? 1.90821492927058770002e-10 : -2.12194440054690583e-4);
    const Native result = k * c(is_double ? 6.93147180369123816490e-01 : 0.693359375) + (f + low);
    const Native not_a_number = Native{} / Native{};
    return Vec(x.v > c(0.0) ? result : not_a_number);
  }
  WIGGERS_INLINE friend Vec pow(const Vec& x, double exponent) { return exp(log(x) * Vec(exponent)); }
};

// exp() above neither overflows nor makes infinities.
template <class Real, int lanes, class Isa>
WIGGERS_INLINE Vec<Real, lanes, Isa> logistic(const Vec<Real, lanes, Isa>& x) {
  using V = Vec<Real, lanes, Isa>;
  return V(1.0) / (V(1.0) + exp(-x));
}

namespace simd_detail {
// (a0 b0 a1 b1 ...) of the lower or the upper halves.
template <bool upper, class V, std::size_t... i>
WIGGERS_INLINE V zip(const V& a, const V& b, std::index_sequence<i...>) {
  constexpr std::size_t n = V::lanes;
  return V(__builtin_shufflevector(a.v, b.v, ((upper ? n / 2 : 0) + i / 2 + (i % 2) * n)...));
}
template <bool upper, class V>
WIGGERS_INLINE V zip(const V& a, const V& b) {
  return zip<upper>(a, b, std::make_index_sequence<V::lanes>());
}
}  // namespace simd_detail

// Transposes `lanes` vectors: rows[i][j] -> rows[j][i].
template <class V, int stage = 1>
WIGGERS_INLINE void transpose(V (&rows)[V::lanes]) {
  constexpr int n = V::lanes;
  if constexpr (stage < n) {
    V next[n];
#pragma GCC unroll 16
    for (int i = 0; i < n / 2; ++i) {
      next[2 * i] = simd_detail::zip<false>(rows[i], rows[i + n / 2]);
      next[2 * i + 1] = simd_detail::zip<true>(rows[i], rows[i + n / 2]);
    }
    transpose<V, 2 * stage>(next);
#pragma GCC unroll 16
    for (int i = 0; i < n; ++i) rows[i] = next[i];
  }
}

}  // namespace wiggers
