#include <wiggers/heart/scene/kind_reduced.hpp>

namespace wiggers {

template <class T>
std::unique_ptr<WallOf<T>> ReducedNumbers<T>::make(const WallPlan& plan, const WallSiteOf<T>& site) const {
  return std::make_unique<ReducedWallOf<T>>(
      plan.cavities.front(), wall, site.fibre(plan.fibres.front(), activation_ms, strength_kPa, plan.name));
}
template struct ReducedNumbers<double>;
template struct ReducedNumbers<Tangent>;

WallKind reduced_wall_kind() {
  return {"reduced", {"LA", "LV", "RA", "RV"}, [](SettingsReader& table, const Scene& scene, WallPlan& plan) {
            plan.fibres = {read_fibre(table, scene)};
            ReducedNumbers<double> numbers;
            numbers.activation_ms = plan.fibres.front().activation_ms;
            numbers.strength_kPa = strength_of(plan.fibres.front());
            ReducedWallParameters& r = numbers.wall;
            r.sphere.V0_mL = table.number(scene_keys::V0);
            r.sphere.Vw_mL = table.number(scene_keys::Vw);
            r.passive = read_usyk(table);
            r.n_f = table.number(scene_keys::n_f);
            r.n_n = table.number(scene_keys::n_n);
            r.viscosity_Pa_s = table.number(scene_keys::viscosity);
            r.epicardial_stiffness_Pa_per_m = table.number(scene_keys::robin_k);
            r.epicardial_damping_Pa_s_per_m = table.number(scene_keys::robin_c);
            plan.recipe = std::make_shared<RecipeOf<ReducedNumbers>>(numbers);
          }};
}

}  // namespace wiggers
