// What the material laws share: how stress and tangent are stored, and the terms that come back in each.
//
// Everything is seen in the fibre frame. With f0, s0, n0 the unit vectors along fibre, sheet and sheet normal
// of the unloaded tissue, a law gets F = F_lab [f0 s0 n0]: its columns are the images of the three
// directions. Then C = F^T F and E = (C - I) / 2 have their components along fibre (0), sheet (1) and normal
// (2), det F is the volume ratio J, and the first Piola-Kirchhoff stress comes out as P = P_lab [f0 s0 n0]. A
// kernel rotates the gradients of its shape functions once, before all steps, and never meets the frame
// again.
//
// A tangent is a table A[9][9] with A[3 i + a][3 j + b] = dP_ia / dF_jb: i, j count directions of space, a, b
// those of the frame. It has the symmetry A_pq = A_qp where P derives from an energy.
//
// Each law offers
//   energy(law, F)                              W, Pa;
//   add_stress(law, F, P)                       P += dW/dF;
//   add_stress_and_tangent(law, F, P, A)        the same and A += d2W/dF2, with shared work,
// over any number type T: double; Dual<N>, which differentiates; Vec, which does several points at once.
// Nothing here looks at det F > 0: logarithms of a turned element give NaN, which the caller's line search
// refuses, as it refuses the infinity of an overflowing exponential.
#pragma once

#include <wiggers/core/numbers.hpp>
#include <wiggers/tissue/laws/tensor.hpp>

namespace wiggers {

// Kinds of tissue whose usual numbers differ.
enum class Tissue { ventricle, left_atrium, right_atrium, artery, other };
constexpr bool is_muscle(Tissue tissue) {
  return tissue == Tissue::ventricle || tissue == Tissue::left_atrium || tissue == Tissue::right_atrium;
}

// The table of a tangent, as functions take it.
template <class T>
using TangentRows = T (*)[9];

// C = F^T F, the right Cauchy-Green tensor.
template <class T>
Matrix3<T> right_cauchy_green(const Matrix3<T>& F) {
  Matrix3<T> C;
  for (int a = 0; a < 3; ++a)
    for (int b = a; b < 3; ++b)
      C.m[a][b] = C.m[b][a] = F.m[0][a] * F.m[0][b] + F.m[1][a] * F.m[1][b] + F.m[2][a] * F.m[2][b];
  return C;
}

// E = (F^T F - I) / 2, Green's strain.
template <class T>
Matrix3<T> green_strain(const Matrix3<T>& F) {
  Matrix3<T> E = right_cauchy_green(F);
  for (int a = 0; a < 3; ++a)
    for (int b = 0; b < 3; ++b) E.m[a][b] = 0.5 * (E.m[a][b] - (a == b ? 1.0 : 0.0));
  return E;
}

// The sum over all nine a_ia b_ia.
template <class T>
T contract(const Matrix3<T>& a, const Matrix3<T>& b) {
  T sum = a.m[0][0] * b.m[0][0];
  for (int p = 1; p < 9; ++p) sum = sum + a.m[p / 3][p % 3] * b.m[p / 3][p % 3];
  return sum;
}

// P += factor F.
template <class T>
void add_scaled(const T& factor, const Matrix3<T>& F, Matrix3<T>& P) {
  for (int i = 0; i < 3; ++i)
    for (int a = 0; a < 3; ++a) P.m[i][a] = P.m[i][a] + factor * F.m[i][a];
}

// A += factor U (x) V, the stiffness along one direction of strain.
template <class T>
void add_outer(const T& factor, const Matrix3<T>& U, const Matrix3<T>& V, TangentRows<T> A) {
  for (int i = 0; i < 3; ++i)
    for (int a = 0; a < 3; ++a) {
      const T u = factor * U.m[i][a];
      for (int j = 0; j < 3; ++j)
        for (int b = 0; b < 3; ++b) A[3 * i + a][3 * j + b] = A[3 * i + a][3 * j + b] + u * V.m[j][b];
    }
}

// A_iajb += S delta_ab delta_ij for one a = b: a stress that pulls along direction a of the frame.
template <class T>
void add_geometric(const T& S, int a, TangentRows<T> A) {
  for (int i = 0; i < 3; ++i) A[3 * i + a][3 * i + a] = A[3 * i + a][3 * i + a] + S;
}

// A += factor d cof(F) / dF. As cof(F)_ia is the minor of the other two rows and columns, only i != j and a
// != b count, and the entry is plus or minus what stands in the remaining row k and column c of F:
//   d cof_ia / dF_jb = epsilon_ijk epsilon_abc F_kc.
template <class T>
void add_cofactor_derivative(const T& factor, const Matrix3<T>& F, TangentRows<T> A) {
  for (int i = 0; i < 3; ++i)
    for (int a = 0; a < 3; ++a) {
      const int j = (i + 1) % 3, k = (i + 2) % 3, b = (a + 1) % 3, c = (a + 2) % 3;
      T* row = A[3 * i + a];
      row[3 * j + b] = row[3 * j + b] + factor * F.m[k][c];
      row[3 * k + c] = row[3 * k + c] + factor * F.m[j][b];
      row[3 * j + c] = row[3 * j + c] - factor * F.m[k][b];
      row[3 * k + b] = row[3 * k + b] - factor * F.m[j][c];
    }
}

// Stress alone, from zero.
template <class Law, class T>
Matrix3<T> stress(const Law& law, const Matrix3<T>& F) {
  Matrix3<T> P;
  add_stress(law, F, P);
  return P;
}

}  // namespace wiggers
