// A run: a scene brought to its limit cycle or through a number of beats, with checkpoints, a result file and
// a summary. Cells first (to their own limit cycles), then the coupled heart.
#pragma once

#include <filesystem>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>
#include <wiggers/core/progress.hpp>
#include <wiggers/heart/coupling/driver.hpp>
#include <wiggers/heart/indexes/indexes.hpp>
#include <wiggers/heart/run/paced_cells.hpp>
#include <wiggers/heart/scene/scene.hpp>

namespace wiggers {

struct RunCost {
  double cells_s = 0;
  double heart_s = 0;
  int beats = 0;  // of the coupled heart
};

// Where the fields of a wall or body of 3D tissue stand: RESULT.NAME.fields, beside the result.
std::filesystem::path fields_folder(const std::filesystem::path& result, const std::string& name);

class HeartRun {
 public:
  explicit HeartRun(Scene scene);

  // Paces the cells and builds the walls. Needed before advance(), unless resume() was called.
  void prepare(Progress::Style style);

  // Continues from a result file of the same scene (its [run] table may differ). Refuses another scene.
  void resume(const std::filesystem::path& result);

  // Runs to the scene's end. With a result path, checkpoints go there; on failure or interrupt the last good
  // state has been written before the exception leaves.
  void advance(Progress::Style style, const std::optional<std::filesystem::path>& result);

  const Scene& scene() const { return scene_; }
  HeartDriver& driver() { return *driver_; }
  const std::map<std::string, PacedCellType>& cells() const { return cells_; }
  const Table& trace() const { return trace_; }
  const BeatAudit& audit() const { return audit_; }
  const LimitCycleCertificate& certificate() const { return certificate_; }
  const RunCost& cost() const { return cost_; }
  // What walls report of their work, by wall and name.
  const std::map<std::string, std::map<std::string, WallFigure>>& wall_figures() const {
    return wall_figures_;
  }
  double blood_volume_drift_mL() const { return volume_drift_; }
  bool complete() const { return complete_; }
  // Whether trace() is a whole beat; a run of 3D tissue may be ended within one.
  bool has_whole_beat() const { return cost_.beats > 0 && !beat_; }
  // Present where there is a whole beat.
  BeatIndexes indexes() const;

 private:
  class Advance;  // one call of advance(): advance.cpp

  void build();
  ActiveFibre make_fibre(const FibrePlan& plan, double activation_ms, double strength_kPa,
                         const std::string& place) const;
  void write(const std::filesystem::path& path, const std::vector<double>& driver_state) const;
  void write_file(const std::filesystem::path& path, const std::vector<double>& driver_state) const;
  void checkpoint(const std::filesystem::path& path);
  void open_fields(const std::filesystem::path& result, bool resumed);
  void collect_wall_figures();
  double time_s() const;  // of the model, since the run's first beat

  Scene scene_;
  std::map<std::string, PacedCellType> cells_;
  std::unique_ptr<HeartDriver> driver_;
  std::unique_ptr<LimitCycleSearch> search_;
  Table trace_;
  BeatAudit audit_;
  LimitCycleCertificate certificate_;
  RunCost cost_;
  double initial_volume_ = 0;
  double volume_drift_ = 0;
  bool complete_ = false;
  // Beats are saved on the way, at moments of the model's time, and a failure goes back to there; else a beat
  // is the unit, and an extrapolated start that fails is given up for a plain one.
  bool long_beats_ = false;
  std::unique_ptr<BeatUnderWay> beat_;  // null between beats
  CirculationValues beat_start_{};
  std::map<std::string, std::map<std::string, WallFigure>> wall_figures_;
};

}  // namespace wiggers
