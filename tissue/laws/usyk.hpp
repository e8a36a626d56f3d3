// Passive myocardium: one exponential of all components of Green's strain.
//
//   W = C/2 (e^Q - 1),   Q = sum over all nine (a, b) of b_ab E_ab^2,   b symmetric,
//
// so that each shear counts twice. Usyk, Mazhari, McCulloch, J Elasticity 61:143-164, 2000; the transversely
// isotropic case is Guccione, McCulloch, Waldman, J Biomech Eng 113:42-55, 1991. The law has no volumetric
// part (volume.hpp) and is not split: E is the whole strain, and the stress vanishes with E at J = 1.
//
// With M_ab = b_ab E_ab and k = C e^Q:  S = k M,  P = k F M, and the tangent is a table that is nearly
// diagonal in strain, plus one direction of exponential stiffening:
//   dS_ab = k [b_ab dE_ab + 2 M_ab (M : dE)],
//   A_iajb = k [M_ab delta_ij + 1/2 delta_ab sum_c b_ac F_ic F_jc + 1/2 b_ab F_ib F_ja + 2 (FM)_ia (FM)_jb].
#pragma once

#include <algorithm>
#include <array>
#include <string_view>
#include <wiggers/core/quantity.hpp>
#include <wiggers/tissue/laws/parts.hpp>

namespace wiggers {

struct UsykLaw3 {
  double C_Pa = 880;
  double b[3][3] = {{8, 12, 3}, {12, 6, 3}, {3, 3, 3}};  // fibre, sheet, normal; symmetric

  static constexpr UsykLaw3 from(double C_Pa, double b_ff, double b_ss, double b_nn, double b_fs, double b_fn,
                                 double b_sn) {
    return {C_Pa, {{b_ff, b_fs, b_fn}, {b_fs, b_ss, b_sn}, {b_fn, b_sn, b_nn}}};
  }

  // Q = bf Eff^2 + bt (Ess^2 + Enn^2 + Esn^2 + Ens^2) + bfs (Efs^2 + Esf^2 + Efn^2 + Enf^2).
  static constexpr UsykLaw3 guccione(double C_Pa, double bf, double bt, double bfs) {
    return from(C_Pa, bf, bt, bt, bfs, bfs, bt);
  }
};

namespace usyk_terms {
// M = b o E (entry by entry) and Q = M : E.
template <class T>
struct Weighted {
  Matrix3<T> M;
  T Q;
};
template <class T>
Weighted<T> weighted(const UsykLaw3& law, const Matrix3<T>& F) {
  const Matrix3<T> E = green_strain(F);
  Weighted<T> w;
  for (int a = 0; a < 3; ++a)
    for (int b = a; b < 3; ++b) w.M.m[a][b] = w.M.m[b][a] = law.b[a][b] * E.m[a][b];
  w.Q = w.M.m[0][0] * E.m[0][0] + w.M.m[1][1] * E.m[1][1] + w.M.m[2][2] * E.m[2][2] +
        2.0 * (w.M.m[0][1] * E.m[0][1] + w.M.m[0][2] * E.m[0][2] + w.M.m[1][2] * E.m[1][2]);
  return w;
}
}  // namespace usyk_terms

template <class T>
T energy(const UsykLaw3& law, const Matrix3<T>& F) {
  return 0.5 * law.C_Pa * expm1(usyk_terms::weighted(law, F).Q);
}

template <class T>
void add_stress(const UsykLaw3& law, const Matrix3<T>& F, Matrix3<T>& P) {
  const usyk_terms::Weighted<T> w = usyk_terms::weighted(law, F);
  add_scaled(T(law.C_Pa * exp(w.Q)), F * w.M, P);
}

template <class T>
void add_stress_and_tangent(const UsykLaw3& law, const Matrix3<T>& F, Matrix3<T>& P, T A[9][9]) {
  const usyk_terms::Weighted<T> w = usyk_terms::weighted(law, F);
  const Matrix3<T> FM = F * w.M;
  const T k = law.C_Pa * exp(w.Q);
  add_scaled(k, FM, P);
  const T half = 0.5 * k, twice = 2.0 * k;
  // What each column of the frame contributes where a = b.
  T diagonal[3][3][3];  // [a][i][j], symmetric in i and j
  for (int a = 0; a < 3; ++a)
    for (int i = 0; i < 3; ++i)
      for (int j = i; j < 3; ++j)
        diagonal[a][i][j] = diagonal[a][j][i] =
            half * (law.b[a][0] * (F.m[i][0] * F.m[j][0]) + law.b[a][1] * (F.m[i][1] * F.m[j][1]) +
                    law.b[a][2] * (F.m[i][2] * F.m[j][2]));
  for (int i = 0; i < 3; ++i)
    for (int a = 0; a < 3; ++a) {
      T* row = A[3 * i + a];
      const T stiffening = twice * FM.m[i][a];
      const T sheared[3] = {half * law.b[a][0] * F.m[i][0], half * law.b[a][1] * F.m[i][1],
                            half * law.b[a][2] * F.m[i][2]};
      for (int j = 0; j < 3; ++j)
        for (int b = 0; b < 3; ++b) {
          T entry = stiffening * FM.m[j][b] + sheared[b] * F.m[j][a];
          if (a == b) entry = entry + diagonal[a][i][j];
          if (i == j) entry = entry + k * w.M.m[a][b];
          row[3 * j + b] = row[3 * j + b] + entry;
        }
    }
}

// Defaults: ventricles and atria of Fedele et al. 2023.
struct UsykMaterial {
  static constexpr std::string_view name = "usyk";
  static constexpr std::array quantities = {
      Quantity{"C_Pa", "Pa", 880, 0, 1e7, "stiffness C of the law C/2 (e^Q - 1)"},
      Quantity{"b_ff", "1", 8, 0, 1e3, "exponent of stretch along the fibre"},
      Quantity{"b_ss", "1", 6, 0, 1e3, "exponent of stretch along the sheet, across the fibre"},
      Quantity{"b_nn", "1", 3, 0, 1e3, "exponent of stretch normal to the sheet"},
      Quantity{"b_fs", "1", 12, 0, 1e3, "exponent of shear between fibre and sheet"},
      Quantity{"b_fn", "1", 3, 0, 1e3, "exponent of shear between fibre and normal"},
      Quantity{"b_sn", "1", 3, 0, 1e3, "exponent of shear between sheet and normal"},
  };
  using Values = std::array<double, quantities.size()>;
  static constexpr Values defaults(Tissue tissue) {
    Values values = defaults_of(quantities);
    if (tissue == Tissue::right_atrium) values[0] = 1470;
    if (tissue == Tissue::left_atrium) values[0] = 1760;
    return values;
  }
  static constexpr UsykLaw3 law(const Values& v) {
    return UsykLaw3::from(v[0], v[1], v[2], v[3], v[4], v[5], v[6]);
  }
  static constexpr double stiffness_Pa(const Values& v) { return v[0] * std::max({v[1], v[2], v[3]}); }
};

// Defaults: the bending beam of Land et al., Proc R Soc A 471:20150641, 2015, problem 1.
struct GuccioneMaterial {
  static constexpr std::string_view name = "guccione";
  static constexpr std::array quantities = {
      Quantity{"C_Pa", "Pa", 2000, 0, 1e7, "stiffness C of the law C/2 (e^Q - 1)"},
      Quantity{"b_f", "1", 8, 0, 1e3, "exponent of stretch along the fibre"},
      Quantity{"b_t", "1", 2, 0, 1e3, "exponent of stretch and shear across the fibre"},
      Quantity{"b_fs", "1", 4, 0, 1e3, "exponent of shear between the fibre and directions across it"},
  };
  using Values = std::array<double, quantities.size()>;
  static constexpr UsykLaw3 law(const Values& v) { return UsykLaw3::guccione(v[0], v[1], v[2], v[3]); }
  static constexpr double stiffness_Pa(const Values& v) { return v[0] * std::max(v[1], v[2]); }
};

}  // namespace wiggers
