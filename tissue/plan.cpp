#include <fmt/core.h>
#include <fmt/format.h>

#include <algorithm>
#include <filesystem>
#include <set>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/units.hpp>
#include <wiggers/heart/scene_keys.hpp>
#include <wiggers/tissue/collective.hpp>
#include <wiggers/tissue/law_parameters.hpp>
#include <wiggers/tissue/mesh_broadcast.hpp>
#include <wiggers/tissue/mesh_check.hpp>
#include <wiggers/tissue/mesh_make.hpp>
#include <wiggers/tissue/mesh_read.hpp>
#include <wiggers/tissue/plan.hpp>

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

template <std::size_t N>
std::array<double, N> read_all(SettingsReader& table, const std::array<Quantity, N>& quantities,
                               const std::array<double, N>& defaults) {
  std::array<double, N> values{};
  for (std::size_t k = 0; k < N; ++k) values[k] = table.number(quantities[k], defaults[k]);
  return values;
}

Material read_material(SettingsReader& table, int tag) {
  const bool muscle = mesh_tags::conductive(tag);
  const std::vector<std::string> laws = {"usyk", "guccione", "holzapfel-ogden", "neo-hookean"};
  const std::string law = table.choice("law", muscle ? "usyk" : "neo-hookean", laws, "material law");
  Material material;
  material.tag = tag;
  if (law == "usyk") {
    auto defaults = defaults_of(usyk_quantities);
    if (tag == mesh_tags::right_atrium) defaults[0] = 1470;
    if (tag == mesh_tags::left_atrium) defaults[0] = 1760;
    const auto values = read_all(table, usyk_quantities, defaults);
    material.law = usyk_law(values);
    material.bulk_Pa = values.back();
  } else if (law == "guccione") {
    const auto values = read_all(table, guccione_quantities, defaults_of(guccione_quantities));
    material.law = guccione_law(values);
    material.bulk_Pa = values.back();
  } else if (law == "holzapfel-ogden") {
    const auto values = read_all(table, holzapfel_ogden_quantities, defaults_of(holzapfel_ogden_quantities));
    material.law = holzapfel_ogden_law(values);
    material.bulk_Pa = values.back();
  } else {
    auto defaults = defaults_of(neo_hookean_quantities);
    if (tag == mesh_tags::aorta || tag == mesh_tags::pulmonary_trunk) defaults = {5.25e5, 1e6};
    material.law = neo_hookean_law(read_all(table, neo_hookean_quantities, defaults));
  }
  return material;
}

Support read_support(SettingsReader& table, int tag) {
  Support support;
  support.tag = tag;
  // Facing pericardial fluid and fat: the founding paper's values; rings are held.
  const bool fluid = tag == mesh_tags::epicardium, fat = tag == mesh_tags::epicardium_fat;
  support.normal_stiffness = table.number(keys::normal_stiffness, fluid ? 2e5 : fat ? 2e2 : 0);
  support.normal_damping = table.number(keys::normal_damping, fluid ? 2e3 : fat ? 2 : 0);
  support.full_stiffness = table.number(keys::full_stiffness);
  support.full_damping = table.number(keys::full_damping);
  const bool held = table.flag("fixed", tag == mesh_tags::rings);
  support.fixed = {held, held, held};
  return support;
}

// Tags that each shape has: what can be named in its tables.
std::vector<int> volumes_of(const std::string& shape) {
  using namespace mesh_tags;
  if (shape == "ellipsoid") return {ventricles, caps};
  if (shape == "biventricular") return {ventricles, annuli, valves};
  return {ventricles, left_atrium, right_atrium, annuli, valves, aorta, pulmonary_trunk, caps};
}

template <std::size_t N>
std::vector<std::string> names_of_tags(const std::array<mesh_tags::Tag, N>& tags) {
  std::vector<std::string> names;
  for (const auto& tag : tags) names.emplace_back(tag.name);
  return names;
}

// Sub-tables named by tags; refuses unknown names.
template <std::size_t N>
std::vector<int> named_tags(SettingsReader& table, const std::array<mesh_tags::Tag, N>& tags,
                            const char* kind) {
  std::vector<int> named;
  for (const std::string& key : table.keys()) {
    bool known = false;
    for (const auto& tag : tags)
      if (tag.name == key) {
        named.push_back(tag.tag);
        known = true;
      }
    if (!known) {
      try {
        refuse_unknown(kind, key, names_of_tags(tags));
      } catch (const InputError& error) {
        throw InputError(fmt::format("{}: {}", table.place(key), error.what()));
      }
    }
  }
  return named;
}

template <std::size_t N>
std::string_view name_of_tag(const std::array<mesh_tags::Tag, N>& tags, int tag) {
  for (const auto& known : tags)
    if (known.tag == tag) return known.name;
  return "?";
}

}  // namespace

int endocardium_of(int chamber) {
  switch (chamber) {
    case LA:
      return mesh_tags::endocardium_LA;
    case LV:
      return mesh_tags::endocardium_LV;
    case RA:
      return mesh_tags::endocardium_RA;
    default:
      return mesh_tags::endocardium_RV;
  }
}

void read_tissue(SettingsReader& table, const Scene& scene, WallPlan& wall) {
  auto plan = std::make_shared<TissuePlan>();
  if (table.has("mesh")) {
    plan->mesh_file = table.text("mesh", "");
    const std::vector<std::string> units = {"auto", "m", "cm", "mm", "um"};
    plan->mesh_unit = table.choice("mesh_unit", "auto", units, "unit of length");
    // As written, or beside the scene. A CARP mesh may be named without ending.
    const auto exists = [](const std::filesystem::path& file) {
      return std::filesystem::exists(file) || std::filesystem::exists(file.string() + ".pts");
    };
    if (!exists(plan->mesh_file) && exists(scene.folder / plan->mesh_file))
      plan->mesh_file = (scene.folder / plan->mesh_file).string();
    if (!exists(plan->mesh_file))
      throw InputError(fmt::format("{} = \"{}\": there is no such file, neither here nor beside the scene",
                                   table.place("mesh"), plan->mesh_file));
  } else {
    const std::vector<std::string> shapes = {"ellipsoid", "biventricular", "heart"};
    plan->shape = table.choice("shape", "ellipsoid", shapes, "shape");
    plan->size_mm = table.number(keys::size);
    if (plan->shape == "ellipsoid")
      plan->shape_values = read_shape(table, ellipsoid_quantities);
    else if (plan->shape == "biventricular")
      plan->shape_values = read_shape(table, biventricular_quantities);
    else
      plan->shape_values = read_shape(table, heart_quantities);
  }
  const std::string& shape = plan->shape;
  const std::vector<int> chambers_of_shape = shape == "ellipsoid"       ? std::vector<int>{LV}
                                             : shape == "biventricular" ? std::vector<int>{LV, RV}
                                             : shape == "heart"         ? std::vector<int>{LA, LV, RA, RV}
                                                                        : wall.cavities;
  if (!shape.empty() && chambers_of_shape != wall.cavities)
    throw InputError(fmt::format("{}: shape \"{}\" has {} cavities, this wall encloses {}",
                                 table.place("shape"), shape, chambers_of_shape.size(),
                                 wall.cavities.size()));

  SettingsReader& fibres = table.table("fibres");
  const std::vector<std::string> rules = {"bayer", "doste", "file"};
  const std::string rule = fibres.choice("rule", "bayer", rules, "rule of fibres");
  plan->fibres_from_file = rule == "file";
  std::array<double, fibre_quantities.size()> angles = defaults_of(fibre_quantities);
  const auto read_angles = read_shape(fibres, fibre_quantities);
  std::copy(read_angles.begin(), read_angles.end(), angles.begin());
  plan->fibres = fibre_rule(plan->fibres_from_file ? FibreRuleKind::bayer : fibre_rule_kind(rule), angles);

  SettingsReader& ep = table.table("electrophysiology");
  MonodomainSettings& m = plan->electrophysiology;
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
  plan->feedback = ep.flag("mechano_electric_feedback", true);
  const std::vector<std::string> ep_solvers = {"cg-ilu", "cg-jacobi"};
  m.solver = ep.choice("solver", "cg-ilu", ep_solvers, "linear solver") == "cg-ilu" ? SolverKind::cg_ilu
                                                                                    : SolverKind::cg_jacobi;
  const auto conductivity = [](SettingsReader& t, double f, double s, double n) {
    constexpr double m2_per_s = 1e-3;  // in one mm^2/ms
    const double a = t.number(keys::sigma_f, f), b = t.number(keys::sigma_s, s),
                 c = t.number(keys::sigma_n, n);
    return Conductivity{m2_per_s * a, m2_per_s * b, m2_per_s * c};
  };
  plan->conductivity = conductivity(ep.table("conductivity"), 0.2, 0.11, 0.055);
  plan->fast_conductivity = conductivity(ep.table("fast_conductivity"), 0.8, 0.44, 0.22);

  SettingsReader& stimuli = table.table("stimuli");
  for (const std::string& name : stimuli.keys()) {
    SettingsReader& s = stimuli.table(name);
    Stimulus stimulus;
    stimulus.centre = read_place(s);
    stimulus.radius = units::m_per_mm * s.number(keys::radius);
    stimulus.start_s = units::s_per_ms * s.number(keys::start);
    stimulus.duration_s = units::s_per_ms * s.number(keys::duration);
    stimulus.amplitude_V_per_s = s.number(keys::amplitude);
    if (stimulus.start_s + stimulus.duration_s > scene.period_s * (1 + 1e-9))
      throw InputError(fmt::format("{} = {} ms: the stimulus of {} ms does not end within the period of {} s",
                                   s.place("start_ms"), stimulus.start_s * units::ms_per_s,
                                   stimulus.duration_s * units::ms_per_s, scene.period_s));
    plan->stimuli.push_back(stimulus);
  }
  if (plan->stimuli.empty())
    throw InputError(
        fmt::format("{}: tissue needs at least one stimulus, a table with x_mm, y_mm, z_mm and start_ms",
                    stimuli.place("apex")));
  SettingsReader& electrodes = table.table("electrodes");
  for (const std::string& name : electrodes.keys())
    plan->electrodes.push_back(read_place(electrodes.table(name)));

  SettingsReader& mechanics = table.table("mechanics");
  MechanicsSettings& s = plan->mechanics;
  s.order = static_cast<int>(mechanics.integer(keys::order));
  s.mean_dilatation = mechanics.flag("mean_dilatation", s.order == 2);
  s.density = mechanics.number(keys::density);
  s.viscosity_Pa_s = mechanics.number(scene_keys::viscosity);
  s.n_f = mechanics.number(scene_keys::n_f);
  s.n_s = mechanics.number(keys::n_s);
  s.n_n = mechanics.number(scene_keys::n_n);
  s.normalised_tension = mechanics.flag("normalised_tension", true);
  const std::vector<std::string> solvers = {"gmres-ilu", "gmres-gamg", "direct"};
  const std::string solver = mechanics.choice("solver", "gmres-ilu", solvers, "linear solver");
  plan->solver = solver == "direct"       ? SolverKind::direct
                 : solver == "gmres-gamg" ? SolverKind::gmres_gamg
                                          : SolverKind::gmres_ilu;
  plan->residual_tolerance = mechanics.number(keys::newton);
  plan->linear_tolerance = mechanics.number(keys::linear);
  plan->tangent_every = static_cast<int>(mechanics.integer(keys::lag));

  SettingsReader& materials = table.table("materials");
  std::vector<int> tags = named_tags(materials, mesh_tags::volumes, "volume tag");
  plan->named_tags = tags;
  // A mesh file may hold any of them; which it holds is seen when it is read.
  for (int tag : shape.empty() ? volumes_of("heart") : volumes_of(shape))
    if (std::find(tags.begin(), tags.end(), tag) == tags.end()) tags.push_back(tag);
  for (int tag : tags)
    s.materials.push_back(
        read_material(materials.table(std::string(name_of_tag(mesh_tags::volumes, tag))), tag));

  SettingsReader& supports = table.table("supports");
  std::vector<int> held = named_tags(supports, mesh_tags::surfaces, "surface tag");
  plan->named_tags.insert(plan->named_tags.end(), held.begin(), held.end());
  const std::vector<int> usual =
      shape == "heart" ? std::vector<int>{mesh_tags::epicardium, mesh_tags::epicardium_fat, mesh_tags::rings}
                       : std::vector<int>{mesh_tags::epicardium, mesh_tags::epicardium_fat};
  for (int tag : usual)
    if (std::find(held.begin(), held.end(), tag) == held.end()) held.push_back(tag);
  for (int tag : held)
    s.supports.push_back(
        read_support(supports.table(std::string(name_of_tag(mesh_tags::surfaces, tag))), tag));

  SettingsReader& reference = table.table("reference");
  plan->recover_reference = reference.flag("recover", true);
  for (int chamber : wall.cavities)
    plan->image_pressure_mmHg[chamber] = reference.number(keys::image_pressures[chamber]);
  plan->right_share = table.number(keys::right_share);
  plan->fields_every_ms = table.number(keys::fields_every);
  wall.tissue = std::move(plan);
}

std::shared_ptr<const TetMesh> make_mesh(const TissuePlan& plan, const std::vector<int>& chambers,
                                         const std::string& place, MPI_Comm communicator) {
  int rank = 0;
  MPI_Comm_rank(communicator, &rank);
  auto mesh = std::make_shared<TetMesh>();
  collectively(communicator, [&] {
    if (rank != 0) return;
    const auto shape_of = [&](auto defaults) {
      std::copy(plan.shape_values.begin(), plan.shape_values.end(), defaults.begin());
      return defaults;
    };
    // What the reader had to assume or mend is said: a wrong unit shows in the extent.
    std::vector<std::string> notes;
    if (!plan.mesh_file.empty())
      *mesh = read_mesh(plan.mesh_file, mesh_unit(plan.mesh_unit), &notes);
    else if (plan.shape == "ellipsoid")
      *mesh = make_ellipsoid(plan.size_mm, shape_of(EllipsoidShape{}));
    else if (plan.shape == "biventricular")
      *mesh = make_biventricular(plan.size_mm, shape_of(BiventricularShape{}));
    else
      *mesh = make_heart(plan.size_mm, shape_of(HeartShape{}));
    for (const std::string& note : notes) fmt::print("note: {}: {}\n", plan.mesh_file, note);
    std::vector<int> closed;
    for (int chamber : chambers) closed.push_back(endocardium_of(chamber));
    require_sound(*mesh, closed, plan.mesh_file.empty() ? place : plan.mesh_file);
  });
  broadcast_mesh(*mesh, communicator);
  return mesh;
}

}  // namespace wiggers
