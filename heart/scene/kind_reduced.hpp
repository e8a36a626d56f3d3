// Reduced walls, thick spheres driven by cells, in scenes.
#pragma once

#include <wiggers/heart/scene/scene_keys.hpp>
#include <wiggers/heart/scene/wall_kind.hpp>
#include <wiggers/heart/walls/reduced.hpp>

namespace wiggers {

template <class T>
struct ReducedNumbers {
  ReducedWallParametersOf<T> wall;
  T activation_ms = 0, strength_kPa = 0;

  ReducedNumbers() = default;
  template <class U>
  explicit ReducedNumbers(const ReducedNumbers<U>&) {}

  template <class Self, class Visit>
  static void for_each(Self& self, const WallPlan& plan, Visit visit) {
    auto& w = self.wall;
    const bool active = plan.fibres.front().settings.active;
    const Quantity& strength = plan.fibres.front().force->strength_key;
    const auto number = [&](const Quantity& q, auto& field, bool present) {
      visit(q.name, q, field, present);
    };
    number(scene_keys::activation, self.activation_ms, true);
    number(scene_keys::V0, w.sphere.V0_mL, true);
    number(scene_keys::Vw, w.sphere.Vw_mL, true);
    number(scene_keys::stiffness, w.passive.C_kPa, true);
    number(scene_keys::b_ff, w.passive.b_ff, true);
    number(scene_keys::b_ss, w.passive.b_ss, true);
    number(scene_keys::b_nn, w.passive.b_nn, true);
    number(strength, self.strength_kPa, active);
    number(scene_keys::n_f, w.n_f, active);
    number(scene_keys::n_n, w.n_n, active);
    // Terms that the scene leaves out (zero) stay out.
    number(scene_keys::viscosity, w.viscosity_Pa_s, w.viscosity_Pa_s > 0.0);
    number(scene_keys::robin_k, w.epicardial_stiffness_Pa_per_m, w.epicardial_stiffness_Pa_per_m > 0.0);
    number(scene_keys::robin_c, w.epicardial_damping_Pa_s_per_m, w.epicardial_damping_Pa_s_per_m > 0.0);
  }
  std::unique_ptr<WallOf<T>> make(const WallPlan& plan, const WallSiteOf<T>& site) const;
  std::unique_ptr<ContinuousWall> continuous(double period_s) const;
  std::string activation_key(const WallPlan& plan, int) const {
    return plan.fibres.front().settings.active ? std::string(scene_keys::activation.name) : "";
  }
};

WallKind reduced_wall_kind();

}  // namespace wiggers
