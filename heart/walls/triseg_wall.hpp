// The TriSeg wall: both ventricles as one wall of three segments, each with its own cells and active fibre.
#pragma once

#include <array>
#include <memory>
#include <wiggers/heart/walls/active_fibre.hpp>
#include <wiggers/heart/walls/triseg.hpp>
#include <wiggers/heart/walls/wall.hpp>

namespace wiggers {

struct TriSegParameters {
  std::array<CapGeometry, n_segments> caps;  // L, S, R
  std::array<UsykLaw, n_segments> passive;
  double n_f = 1, n_n = 0.4;
};

inline constexpr std::array<std::string_view, n_segments> segment_names = {"left", "septum", "right"};

class TriSegWall final : public Wall {
 public:
  TriSegWall(TriSegParameters parameters, std::array<std::unique_ptr<ActiveFibre>, n_segments> fibres);

  std::span<const int> cavities() const override { return cavities_; }
  void start(const double& t, const double* volumes, double* pressures) override;
  void begin_step(const double& t, const double& dt) override;
  void linearise(const double* pressures, double* volumes, double* dV_dp) override;
  void update(const double* pressure_change, double share) override;
  void accept_step() override;
  void reject_step() override;
  void move_to(const double* volumes) override;
  void save(std::vector<double>& out) const override;
  void restore(std::span<const double>& in) override;
  std::vector<WallOutput> outputs() const override;
  void output_values(double* values) const override;

 private:
  // Unknowns of the wall: V_LV, V_RV, Vm_S (mL), y (cm).
  using Unknowns = std::array<double, 4>;
  template <class T>
  TriSegBalance<T> balance(const std::array<T, 4>& u) const;
  // Finds (Vm_S, y) for given volumes; throws NumericalFailure where there is no equilibrium.
  void solve_junction(Unknowns& u) const;

  std::array<int, 2> cavities_;
  TriSegParameters parameters_;
  std::array<std::unique_ptr<ActiveFibre>, n_segments> fibres_;
  Unknowns u_{};                                         // at the start of the step
  Unknowns newton_{};                                    // Newton's iterate
  std::array<double, 4> correction_{};                   // of the iterate at the present pressures
  std::array<std::array<double, 4>, 2> per_pressure_{};  // its change per unit of each pressure
  std::vector<double> backup_;
};

}  // namespace wiggers
