// The reduced wall: a thick-walled sphere whose tension comes from cell to calcium to RDQ20.
//
//   ActiveFibre (tension at a stretch) -> sphere: p(V) = p_passive(V) + (n_f + n_n) tension(lambda(V)) G(V)
//                                                      + viscosity + surroundings
#pragma once

#include <array>
#include <memory>
#include <wiggers/heart/active_fibre.hpp>
#include <wiggers/heart/sphere.hpp>
#include <wiggers/heart/wall.hpp>

namespace wiggers {

struct ReducedWallParameters {
  SphereWall sphere;
  UsykLaw passive;
  double n_f = 1, n_n = 0.4;  // shares of the active stress along fibre and in-plane normal
  double viscosity_Pa_s = 0;
  // Robin surroundings: p_e = f (k (b - b0) + c b') (b0/b)^2, b the outer radius.
  double epicardial_stiffness_Pa_per_m = 0;  // f k
  double epicardial_damping_Pa_s_per_m = 0;  // f c
};

class ReducedWall final : public Wall {
 public:
  ReducedWall(int chamber, ReducedWallParameters parameters, ActiveFibre fibre);

  std::span<const int> cavities() const override { return chamber_; }
  void start(double t, const double* volumes, double* pressures) override;
  void begin_step(double t, double dt) override;
  void linearise(const double* pressures, double* volumes, double* dV_dp) override;
  void update(const double* pressure_change) override;
  void accept_step() override;
  void reject_step() override;
  void move_to(const double* volumes) override;
  void save(std::vector<double>& out) const override;
  void restore(std::span<const double>& in) override;
  std::vector<WallOutput> outputs() const override { return fibre_.outputs(); }
  void output_values(double* values) const override { fibre_.output_values(values); }

 private:
  // p(V) at the tension of the current step (kPa).
  template <class T>
  T pressure_kPa(const T& V) const;

  std::array<int, 1> chamber_;
  ReducedWallParameters parameters_;
  ActiveFibre fibre_;
  double V_ = 0;
  // Of the current step.
  double dt_ = 1;
  double newton_V_ = 0;  // Newton's iterate
  double dV_dp_ = 0, linearised_V_ = 0;
  std::vector<double> backup_;  // for reject_step
};

}  // namespace wiggers
