// An isotropic exponential law (Demiray, J Biomech 5:309-311, 1972), with the shape's invariant:
//   W = a/(2b) [e^(b (I1bar - 3)) - 1].
// Added by the recipe of material.hpp (own_law.cmake).
#pragma once

#include <wiggers/tissue/laws/isotropic.hpp>

namespace wiggers {

struct Demiray {
  double a_Pa = 2000, b = 6;
};

template <class T>
T energy(const Demiray& law, const Matrix3<T>& F) {
  return 0.5 * law.a_Pa / law.b * expm1(law.b * (IsochoricInvariant<T>(F).value - 3.0));
}
template <class T>
void add_stress(const Demiray& law, const Matrix3<T>& F, Matrix3<T>& P) {
  const IsochoricInvariant<T> I1(F);
  add_scaled(T(0.5 * law.a_Pa * exp(T(law.b * (I1.value - 3.0)))), I1.slope, P);
}
template <class T>
void add_stress_and_tangent(const Demiray& law, const Matrix3<T>& F, Matrix3<T>& P, T A[9][9]) {
  const IsochoricInvariant<T> I1(F);
  const T first = 0.5 * law.a_Pa * exp(T(law.b * (I1.value - 3.0)));
  add_scaled(first, I1.slope, P);
  I1.add_tangent(first, T(law.b * first), F, A);
}

struct DemirayMaterial {
  static constexpr std::string_view name = "demiray";
  static constexpr std::array quantities = {
      Quantity{"a_Pa", "Pa", 2000, 0, 1e7, "stiffness"},
      Quantity{"b", "1", 6, 1e-3, 1e3, "exponent"},
  };
  using Values = std::array<double, quantities.size()>;
  static constexpr Demiray law(const Values& v) { return {v[0], v[1]}; }
  static constexpr double stiffness_Pa(const Values& v) { return v[0]; }
};

}  // namespace wiggers
