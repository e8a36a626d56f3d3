// Scenes: which chambers there are, how each is modelled, what drives them, how it is solved and for how
// long.
//
// A scene is a TOML file. `base = "other.toml"` starts from another scene (path relative to this one) and
// changes what is named. What is not named is not built. Unknown keys are refused with the nearest name.
#pragma once

#include <filesystem>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>
#include <wiggers/cellmodels/catalogue/catalogue.hpp>
#include <wiggers/cellmodels/models/calcium.hpp>
#include <wiggers/circulation/loop.hpp>
#include <wiggers/core/limit_cycle.hpp>
#include <wiggers/core/settings.hpp>
#include <wiggers/heart/indexes/indexes.hpp>
#include <wiggers/heart/walls/cell_source.hpp>
#include <wiggers/heart/walls/pericardium.hpp>
#include <wiggers/heart/walls/reduced.hpp>
#include <wiggers/heart/walls/triseg_wall.hpp>

namespace wiggers {

// One entry of [cells].
struct CellType {
  std::string name;
  const CellModel* ionic = nullptr;  // null: a prescribed calcium transient
  std::vector<double> ionic_parameters;
  CalciumShape transient;
  StimulusPulse stimulus;
  bool from_limit_cycle = true;  // start from the cell's limit cycle, or from its published state
  const CellModel* force = nullptr;
  std::vector<double> force_parameters;
  CalciumRescaling rescaling;
  double calcium_factor_period_s = 0;  // at which the factor was chosen; 0: not said
};

// A piece of wall with its own cells and activation.
struct FibrePlan {
  std::string cells;  // name of the entry of [cells]
  double activation_ms = 0;
  ActiveFibreSettings settings;
  const CellModel* force = nullptr;
  std::vector<double> force_parameters;  // of the cell type, with the piece's own strength
};

// What is computed: a heart in the closed loop, or one physics of a body of 3D tissue alone.
enum class Physics { heart, electrophysiology, mechanics };

class WallRecipe;  // wall_kind.hpp

struct WallPlan {
  std::string name;                          // as in the scene: LA, ..., ventricles, heart; or body
  std::vector<int> cavities;                 // chambers it encloses
  std::string kind;                          // of wall_kinds()
  std::vector<FibrePlan> fibres;             // none, one, or several pieces
  std::shared_ptr<const WallRecipe> recipe;  // makes it
  std::string files;  // a comment line for each file that it reads: its name and checksum
};

struct Scene {
  std::string name;  // of the file, for messages
  std::string title;
  std::filesystem::path folder;                    // of the scene file
  std::shared_ptr<const SettingsReader> settings;  // all that was read, defaults filled in
  Physics physics = Physics::heart;
  double period_s = 0.8;
  double body_surface_area_m2 = 1.9;
  std::map<std::string, CellType> cells;
  std::vector<WallPlan> walls;  // a body of tissue alone is the only one
  CirculationParameters circulation;
  Pericardium pericardium;
  CirculationValues initial{};
  double dt_s = 1e-3;
  double electrophysiology_substep_ms = 0;
  std::string electrophysiology_integrator;
  RegulationScheme regulation = RegulationScheme::forward_euler;
  double regulatory_substep_us = 0;  // forward_euler
  RateScheme rate = RateScheme::implicit;
  bool stabilise_active_stress = true;
  bool stabilise_volumes = true;
  bool implicit_inductors = false;
  bool until_limit_cycle = true;
  int beats = 0;
  LimitCycleSettings limit_cycle;
  double checkpoint_every_s = 1;
  double checkpoint_every_ms = 50;  // of the model's time, with 3D tissue
  double stop_after_ms = 0;         // of the model's time, with 3D tissue; 0: at the end of the beats
  // A body of tissue alone.
  double end_ms = 0;         // of electrophysiology
  double rows_every_ms = 1;  // of its result
  int load_steps = 10;       // of mechanics: equilibria on the way to the whole load, one row each
  std::vector<std::string> warnings;

  // The scene with all defaults filled in, files it reads by their checksum.
  std::string text() const;
};

// Reads and checks a scene file with overrides ("solver.dt_s=5e-4"). Refuses with InputError before any work.
Scene read_scene(const std::filesystem::path& path, const std::vector<std::string>& overrides);
Scene read_scene_text(const std::string& text, const std::string& name,
                      const std::vector<std::string>& overrides);
// The scene with other numbers, by their keys, checked as all scenes are. The blood's volume is a number of
// its own (circulation.initial.total_volume): it stays what it is when others change.
Scene with_numbers(const Scene& scene, const std::vector<std::pair<std::string, double>>& changes);

// When the atria (left, right) begin to contract (s); nothing for one that does not.
AtrialActivations atrial_activations_s(const Scene& scene);

}  // namespace wiggers
