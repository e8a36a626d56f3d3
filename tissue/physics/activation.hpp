// Active force in the tissue: a force model at every vertex of the myocardium, in SIMD batches, by the scheme
// of all walls (cellmodels/schemes/force_step.hpp).
//
// Per step of mechanics: calcium (its mean over the step), stretch at its start and the stretch's rate go in;
// tension and stiffness come out. The strength varies smoothly between the ventricles:
//   a(x) = a (xi + share (1 - xi)),  xi the normalised interventricular coordinate (1 left, 0 right).
#pragma once

#include <memory>
#include <span>
#include <vector>
#include <wiggers/cellmodels/models/calcium.hpp>
#include <wiggers/heart/walls/active_fibre.hpp>
#include <wiggers/tissue/fibres/fibres.hpp>
#include <wiggers/tissue/parallel/partition.hpp>

namespace wiggers {

struct ForceRegion {
  std::vector<int> tags;
  const CellModel* model = nullptr;  // of force
  std::vector<double> parameters;
  double rest_calcium_uM = 0;  // whose steady tension is removed
  double right_share = 1;      // strength of the right ventricle over that of the left
  bool active = true;          // false: no tension at all
  bool subtract_rest_tension = true;
};

class Activation {
 public:
  // Collective.
  Activation(const Partition& partition, const FibreField* fibres, std::vector<ForceRegion> regions,
             RateScheme rate, bool stabilise);
  ~Activation();

  const NodeSpace& nodes() const;  // vertices of the myocardium

  // Advances over dt (s). Per local node: calcium (uM), its mean over the step, stretch at its start and one
  // step (dt_before) earlier. Collective.
  void begin_step(double dt_s, std::span<const double> calcium_uM, std::span<const double> stretch,
                  std::span<const double> stretch_before, double dt_before_s);
  // Throws NumericalFailure if a step that ends with this stretch is beyond what the force model describes,
  // with the place. Collective.
  void require_in_range(std::span<const double> stretch) const;
  // The step is done; with the implicit rate the bridges move again with the rate it had.
  void accept(std::span<const double> stretch);
  void reject();

  // Pa, of local nodes.
  const std::vector<double>& tension() const;
  const std::vector<double>& stiffness() const;
  // Tension at the end of the last accepted step, the stabilising term included.
  const std::vector<double>& accepted_tension() const;

  void save(std::vector<double>& out) const;  // collective, partition-independent
  void restore(std::span<const double>& in);

 private:
  struct Implementation;
  std::unique_ptr<Implementation> me_;
};

}  // namespace wiggers
