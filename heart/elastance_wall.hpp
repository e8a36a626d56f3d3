// A wall that is an elastance: p = E(t) (V - V0). The cheapest chamber.
#pragma once

#include <array>
#include <wiggers/circulation/elastance.hpp>
#include <wiggers/heart/wall.hpp>

namespace wiggers {

class ElastanceWall final : public Wall {
 public:
  ElastanceWall(int chamber, ElastanceParameters parameters, double period_s)
      : chamber_{chamber}, parameters_(parameters), period_(period_s) {}

  std::span<const int> cavities() const override { return chamber_; }
  void start(double t, const double* volumes, double* pressures) override {
    elastance_ = elastance(parameters_, t, period_);
    activation_ = elastance_activation(parameters_, t, period_);
    pressures[0] = elastance_ * (volumes[0] - parameters_.V0);
  }
  void begin_step(double t, double dt) override {
    elastance_ = elastance(parameters_, t + dt, period_);
    activation_ = elastance_activation(parameters_, t + dt, period_);
  }
  void linearise(const double* pressures, double* volumes, double* dV_dp) override {
    volumes[0] = pressures[0] / elastance_ + parameters_.V0;
    dV_dp[0] = 1 / elastance_;
  }
  void update(const double*) override {}
  void accept_step() override {}
  void reject_step() override {}
  void move_to(const double*) override {}
  void save(std::vector<double>&) const override {}
  void restore(std::span<const double>&) override {}

  std::vector<WallOutput> outputs() const override {
    return {{"activation", "1", "activation of the elastance, 0 to 1"}};
  }
  void output_values(double* values) const override { values[0] = activation_; }

 private:
  std::array<int, 1> chamber_;
  ElastanceParameters parameters_;
  double period_;
  double elastance_ = 1, activation_ = 0;
};

}  // namespace wiggers
