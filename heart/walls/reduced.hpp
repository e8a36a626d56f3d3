// The reduced wall: a thick-walled sphere whose tension comes from cell to calcium to force model.
//
//   ActiveFibre (tension at a stretch) -> sphere: p(V) = p_passive(V) + (n_f + n_n) tension(lambda(V)) G(V)
//                                                      + viscosity + surroundings
#pragma once

#include <array>
#include <memory>
#include <wiggers/heart/walls/active_fibre.hpp>
#include <wiggers/heart/walls/sphere.hpp>
#include <wiggers/heart/walls/wall.hpp>

namespace wiggers {

template <class P>
struct ReducedWallParametersOf {
  SphereWallOf<P> sphere;
  UsykLawOf<P> passive;
  P n_f = 1, n_n = 0.4;  // shares of the active stress along fibre and in-plane normal
  P viscosity_Pa_s = 0;
  // Robin surroundings: p_e = f (k (b - b0) + c b') (b0/b)^2, b the outer radius.
  P epicardial_stiffness_Pa_per_m = 0;  // f k
  P epicardial_damping_Pa_s_per_m = 0;  // f c
};
using ReducedWallParameters = ReducedWallParametersOf<double>;

// Numbers are plain, or dual to carry sensitivities.
template <class T>
class ReducedWallOf final : public WallOf<T> {
 public:
  ReducedWallOf(int chamber, ReducedWallParametersOf<T> parameters, ActiveFibreOf<T> fibre);

  std::span<const int> cavities() const override { return chamber_; }
  void start(const T& t, const T* volumes, T* pressures) override;
  void begin_step(const T& t, const T& dt) override;
  void linearise(const T* pressures, T* volumes, double* dV_dp) override;
  void update(const T* pressure_change, double share) override;
  void accept_step() override;
  void reject_step() override;
  void move_to(const T* volumes) override;
  void save(std::vector<T>& out) const override;
  void restore(std::span<const T>& in) override;
  std::vector<WallOutput> outputs() const override { return fibre_.outputs(); }
  void output_values(double* values) const override { fibre_.output_values(values); }

 private:
  T stretch_at(const T& V) const { return mean_stretch(parameters_.sphere, gauss_8(), V); }

  std::array<int, 1> chamber_;
  ReducedWallParametersOf<T> parameters_;
  ReducedWallParameters plain_;  // the same without derivatives, for Newton's slopes
  ActiveFibreOf<T> fibre_;
  T V_ = 0;
  // Of the current step.
  T dt_ = 1;
  T newton_V_ = 0;  // Newton's iterate
  double dV_dp_ = 0;
  T linearised_V_ = 0;
  std::vector<T> backup_;  // for reject_step
};
using ReducedWall = ReducedWallOf<double>;

}  // namespace wiggers
