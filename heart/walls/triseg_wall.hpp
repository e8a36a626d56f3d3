// The TriSeg wall: both ventricles as one wall of three segments, each with its own cells and active fibre.
#pragma once

#include <array>
#include <memory>
#include <wiggers/heart/walls/active_fibre.hpp>
#include <wiggers/heart/walls/triseg.hpp>
#include <wiggers/heart/walls/wall.hpp>

namespace wiggers {

template <class P>
struct TriSegParametersOf {
  std::array<CapGeometryOf<P>, n_segments> caps;  // L, S, R
  std::array<UsykLawOf<P>, n_segments> passive;
  P n_f = 1, n_n = 0.4;
};
using TriSegParameters = TriSegParametersOf<double>;

inline constexpr std::array<std::string_view, n_segments> segment_names = {"left", "septum", "right"};

// Numbers are plain, or dual to carry sensitivities.
template <class T>
class TriSegWallOf final : public WallOf<T> {
 public:
  TriSegWallOf(TriSegParametersOf<T> parameters,
               std::array<std::unique_ptr<ActiveFibreOf<T>>, n_segments> fibres);

  std::span<const int> cavities() const override { return cavities_; }
  void start(const T& t, const T* volumes, T* pressures) override;
  void begin_step(const T& t, const T& dt) override;
  void linearise(const T* pressures, T* volumes, double* dV_dp) override;
  void update(const T* pressure_change, double share) override;
  void accept_step() override;
  void reject_step() override;
  void move_to(const T* volumes) override;
  void save(std::vector<T>& out) const override;
  void restore(std::span<const T>& in) override;
  std::vector<WallOutput> outputs() const override;
  void output_values(double* values) const override;

 private:
  // Unknowns of the wall: V_LV, V_RV, Vm_S (mL), y (cm).
  using Unknowns = std::array<T, 4>;
  TriSegBalance<T> balance(const Unknowns& u) const;
  // The same for plain numbers, with derivatives by the unknowns from `first` on.
  auto plain_balance(const Unknowns& u, int first) const;
  // Finds (Vm_S, y) for given volumes; throws NumericalFailure where there is no equilibrium.
  void solve_junction(Unknowns& u) const;

  std::array<int, 2> cavities_;
  TriSegParametersOf<T> parameters_;
  TriSegParameters plain_;  // the same without derivatives, for Newton's slopes
  std::array<std::unique_ptr<ActiveFibreOf<T>>, n_segments> fibres_;
  Unknowns u_{};                                         // at the start of the step
  Unknowns newton_{};                                    // Newton's iterate
  Unknowns correction_{};                                // of the iterate at the present pressures
  std::array<std::array<double, 4>, 2> per_pressure_{};  // its change per unit of each pressure
  std::vector<T> backup_;
};
using TriSegWall = TriSegWallOf<double>;

}  // namespace wiggers
