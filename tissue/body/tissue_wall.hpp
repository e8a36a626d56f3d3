// A wall of 3D tissue: electrophysiology, active force and mechanics behind the seam that all walls share.
//
// One step of mechanics, in the founding paper's order: sub-steps of ionic cells and monodomain with the
// deformation frozen; the force model at the vertices with the new calcium; Newton for displacement and
// pressures, driven by heart's driver through linearise() and update(); then the deformed conductivities.
//
// Under MPI every rank runs the same driver; all calls here are collective.
#pragma once

#include <map>
#include <memory>
#include <string>
#include <vector>
#include <wiggers/heart/run/run.hpp>
#include <wiggers/heart/walls/wall.hpp>
#include <wiggers/tissue/body/plan.hpp>

namespace wiggers {

class TissueWall final : public Wall {
 public:
  TissueWall(const Scene& scene, const WallPlan& plan, const std::map<std::string, PacedCellType>& cells,
             MPI_Comm communicator);
  ~TissueWall() override;

  std::span<const int> cavities() const override;
  void start(const double& t, const double* volumes, double* pressures) override;
  void set_arterial_pressures(const double* systemic_and_pulmonary_mmHg) override;
  void begin_step(const double& t, const double& dt) override;
  void linearise(const double* pressures, double* volumes, double* dV_dp) override;
  double admissible_share(const double* pressure_change) override;
  void update(const double* pressure_change, double share) override;
  void confirm_step() override;
  std::string trouble() const override;
  bool balanced() const override;
  double volume_tolerance_mL() const override;
  bool may_halve_steps() const override { return true; }
  void accept_step() override;
  void reject_step() override;
  void move_to(const double* volumes) override;
  void save(std::vector<double>& out) const override;
  void restore(std::span<const double>& in) override;
  std::vector<WallOutput> outputs() const override;
  void output_values(double* values) const override;
  void open_fields(const std::string& folder, double resume_at_s) override;
  void write_fields(double time_s) override;
  void report(std::map<std::string, WallFigure>& figures) const override;

 private:
  struct Implementation;
  std::unique_ptr<Implementation> me_;
};

}  // namespace wiggers
