// The reduced wall: a thick-walled sphere whose tension comes from cell to calcium to RDQ20.
//
//   cell (CellSource) -> calcium -> RDQ20 (tension T, stiffness K) -> sphere: p(V; T, K)
//
// With the stabilised active stress (switch) the sphere sees T + K (lambda - lambda^n): attached bridges are
// stretched at once by the strain of the step, which removes the lag's instability. Without it T alone.
#pragma once

#include <array>
#include <memory>
#include <wiggers/cellmodels/rdq20_stepper.hpp>
#include <wiggers/heart/cell_source.hpp>
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
  bool active = true;                        // false: no active stress at all
  bool subtract_rest_tension = true;
  double rest_calcium_uM = 0.1;  // calcium whose steady tension counts as rest
  int regulatory_substeps = 40;
};

// How strain reaches the crossbridges in a step.
enum class RateScheme {
  lagged,    // the strain rate of the previous step; T + K (lambda - lambda^n) if stabilised
  implicit,  // bridges predicted without sliding, stiffness averaged over the step, repeated with the true
             // rate
  none       // no stretch-rate feedback: rate and K are zero
};
inline constexpr std::array<std::string_view, 3> rate_scheme_names = {"lagged", "implicit", "none"};

class ReducedWall final : public Wall {
 public:
  ReducedWall(int chamber, ReducedWallParameters parameters, std::vector<double> force_parameters,
              std::unique_ptr<CellSource> cell, RateScheme rate, bool stabilise_active_stress);

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
  std::vector<WallOutput> outputs() const override;
  void output_values(double* values) const override;

  // p(V) at the tension and stiffness of the current step (kPa), for tests and other solvers.
  template <class T>
  T pressure_kPa(const T& V) const;

  double mu1_rest() const { return mu1_rest_; }

 private:
  void advance_force(double dt);

  std::array<int, 1> chamber_;
  ReducedWallParameters parameters_;
  Rdq20Stepper force_;
  std::unique_ptr<CellSource> cell_;
  RateScheme rate_;
  bool stabilise_;
  double mu1_rest_ = 0;

  // State.
  std::array<double, 20> bridges_{};
  double V_ = 0;
  double stretch_ = 1, stretch_before_ = 1;  // at the start of the step, and one step earlier
  // Of the current step.
  double tension_ = 0, stiffness_ = 0;  // kPa, rest tension removed
  double dt_ = 1;
  double newton_V_ = 0;  // Newton's iterate
  double dV_dp_ = 0, linearised_V_ = 0;
  Rdq20::Regulation<double> regulation_{};  // implicit rate: to repeat the bridge step
  std::array<double, 4> moments_before_{};
  std::vector<double> backup_;  // for reject_step
};

}  // namespace wiggers
