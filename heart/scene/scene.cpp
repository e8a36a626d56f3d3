#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <wiggers/circulation/stiffness.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/units.hpp>
#include <wiggers/heart/indexes/indexes.hpp>
#include <wiggers/heart/scene/scene.hpp>
#include <wiggers/heart/scene/scene_keys.hpp>
#include <wiggers/heart/scene/tissue_services.hpp>
#include <wiggers/heart/scene/wall_kind.hpp>

namespace wiggers {

namespace {

std::vector<std::string> as_strings(auto&& names) { return {names.begin(), names.end()}; }

// Overrides of a model's parameters by name, each with its own range.
void read_parameters(SettingsReader& table, const CellModel& model, std::vector<double>& values) {
  for (const std::string& key : table.keys()) {
    std::size_t index = 0;
    try {
      index = require_index(model.parameters, fmt::format("parameter of {}", model.name), key);
    } catch (const InputError& error) {
      throw InputError(fmt::format("{}: {}", table.place(key), error.what()));
    }
    values[index] = table.number(model.parameters[index], values[index]);
  }
}

CellType read_cells(SettingsReader& table, const std::string& name) {
  CellType cell;
  cell.name = name;
  std::vector<std::string> kinds;
  for (const CellModel* model : catalogue())
    if (model->is_ionic()) kinds.emplace_back(model->name);
  kinds.emplace_back("transient");
  if (!table.has("ionic"))
    throw InputError(
        fmt::format("{} is missing; choose one of {}", table.place("ionic"), fmt::join(kinds, ", ")));
  const std::string ionic = table.choice("ionic", "", kinds, "ionic model");
  if (ionic == "transient") {
    cell.transient.rest_uM = table.number(scene_keys::calcium_rest);
    cell.transient.peak_uM = table.number(scene_keys::calcium_peak);
    cell.transient.rise_ms = table.number(scene_keys::rise);
    cell.transient.decay_ms = table.number(scene_keys::decay);
    if (cell.transient.rise_ms >= cell.transient.decay_ms)
      throw InputError(fmt::format("{} = {} must be shorter than decay_ms = {}", table.place("rise_ms"),
                                   cell.transient.rise_ms, cell.transient.decay_ms));
    if (cell.transient.peak_uM < cell.transient.rest_uM)
      throw InputError(fmt::format("{} = {} is below calcium_rest_uM = {}", table.place("calcium_peak_uM"),
                                   cell.transient.peak_uM, cell.transient.rest_uM));
  } else {
    cell.ionic = &find_model(ionic);
    std::vector<std::string> sets;
    for (const ParameterSet& set : cell.ionic->parameter_sets) sets.emplace_back(set.name);
    cell.ionic_parameters =
        cell.ionic->parameter_values(table.choice("ionic_parameters", "default", sets, "parameter set"));
    if (table.has("ionic_changes"))
      read_parameters(table.table("ionic_changes"), *cell.ionic, cell.ionic_parameters);
    cell.stimulus.amplitude_A_per_F = table.number(stimulus_amplitude_quantity);
    cell.stimulus.duration_ms = table.number(stimulus_duration_quantity);
    const std::vector<std::string> starts = {"limit-cycle", "published"};
    cell.from_limit_cycle =
        table.choice("start", "limit-cycle", starts, "start of the cells") == "limit-cycle";
    if (cell.from_limit_cycle && !cell.ionic->keeps_invariants(cell.ionic_parameters.data()))
      throw InputError(
          fmt::format("{}: these parameters book the stimulus charge to no ion, so the cell has no limit "
                      "cycle; use start = "
                      "\"published\" or another parameter set",
                      table.place("start")));
    cell.rescaling.factor = table.number(scene_keys::calcium_factor);
    cell.calcium_factor_period_s = table.number(scene_keys::calcium_factor_period);
    const std::string reading = table.choice("calcium_reading", calcium_reading_names[0],
                                             as_strings(calcium_reading_names), "calcium reading");
    cell.rescaling.reading = reading == "peak" ? CalciumReading::peak : CalciumReading::scaled;
  }
  std::vector<std::string> forces;
  for (const CellModel* model : force_models()) forces.emplace_back(model->name);
  cell.force = &find_model(table.choice("force", forces.front(), forces, "force model"));
  const CellModel& force = *cell.force;
  std::vector<std::string> sets;
  for (const ParameterSet& set : force.parameter_sets) sets.emplace_back(set.name);
  cell.force_parameters =
      force.parameter_values(table.choice("parameters", sets.front(), sets, "force parameter set"));
  if (table.has("force_changes")) read_parameters(table.table("force_changes"), force, cell.force_parameters);
  return cell;
}

}  // namespace

// Which cells a piece of wall has, and when they are stimulated.
FibrePlan read_fibre_cells(SettingsReader& table, const Scene& scene) {
  const double period_s = scene.period_s;
  const std::map<std::string, CellType>& cells = scene.cells;
  FibrePlan fibre;
  std::vector<std::string> known;
  for (const auto& entry : cells) known.push_back(entry.first);
  if (known.empty())
    throw InputError(
        fmt::format("{}: this wall needs an entry of [cells] to drive it", table.place("cells")));
  fibre.cells = table.choice("cells", known.front(), known, "entry of [cells]");
  fibre.activation_ms = table.number(scene_keys::activation);
  if (fibre.activation_ms >= period_s * 1e3)
    throw InputError(fmt::format("{} = {} ms is not within the period of {} s", table.place("activation_ms"),
                                 fibre.activation_ms, period_s));
  return fibre;
}

FibrePlan read_fibre(SettingsReader& table, const Scene& scene) {
  const std::map<std::string, CellType>& cells = scene.cells;
  FibrePlan fibre = read_fibre_cells(table, scene);
  if (const CellModel* ionic = cells.at(fibre.cells).ionic; ionic && !ionic->has_calcium())
    throw InputError(fmt::format(
        "{}: {} has no calcium that could drive a force model; use cells of another ionic model, or "
        "\"transient\"",
        table.place("cells"), ionic->name));
  fibre.settings.active = table.flag("active", true);
  fibre.settings.subtract_rest_tension = table.flag("subtract_rest_tension", true);
  fibre.force = cells.at(fibre.cells).force;
  fibre.force_parameters = cells.at(fibre.cells).force_parameters;
  double& strength = fibre.force_parameters[static_cast<std::size_t>(fibre.force->parameter(Role::strength))];
  strength = table.number(fibre.force->strength_key, strength);
  // The force model must hold at least at the length that strain is referred to.
  try {
    const auto SL0 = static_cast<std::size_t>(fibre.force->parameter(Role::reference_length));
    check_sarcomere_length(*fibre.force, fibre.force_parameters, fibre.force_parameters[SL0]);
  } catch (const InputError& error) {
    throw InputError(fmt::format("{}: cells {}: {}", table.place("cells"), fibre.cells, error.what()));
  }
  return fibre;
}

UsykLaw read_usyk(SettingsReader& table) {
  return {table.number(scene_keys::stiffness), table.number(scene_keys::b_ff), table.number(scene_keys::b_ss),
          table.number(scene_keys::b_nn)};
}

namespace {

// Changes of `over` on top of `base`, table by table.
void merge(SettingsTable& base, const SettingsTable& over) {
  for (const auto& [key, value] : over.entries) {
    const auto* table = std::get_if<std::shared_ptr<SettingsTable>>(&value.data);
    const auto it = base.entries.find(key);
    if (table && it != base.entries.end())
      if (auto* below = std::get_if<std::shared_ptr<SettingsTable>>(&it->second.data)) {
        // A wall or cell of another kind shares no keys with the old one: it replaces it.
        const auto kind_of = [](const SettingsTable& t, const char* name) {
          const auto entry = t.entries.find(name);
          const std::string* text =
              entry == t.entries.end() ? nullptr : std::get_if<std::string>(&entry->second.data);
          return text ? *text : std::string();
        };
        bool replaced = false;
        for (const char* name : {"kind", "ionic"}) {
          const std::string now = kind_of(**table, name);
          replaced = replaced || (!now.empty() && now != kind_of(**below, name));
        }
        if (!replaced) {
          merge(**below, **table);
          continue;
        }
      }
    base.entries[key] = value;
  }
}

// Overrides from the command line. Another kind of wall or cell replaces its table, as in a scene with a
// base; a number of beats implies that the run ends after them.
void apply(SettingsTable& table, const std::vector<std::string>& overrides) {
  bool end_given = false;
  for (const std::string& assignment : overrides)
    end_given = end_given || assignment.starts_with("run.until=");
  for (const std::string& assignment : overrides) {
    const std::string key = assignment.substr(0, assignment.find('='));
    if (key.ends_with(".kind") || key.ends_with(".ionic")) {
      SettingsTable change;
      override_setting(change, assignment);
      merge(table, change);
    } else {
      override_setting(table, assignment);
      if (key == "run.beats" && !end_given) override_setting(table, "run.until=beats");
    }
  }
}

SettingsTable* table_in(const SettingsTable& table, const std::string& name) {
  const auto it = table.entries.find(name);
  if (it == table.entries.end()) return nullptr;
  const auto* found = std::get_if<std::shared_ptr<SettingsTable>>(&it->second.data);
  return found ? found->get() : nullptr;
}

// What the changes say in other words than the base is taken out of the base: a wall of several cavities
// takes the place of the walls for each of them, and the other way round; a number of beats that of another
// end.
void make_room(SettingsTable& base, const SettingsTable& changes) {
  const SettingsTable* run = table_in(changes, "run");
  if (SettingsTable* below = table_in(base, "run"); run && below) {
    const bool beats = run->entries.contains("beats"), until = run->entries.contains("until");
    if (beats && !until) below->entries.erase("until");
    if (until && !beats) {
      const auto* end = std::get_if<std::string>(&run->entries.at("until").data);
      if (end && *end == "limit-cycle") below->entries.erase("beats");
    }
  }
  SettingsTable* there = table_in(base, "walls");
  const SettingsTable* named = table_in(changes, "walls");
  if (!there || !named) return;
  for (const WallPlace& whole : wall_places())
    for (const WallPlace& part : wall_places()) {
      const bool is_part = part.cavities.size() < whole.cavities.size() &&
                           std::includes(whole.cavities.begin(), whole.cavities.end(), part.cavities.begin(),
                                         part.cavities.end());
      if (!is_part) continue;
      const bool whole_named = named->entries.contains(whole.name),
                 part_named = named->entries.contains(part.name);
      if (whole_named && !part_named) there->entries.erase(part.name);
      if (!whole_named && part_named) there->entries.erase(whole.name);
    }
}

std::shared_ptr<SettingsTable> with_base(std::shared_ptr<SettingsTable> table,
                                         const std::filesystem::path& file, int depth) {
  const auto it = table->entries.find("base");
  if (it == table->entries.end()) return table;
  const auto* name = std::get_if<std::string>(&it->second.data);
  if (!name) throw InputError(fmt::format("{}: base must name a scene file", file.string()));
  if (depth > 8)
    throw InputError(fmt::format("{}: scenes name one another as base in a circle", file.string()));
  const std::filesystem::path base_file = file.parent_path() / *name;
  auto base = with_base(parse_settings_file(base_file), base_file, depth + 1);
  SettingsTable changes = *table;
  changes.entries.erase("base");
  make_room(*base, changes);
  merge(*base, changes);
  return base;
}

// Step and scheme of single cells, which bring tissue and walls to their starting state.
void read_cell_solver(SettingsReader& solver, Scene& scene) {
  scene.electrophysiology_substep_ms = solver.number(scene_keys::substep);
  scene.electrophysiology_integrator = solver.choice("electrophysiology_integrator", "rush-larsen-2",
                                                     as_strings(fixed_step_integrators()), "integrator");
}

// Cells that no wall uses are not built.
void leave_out_unused_cells(Scene& scene) {
  std::erase_if(scene.cells, [&](const auto& entry) {
    bool used = false;
    for (const WallPlan& wall : scene.walls)
      for (const FibrePlan& fibre : wall.fibres) used = used || fibre.cells == entry.first;
    if (!used)
      scene.warnings.push_back(fmt::format("cells.{} is used by no wall and is left out", entry.first));
    return !used;
  });
}

// [body]: one physics of a body of 3D tissue, without circulation.
void read_body(SettingsReader& reader, Scene& scene) {
  for (const char* other : {"walls", "circulation", "pericardium"})
    if (reader.has(other))
      throw InputError(
          fmt::format("{}: a scene has either a [body] of tissue alone or walls in the closed loop, not both",
                      reader.place(other)));
  SettingsReader& table = reader.table("body");
  if (!tissue_services().run_body) throw TissueNeeded(reader.place("body"));
  const std::vector<std::string> kinds = {"electrophysiology", "mechanics"};
  if (!table.has("physics"))
    throw InputError(
        fmt::format("{} is missing; choose one of {}", table.place("physics"), fmt::join(kinds, ", ")));
  scene.physics = table.choice("physics", "", kinds, "physics") == kinds[0] ? Physics::electrophysiology
                                                                            : Physics::mechanics;
  WallPlan body;
  body.name = "body";
  read_wall_as("tissue", table, scene, body);
  scene.walls.push_back(std::move(body));
  leave_out_unused_cells(scene);
  SettingsReader& run = reader.table("run");
  if (scene.physics == Physics::electrophysiology) {
    read_cell_solver(reader.table("solver"), scene);
    scene.end_ms = run.number(scene_keys::end);
    scene.rows_every_ms = run.number(scene_keys::rows_every);
    // Steps are of one length: rows divide the beat and the run.
    const auto divides = [&](double whole_ms) {
      const double rows = whole_ms / scene.rows_every_ms;
      return rows > 0.5 && std::abs(rows - std::round(rows)) < 1e-6;
    };
    if (!divides(scene.period_s * units::ms_per_s))
      throw InputError(fmt::format("{} = {} does not divide the period, {} ms", run.place("rows_every_ms"),
                                   scene.rows_every_ms, scene.period_s * units::ms_per_s));
    if (!divides(scene.end_ms))
      throw InputError(fmt::format("{} = {} is not a multiple of rows_every_ms = {}", run.place("end_ms"),
                                   scene.end_ms, scene.rows_every_ms));
    scene.checkpoint_every_ms = run.number(scene_keys::checkpoint_ms);
  } else {
    scene.load_steps = static_cast<int>(run.integer(scene_keys::load_steps));
  }
}

// [walls]: every chamber is enclosed once.
void read_walls(SettingsReader& walls, Scene& scene) {
  std::vector<std::string> known;
  for (const WallPlace& place : wall_places()) known.push_back(place.name);
  for (const std::string& key : walls.keys())
    if (std::find(known.begin(), known.end(), key) == known.end()) {
      try {
        refuse_unknown("cavity", key, known);
      } catch (const InputError& error) {
        throw InputError(fmt::format("{}: {}", walls.place(key), error.what()));
      }
    }
  std::array<const WallPlace*, n_chambers> around{};
  // The larger first: it is the smaller one's key that is one too many.
  std::vector<const WallPlace*> named;
  for (const WallPlace& place : wall_places())
    if (walls.has(place.name)) named.push_back(&place);
  std::stable_sort(named.begin(), named.end(), [](const WallPlace* a, const WallPlace* b) {
    return a->cavities.size() > b->cavities.size();
  });
  for (const WallPlace* place : named)
    for (int chamber : place->cavities) {
      const WallPlace*& there = around[static_cast<std::size_t>(chamber)];
      if (there)
        throw InputError(fmt::format("{}: walls.{} encloses this cavity already; name one of them",
                                     walls.place(place->name), there->name));
      there = place;
    }
  for (int c = 0; c < n_chambers; ++c) {
    const WallPlace* place = around[static_cast<std::size_t>(c)];
    if (!place)
      throw InputError(
          fmt::format("{} is missing: the closed loop needs a wall for each of LA, LV, RA and RV; the "
                      "cheapest is kind = \"elastance\"",
                      walls.place(chamber_names[c])));
    if (place->cavities.front() == c)
      scene.walls.push_back(read_wall(walls.table(place->name), *place, scene));
  }
}

// Names of cells are names of groups in the result file.
void check_cell_name(const SettingsReader& cells, const std::string& name) {
  const bool plain =
      !name.empty() && name.size() <= 100 &&
      std::all_of(name.begin(), name.end(), [](unsigned char c) { return c > 0x20 && c != '/' && c != '.'; });
  if (!plain)
    throw InputError(fmt::format(
        "{}: a name of cells names their group in the result file and is part of keys: at most 100 "
        "characters, no '/', no '.', no spaces",
        cells.place(name)));
}

// A misspelt table would leave its part of the scene out.
void refuse_unknown_tables(const SettingsReader& reader, const std::string& name) {
  const std::vector<std::string> entries = {"base",        "title",       "heart",  "cells", "walls",
                                            "circulation", "pericardium", "solver", "run",   "body"};
  for (const std::string& key : reader.keys())
    if (std::find(entries.begin(), entries.end(), key) == entries.end())
      refuse_unknown(fmt::format("key of {}", name), key, entries);
}

void read_all_cells(SettingsReader& cells, const SettingsReader& heart, Scene& scene) {
  for (const std::string& key : cells.keys()) {
    check_cell_name(cells, key);
    CellType cell = read_cells(cells.table(key), key);
    if (cell.ionic && scene.period_s * 1e3 <= cell.stimulus.duration_ms)
      throw InputError(fmt::format("{}: the period, {} s, is not longer than the stimulus, {} ms",
                                   heart.place("period_s"), scene.period_s, cell.stimulus.duration_ms));
    scene.cells.emplace(key, std::move(cell));
  }
}

void read_circulation_of(SettingsReader& circulation, Scene& scene) {
  const std::string set = circulation.choice("parameters", "fedele2023", circulation_set_names(false),
                                             "circulation parameter set");
  scene.circulation = find_circulation_set(set).loop.circulation;
  read_circulation(circulation, scene.circulation);
  scene.initial =
      read_initial(circulation.table("initial"), scene.circulation, find_circulation_set(set).loop.initial);
}

void read_pericardium(SettingsReader& bag, Scene& scene) {
  scene.pericardium.pressure_mmHg = bag.number(scene_keys::bag_pressure);
  scene.pericardium.reference_volume_mL = bag.number(scene_keys::bag_volume);
  scene.pericardium.exponent = bag.number(scene_keys::bag_exponent);
}

// Steps divide the period, and explicit parts of the circulation are stable at their length.
void check_steps(const SettingsReader& solver, const Scene& scene) {
  const double steps = scene.period_s / scene.dt_s;
  if (std::abs(steps - std::round(steps)) > 1e-6 * steps || steps < 10)
    throw InputError(
        fmt::format("{} = {} s does not divide the period, {} s, into at least ten whole steps; the "
                    "nearest that does is {:.6g} s",
                    solver.place("dt_s"), scene.dt_s, scene.period_s,
                    scene.period_s / std::max(10.0, std::round(steps))));
  const double bound = largest_explicit_step(scene.circulation);
  if (!scene.implicit_inductors && scene.dt_s > bound)
    throw InputError(
        fmt::format("{} = {} s: the circulation's explicit step is stable below {:.2f} ms (2 L/R of the "
                    "stiffest inductor); the "
                    "nearest step that works is {:.6g} s, or set {} = \"implicit\"",
                    solver.place("dt_s"), scene.dt_s, 1e3 * bound,
                    scene.period_s / std::ceil(scene.period_s / bound), solver.place("inductors")));
  const FillingLimit filling = largest_filling_step(scene.circulation);
  if (scene.dt_s > filling.step_s)
    throw InputError(
        fmt::format("{} = {} s: vessels are filled explicitly, which is stable below {:.3g} ms because of "
                    "{}; the nearest "
                    "step that works is {:.6g} s",
                    solver.place("dt_s"), scene.dt_s, 1e3 * filling.step_s, filling.branch,
                    scene.period_s / std::ceil(scene.period_s / filling.step_s)));
}

void read_solver(SettingsReader& solver, Scene& scene) {
  const std::vector<std::string> schemes = {"staggered"};
  solver.choice("scheme", schemes[0], schemes, "scheme");
  scene.dt_s = solver.number(scene_keys::dt);
  read_cell_solver(solver, scene);
  const bool regulation_named = solver.has("regulation");
  const std::string regulation =
      solver.choice("regulation", regulation_scheme_names[1], as_strings(regulation_scheme_names),
                    "scheme of the regulatory units");
  scene.regulation =
      regulation == regulation_scheme_names[0] ? RegulationScheme::midpoint : RegulationScheme::forward_euler;
  scene.regulatory_substep_us = solver.number(scene_keys::ru_substep);
  const std::string rate = solver.choice("stretch_rate", rate_scheme_names[1], as_strings(rate_scheme_names),
                                         "stretch-rate scheme");
  for (std::size_t k = 0; k < rate_scheme_names.size(); ++k)
    if (rate == rate_scheme_names[k]) scene.rate = static_cast<RateScheme>(k);
  const std::vector<std::string> inductors = {"explicit", "implicit"};
  scene.implicit_inductors =
      solver.choice("inductors", inductors[0], inductors, "treatment of the inductors") == inductors[1];
  SettingsReader& stabilise = solver.table("stabilise");
  scene.stabilise_active_stress = stabilise.flag("active_stress", true);
  scene.stabilise_volumes = stabilise.flag("volumes", true);
  check_steps(solver, scene);
  for (const WallPlan& wall : scene.walls)
    if (wall.recipe->in_space() && regulation_named && scene.regulation == RegulationScheme::forward_euler)
      scene.warnings.push_back(
          fmt::format("walls.{} steps its regulatory units by the frozen-midpoint rule, whatever "
                      "solver.regulation says",
                      wall.name));
}

void read_run(SettingsReader& run, Scene& scene) {
  const std::vector<std::string> ends = {"limit-cycle", "beats"};
  const bool counted = run.has("beats");
  if (counted && run.is_text("until") && run.text("until", "") == "limit-cycle")
    throw InputError(
        fmt::format("{}: give until = \"limit-cycle\" or a number of beats, not both", run.place("beats")));
  scene.until_limit_cycle =
      run.choice("until", counted ? "beats" : "limit-cycle", ends, "end of the run") == "limit-cycle";
  if (!scene.until_limit_cycle) scene.beats = static_cast<int>(run.integer(scene_keys::beats));
  scene.limit_cycle.distance = run.number(scene_keys::distance);
  scene.limit_cycle.max_beats = static_cast<int>(run.integer(scene_keys::max_beats));
  const std::vector<std::string> methods = {"anderson", "pacing"};
  scene.limit_cycle.method = run.choice("method", "anderson", methods, "limit-cycle method") == "pacing"
                                 ? LimitCycleMethod::pacing
                                 : LimitCycleMethod::anderson;
  scene.checkpoint_every_s = run.number(scene_keys::checkpoint);
  for (const WallPlan& wall : scene.walls)
    if (wall.recipe->in_space()) {
      scene.checkpoint_every_ms = run.number(scene_keys::checkpoint_ms);
      scene.stop_after_ms = run.number(scene_keys::stop_after);
      break;
    }
}

// How every piece of wall steps its fibres.
void schedule_fibres(Scene& scene) {
  const double substep_s = scene.regulatory_substep_us * 1e-6;
  for (WallPlan& wall : scene.walls)
    for (FibrePlan& fibre : wall.fibres) {
      fibre.settings.scheme = {scene.regulation,
                               std::max(1, static_cast<int>(std::ceil(scene.dt_s / substep_s - 1e-9))),
                               scene.rate};
      fibre.settings.stabilise = scene.stabilise_active_stress;
    }
}

Scene interpret(std::shared_ptr<SettingsTable> table, const std::string& name,
                const std::filesystem::path& folder) {
  const auto settings = std::make_shared<SettingsReader>(table, name);
  SettingsReader& reader = *settings;
  refuse_unknown_tables(reader, name);
  Scene scene;
  scene.settings = settings;
  scene.name = name;
  scene.folder = folder;
  scene.title = reader.text("title", name);
  SettingsReader& heart = reader.table("heart");
  scene.period_s = heart.number(period_quantity);
  scene.body_surface_area_m2 = heart.number(scene_keys::body_surface_area);
  read_all_cells(reader.table("cells"), heart, scene);
  if (reader.has("body")) {
    read_body(reader, scene);
  } else {
    read_walls(reader.table("walls"), scene);
    leave_out_unused_cells(scene);
    read_circulation_of(reader.table("circulation"), scene);
    read_pericardium(reader.table("pericardium"), scene);
    read_solver(reader.table("solver"), scene);
    read_run(reader.table("run"), scene);
    schedule_fibres(scene);
  }
  reader.finish();
  return scene;
}

}  // namespace

Scene read_scene(const std::filesystem::path& path, const std::vector<std::string>& overrides) {
  auto table = with_base(parse_settings_file(path), path, 0);
  apply(*table, overrides);
  return interpret(table, path.filename().string(), path.parent_path());
}

Scene read_scene_text(const std::string& text, const std::string& name,
                      const std::vector<std::string>& overrides) {
  auto table = parse_settings_text(text, name);
  apply(*table, overrides);
  return interpret(table, name, {});
}

std::string Scene::text() const {
  std::string text;
  for (const WallPlan& wall : walls) text += wall.files;
  return text + settings->full();
}

Scene with_numbers(const Scene& scene, const std::vector<std::pair<std::string, double>>& changes) {
  const std::shared_ptr<SettingsTable> table = scene.settings->filled();
  const std::string initial = "circulation.initial";
  if (SettingsTable* circulation = table_in(*table, "circulation"))
    if (SettingsTable* start = table_in(*circulation, "initial")) {
      start->entries.erase(std::string(circulation_state_quantities[pressure_of(reservoir)].name));
      override_setting(*table, initial + "." + std::string(total_volume_quantity.name),
                       total_volume(scene.circulation, scene.initial.data()));
    }
  for (const auto& [key, value] : changes) override_setting(*table, key, value);
  return interpret(table, scene.name, scene.folder);
}

AtrialActivations atrial_activations_s(const Scene& scene) {
  AtrialActivations activations;
  for (int side = 0; side < 2; ++side)
    for (const WallPlan& wall : scene.walls) {
      if (std::find(wall.cavities.begin(), wall.cavities.end(), side == 0 ? LA : RA) == wall.cavities.end())
        continue;
      const int chamber = side == 0 ? LA : RA;
      if (const auto onset = wall.recipe->activation_s(wall, chamber, scene.period_s))
        activations[side] = onset;
    }
  return activations;
}

}  // namespace wiggers
