#include <wiggers/heart/scene/kind_triseg.hpp>

namespace wiggers {

template <class T>
std::unique_ptr<WallOf<T>> TriSegNumbers<T>::make(const WallPlan& plan, const WallSiteOf<T>& site) const {
  std::array<std::unique_ptr<ActiveFibreOf<T>>, n_segments> segments;
  for (std::size_t i = 0; i < n_segments; ++i)
    segments[i] =
        std::make_unique<ActiveFibreOf<T>>(site.fibre(plan.fibres[i], activation_ms[i], strength_kPa[i],
                                                      fmt::format("{}.{}", plan.name, segment_names[i])));
  return std::make_unique<TriSegWallOf<T>>(wall, std::move(segments));
}
template struct TriSegNumbers<double>;
template struct TriSegNumbers<Tangent>;

WallKind triseg_wall_kind() {
  return {"triseg", {"ventricles"}, [](SettingsReader& table, const Scene& scene, WallPlan& plan) {
            TriSegNumbers<double> numbers;
            numbers.wall.n_f = table.number(scene_keys::n_f);
            numbers.wall.n_n = table.number(scene_keys::n_n);
            TriSegShape shape;
            shape.V_LV_mL = table.number(scene_keys::V0_LV, shape.V_LV_mL);
            shape.V_RV_mL = table.number(scene_keys::V0_RV, shape.V_RV_mL);
            shape.septum_height = table.number(scene_keys::septum_height, shape.septum_height);
            for (std::size_t i = 0; i < n_segments; ++i)
              shape.wall_volume_mL[i] =
                  table.table(segment_names[i]).number(scene_keys::Vw, shape.wall_volume_mL[i]);
            numbers.wall.caps = triseg_unloaded(shape).caps;
            for (std::size_t i = 0; i < n_segments; ++i) {
              SettingsReader& segment = table.table(segment_names[i]);
              plan.fibres.push_back(read_fibre(segment, scene));
              numbers.activation_ms[i] = plan.fibres[i].activation_ms;
              numbers.strength_kPa[i] = strength_of(plan.fibres[i]);
              CapGeometry& cap = numbers.wall.caps[i];
              cap.reference_area_cm2 = segment.number(scene_keys::reference_area, cap.reference_area_cm2);
              numbers.wall.passive[i] = read_usyk(segment);
            }
            plan.recipe = std::make_shared<RecipeOf<TriSegNumbers>>(numbers);
          }};
}

}  // namespace wiggers
