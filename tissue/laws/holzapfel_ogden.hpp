// Passive myocardium from the structure of its layers (Holzapfel, Ogden, Phil Trans R Soc A 367:3445-3475,
// 2009):
//
//   W = a/(2b) [e^(b (I1bar - 3)) - 1] + sum over i = f, s of a_i/(2 b_i) [e^(b_i E_i^2) - 1]
//       + a_fs/(2 b_fs) [e^(b_fs I8^2) - 1],
//   E_f = kappa_f tr C + (1 - 3 kappa_f) C_ff - 1,   E_s = C_ss - 1,   I8 = C_fs.
//
// The original is incompressible. For nearly incompressible tissue the isotropic term takes I1bar = J^(-2/3)
// tr C, which leaves the unloaded state free of stress whatever b is, while the terms of the fibres keep the
// whole C: fibres are stretched by a change of volume too. With C_ff J^(-2/3) in their place fibres can
// escape their load by swelling of the tissue, and a sphere under pressure from all sides stays a sphere
// however stiff its fibres are: Sansour, Eur J Mech A 27:28-39, 2008; Nolan, Gower, Destrade, Ogden, McGarry,
// J Mech Behav Biomed Mater 39:48-60, 2014, who recommend what stands here.
//
// Dispersion: fibre directions spread around f0 rotationally symmetrically, and kappa_f says how far, from 0
// (all along f0) to 1/3 (all directions alike): Gasser, Ogden, Holzapfel, J R Soc Interface 3:15-35, 2006.
//
// Fibres and sheets wave rather than bear compression: their terms act where E_i > 0 only, unless told
// otherwise. The bound is E_i, which is C_ii > 1 without dispersion, so that the stress has no jump with
// dispersion either.
#pragma once

#include <algorithm>
#include <array>
#include <string_view>
#include <wiggers/core/quantity.hpp>
#include <wiggers/tissue/laws/isotropic.hpp>

namespace wiggers {

struct HolzapfelOgden {
  // Table 1 of the paper, fitted to simple shear of pig myocardium (Dokos et al. 2002).
  double a_Pa = 59, b = 8.023, a_f_Pa = 18472, b_f = 16.026, a_s_Pa = 2481, b_s = 11.120, a_fs_Pa = 216,
         b_fs = 11.436;
  double kappa_f = 0;                    // dispersion of fibres, 0 to 1/3
  bool fibres_bear_compression = false;  // true: the terms of fibre and sheet act at any E_i
};

namespace holzapfel_ogden_terms {
// a/(2b) (e^(b E^2) - 1) and its derivatives by E; b may be 0, which makes it a/2 E^2.
template <class T>
T fibre_energy(double a, double b, const T& E) {
  return b > 0 ? T(0.5 * a / b * expm1(b * E * E)) : T(0.5 * a * E * E);
}
template <class T>
struct Slopes {
  T first, second;
};
template <class T>
Slopes<T> fibre_slopes(double a, double b, const T& E) {
  const T bE2 = b * E * E, e = a * exp(bE2);
  return {e * E, e * (1.0 + 2.0 * bE2)};
}

// The strains of the three families.
template <class T>
struct Strains {
  T f, s, fs;
};
template <class T>
Strains<T> strains(const HolzapfelOgden& law, const Matrix3<T>& F) {
  const Matrix3<T> C = right_cauchy_green(F);
  const double k = law.kappa_f;
  return {(1.0 - 2.0 * k) * C.m[0][0] + k * (C.m[1][1] + C.m[2][2]) - 1.0, C.m[1][1] - 1.0, C.m[0][1]};
}

// All derivatives of W but those by I1bar.
template <class T>
struct FamilySlopes {
  Slopes<T> f, s, fs;
};
template <class T>
FamilySlopes<T> family_slopes(const HolzapfelOgden& law, const Matrix3<T>& F) {
  const Strains<T> E = strains(law, F);
  FamilySlopes<T> w = {fibre_slopes(law.a_f_Pa, law.b_f, E.f), fibre_slopes(law.a_s_Pa, law.b_s, E.s),
                       fibre_slopes(law.a_fs_Pa, law.b_fs, E.fs)};
  if (!law.fibres_bear_compression) {
    const T none(0.0);
    w.f = {select(E.f > 0.0, w.f.first, none), select(E.f > 0.0, w.f.second, none)};
    w.s = {select(E.s > 0.0, w.s.first, none), select(E.s > 0.0, w.s.second, none)};
  }
  return w;
}

// P += the stress of the families. S = dW/dE_f 2 H + dW/dE_s 2 (s (x) s) + dW/dI8 (f (x) s + s (x) f), with
// H = diag(1 - 2 kappa_f, kappa_f, kappa_f).
template <class T>
void add_family_stress(const HolzapfelOgden& law, const FamilySlopes<T>& w, const Matrix3<T>& F,
                       Matrix3<T>& P) {
  const T along = 2.0 * (1.0 - 2.0 * law.kappa_f) * w.f.first, across = 2.0 * law.kappa_f * w.f.first;
  const T sheet = across + 2.0 * w.s.first;
  for (int i = 0; i < 3; ++i) {
    P.m[i][0] = P.m[i][0] + (along * F.m[i][0] + w.fs.first * F.m[i][1]);
    P.m[i][1] = P.m[i][1] + (sheet * F.m[i][1] + w.fs.first * F.m[i][0]);
    P.m[i][2] = P.m[i][2] + across * F.m[i][2];
  }
}
}  // namespace holzapfel_ogden_terms

template <class T>
T energy(const HolzapfelOgden& law, const Matrix3<T>& F) {
  using namespace holzapfel_ogden_terms;
  Strains<T> E = strains(law, F);
  if (!law.fibres_bear_compression) {
    E.f = select(E.f > 0.0, E.f, T(0.0));
    E.s = select(E.s > 0.0, E.s, T(0.0));
  }
  const T I = IsochoricInvariant<T>(F).value - 3.0;
  const T matrix = law.b > 0 ? T(0.5 * law.a_Pa / law.b * expm1(law.b * I)) : T(0.5 * law.a_Pa * I);
  return matrix + fibre_energy(law.a_f_Pa, law.b_f, E.f) + fibre_energy(law.a_s_Pa, law.b_s, E.s) +
         fibre_energy(law.a_fs_Pa, law.b_fs, E.fs);
}

template <class T>
void add_stress(const HolzapfelOgden& law, const Matrix3<T>& F, Matrix3<T>& P) {
  const IsochoricInvariant<T> I1(F);
  add_scaled(T(0.5 * law.a_Pa * exp(law.b * (I1.value - 3.0))), I1.slope, P);
  holzapfel_ogden_terms::add_family_stress(law, holzapfel_ogden_terms::family_slopes(law, F), F, P);
}

template <class T>
void add_stress_and_tangent(const HolzapfelOgden& law, const Matrix3<T>& F, Matrix3<T>& P, T A[9][9]) {
  const IsochoricInvariant<T> I1(F);
  const T first = 0.5 * law.a_Pa * exp(law.b * (I1.value - 3.0));
  add_scaled(first, I1.slope, P);
  I1.add_tangent(first, T(law.b * first), F, A);

  const holzapfel_ogden_terms::FamilySlopes<T> w = holzapfel_ogden_terms::family_slopes(law, F);
  holzapfel_ogden_terms::add_family_stress(law, w, F, P);
  // Stress: second derivatives of the strains by F.
  const double H[3] = {1.0 - 2.0 * law.kappa_f, law.kappa_f, law.kappa_f};
  add_geometric(T(2.0 * H[0] * w.f.first), 0, A);
  add_geometric(T(2.0 * (H[1] * w.f.first + w.s.first)), 1, A);
  add_geometric(T(2.0 * H[2] * w.f.first), 2, A);
  for (int i = 0; i < 3; ++i) {
    A[3 * i][3 * i + 1] = A[3 * i][3 * i + 1] + w.fs.first;
    A[3 * i + 1][3 * i] = A[3 * i + 1][3 * i] + w.fs.first;
  }
  // Stiffening: squares of the first derivatives, which without dispersion fill few columns.
  if (law.kappa_f > 0) {
    Matrix3<T> N;
    for (int i = 0; i < 3; ++i)
      for (int a = 0; a < 3; ++a) N.m[i][a] = 2.0 * H[a] * F.m[i][a];
    add_outer(w.f.second, N, N, A);
  }
  const T fibre = law.kappa_f > 0 ? T(0.0) : T(4.0 * w.f.second);
  const T sheet = 4.0 * w.s.second;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) {
      T* row_f = A[3 * i] + 3 * j;
      T* row_s = A[3 * i + 1] + 3 * j;
      const T ff = F.m[i][0] * F.m[j][0], ss = F.m[i][1] * F.m[j][1];
      row_f[0] = row_f[0] + (fibre * ff + w.fs.second * ss);
      row_f[1] = row_f[1] + w.fs.second * (F.m[i][1] * F.m[j][0]);
      row_s[0] = row_s[0] + w.fs.second * (F.m[i][0] * F.m[j][1]);
      row_s[1] = row_s[1] + (sheet * ss + w.fs.second * ff);
    }
}

// Defaults: Table 1 of the paper (simple shear of pig myocardium).
struct HolzapfelOgdenMaterial {
  static constexpr std::string_view name = "holzapfel-ogden";
  static constexpr std::array quantities = {
      Quantity{"a_Pa", "Pa", 59, 0, 1e7, "stiffness of the matrix between fibres"},
      Quantity{"b", "1", 8.023, 0, 1e3, "exponent of the matrix"},
      Quantity{"a_f_Pa", "Pa", 18472, 0, 1e7, "stiffness along the fibre"},
      Quantity{"b_f", "1", 16.026, 0, 1e3, "exponent along the fibre"},
      Quantity{"a_s_Pa", "Pa", 2481, 0, 1e7, "stiffness along the sheet"},
      Quantity{"b_s", "1", 11.120, 0, 1e3, "exponent along the sheet"},
      Quantity{"a_fs_Pa", "Pa", 216, 0, 1e7, "stiffness of shear between fibre and sheet"},
      Quantity{"b_fs", "1", 11.436, 0, 1e3, "exponent of shear between fibre and sheet"},
      Quantity{"kappa_f", "1", 0, 0, 1.0 / 3.0, "dispersion of fibres: 0 none, 1/3 all directions alike"},
      Quantity{"fibres_bear_compression", "1", 0, 0, 1,
               "1: the terms of fibre and sheet resist shortening too; 0: stretch only"},
  };
  using Values = std::array<double, quantities.size()>;
  static constexpr HolzapfelOgden law(const Values& v) {
    return {v[0], v[1], v[2], v[3], v[4], v[5], v[6], v[7], v[8], v[9] > 0.5};
  }
  static constexpr double stiffness_Pa(const Values& v) { return std::max({v[0], v[2], v[4]}); }
};

}  // namespace wiggers
