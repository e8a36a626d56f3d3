// A wall that is an elastance: p = E(t) (V - V0). The cheapest chamber.
#pragma once

#include <array>
#include <wiggers/circulation/elastance.hpp>
#include <wiggers/heart/walls/wall.hpp>

namespace wiggers {

template <class T>
class ElastanceWallOf final : public WallOf<T> {
 public:
  ElastanceWallOf(int chamber, ElastanceParametersOf<T> parameters, T period_s)
      : chamber_{chamber}, parameters_(parameters), period_(period_s) {}

  std::span<const int> cavities() const override { return chamber_; }
  void start(const T& t, const T* volumes, T* pressures) override {
    elastance_ = elastance(parameters_, t, period_);
    activation_ = value_of(elastance_activation(parameters_, t, period_));
    pressures[0] = elastance_ * (volumes[0] - parameters_.V0);
  }
  void begin_step(const T& t, const T& dt) override {
    elastance_ = elastance(parameters_, T(t + dt), period_);
    activation_ = value_of(elastance_activation(parameters_, T(t + dt), period_));
  }
  void linearise(const T* pressures, T* volumes, double* dV_dp) override {
    volumes[0] = pressures[0] / elastance_ + parameters_.V0;
    dV_dp[0] = 1 / value_of(elastance_);
  }
  void update(const T*, double) override {}
  void accept_step() override {}
  void reject_step() override {}
  void move_to(const T*) override {}
  // The activation of the last step is the first row of the next beat.
  void save(std::vector<T>& out) const override { out.insert(out.end(), {elastance_, T(activation_)}); }
  void restore(std::span<const T>& in) override {
    elastance_ = take_saved(in);
    activation_ = value_of(take_saved(in));
  }

  std::vector<WallOutput> outputs() const override {
    return {{"activation", "1", "activation of the elastance, 0 to 1"}};
  }
  void output_values(double* values) const override { values[0] = activation_; }

 private:
  std::array<int, 1> chamber_;
  ElastanceParametersOf<T> parameters_;
  T period_;
  T elastance_ = 1;
  double activation_ = 0;
};
using ElastanceWall = ElastanceWallOf<double>;

}  // namespace wiggers
