// What a scene says of a body's mechanics: materials, supports, loads.
#include <fmt/format.h>

#include <algorithm>
#include <wiggers/core/errors.hpp>
#include <wiggers/heart/scene/scene_keys.hpp>
#include <wiggers/tissue/body/body.hpp>
#include <wiggers/tissue/body/plan.hpp>
#include <wiggers/tissue/laws/material.hpp>

namespace wiggers {

namespace {

namespace keys = tissue_keys;

// A Poisson ratio above 0.49: there linear tetrahedra, which have one volume each and few freedoms, lock.
constexpr double locking_ratio = 50;

Tissue tissue_of(int tag) {
  switch (tag) {
    case mesh_tags::ventricles:
      return Tissue::ventricle;
    case mesh_tags::left_atrium:
      return Tissue::left_atrium;
    case mesh_tags::right_atrium:
      return Tissue::right_atrium;
    case mesh_tags::aorta:
    case mesh_tags::pulmonary_trunk:
      return Tissue::artery;
    default:
      return Tissue::other;
  }
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

// [body.load]: what mechanics alone is loaded by. Cavities that a mesh file has are those that are named.
void read_load(SettingsReader& load, std::vector<int>& chambers, TissuePlan& plan) {
  std::vector<std::string> known(chamber_names.begin(), chamber_names.end());
  for (const Artery& artery : arteries) known.emplace_back(artery.name);
  bool loaded = false;
  for (const std::string& key : load.keys()) {
    if (key == keys::tension.name) continue;
    const auto at = std::find(known.begin(), known.end(), key);
    if (at == known.end()) {
      known.emplace_back(keys::tension.name);
      try {
        refuse_unknown("load", key, known);
      } catch (const InputError& error) {
        throw InputError(fmt::format("{}: {}", load.place(key), error.what()));
      }
    }
    loaded = true;
    const auto index = static_cast<int>(at - known.begin());
    SettingsReader& table = load.table(key);
    const bool artery = index >= n_chambers;
    const bool is_there =
        artery ? plan.shape == "heart" : std::find(chambers.begin(), chambers.end(), index) != chambers.end();
    if (!plan.mesh_file.empty()) {
      if (artery)
        plan.named_tags.push_back(arteries[index - n_chambers].tag);
      else if (!is_there)
        chambers.push_back(index);
    } else if (!is_there) {
      throw InputError(fmt::format("{}: shape \"{}\" has no such {}", load.place(key), plan.shape,
                                   artery ? "artery" : "cavity"));
    }
    if (artery) {
      plan.arterial_pressure_mmHg[index - n_chambers] = table.number(keys::pressure);
      continue;
    }
    CavityLoad& of = plan.loads[index];
    if (table.has("volume_mL") && table.has("pressure_mmHg"))
      throw InputError(
          fmt::format("{}: give the volume or pressure_mmHg, not both", table.place("volume_mL")));
    if (table.has("volume_mL"))
      of.volume_mL = table.number(keys::volume);
    else
      of.pressure_mmHg = table.number(keys::pressure);
  }
  plan.active_tension_kPa = load.number(keys::tension);
  if (!loaded && !(plan.active_tension_kPa > 0))
    throw InputError(
        fmt::format("{}: nothing is loaded; name a cavity's pressure_mmHg or volume_mL, or "
                    "active_tension_kPa",
                    load.place("LV")));
}

}  // namespace

std::string locking_warning(const MechanicsSettings& mechanics) {
  if (mechanics.order != 1) return {};
  for (const Material& m : mechanics.materials)
    if (mesh_tags::conductive(m.tag) && m.stiffness_Pa > 0 && m.bulk_Pa > locking_ratio * m.stiffness_Pa)
      return fmt::format(
          "linear tetrahedra lock in {}: its bulk modulus, {:.3g} kPa, is {:.0f} times its stiffness at rest "
          "({:.3g} kPa), so the wall is far too stiff and its motion wrong. Take mechanics.order = 2, or a "
          "bulk modulus below {:.3g} kPa",
          mesh_tags::name_of_tag(mesh_tags::volumes, m.tag), 1e-3 * m.bulk_Pa, m.bulk_Pa / m.stiffness_Pa,
          1e-3 * m.stiffness_Pa, 1e-3 * locking_ratio * m.stiffness_Pa);
  return {};
}

void read_mechanics(SettingsReader& table, Physics physics, std::vector<int>& chambers, TissuePlan& plan) {
  const std::string& shape = plan.shape;
  SettingsReader& mechanics = table.table("mechanics");
  MechanicsSettings& s = plan.mechanics;
  s.order = static_cast<int>(mechanics.integer(keys::order));
  s.mean_dilatation = mechanics.flag("mean_dilatation", s.order == 2);
  s.density = mechanics.number(keys::density);
  s.viscosity_Pa_s = mechanics.number(scene_keys::viscosity);
  s.n_f = mechanics.number(scene_keys::n_f);
  s.n_s = mechanics.number(keys::n_s);
  s.n_n = mechanics.number(scene_keys::n_n);
  s.normalised_tension = mechanics.flag("normalised_tension", true);
  if (physics == Physics::heart) {
    const std::vector<std::string> solvers = {"auto", "gmres-ilu", "gmres-gamg", "direct"};
    const std::string solver = mechanics.choice("solver", "auto", solvers, "linear solver");
    for (SolverKind kind : {SolverKind::gmres_ilu, SolverKind::gmres_gamg, SolverKind::direct})
      if (solver == solver_kind_names[static_cast<std::size_t>(kind)]) plan.solver = kind;
    plan.residual_tolerance = mechanics.number(keys::newton);
    plan.linear_tolerance = mechanics.number(keys::linear);
    plan.tangent_every = static_cast<int>(mechanics.integer(keys::lag));
  }

  SettingsReader& materials = table.table("materials");
  std::vector<int> tags = named_tags(materials, mesh_tags::volumes, "volume tag");
  plan.named_tags = tags;
  // A mesh file may hold any of them; which it holds is seen when it is read.
  for (int tag : shape.empty() ? volumes_of("heart") : volumes_of(shape))
    if (std::find(tags.begin(), tags.end(), tag) == tags.end()) tags.push_back(tag);
  for (int tag : tags) {
    const std::string name(mesh_tags::name_of_tag(mesh_tags::volumes, tag));
    s.materials.push_back(read_material(materials.table(name), tissue_of(tag)));
    s.materials.back().tag = tag;
  }

  SettingsReader& supports = table.table("supports");
  std::vector<int> held = named_tags(supports, mesh_tags::surfaces, "surface tag");
  plan.named_tags.insert(plan.named_tags.end(), held.begin(), held.end());
  const std::vector<int> usual =
      shape == "heart" ? std::vector<int>{mesh_tags::epicardium, mesh_tags::epicardium_fat, mesh_tags::rings}
                       : std::vector<int>{mesh_tags::epicardium, mesh_tags::epicardium_fat};
  for (int tag : usual)
    if (std::find(held.begin(), held.end(), tag) == held.end()) held.push_back(tag);
  for (int tag : held)
    s.supports.push_back(
        read_support(supports.table(std::string(mesh_tags::name_of_tag(mesh_tags::surfaces, tag))), tag));

  if (physics == Physics::mechanics) read_load(table.table("load"), chambers, plan);

  SettingsReader& reference = table.table("reference");
  plan.recover_reference = reference.flag("recover", true);
  for (int chamber : chambers)
    plan.image_pressure_mmHg[chamber] = reference.number(keys::image_pressures[chamber]);
  if (shape == "heart" || !plan.mesh_file.empty())
    for (std::size_t k = 0; k < arteries.size(); ++k)
      plan.artery_image_pressure_mmHg[k] = reference.number(keys::artery_image_pressures[k]);
}

}  // namespace wiggers
