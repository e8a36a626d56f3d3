// The monodomain equation on the conductive cells, with the ionic states in its nodes:
//
//   du/dt + I_ion/C_m - (1/J) div(J F^-1 D F^-T grad u) = I_app/C_m,   zero flux
//
// Linear or quadratic tetrahedra; BDF2 with ionic currents explicit (first step BDF1); one linear system a
// step. D is diagonal in the fibre frame, also pulled back: J sigma_k k0 k0^T / |F k0|^2. As F is constant in
// a cell, its matrices are six reference matrices times six numbers: nothing is integrated again when the
// tissue deforms.
//
// Ionic currents enter at the nodes and are interpolated (ICI); for verification, potential and ionic states
// can be interpolated to quadrature points instead and the currents evaluated there (SVI, many times dearer).
// Units: u mV, times s at the interface and ms inside, lengths m.
#pragma once

#include <memory>
#include <optional>
#include <span>
#include <vector>
#include <wiggers/cellmodels/population/population.hpp>
#include <wiggers/tissue/fibres/fibres.hpp>
#include <wiggers/tissue/parallel/algebra.hpp>

namespace wiggers {

// sigma / (chi C_m), m^2/s, along fibre, sheet and normal.
struct Conductivity {
  double fibre = 0, sheet = 0, normal = 0;
};

// Current that starts the excitation, in a ball or a box, once a beat.
struct Stimulus {
  enum class Shape { ball, box };
  Shape shape = Shape::ball;
  Point3 centre{};  // m; box: its lowest corner
  Point3 corner{};  // box: its highest corner
  double radius = 3e-3;
  double start_s = 0, duration_s = 3e-3;
  double amplitude_V_per_s = 25.71;
  bool holds(const Point3& point) const;
};

// Refuses stimuli that hold no node (order 2: vertices and middles of edges) of the conductive cells.
void require_stimuli_touch(const TetMesh& mesh, std::span<const Stimulus> stimuli, int order);

// What is excitable: the cells of some volume tags with one cell model.
struct IonicRegion {
  std::vector<int> tags;
  const CellModel* model = nullptr;
  std::vector<double> parameters;
  std::vector<double> initial_state;
  Conductivity conductivity, fast_layer;
};

enum class IonicCurrents { interpolated, at_quadrature_points };  // ICI, SVI
inline constexpr std::array<std::string_view, 2> ionic_currents_names = {"ici", "svi"};

struct MonodomainSettings {
  int order = 2;
  IonicCurrents currents = IonicCurrents::interpolated;
  double tau_s = 5e-5;
  double relative_tolerance = 1e-8;
  SolverKind solver = SolverKind::cg_ilu;
  double table_spacing_mV = 0.1;       // of the ionic models' functions of V; 0: no tables
  double fast_layer_thickness = 0.05;  // in endocardial distance; 0: none
  double activation_threshold_mV = -20;
};

struct MonodomainCost {
  double ionic_s = 0, right_side_s = 0, solve_s = 0, assembly_s = 0;
  long steps = 0, iterations = 0, assemblies = 0;
};

class Monodomain {
 public:
  // Collective. `fibres` may be empty: axes of space. Refuses regions and stimuli that touch nothing.
  // Stimuli are placed in `image` where one is given: the same mesh with other points, as it was seen under
  // load.
  Monodomain(const Partition& partition, const FibreField* fibres, MonodomainSettings settings,
             std::vector<IonicRegion> regions, std::vector<Stimulus> stimuli, const TetMesh* image = nullptr);
  ~Monodomain();

  // Conductivities and mass of the deformed tissue: for each local cell |F f0|^2, |F s0|^2, |F n0|^2, J.
  void set_deformation(std::span<const std::array<double, 4>> cells);

  // From t to t + dt, in equal steps not longer than tau. Times within the beat. Collective.
  void advance(double t_s, double dt_s);

  const NodeSpace& nodes() const;
  const double* potential_mV() const;  // of local nodes, ghosts included
  // A state of the cells' models by name (their unit), of local nodes; zero where a model has no such state.
  std::vector<double> state(std::string_view name) const;
  // Cytosolic calcium in uM, of local nodes.
  std::vector<double> calcium_uM() const;
  // When each own node was last activated, s within the beat; negative: not in this beat.
  const std::vector<double>& activation_s() const;
  void forget_activation();

  // - integral of D grad u . grad(1/|x - electrode|), mV m^2/s (no absolute scale): a pseudo-ECG lead.
  double lead(const Point3& electrode) const;

  const MonodomainCost& cost() const;

  // For tests: sets u and its history by position, and adds a source (mV/ms) by position and time instead of
  // cells.
  void prescribe(const std::function<double(const Point3&, double)>& exact, double t_s, double tau_s,
                 std::function<double(const Point3&, double)> source);

  void save(std::vector<double>& out) const;  // collective, partition-independent
  void restore(std::span<const double>& in);

 private:
  struct Implementation;
  std::unique_ptr<Implementation> me_;
};

}  // namespace wiggers
