// The recipe of heart/scene/wall_kind.hpp, followed: a kind of wall that this project does not have, a bag of
// constant stiffness, in scenes, runs, studies and sensitivities.
#include <catch2/catch.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/heart/run/monolithic.hpp>
#include <wiggers/heart/run/run.hpp>
#include <wiggers/heart/scene/wall_kind.hpp>
#include <wiggers/heart/study/heart_study.hpp>

using namespace wiggers;

namespace {

constexpr Quantity stiffness{"stiffness_mmHg_per_mL", "mmHg/mL", 0.15, 0.01, 10, "stiffness of the bag"};
constexpr Quantity slack{"slack_volume_mL", "mL", 10, 0, 100, "volume without pressure"};

// 1. The wall.
template <class T>
class Bag final : public WallOf<T> {
 public:
  Bag(int chamber, T E, T V0) : chamber_{chamber}, E_(E), V0_(V0) {}
  std::span<const int> cavities() const override { return chamber_; }
  void start(const T&, const T* volumes, T* pressures) override { pressures[0] = E_ * (volumes[0] - V0_); }
  void begin_step(const T&, const T&) override {}
  void linearise(const T* pressures, T* volumes, double* dV_dp) override {
    volumes[0] = pressures[0] / E_ + V0_;
    dV_dp[0] = 1 / value_of(E_);
  }
  void update(const T*, double) override {}
  void accept_step() override {}
  void reject_step() override {}
  void move_to(const T*) override {}
  void save(std::vector<T>&) const override {}
  void restore(std::span<const T>&) override {}

 private:
  std::array<int, 1> chamber_;
  T E_, V0_;
};

// 2. Its numbers.
template <class T>
struct BagNumbers {
  T E = 0, V0 = 0;
  BagNumbers() = default;
  template <class U>
  explicit BagNumbers(const BagNumbers<U>&) {}
  template <class Self, class Visit>
  static void for_each(Self& self, const WallPlan&, Visit visit) {
    visit(stiffness.name, stiffness, self.E, true);
    visit(slack.name, slack, self.V0, true);
  }
  std::unique_ptr<WallOf<T>> make(const WallPlan& plan, const WallSiteOf<T>&) const {
    return std::make_unique<Bag<T>>(plan.cavities.front(), E, V0);
  }
  std::string activation_key(const WallPlan&, int) const { return ""; }
};

// 3. How it is read.
WallKind bag_wall_kind() {
  return {"bag", {"LA", "RA"}, [](SettingsReader& table, const Scene&, WallPlan& plan) {
            BagNumbers<double> numbers;
            numbers.E = table.number(stiffness);
            numbers.V0 = table.number(slack);
            plan.recipe = std::make_shared<RecipeOf<BagNumbers>>(numbers);
          }};
}

Scene scene_with_bags(std::vector<std::string> more = {}) {
  register_wall_kind(bag_wall_kind());
  more.insert(more.begin(),
              {"walls.LA.kind=bag", "walls.RA.kind=bag", "walls.RA.stiffness_mmHg_per_mL=0.08"});
  return read_scene(std::string(WIGGERS_TEST_DATA) + "/../../scenes/elastance_healthy.toml", more);
}

}  // namespace

TEST_CASE("a kind of wall of one's own is read, run and refused as the others are") {
  const Scene scene = scene_with_bags();
  CHECK(scene.text().find("stiffness_mmHg_per_mL = 0.08") != std::string::npos);
  CHECK_THROWS_WITH(scene_with_bags({"walls.LA.slack_volume_mL=500"}), Catch::Contains("slack_volume_mL"));
  CHECK_THROWS_WITH(scene_with_bags({"walls.LA.slak_volume_mL=5"}), Catch::Contains("slack_volume_mL"));
  CHECK_THROWS_WITH(scene_with_bags({"walls.LV.kind=bag"}), Catch::Contains("elastance"));
  HeartRun run(scene);
  run.prepare(Progress::Style::quiet);
  run.advance(Progress::Style::quiet, {});
  REQUIRE(run.certificate().good());
  const BeatIndexes b = run.indexes();
  CHECK(b.ventricle[0].SV_mL > 30);
  CHECK_FALSE(b.atrium[0].VpreAC_mL.has_value());  // it does not contract
  // Pressure and volume of a bag are on its line.
  CHECK(b.atrium[0].pressure_mean_mmHg > 0.15 * (b.atrium[0].Vmin_mL - 10));
  CHECK(b.atrium[0].pressure_mean_mmHg < 0.15 * (b.atrium[0].Vmax_mL - 10));
  CHECK_THROWS_WITH(MonolithicHeart(scene, {}), Catch::Contains("bag"));
}

TEST_CASE("a kind of wall of one's own has parameters and sensitivities") {
  HeartStudy heart(scene_with_bags({"solver.dt_s=2e-3"}));
  const std::string name = "walls.LA.stiffness_mmHg_per_mL";
  HeartState state = heart.to_limit_cycle({}, nullptr);
  REQUIRE(state.certificate.good());
  const FixedPointDerivatives newton = heart.newton_at(state);
  state = heart.refined(state, newton);
  const Sensitivities table = heart.sensitivities(state, {name, "walls.RA.slack_volume_mL"});
  const auto output = [&](const HeartStudy& changed_from, double value) {
    HeartStudy changed = changed_from.copy();
    changed.set_parameter(name, value);
    return changed.indexes(changed.refined(state, newton)).ventricle[0].EDV_mL;
  };
  const double difference =
      (output(heart, 0.15 * (1 + 1e-4)) - output(heart, 0.15 * (1 - 1e-4))) / (2e-4 * 0.15);
  const auto row = static_cast<std::size_t>(
      std::find(table.outputs.begin(), table.outputs.end(), "LV.EDV_mL") - table.outputs.begin());
  REQUIRE(row < table.outputs.size());
  CHECK(std::abs(difference) > 1);
  CHECK(table.derivatives[2 * row] == Approx(difference).epsilon(1e-5));
}
