#include <cmath>
#include <wiggers/heart/walls/triseg.hpp>

namespace wiggers {

TriSegUnloaded triseg_unloaded(const TriSegShape& shape) {
  TriSegUnloaded u;
  const auto& Vw = shape.wall_volume_mL;
  const double half_L = 0.5 * (Vw[segment_L] + Vw[segment_S]);
  const double half_R = 0.5 * (Vw[segment_R] + Vw[segment_S]);
  const double radius = std::cbrt(3 * (shape.V_LV_mL + half_L) / (4 * M_PI));
  const double height = shape.septum_height * radius;
  u.y_cm = std::sqrt(height * (2 * radius - height));
  u.Vm_S_mL = M_PI / 6 * height * (height * height + 3 * u.y_cm * u.y_cm);
  const double Vm[n_segments] = {u.Vm_S_mL - shape.V_LV_mL - half_L, u.Vm_S_mL,
                                 u.Vm_S_mL + shape.V_RV_mL + half_R};
  for (int i = 0; i < n_segments; ++i) {
    // With the area itself as reference the stretch is exp(-z^2/12 - 0.019 z^4); the reference that makes it
    // one.
    CapGeometry trial{Vw[i], 1.0};
    trial.reference_area_cm2 = cap(trial, Vm[i], u.y_cm).area;
    const double stretch = cap(trial, Vm[i], u.y_cm).stretch;
    u.caps[i] = {Vw[i], trial.reference_area_cm2 * stretch * stretch};
  }
  return u;
}

}  // namespace wiggers
