// Finite-strain mechanics of the tissue: the balance of forces and its tangent at a displacement.
//
//   rho (d - 2 d^n + d^{n-1})/dt^2 + P(d) : grad phi + supports + sum_k p_k int_k J F^-T N . phi = 0
//
// Linear or quadratic tetrahedra. Gradients are kept rotated into the fibre frame, so that the laws never
// meet it; all surface terms follow from the facets' own nodes, n da = x_xi (x) x_eta. Quadratic tetrahedra
// may take the volume ratio from its mean over the element (mean dilatation: a pressure, constant in each
// element, is the second field, eliminated within it), which removes locking when the tissue is nearly
// incompressible.
//
// A cavity's volume is V = -(1/3) int (x - origin) . n da over its surface, n out of the tissue; then
// dV/dd = -b, the load vector, also at the discrete level. SI units.
#pragma once

#include <array>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <vector>
#include <wiggers/tissue/fibres/fibres.hpp>
#include <wiggers/tissue/laws/laws.hpp>
#include <wiggers/tissue/parallel/algebra.hpp>

namespace wiggers {

// What holds a surface, per area: springs and dashpots along the unloaded normal, and in all directions.
struct Support {
  int tag = 0;
  double normal_stiffness = 0, normal_damping = 0;  // Pa/m, Pa s/m
  double full_stiffness = 0, full_damping = 0;
  std::array<bool, 3> fixed{};  // displacement held at its present value, by direction
};

struct PressureSurface {
  int tag = 0;
  Point3 origin{};  // of the volume functional: matters only for surfaces that are not closed
};

struct MechanicsSettings {
  int order = 1;
  bool mean_dilatation = false;
  int quadrature_degree = 0;  // 0: 1 for linear, 2 for quadratic tetrahedra, 5 for those with mean dilatation
  // Quadratic tetrahedra: where the middle of an edge of a surface's triangle belongs on the true surface;
  // none: straight edges. Given the surface tag and the middle of the straight edge.
  std::function<Point3(int tag, const Point3& middle)> curve;
  double density = 1e3;  // kg/m^3
  double viscosity_Pa_s = 0;
  double n_f = 1, n_s = 0, n_n = 0.4;  // shares of the active tension along fibre, sheet, normal
  bool normalised_tension = true;
  std::vector<Material> materials;
  std::vector<Support> supports;
  std::vector<PressureSurface> surfaces;
};

// Active tension and stiffness (Pa) at the four vertices of a local cell.
struct CellTension {
  std::array<double, 4> tension{}, stiffness{};
};

// Four fifths of tissue are water, by mass. Whatever is pressed out of it, its dry matter stays, some 15 % of
// the volume: a state with a smaller volume ratio is one of the law's formula, not of tissue.
inline constexpr double smallest_meaningful_J = 0.15;

struct Balance {
  double residual = 0;  // Euclidean norm, N
  bool finite = true;
  double smallest_J = 0;
  int worst_cell = -1;             // file number
  std::vector<double> volumes_m3;  // enclosed by each surface
};

class Mechanics {
 public:
  // Collective. `fibres` may be null: axes of space.
  Mechanics(const Partition& partition, const FibreField* fibres, MechanicsSettings settings);
  ~Mechanics();

  const NodeSpace& nodes() const;
  const MechanicsSettings& settings() const;
  const Partition& partition() const;

  // Displacement of local nodes (m), three numbers a node: now, and at the last two time levels.
  std::vector<double>& displacement();
  const std::vector<double>& displacement() const;
  std::vector<double>& last_displacement();
  std::vector<double>& displacement_before_last();

  // Length of the step of the next balances, and of the one before it, s; 0: static.
  void set_step(double dt_s, double dt_last_s = 0);
  // Active tension and stiffness of all local cells; the stretch they are referred to is that of
  // last_displacement(). Empty: none.
  void set_tension(std::vector<CellTension> tension);

  // Residual, load vectors and volumes at displacement(); with `tangent` also the matrix. Ghosts must be up
  // to date. Collective.
  Balance assemble(std::span<const double> pressures_Pa, bool tangent);
  // The smallest volume ratio over all points, and its cell, at a displacement. Collective.
  std::pair<double, int> smallest_volume_ratio(const std::vector<double>& displacement) const;

  const std::vector<double>& residual() const;         // own nodes
  const std::vector<double>& load(int surface) const;  // own nodes
  NodeMatrix& matrix();
  // Inner product over own nodes of all ranks.
  double product(const std::vector<double>& a, const std::vector<double>& b) const;

  // The step is done: displacement() becomes the last one.
  void accept();

  // |F f0|^2, |F s0|^2, |F n0|^2 and J of each local cell (its centroid), at displacement().
  std::vector<std::array<double, 4>> cell_deformation() const;

  // Throws NumericalFailure, with the cell, where an accepted state has a smaller volume ratio than tissue
  // can have.
  void require_meaningful(const Balance& balance) const;

  // "cell 1234 (volume tag 1) at (x, y, z) mm"
  std::string place_of_cell(int file_cell) const;

 private:
  struct Implementation;
  std::unique_ptr<Implementation> me_;
};

}  // namespace wiggers
