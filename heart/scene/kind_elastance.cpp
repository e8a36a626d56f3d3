#include <wiggers/circulation/loop.hpp>
#include <wiggers/heart/scene/kind_elastance.hpp>
#include <wiggers/heart/walls/elastance.hpp>

namespace wiggers {

namespace {

class ContinuousElastance final : public ContinuousWall {
 public:
  ContinuousElastance(const ElastanceParameters& elastance, double period_s)
      : e_(elastance), period_s_(period_s) {}
  double pressure(double t, double V, double, double) const override {
    return elastance(e_, t, period_s_) * (V - e_.V0);
  }
  std::vector<double> kinks() const override { return {e_.tC, e_.tC + e_.TC, e_.tC + e_.TC + e_.TR}; }

 private:
  ElastanceParameters e_;
  double period_s_;
};

}  // namespace

template <class T>
std::unique_ptr<ContinuousWall> ElastanceNumbers<T>::continuous(double period_s) const {
  if constexpr (std::is_same_v<T, double>) return std::make_unique<ContinuousElastance>(elastance, period_s);
  return nullptr;
}

template <class T>
std::unique_ptr<WallOf<T>> ElastanceNumbers<T>::make(const WallPlan& plan, const WallSiteOf<T>& site) const {
  return std::make_unique<ElastanceWallOf<T>>(plan.cavities.front(), elastance, site.period_s);
}
template struct ElastanceNumbers<double>;
template struct ElastanceNumbers<Tangent>;

WallKind elastance_wall_kind() {
  return {
      "elastance", {"LA", "LV", "RA", "RV"}, [](SettingsReader& table, const Scene& scene, WallPlan& plan) {
        const auto sets = circulation_set_names(true);
        const std::string set =
            table.choice("parameters", "wiggers-healthy-0d", sets, "circulation parameter set");
        const auto chamber = static_cast<std::size_t>(plan.cavities.front());
        ElastanceNumbers<double> numbers;
        numbers.elastance = read_elastance(table, find_circulation_set(set).loop.elastance[chamber]);
        check_elastance(numbers.elastance, scene.period_s, table.place("TC").c_str());
        plan.recipe = std::make_shared<RecipeOf<ElastanceNumbers>>(numbers);
      }};
}

}  // namespace wiggers
