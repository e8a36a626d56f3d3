// TriSeg, both ventricles as one wall of three segments, in scenes: [walls.ventricles] with a table for each.
#pragma once

#include <fmt/format.h>

#include <wiggers/heart/scene/scene_keys.hpp>
#include <wiggers/heart/scene/wall_kind.hpp>
#include <wiggers/heart/walls/triseg_wall.hpp>

namespace wiggers {

template <class T>
struct TriSegNumbers {
  TriSegParametersOf<T> wall;
  std::array<T, n_segments> activation_ms{}, strength_kPa{};

  TriSegNumbers() = default;
  template <class U>
  explicit TriSegNumbers(const TriSegNumbers<U>&) {}

  template <class Self, class Visit>
  static void for_each(Self& self, const WallPlan& plan, Visit visit) {
    auto& w = self.wall;
    bool active = false;
    for (std::size_t i = 0; i < n_segments; ++i) {
      const FibrePlan& fibre = plan.fibres[i];
      active = active || fibre.settings.active;
      const auto number = [&](const Quantity& q, auto& field, bool present) {
        visit(fmt::format("{}.{}", segment_names[i], q.name), q, field, present);
      };
      number(scene_keys::activation, self.activation_ms[i], true);
      number(scene_keys::Vw, w.caps[i].wall_volume_mL, true);
      number(scene_keys::reference_area, w.caps[i].reference_area_cm2, true);
      number(scene_keys::stiffness, w.passive[i].C_kPa, true);
      number(scene_keys::b_ff, w.passive[i].b_ff, true);
      number(scene_keys::b_ss, w.passive[i].b_ss, true);
      number(scene_keys::b_nn, w.passive[i].b_nn, true);
      number(fibre.force->strength_key, self.strength_kPa[i], fibre.settings.active);
    }
    visit(scene_keys::n_f.name, scene_keys::n_f, w.n_f, active);
    visit(scene_keys::n_n.name, scene_keys::n_n, w.n_n, active);
  }
  std::unique_ptr<WallOf<T>> make(const WallPlan& plan, const WallSiteOf<T>& site) const;
  std::string activation_key(const WallPlan&, int) const { return ""; }  // no atria in it
};

WallKind triseg_wall_kind();

}  // namespace wiggers
