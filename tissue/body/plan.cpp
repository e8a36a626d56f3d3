#include <fmt/core.h>
#include <fmt/format.h>

#include <algorithm>
#include <filesystem>
#include <set>
#include <wiggers/core/checksum.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/files.hpp>
#include <wiggers/core/units.hpp>
#include <wiggers/tissue/body/plan.hpp>
#include <wiggers/tissue/mesh/make.hpp>
#include <wiggers/tissue/mesh/read.hpp>

namespace wiggers {

namespace {

namespace keys = tissue_keys;

Point3 read_place(SettingsReader& table) {
  const double x = table.number(keys::x), y = table.number(keys::y), z = table.number(keys::z);
  return {units::m_per_mm * x, units::m_per_mm * y, units::m_per_mm * z};
}

// Names of shapes' quantities have dashes on the command line and underscores in scenes.
template <std::size_t N>
std::vector<double> read_shape(SettingsReader& table, const std::array<Quantity, N>& quantities) {
  static std::set<std::string> names;  // a Quantity's name is a view: the text must live on
  std::vector<double> values;
  for (Quantity key : quantities) {
    std::string name(key.name);
    std::replace(name.begin(), name.end(), '-', '_');
    key.name = *names.insert(std::move(name)).first;
    values.push_back(table.number(key));
  }
  return values;
}

// Comment lines for `files`: what the mesh file holds, so that a result knows it again.
std::string mesh_file_checksums(const std::string& mesh_file) {
  std::string lines;
  for (const std::filesystem::path& part : mesh_files(mesh_file))
    lines += fmt::format("# content of {}: {:016x}\n", part.filename().string(), checksum(read_file(part)));
  return lines;
}

void read_mesh_keys(SettingsReader& table, const Scene& scene, TissuePlan& plan, std::string& files) {
  if (table.has("mesh")) {
    plan.mesh_file = table.text("mesh", "");
    const std::vector<std::string> units = {"auto", "m", "cm", "mm", "um"};
    plan.mesh_unit = table.choice("mesh_unit", "auto", units, "unit of length");
    // As written, or beside the scene. A CARP mesh may be named without ending.
    const auto exists = [](const std::filesystem::path& file) {
      return std::filesystem::exists(file) || std::filesystem::exists(file.string() + ".pts");
    };
    if (!exists(plan.mesh_file) && exists(scene.folder / plan.mesh_file))
      plan.mesh_file = (scene.folder / plan.mesh_file).string();
    if (!exists(plan.mesh_file))
      throw InputError(fmt::format("{} = \"{}\": there is no such file, neither here nor beside the scene",
                                   table.place("mesh"), plan.mesh_file));
    files = mesh_file_checksums(plan.mesh_file);
  } else {
    const std::vector<std::string> shapes = {"ellipsoid", "biventricular", "heart"};
    plan.shape = table.choice("shape", "ellipsoid", shapes, "shape");
    plan.size_mm = table.number(keys::size);
    if (plan.shape == "ellipsoid")
      plan.shape_values = read_shape(table, ellipsoid_quantities);
    else if (plan.shape == "biventricular")
      plan.shape_values = read_shape(table, biventricular_quantities);
    else
      plan.shape_values = read_shape(table, heart_quantities);
  }
}

void read_fibre_rule(SettingsReader& table, TissuePlan& plan) {
  SettingsReader& fibres = table.table("fibres");
  const std::vector<std::string> rules = {"bayer", "doste", "file"};
  const std::string rule = fibres.choice("rule", "bayer", rules, "rule of fibres");
  plan.fibres_from_file = rule == "file";
  std::array<double, fibre_quantities.size()> angles = defaults_of(fibre_quantities);
  const auto read_angles = read_shape(fibres, fibre_quantities);
  std::copy(read_angles.begin(), read_angles.end(), angles.begin());
  plan.fibres = fibre_rule(plan.fibres_from_file ? FibreRuleKind::bayer : fibre_rule_kind(rule), angles);
}

void read_electrophysiology(SettingsReader& table, bool with_mechanics, bool with_atria, TissuePlan& plan) {
  SettingsReader& ep = table.table("electrophysiology");
  MonodomainSettings& m = plan.electrophysiology;
  m.order = static_cast<int>(ep.integer(keys::ep_order));
  m.tau_s = units::s_per_ms * ep.number(keys::tau);
  m.relative_tolerance = ep.number(keys::ep_tolerance);
  m.table_spacing_mV = ep.number(keys::table_spacing);
  if (m.table_spacing_mV > 0 && m.table_spacing_mV < 0.01)
    throw InputError(fmt::format("{} = {} is outside 0.01 to 1 mV (0: no tables)",
                                 ep.place("table_spacing_mV"), m.table_spacing_mV));
  m.fast_layer_thickness = ep.number(keys::fast_thickness);
  const std::vector<std::string> currents(ionic_currents_names.begin(), ionic_currents_names.end());
  m.currents = ep.choice("ionic_currents", "ici", currents, "treatment of ionic currents") == "svi"
                   ? IonicCurrents::at_quadrature_points
                   : IonicCurrents::interpolated;
  if (with_mechanics) plan.feedback = ep.flag("mechano_electric_feedback", true);
  const std::vector<std::string> ep_solvers = {"cg-ilu", "cg-jacobi"};
  m.solver = ep.choice("solver", "cg-ilu", ep_solvers, "linear solver") == "cg-ilu" ? SolverKind::cg_ilu
                                                                                    : SolverKind::cg_jacobi;
  const auto conductivity = [](SettingsReader& t, double f, double s, double n) {
    constexpr double m2_per_s = 1e-3;  // in one mm^2/ms
    const double a = t.number(keys::sigma_f, f), b = t.number(keys::sigma_s, s),
                 c = t.number(keys::sigma_n, n);
    return Conductivity{m2_per_s * a, m2_per_s * b, m2_per_s * c};
  };
  plan.conductivity = conductivity(ep.table("conductivity"), 0.2, 0.11, 0.055);
  plan.fast_conductivity = conductivity(ep.table("fast_conductivity"), 0.8, 0.44, 0.22);
  if (with_atria) plan.atrial_conductivity = conductivity(ep.table("atrial_conductivity"), 0.7, 0.141, 0.141);
}

// Stimuli come once a beat, and must end within it.
void read_stimuli(SettingsReader& table, double period_s, TissuePlan& plan) {
  SettingsReader& stimuli = table.table("stimuli");
  for (const std::string& name : stimuli.keys()) {
    SettingsReader& s = stimuli.table(name);
    Stimulus stimulus;
    std::optional<Site> site;
    if (s.has("site")) {
      const std::string name_of_site = s.choice("site", "", site_names(), "site");
      site = named_site(name_of_site, 0.5);
      if (has_height(*site)) site->height = s.number(keys::height);
    } else {
      stimulus.centre = read_place(s);
    }
    stimulus.radius = units::m_per_mm * s.number(keys::radius);
    stimulus.start_s = units::s_per_ms * s.number(keys::start);
    stimulus.duration_s = units::s_per_ms * s.number(keys::duration);
    stimulus.amplitude_V_per_s = s.number(keys::amplitude);
    if (stimulus.start_s + stimulus.duration_s > period_s * (1 + 1e-9))
      throw InputError(fmt::format("{} = {} ms: the stimulus of {} ms does not end within the period of {} s",
                                   s.place("start_ms"), stimulus.start_s * units::ms_per_s,
                                   stimulus.duration_s * units::ms_per_s, period_s));
    plan.stimuli.push_back(stimulus);
    plan.sites.push_back(site);
  }
  if (plan.stimuli.empty())
    throw InputError(
        fmt::format("{}: tissue needs at least one stimulus, a table with x_mm, y_mm, z_mm and start_ms",
                    stimuli.place("apex")));
  SettingsReader& electrodes = table.table("electrodes");
  for (const std::string& name : electrodes.keys())
    plan.electrodes.push_back(read_place(electrodes.table(name)));
}

// Cells of the pieces of wall.
void read_cells(SettingsReader& table, const Scene& scene, WallPlan& wall) {
  const auto read_piece = [&](SettingsReader& piece) {
    return scene.physics == Physics::heart ? read_fibre(piece, scene) : read_fibre_cells(piece, scene);
  };
  if (table.is_table("cells")) {
    // Different cells in ventricles and atria.
    SettingsReader& cells = table.table("cells");
    wall.fibres = {read_piece(cells.table("ventricles")), read_piece(cells.table("atria"))};
  } else {
    wall.fibres = {read_piece(table)};
  }
}

void read_tissue(SettingsReader& table, const Scene& scene, WallPlan& wall) {
  // Where mechanics is alone, tension is prescribed and there are no cells.
  if (scene.physics != Physics::mechanics) read_cells(table, scene, wall);
  auto plan = std::make_shared<TissuePlan>();
  read_mesh_keys(table, scene, *plan, wall.files);
  const std::string& shape = plan->shape;
  const std::vector<int> chambers_of_shape = shape == "ellipsoid"       ? std::vector<int>{LV}
                                             : shape == "biventricular" ? std::vector<int>{LV, RV}
                                             : shape == "heart"         ? std::vector<int>{LA, LV, RA, RV}
                                                                        : wall.cavities;
  const bool alone = scene.physics != Physics::heart;
  if (alone)
    wall.cavities = chambers_of_shape;
  else if (!shape.empty() && chambers_of_shape != wall.cavities)
    throw InputError(fmt::format("{}: shape \"{}\" has {} cavities, this wall encloses {}",
                                 table.place("shape"), shape, chambers_of_shape.size(),
                                 wall.cavities.size()));
  read_fibre_rule(table, *plan);
  if (scene.physics != Physics::mechanics) {
    if (shape == "heart" && wall.fibres.size() == 1)
      throw InputError(
          fmt::format("{}: this shape has atria: name their cells by tables cells.ventricles "
                      "and cells.atria",
                      table.place("cells")));
    const bool with_atria = wall.fibres.size() == 2 || shape == "heart";
    read_electrophysiology(table, !alone, with_atria, *plan);
    read_stimuli(table, scene.period_s, *plan);
  }
  if (scene.physics != Physics::electrophysiology) read_mechanics(table, scene.physics, wall.cavities, *plan);
  if (!alone) plan->right_share = table.number(keys::right_share);
  if (scene.physics == Physics::mechanics)
    plan->fields_every_step = table.flag("fields", true);
  else
    plan->fields_every_ms = table.number(keys::fields_every);
  wall.recipe = std::make_shared<TissueRecipe>(std::move(*plan));
}

}  // namespace

WallKind tissue_wall_kind() {
  return {"tissue", {"LA", "LV", "RA", "RV", "ventricles", "heart"}, read_tissue};
}

const TissuePlan& tissue_plan(const WallPlan& wall) {
  return dynamic_cast<const TissueRecipe&>(*wall.recipe).plan();
}

std::optional<double> TissueRecipe::activation_s(const WallPlan& plan, int, double) const {
  if (plan.fibres.empty() || !plan.fibres.back().settings.active) return {};
  return plan.fibres.back().activation_ms *
         units::s_per_ms;  // of several pieces of wall the atria's is the last
}

}  // namespace wiggers
