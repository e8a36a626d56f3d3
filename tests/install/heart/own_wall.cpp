// A 3D code's ventricle as a wall of the heart driver: balanced with the circulation by Newton in every step.
#include <cmath>
#include <cstdio>
#include <memory>
#include <wiggers/circulation/loop.hpp>
#include <wiggers/heart/coupling/driver.hpp>
#include <wiggers/heart/walls/elastance.hpp>

using namespace wiggers;

// Stands for the 3D code: the volume of its ventricle in balance with a pressure, and how it changes with it.
struct Ventricle3d {
  const ElastanceParameters e{2.75, 0.08, 0, 0.272, 0.136, 5};
  double stiffness = 0;  // at the end of the present step, mmHg/mL
  void activate(double t_s) { stiffness = elastance(e, t_s, 0.8); }
  double volume_mL(double pressure_mmHg) const { return pressure_mmHg / stiffness + e.V0; }
  double compliance() const { return 1 / stiffness; }  // mL/mmHg: of a 3D code by one linear solve
};

class Wall3d final : public Wall {
 public:
  std::span<const int> cavities() const override { return cavity_; }
  void start(const double& t, const double* volumes, double* pressures) override {
    ventricle_.activate(t);
    pressures[0] = (volumes[0] - ventricle_.e.V0) * ventricle_.stiffness;
  }
  void begin_step(const double& t, const double& dt) override { ventricle_.activate(t + dt); }
  void linearise(const double* pressures, double* volumes, double* dV_dp) override {
    volumes[0] = ventricle_.volume_mL(pressures[0]);
    dV_dp[0] = ventricle_.compliance();
  }
  void update(const double*, double) override {}  // a 3D code corrects its displacements here
  void accept_step() override {}                  // ... keeps them here
  void reject_step() override {}                  // ... goes back to those of the last accepted step
  void move_to(const double*) override {}
  void save(std::vector<double>&) const override {}  // everything that the next step depends on
  void restore(std::span<const double>&) override {}

 private:
  static constexpr int cavity_[] = {LV};
  Ventricle3d ventricle_;
};

// Ten beats with a wall as left ventricle; the driver afterwards.
HeartDriver beaten(std::unique_ptr<Wall> left_ventricle) {
  const Loop loop = find_circulation_set("wiggers-healthy-0d").loop;
  std::vector<std::unique_ptr<Wall>> walls;
  walls.push_back(std::move(left_ventricle));
  for (int chamber : {LA, RA, RV})
    walls.push_back(std::make_unique<ElastanceWall>(chamber, loop.elastance[chamber], loop.period_s));
  HeartDriver driver({loop.period_s, 1e-3}, loop.circulation, std::move(walls));
  driver.start(loop.initial);
  for (int beat = 0; beat < 10; ++beat) driver.beat(nullptr);
  return driver;
}

int main() {
  const HeartDriver own = beaten(std::make_unique<Wall3d>());
  const Loop loop = find_circulation_set("wiggers-healthy-0d").loop;
  const HeartDriver ours = beaten(std::make_unique<ElastanceWall>(LV, loop.elastance[LV], loop.period_s));
  double difference = 0;
  for (int k = 0; k < n_circulation_states; ++k)
    difference = std::max(difference, std::abs(own.values()[k] - ours.values()[k]));
  std::printf("LV %.2f mL, aorta %.2f mmHg; from the same wall of wiggers %.0e\n", own.values()[V_LV],
              own.values()[p_AR_SYS], difference);
  return difference < 1e-9 && own.values()[p_AR_SYS] > 60 ? 0 : 1;
}
