// TriSeg: left free wall (L), septum (S) and right free wall (R) as three spherical caps that meet in one
// circle.
//
// J. Lumens et al., "Three-wall segment (TriSeg) model describing mechanics and hemodynamics of ventricular
// interaction", Ann Biomed Eng 37:2234-2255, 2009. Lengths cm, volumes mL, stresses kPa, tensions kPa cm.
//
//            RV          x_i: signed height of cap i, positive towards the RV
//        .-----. R       y:   radius of the junction circle
//      /    S    \       Vm:  volume under the midwall cap, Am: its area, Cm: its curvature
//     |---( ------|      Vm_L = Vm_S - V_LV - (Vw_L + Vw_S)/2
//      \   LV    /       Vm_R = Vm_S + V_RV + (Vw_R + Vw_S)/2
//        '-----' L
//
// Inner unknowns (Vm_S, y): the tensions of the three caps balance at the junction, axially and radially.
#pragma once

#include <array>
#include <wiggers/core/numbers.hpp>
#include <wiggers/heart/walls/sphere.hpp>

namespace wiggers {

enum TriSegSegment { segment_L, segment_S, segment_R };
inline constexpr int n_segments = 3;

// Parameters may be plain, or dual to carry sensitivities.
template <class P>
struct CapGeometryOf {
  P wall_volume_mL = 0;
  P reference_area_cm2 = 0;  // midwall, unloaded
};
using CapGeometry = CapGeometryOf<double>;

template <class T>
struct Cap {
  T x, area, curvature, stretch;
  T z;  // ratio of wall thickness to radius, 3 Cm Vw / (2 Am)
};

// Height of a cap from its volume and the junction radius: the real root of x^3 + 3 y^2 x - 6 Vm/pi = 0,
// without cancellation for flat caps (the product of both cube roots is -y^2).
template <class T>
T cap_height(const T& Vm, const T& y) {
  const T q = abs(Vm) * (3.0 / 3.14159265358979323846);
  const T root = cbrt(T(q + sqrt(T(square(q) + square(cube(y))))));
  const T height = root - square(y) / root;
  return select(Vm < 0.0, T(-height), height);
}

template <class T, class P>
Cap<T> cap(const CapGeometryOf<P>& g, const T& Vm, const T& y) {
  constexpr double pi = 3.14159265358979323846;
  Cap<T> c;
  c.x = cap_height(Vm, y);
  const T square_sum = square(c.x) + square(y);
  c.area = pi * square_sum;
  c.curvature = 2.0 * c.x / square_sum;
  c.z = 1.5 * g.wall_volume_mL * c.curvature / c.area;
  const T z2 = square(c.z);
  c.stretch = exp(T(0.5 * log(T(c.area / g.reference_area_cm2)) - z2 / 12.0 - 0.019 * square(z2)));
  return c;
}

// Midwall tension of a cap under a fibre stress (kPa cm).
template <class T, class P>
T cap_tension(const CapGeometryOf<P>& g, const Cap<T>& c, const T& fibre_stress) {
  const T z2 = square(c.z);
  return g.wall_volume_mL * fibre_stress / (2.0 * c.area) * (1.0 + z2 / 3.0 + square(z2) / 5.0);
}

// Unloaded shape of both ventricles: a sphere around LV and septum, cut so that the septal cap has a height
// of `septum_height` radii, and an RV of the given volume. Returns wall volumes and the reference areas that
// make this shape free of pressure.
struct TriSegShape {
  double V_LV_mL = 85, V_RV_mL = 100;
  double septum_height = 0.66;
  std::array<double, n_segments> wall_volume_mL = {87, 43, 45};
};
struct TriSegUnloaded {
  std::array<CapGeometry, n_segments> caps;
  double Vm_S_mL = 0, y_cm = 0;
};
TriSegUnloaded triseg_unloaded(const TriSegShape& shape);

template <class T>
struct TriSegBalance {
  std::array<Cap<T>, n_segments> caps;
  T axial, radial;         // sums of the junction tensions (kPa cm): zero in equilibrium
  T p_LV, p_RV, p_septum;  // transmural pressures (kPa); p_septum equals p_LV - p_RV in equilibrium
};

// fibre_stress(segment, stretch) gives the stress of each wall (kPa).
template <class T, class P, class FibreStress>
TriSegBalance<T> triseg_balance(const std::array<CapGeometryOf<P>, n_segments>& g, const T& V_LV,
                                const T& V_RV, const T& Vm_S, const T& y, FibreStress fibre_stress) {
  TriSegBalance<T> b;
  const P half_L = 0.5 * (g[segment_L].wall_volume_mL + g[segment_S].wall_volume_mL);
  const P half_R = 0.5 * (g[segment_R].wall_volume_mL + g[segment_S].wall_volume_mL);
  const T Vm[n_segments] = {Vm_S - V_LV - half_L, Vm_S, Vm_S + V_RV + half_R};
  T transmural[n_segments];
  b.axial = b.radial = T(0.0);
  for (int i = 0; i < n_segments; ++i) {
    b.caps[i] = cap(g[i], Vm[i], y);
    const Cap<T>& c = b.caps[i];
    const T tension = cap_tension(g[i], c, T(fibre_stress(i, c.stretch)));
    const T square_sum = square(c.x) + square(y);
    const T axial = tension * 2.0 * c.x * y / square_sum;
    b.axial = b.axial + axial;
    b.radial = b.radial + tension * (square(y) - square(c.x)) / square_sum;
    transmural[i] = 2.0 * axial / y;
  }
  b.p_LV = -transmural[segment_L];
  b.p_RV = transmural[segment_R];
  b.p_septum = transmural[segment_S];
  return b;
}

}  // namespace wiggers
