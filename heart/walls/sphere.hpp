// Thick-walled incompressible sphere with the tissue's constitutive laws. kPa, mL.
//
//   a shell is labelled by the unloaded volume xi in [V0, V0 + Vw] it encloses; deformed it encloses
//   v = V + xi - V0; both tangential stretches are lambda = (v/xi)^(1/3), the radial one lambda^-2.
//   Radial equilibrium:  p - p_e = integral (sigma_ff + sigma_nn - 2 sigma_ss) / (3 v) dxi
//
// The tangential stretch is equibiaxial, so the helix-angle distribution drops out of the pressure exactly:
// only n_f + n_n and n_s matter. (In 3D it does not quite: at a given pressure the volume is 0.5-4 % larger
// than the sphere's, depending on the helix. A modelling error of the reduction.) Passive law: Usyk, W = C/2
// (e^Q - 1), Q = b_ff E_ff^2 + b_nn E_nn^2 + b_ss E_ss^2.
#pragma once

#include <array>
#include <wiggers/core/numbers.hpp>

namespace wiggers {

// Parameters may be plain, or dual to carry sensitivities.
template <class P>
struct SphereWallOf {
  P V0_mL = 0;  // unloaded cavity volume
  P Vw_mL = 0;  // wall volume
};
using SphereWall = SphereWallOf<double>;

template <class P>
struct UsykLawOf {
  P C_kPa = 0.88;
  P b_ff = 8, b_ss = 6, b_nn = 3;
};
using UsykLaw = UsykLawOf<double>;

// Gauss-Legendre on [0, 1], weights summing to 1.
template <int n>
struct GaussRule {
  std::array<double, n> point, weight;
};
const GaussRule<8>& gauss_8();
const GaussRule<64>& gauss_64();

inline constexpr double usyk_exponent_cap = 60;  // overflow guard of Newton trials; far beyond any answer

template <class T, class P, int n>
T mean_stretch(const SphereWallOf<P>& wall, const GaussRule<n>& rule, const T& V) {
  T sum(0.0);
  for (int q = 0; q < n; ++q) {
    const P xi = wall.V0_mL + wall.Vw_mL * rule.point[q];
    sum = sum + rule.weight[q] * cbrt(T((V + (xi - wall.V0_mL)) / xi));
  }
  return sum;
}

// G(V): pressure per unit of in-plane active stress, p_act = (n_f + n_n) T G.
template <class T, class P, int n>
T pressure_per_tension(const SphereWallOf<P>& wall, const GaussRule<n>& rule, const T& V) {
  T sum(0.0);
  for (int q = 0; q < n; ++q) {
    const P xi = wall.V0_mL + wall.Vw_mL * rule.point[q];
    const T v = V + (xi - wall.V0_mL);
    sum = sum + (rule.weight[q] * wall.Vw_mL / 3.0) * cbrt(T(v / xi)) / v;
  }
  return sum;
}

// Exponent Q of the passive law at a stretch, capped.
template <class T, class P>
T usyk_exponent(const UsykLawOf<P>& law, const T& E_tangential, const T& E_radial) {
  const T Q = (law.b_ff + law.b_nn) * square(E_tangential) + law.b_ss * square(E_radial);
  return select(Q > usyk_exponent_cap, T(usyk_exponent_cap), Q);
}

// Fibre stress of the law under equibiaxial stretch, sigma_ff + sigma_nn - 2 sigma_ss (kPa):
// lambda^2 (S_f + S_n) - 2 lambda^-4 S_s with S_a = C e^Q b_a E_aa.
template <class T, class P>
T usyk_fibre_stress(const UsykLawOf<P>& law, const T& lambda2) {
  const T lambda4_inverse = 1.0 / square(lambda2);
  const T E_t = 0.5 * (lambda2 - 1.0);
  const T E_r = 0.5 * (lambda4_inverse - 1.0);
  return law.C_kPa * exp(usyk_exponent(law, E_t, E_r)) *
         ((law.b_ff + law.b_nn) * E_t * lambda2 - 2.0 * law.b_ss * E_r * lambda4_inverse);
}

template <class T, class P, int n>
T passive_pressure(const SphereWallOf<P>& wall, const UsykLawOf<P>& law, const GaussRule<n>& rule,
                   const T& V) {
  T sum(0.0);
  for (int q = 0; q < n; ++q) {
    const P xi = wall.V0_mL + wall.Vw_mL * rule.point[q];
    const T v = V + (xi - wall.V0_mL);
    const T stress = usyk_fibre_stress(law, square(T(cbrt(T(v / xi)))));
    sum = sum + (rule.weight[q] * wall.Vw_mL / 3.0) * stress / v;
  }
  return sum;
}

// Stored energy (kPa mL); its derivative by V is the passive pressure.
template <class T, class P, int n>
T passive_energy(const SphereWallOf<P>& wall, const UsykLawOf<P>& law, const GaussRule<n>& rule, const T& V) {
  T sum(0.0);
  for (int q = 0; q < n; ++q) {
    const P xi = wall.V0_mL + wall.Vw_mL * rule.point[q];
    const T v = V + (xi - wall.V0_mL);
    const T lambda2 = square(cbrt(T(v / xi)));
    const T E_t = 0.5 * (lambda2 - 1.0);
    const T E_r = 0.5 * (1.0 / square(lambda2) - 1.0);
    sum = sum + rule.weight[q] * wall.Vw_mL * 0.5 * law.C_kPa * (exp(usyk_exponent(law, E_t, E_r)) - 1.0);
  }
  return sum;
}

// Mean of the Cauchy part of the tangential stress for fibres at helix angles alpha(x), x in [0, 1] through
// the wall, with stresses s_f and s_n: the trace that enters the pressure. Kept to test the invariance to
// alpha.
template <class AlphaOfX>
double active_pressure_with_helix(const SphereWall& wall, const GaussRule<8>& rule, double V, double s_f,
                                  double s_n, AlphaOfX alpha);

// One-fibre relation: uniform fibre stress sigma_f gives p = (sigma_f/3) ln(1 + Vw/V), exactly.
template <class T>
T one_fibre_pressure(const T& fibre_stress, double Vw, const T& V) {
  return fibre_stress * log(T(1.0 + Vw / V)) * (1.0 / 3.0);
}
// The familiar approximation p = sigma_f / (1 + 3 V/Vw) (Arts, Bovendeerd); 4-9 % low.
template <class T>
T one_fibre_pressure_approximate(const T& fibre_stress, double Vw, const T& V) {
  return fibre_stress / (1.0 + 3.0 * V / Vw);
}

template <class AlphaOfX>
double active_pressure_with_helix(const SphereWall& wall, const GaussRule<8>& rule, double V, double s_f,
                                  double s_n, AlphaOfX alpha) {
  double sum = 0;
  for (int q = 0; q < 8; ++q) {
    const double xi = wall.V0_mL + wall.Vw_mL * rule.point[q];
    const double v = V + (xi - wall.V0_mL);
    const double lambda = std::cbrt(v / xi);
    const double c = std::cos(alpha(rule.point[q])), s = std::sin(alpha(rule.point[q]));
    // Fibre and in-plane normal in the tangential frame (circumferential, meridional).
    const double sigma_cc = lambda * (s_f * c * c + s_n * s * s);
    const double sigma_mm = lambda * (s_f * s * s + s_n * c * c);
    sum += rule.weight[q] * wall.Vw_mL * (sigma_cc + sigma_mm) / (3 * v);
  }
  return sum;
}

}  // namespace wiggers
