// Active tension of the sarcomeres, and the viscosity of the wall.
//
// Active: the tension T pulls along the stretched fibre, and in part along sheet and normal because fibres
// spread (Usyk et al. 2000). With the columns F_k of F and lambda_k = |F_k|,
//   column k of P += T n_k F_k / lambda_k   (normalised: T is force per unloaded area whatever the stretch)
//   column k of P += T n_k F_k              (as a second Piola-Kirchhoff stress S_kk = T n_k).
// At fixed T both derive from an energy, T sum n_k lambda_k or T/2 sum n_k lambda_k^2.
//
// Stiffness: a cell model gives its tension for the stretch it saw last. Held fixed while the tissue moves,
// that tension oscillates from step to step; with the stiffness of its attached crossbridges,
//   T = tension + stiffness (lambda_f - stretch_before),
// it does not (Regazzoni, Quarteroni, Comput Methods Appl Mech Eng 373:113506, 2021). The tangent gains
// dT/dF = stiffness F_f / lambda_f along the fibre, and is symmetric then only if n_s = n_n = 0.
#pragma once

#include <wiggers/tissue/laws/parts.hpp>

namespace wiggers {

// P: the type of what differs from point to point.
template <class P>
struct ActiveStressOf {
  P tension_Pa = 0.0, stiffness_Pa = 0.0, stretch_before = 1.0;
  double n_f = 1, n_s = 0, n_n = 0.4;  // parts of the tension along fibre, sheet, normal
  bool normalised = true;
};
using ActiveStress = ActiveStressOf<double>;

template <class T>
T stretch(const Matrix3<T>& F, int k) {
  return sqrt(T(F.m[0][k] * F.m[0][k] + F.m[1][k] * F.m[1][k] + F.m[2][k] * F.m[2][k]));
}

// The tension at this stretch of the fibre.
template <class P, class T>
T tension(const ActiveStressOf<P>& law, const T& fibre_stretch) {
  return law.tension_Pa + law.stiffness_Pa * (fibre_stretch - law.stretch_before);
}

template <class P, class T>
void add_stress(const ActiveStressOf<P>& law, const Matrix3<T>& F, Matrix3<T>& stress_P) {
  const double part[3] = {law.n_f, law.n_s, law.n_n};
  const T lambda_f = stretch(F, 0);
  const T now = tension(law, lambda_f);
  for (int k = 0; k < 3; ++k) {
    if (part[k] == 0) continue;
    T pull = part[k] * now;
    if (law.normalised) pull = pull / (k == 0 ? lambda_f : stretch(F, k));
    for (int i = 0; i < 3; ++i) stress_P.m[i][k] = stress_P.m[i][k] + pull * F.m[i][k];
  }
}

template <class P, class T>
void add_stress_and_tangent(const ActiveStressOf<P>& law, const Matrix3<T>& F, Matrix3<T>& stress_P,
                            T A[9][9]) {
  const double part[3] = {law.n_f, law.n_s, law.n_n};
  const T lambda_f = stretch(F, 0);
  const T now = tension(law, lambda_f);
  const T stiffening = law.stiffness_Pa / lambda_f;
  for (int k = 0; k < 3; ++k) {
    if (part[k] == 0) continue;
    T pull = part[k] * now, by_tension(part[k]), turning(0.0);
    if (law.normalised) {
      const T inverse = 1.0 / (k == 0 ? lambda_f : stretch(F, k));
      pull = pull * inverse;
      by_tension = part[k] * inverse;
      turning = pull * inverse * inverse;
    }
    const T coupling = by_tension * stiffening;
    for (int i = 0; i < 3; ++i) {
      T* row = A[3 * i + k];
      stress_P.m[i][k] = stress_P.m[i][k] + pull * F.m[i][k];
      row[3 * i + k] = row[3 * i + k] + pull;
      for (int j = 0; j < 3; ++j) {
        row[3 * j + k] = row[3 * j + k] - turning * F.m[i][k] * F.m[j][k];
        row[3 * j] = row[3 * j] + coupling * F.m[i][k] * F.m[j][0];
      }
    }
  }
}

// The energy at fixed tension, of which the stress derives where the stiffness is zero.
template <class P, class T>
T energy(const ActiveStressOf<P>& law, const Matrix3<T>& F) {
  const double part[3] = {law.n_f, law.n_s, law.n_n};
  T sum(0.0);
  for (int k = 0; k < 3; ++k) {
    if (part[k] == 0) continue;
    const T lambda = stretch(F, k);
    sum = sum + part[k] * (law.normalised ? lambda : T(0.5 * lambda * lambda));
  }
  return law.tension_Pa * sum;
}

// Viscosity of the wall: S = eta dE/dt, by the implicit Euler method dE/dt = (E - E_before) / dt. As it acts
// between tensors that do not see rotations, a turning wall feels nothing. Over a step it derives from the
// energy eta/(2 dt) |E - E_before|^2, so its tangent is symmetric.
template <class P>
struct WallViscosityOf {
  double eta_Pa_s = 0, dt_s = 1e-3;
  Matrix3<P> strain_before;  // green_strain at the step's start
};
using WallViscosity = WallViscosityOf<double>;

namespace wall_viscosity_terms {
template <class P, class T>
Matrix3<T> second_stress(const WallViscosityOf<P>& law, const Matrix3<T>& F) {
  const double factor = law.eta_Pa_s / law.dt_s;
  Matrix3<T> S = green_strain(F);
  for (int a = 0; a < 3; ++a)
    for (int b = 0; b < 3; ++b) S.m[a][b] = factor * (S.m[a][b] - law.strain_before.m[a][b]);
  return S;
}
}  // namespace wall_viscosity_terms

template <class P, class T>
T energy(const WallViscosityOf<P>& law, const Matrix3<T>& F) {
  Matrix3<T> E = green_strain(F);
  for (int a = 0; a < 3; ++a)
    for (int b = 0; b < 3; ++b) E.m[a][b] = E.m[a][b] - law.strain_before.m[a][b];
  return 0.5 * law.eta_Pa_s / law.dt_s * contract(E, E);
}

template <class P, class T>
void add_stress(const WallViscosityOf<P>& law, const Matrix3<T>& F, Matrix3<T>& stress_P) {
  add_scaled(T(1.0), F * wall_viscosity_terms::second_stress(law, F), stress_P);
}

template <class P, class T>
void add_stress_and_tangent(const WallViscosityOf<P>& law, const Matrix3<T>& F, Matrix3<T>& stress_P,
                            T A[9][9]) {
  const Matrix3<T> S = wall_viscosity_terms::second_stress(law, F);
  add_scaled(T(1.0), F * S, stress_P);
  const double half = 0.5 * law.eta_Pa_s / law.dt_s;
  const Matrix3<T> B = F * transpose(F);
  for (int i = 0; i < 3; ++i)
    for (int a = 0; a < 3; ++a) {
      T* row = A[3 * i + a];
      for (int j = 0; j < 3; ++j)
        for (int b = 0; b < 3; ++b) {
          T entry = half * F.m[i][b] * F.m[j][a];
          if (a == b) entry = entry + half * B.m[i][j];
          if (i == j) entry = entry + S.m[a][b];
          row[3 * j + b] = row[3 * j + b] + entry;
        }
    }
}

}  // namespace wiggers
