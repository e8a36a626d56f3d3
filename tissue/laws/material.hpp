// Passive materials: a law of shape and a volumetric law, chosen by name in scenes.
//
// How to add a law: a header of its own, included here, and one entry in MaterialKinds below.
//
//  1. The law: a struct of its numbers and, over any number type T (parts.hpp says how), energy(law, F),
//     add_stress(law, F, P) and add_stress_and_tangent(law, F, P, A). A law that brings its own volumetric
//     part has volume(), which volume_derivatives() takes (volume.hpp); one without gets the penalty of the
//     scene's bulk_Pa.
//  2. What scenes know of it, struct XMaterial:
//       name                "x", the word in materials.TAG.law
//       quantities          std::array of its Quantity: keys, units, defaults, ranges
//       law(values)         the law of values in that order
//       stiffness_Pa(values)  the largest at rest, which the bulk modulus is compared with
//       defaults(tissue)    optional: where defaults differ by tissue
//  3. XMaterial in MaterialKinds.
//
// The element kernel, scenes, messages and the tests of all laws then have it. tests/own_law.cmake follows
// this.
#pragma once

#include <array>
#include <concepts>
#include <string_view>
#include <tuple>
#include <type_traits>
#include <utility>
#include <variant>
#include <wiggers/core/quantity.hpp>
#include <wiggers/core/settings.hpp>
#include <wiggers/tissue/laws/holzapfel_ogden.hpp>
#include <wiggers/tissue/laws/isotropic.hpp>
#include <wiggers/tissue/laws/usyk.hpp>
#include <wiggers/tissue/laws/volume.hpp>

namespace wiggers {

template <class Kind>
using ValuesOf = std::array<double, Kind::quantities.size()>;
template <class Kind>
using LawOf = decltype(Kind::law(ValuesOf<Kind>{}));
template <class Law>
inline constexpr bool has_volume = requires(const Law& law) {
  law.volume();
};

template <class Kind>
concept MaterialKind = requires(const ValuesOf<Kind>& values, const LawOf<Kind>& law, Matrix3<double>& P,
                                double (&A)[9][9]) {
  { Kind::name } -> std::convertible_to<std::string_view>;
  { Kind::stiffness_Pa(values) } -> std::convertible_to<double>;
  { energy(law, P) } -> std::convertible_to<double>;
  add_stress(law, P, P);
  add_stress_and_tangent(law, P, P, A);
}
&&well_formed(Kind::quantities);

using MaterialKinds = std::tuple<UsykMaterial, GuccioneMaterial, HolzapfelOgdenMaterial, NeoHookeanMaterial>;

namespace material_details {
template <class Variant, class Law>
struct With;
template <class... Laws, class Law>
struct With<std::variant<Laws...>, Law> {
  using type = std::conditional_t<(std::is_same_v<Laws, Law> || ...), std::variant<Laws...>,
                                  std::variant<Laws..., Law>>;
};
template <class Variant, class... Kinds>
struct Collected {
  using type = Variant;
};
template <class Variant, class Kind, class... Kinds>
struct Collected<Variant, Kind, Kinds...> {
  using type = typename Collected<typename With<Variant, LawOf<Kind>>::type, Kinds...>::type;
};
template <class List>
struct Shapes;
template <MaterialKind Kind, MaterialKind... Kinds>
struct Shapes<std::tuple<Kind, Kinds...>> {
  using type = typename Collected<std::variant<LawOf<Kind>>, Kinds...>::type;
};
}  // namespace material_details

// Any law of shape.
using ShapeLaw = typename material_details::Shapes<MaterialKinds>::type;

// visit(kind) for every kind, in the order of the list.
template <class Visit>
void for_each_material_kind(Visit visit) {
  std::apply([&](auto... kinds) { (visit(kinds), ...); }, MaterialKinds{});
}

// The law of all cells with a volume tag. The bulk modulus is that of the penalty B/2 (J - 1) ln J; for laws
// that bring a volumetric law, it is that law's.
struct Material {
  int tag = 0;
  ShapeLaw law;
  double bulk_Pa = 50e3;
  double stiffness_Pa =
      0;  // the largest of the law at rest, to be compared with the bulk modulus; 0: unknown
};

// visit(shape law, volumetric law)
template <class Visit>
decltype(auto) visit_material(const Material& material, Visit visit) {
  return std::visit(
      [&](const auto& law) {
        if constexpr (has_volume<std::decay_t<decltype(law)>>)
          return visit(law, law.volume());
        else
          return visit(law, VolumetricPenalty{material.bulk_Pa});
      },
      material.law);
}

// A material's table in a scene: its law, by default that of the tissue, and its numbers.
Material read_material(SettingsReader& table, Tissue tissue);

}  // namespace wiggers
