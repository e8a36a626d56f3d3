// Forces and stiffness of a linear tetrahedron from the stress and tangent at its one point.
//
// With g_n the gradient of shape function n in the fibre frame (g_n = [f0 s0 n0]^T grad N_n) and x_n the
// deformed position of node n,
//   F_ia = sum_n x_ni g_na,   f_ni = V P_ia g_na,   K_nimj = V g_na A_iajb g_mb = df_ni / dx_mj.
// The four gradients sum to zero, and so do the forces and the rows and columns of blocks of K. Three nodes
// are therefore computed and node 0 follows, which saves work and keeps the balance of forces exact; g[0] is
// not read by what computes forces and stiffness.
//
// K[n][i][m][j] has node n and direction i as its row, node m and direction j as its column. All functions
// overwrite their results.
#pragma once

#include <wiggers/tissue/laws/parts.hpp>

namespace wiggers {

// The gradients of the shape functions of the tetrahedron x, and its volume.
template <class T>
T shape_gradients(const T x[4][3], T g[4][3]) {
  Matrix3<T> edges;  // rows
  for (int n = 0; n < 3; ++n)
    for (int i = 0; i < 3; ++i) edges.m[n][i] = x[n + 1][i] - x[0][i];
  const Matrix3<T> cof = cofactors(edges);
  const T det = edges.m[0][0] * cof.m[0][0] + edges.m[0][1] * cof.m[0][1] + edges.m[0][2] * cof.m[0][2];
  const T inverse = 1.0 / det;
  for (int i = 0; i < 3; ++i) {
    for (int n = 0; n < 3; ++n) g[n + 1][i] = inverse * cof.m[n][i];
    g[0][i] = -(g[1][i] + g[2][i] + g[3][i]);
  }
  return T(det * (1.0 / 6.0));
}

// F from deformed positions. Taken from differences to node 0, so that a shift changes it by round-off of the
// shape only.
template <class T>
Matrix3<T> deformation_gradient(const T x[4][3], const T g[4][3]) {
  Matrix3<T> F;
  for (int i = 0; i < 3; ++i) {
    const T d1 = x[1][i] - x[0][i], d2 = x[2][i] - x[0][i], d3 = x[3][i] - x[0][i];
    for (int a = 0; a < 3; ++a) F.m[i][a] = d1 * g[1][a] + d2 * g[2][a] + d3 * g[3][a];
  }
  return F;
}

template <class T>
void element_force(const T g[4][3], const Matrix3<T>& P, const T& volume, T f[4][3]) {
  for (int i = 0; i < 3; ++i) {
    const T p0 = volume * P.m[i][0], p1 = volume * P.m[i][1], p2 = volume * P.m[i][2];
    for (int n = 1; n < 4; ++n) f[n][i] = p0 * g[n][0] + p1 * g[n][1] + p2 * g[n][2];
    f[0][i] = -(f[1][i] + f[2][i] + f[3][i]);
  }
}

// Any tangent; 486 multiplications for nine blocks of sixteen. Computing only the upper half where A is
// symmetric and mirroring it was tried and is slower: scattered stores cost more than the products saved.
template <class T>
void element_force_and_stiffness(const T g[4][3], const Matrix3<T>& P, const T A[9][9], const T& volume,
                                 T f[4][3], T K[4][3][4][3]) {
  element_force(g, P, volume, f);
  for (int n = 1; n < 4; ++n) {
    const T w[3] = {volume * g[n][0], volume * g[n][1], volume * g[n][2]};
    for (int i = 0; i < 3; ++i) {
      T h[9];
      for (int q = 0; q < 9; ++q) h[q] = w[0] * A[3 * i][q] + w[1] * A[3 * i + 1][q] + w[2] * A[3 * i + 2][q];
      for (int j = 0; j < 3; ++j) {
        for (int m = 1; m < 4; ++m)
          K[n][i][m][j] = h[3 * j] * g[m][0] + h[3 * j + 1] * g[m][1] + h[3 * j + 2] * g[m][2];
        K[n][i][0][j] = -(K[n][i][1][j] + K[n][i][2][j] + K[n][i][3][j]);
      }
    }
  }
  for (int i = 0; i < 3; ++i)
    for (int m = 0; m < 4; ++m)
      for (int j = 0; j < 3; ++j) K[0][i][m][j] = -(K[1][i][m][j] + K[2][i][m][j] + K[3][i][m][j]);
}

}  // namespace wiggers
