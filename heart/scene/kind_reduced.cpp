#include <cmath>
#include <wiggers/core/dual.hpp>
#include <wiggers/core/units.hpp>
#include <wiggers/heart/scene/kind_reduced.hpp>

namespace wiggers {

namespace {

class ContinuousSphere final : public ContinuousWall {
 public:
  explicit ContinuousSphere(const ReducedWallParameters& wall) : w_(wall) {}
  double pressure(double, double V, double dV_dt, double tension) const override {
    double p = passive_pressure(w_.sphere, w_.passive, gauss_8(), V);
    const double G = pressure_per_tension(w_.sphere, gauss_8(), V);
    p += (w_.n_f + w_.n_n) * tension * G;
    if (w_.viscosity_Pa_s > 0) {
      double slope = 0;
      stretch(V, &slope);
      p += 2e-3 * w_.viscosity_Pa_s * slope * dV_dt * G;
    }
    if (w_.epicardial_stiffness_Pa_per_m > 0 || w_.epicardial_damping_Pa_s_per_m > 0) {
      const auto radius = [](double mL) { return 0.01 * std::cbrt(mL * 3 / (4 * M_PI)); };
      const double b = radius(V + w_.sphere.Vw_mL), b0 = radius(w_.sphere.V0_mL + w_.sphere.Vw_mL);
      const double db_dt = b / (3 * (V + w_.sphere.Vw_mL)) * dV_dt;
      p += 1e-3 * (w_.epicardial_stiffness_Pa_per_m * (b - b0) + w_.epicardial_damping_Pa_s_per_m * db_dt) *
           square(b0 / b);
    }
    return p * units::mmHg_per_kPa;
  }
  bool damped() const override { return w_.viscosity_Pa_s > 0 || w_.epicardial_damping_Pa_s_per_m > 0; }
  double stretch(double V, double* slope) const override {
    const auto lambda = mean_stretch(w_.sphere, gauss_8(), Dual<1>::variable(V, 0));
    if (slope) *slope = lambda.derivative[0];
    return lambda.value;
  }

 private:
  ReducedWallParameters w_;
};

}  // namespace

template <class T>
std::unique_ptr<ContinuousWall> ReducedNumbers<T>::continuous(double) const {
  if constexpr (std::is_same_v<T, double>) return std::make_unique<ContinuousSphere>(wall);
  return nullptr;
}

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
