// The isotropic invariant of shape, and the neo-Hookean law of valves, annuli and great vessels.
//
//   I1bar = J^(-2/3) F : F,   N = dI1bar/dF = 2 J^(-2/3) F - 2/3 I1bar cof(F) / J,
//   d2I1bar/dF2 = 2 J^(-2/3) (identity) - 2/(3 J) (N (x) cof + cof (x) N) + 2/9 I1bar / J^2 cof (x) cof
//                 - 2/3 I1bar / J d cof / dF.
// I1bar does not feel a change of volume (I1bar(c F) = I1bar(F)), so N vanishes at F = I and a function of it
// alone is a law of shape; Ogden, Non-Linear Elastic Deformations, 1984.
#pragma once

#include <array>
#include <string_view>
#include <wiggers/core/quantity.hpp>
#include <wiggers/tissue/laws/parts.hpp>
#include <wiggers/tissue/laws/volume.hpp>

namespace wiggers {

template <class T>
struct IsochoricInvariant {
  Matrix3<T> cof, slope;      // cof(F) and N
  T value, scale, inverse_J;  // I1bar, J^(-2/3), 1 / J

  explicit IsochoricInvariant(const Matrix3<T>& F) : cof(cofactors(F)) {
    const T J = F.m[0][0] * cof.m[0][0] + F.m[0][1] * cof.m[0][1] + F.m[0][2] * cof.m[0][2];
    inverse_J = 1.0 / J;
    scale = exp(T(log(J) * (-2.0 / 3.0)));
    value = scale * contract(F, F);
    const T along = 2.0 * scale, across = (-2.0 / 3.0) * value * inverse_J;
    for (int i = 0; i < 3; ++i)
      for (int a = 0; a < 3; ++a) slope.m[i][a] = along * F.m[i][a] + across * cof.m[i][a];
  }

  // A += first d2I1bar + second N (x) N, for a law with these derivatives by I1bar.
  void add_tangent(const T& first, const T& second, const Matrix3<T>& F, TangentRows<T> A) const {
    const T mixed = (-2.0 / 3.0) * first * inverse_J;
    const T volumetric = (2.0 / 9.0) * first * value * inverse_J * inverse_J;
    Matrix3<T> by_slope, by_cof;
    for (int i = 0; i < 3; ++i)
      for (int a = 0; a < 3; ++a) {
        by_slope.m[i][a] = second * slope.m[i][a] + mixed * cof.m[i][a];
        by_cof.m[i][a] = mixed * slope.m[i][a] + volumetric * cof.m[i][a];
      }
    for (int i = 0; i < 3; ++i)
      for (int a = 0; a < 3; ++a) {
        T* row = A[3 * i + a];
        for (int j = 0; j < 3; ++j)
          for (int b = 0; b < 3; ++b)
            row[3 * j + b] =
                row[3 * j + b] + (slope.m[i][a] * by_slope.m[j][b] + cof.m[i][a] * by_cof.m[j][b]);
      }
    for (int a = 0; a < 3; ++a) add_geometric(T(2.0 * first * scale), a, A);
    add_cofactor_derivative(T(mixed * value), F, A);
  }
};

// W = mu/2 (I1bar - 3), and apart from it U = kappa/4 [(J - 1)^2 + ln^2 J] as volume(). mu is the shear
// modulus.
struct NeoHookean {
  double mu_Pa = 1e6, kappa_Pa = 5e6;

  constexpr NeoHookeanVolume volume() const { return {kappa_Pa}; }
};

template <class T>
T energy(const NeoHookean& law, const Matrix3<T>& F) {
  return 0.5 * law.mu_Pa * (IsochoricInvariant<T>(F).value - 3.0);
}

template <class T>
void add_stress(const NeoHookean& law, const Matrix3<T>& F, Matrix3<T>& P) {
  add_scaled(T(0.5 * law.mu_Pa), IsochoricInvariant<T>(F).slope, P);
}

template <class T>
void add_stress_and_tangent(const NeoHookean& law, const Matrix3<T>& F, Matrix3<T>& P, T A[9][9]) {
  const IsochoricInvariant<T> I1(F);
  const T half_mu(0.5 * law.mu_Pa);
  add_scaled(half_mu, I1.slope, P);
  I1.add_tangent(half_mu, T(0.0), F, A);
}

// Defaults: valves and caps, and the great arteries.
struct NeoHookeanMaterial {
  static constexpr std::string_view name = "neo-hookean";
  static constexpr std::array quantities = {
      Quantity{"mu_Pa", "Pa", 1e6, 0, 1e9, "shear modulus"},
      Quantity{"kappa_Pa", "Pa", 5e6, 0, 1e10, "bulk modulus"},
  };
  using Values = std::array<double, quantities.size()>;
  static constexpr Values defaults(Tissue tissue) {
    return tissue == Tissue::artery ? Values{5.25e5, 1e6} : defaults_of(quantities);
  }
  static constexpr NeoHookean law(const Values& v) { return {v[0], v[1]}; }
  static constexpr double stiffness_Pa(const Values& v) { return v[0]; }
};

}  // namespace wiggers
