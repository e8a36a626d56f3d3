#include <fmt/format.h>

#include <string>
#include <vector>
#include <wiggers/tissue/laws/material.hpp>

namespace wiggers {

Material read_material(SettingsReader& table, Tissue tissue) {
  std::vector<std::string> names;
  for_each_material_kind([&](auto kind) { names.emplace_back(kind.name); });
  const bool muscle = is_muscle(tissue);
  const std::string_view usual = muscle ? UsykMaterial::name : NeoHookeanMaterial::name;
  const std::string chosen = table.choice("law", usual, names, "material law");
  Material material;
  for_each_material_kind([&](auto kind) {
    using Kind = decltype(kind);
    if (chosen != Kind::name) return;
    ValuesOf<Kind> values = defaults_of(Kind::quantities);
    if constexpr (requires { Kind::defaults(tissue); }) values = Kind::defaults(tissue);
    for (std::size_t k = 0; k < values.size(); ++k) values[k] = table.number(Kind::quantities[k], values[k]);
    material.law = Kind::law(values);
    material.stiffness_Pa = Kind::stiffness_Pa(values);
    if constexpr (!has_volume<LawOf<Kind>>) material.bulk_Pa = table.number(bulk_quantity);
    visit_material(material, [&](const auto&, const auto& volumetric) {
      material.bulk_Pa = volume_derivatives(volumetric, 1.0).curvature;
    });
  });
  return material;
}

}  // namespace wiggers
