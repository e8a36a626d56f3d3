// Resistance to change of volume, apart from the laws of shape.
//
// A volumetric law is a function U(J) alone. Its stress is U'(J) cof(F), as dJ/dF = cof(F), and its tangent
//   U''(J) cof(F) (x) cof(F) + U'(J) d cof(F) / dF.
// It is kept apart because tissue is nearly incompressible and linear tetrahedra lock: a kernel may then take
// J, and with it U' and U'', from an average over a patch of elements (mean dilatation) and add the two parts
// itself with the functions that take U' and U'' as numbers.
#pragma once

#include <wiggers/core/quantity.hpp>
#include <wiggers/tissue/laws/parts.hpp>

namespace wiggers {

// Bulk modulus of myocardium.
inline constexpr Quantity bulk_quantity = {
    "bulk_Pa", "Pa", 50e3, 0, 1e9, "bulk modulus B of the penalty B/2 (J - 1) ln J on changes of volume"};

// U = B/2 (J - 1) ln J: infinite at J = 0, convex, and softer than quadratic in expansion. B is the bulk
// modulus.
struct VolumetricPenalty {
  double B_Pa = 50e3;
};

// U = kappa/4 [(J - 1)^2 + ln^2 J], the volumetric part of the neo-Hookean law for valves and vessels. kappa
// is the bulk modulus; U is convex and resists expansion and compression alike.
struct NeoHookeanVolume {
  double kappa_Pa = 5e6;
};

// U, U' and U'' at one J, from one logarithm.
template <class T>
struct VolumeDerivatives {
  T energy, slope, curvature;
};

template <class T>
VolumeDerivatives<T> volume_derivatives(const VolumetricPenalty& law, const T& J) {
  const T log_J = log(J), inverse = 1.0 / J;
  const double half = 0.5 * law.B_Pa;
  return {half * (J - 1.0) * log_J, half * (log_J + 1.0 - inverse), half * (inverse + inverse * inverse)};
}

template <class T>
VolumeDerivatives<T> volume_derivatives(const NeoHookeanVolume& law, const T& J) {
  const T log_J = log(J), inverse = 1.0 / J;
  const double half = 0.5 * law.kappa_Pa;
  return {0.5 * half * ((J - 1.0) * (J - 1.0) + log_J * log_J), half * (J - 1.0 + log_J * inverse),
          half * (1.0 + (1.0 - log_J) * inverse * inverse)};
}

template <class Volume, class T>
concept VolumetricLaw = requires(const Volume& law, const T& J) {
  volume_derivatives(law, J);
};

// P += U' cof(F), with U' from wherever the caller takes its J.
template <class T>
void add_volumetric_stress(const T& slope, const Matrix3<T>& F, Matrix3<T>& P) {
  add_scaled(slope, cofactors(F), P);
}

// P += U' cof(F); A += U'' cof (x) cof + U' d cof / dF. With an averaged J give curvature 0: the first part
// then joins all elements of the average and is the kernel's.
template <class T>
void add_volumetric_stress_and_tangent(const T& slope, const T& curvature, const Matrix3<T>& F, Matrix3<T>& P,
                                       TangentRows<T> A) {
  const Matrix3<T> cof = cofactors(F);
  add_scaled(slope, cof, P);
  add_outer(curvature, cof, cof, A);
  add_cofactor_derivative(slope, F, A);
}

template <class T, VolumetricLaw<T> Volume>
T energy(const Volume& law, const Matrix3<T>& F) {
  return volume_derivatives(law, determinant(F)).energy;
}

template <class T, VolumetricLaw<T> Volume>
void add_stress(const Volume& law, const Matrix3<T>& F, Matrix3<T>& P) {
  add_volumetric_stress(volume_derivatives(law, determinant(F)).slope, F, P);
}

template <class T, VolumetricLaw<T> Volume>
void add_stress_and_tangent(const Volume& law, const Matrix3<T>& F, Matrix3<T>& P, T A[9][9]) {
  const VolumeDerivatives<T> U = volume_derivatives(law, determinant(F));
  add_volumetric_stress_and_tangent(U.slope, U.curvature, F, P, A);
}

}  // namespace wiggers
