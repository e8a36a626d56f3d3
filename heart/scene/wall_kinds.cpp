#include <fmt/format.h>

#include <algorithm>
#include <wiggers/circulation/elastance.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/units.hpp>
#include <wiggers/heart/scene/kind_elastance.hpp>
#include <wiggers/heart/scene/kind_reduced.hpp>
#include <wiggers/heart/scene/kind_triseg.hpp>
#include <wiggers/heart/scene/tissue_services.hpp>
#include <wiggers/heart/scene/wall_kind.hpp>

namespace wiggers {

namespace {
// The first that fits a place is its default.
std::vector<WallKind>& kinds() {
  static std::vector<WallKind> all = {
      elastance_wall_kind(),
      reduced_wall_kind(),
      triseg_wall_kind(),
      {"tissue",
       {"LA", "LV", "RA", "RV", "ventricles", "heart"},
       {}},  // read by the program that has 3D tissue
  };
  return all;
}

const WallKind& kind_named(std::string_view name, const std::string& place) {
  for (const WallKind& kind : kinds())
    if (kind.name == name) {
      if (!kind.read) throw TissueNeeded(place);
      return kind;
    }
  throw std::logic_error("no such kind of wall");
}
}  // namespace

const std::vector<WallKind>& wall_kinds() { return kinds(); }

void register_wall_kind(WallKind kind) {
  for (WallKind& known : kinds())
    if (known.name == kind.name) {
      known = std::move(kind);
      return;
    }
  kinds().push_back(std::move(kind));
}

const std::vector<WallPlace>& wall_places() {
  static const std::vector<WallPlace> places = {{"LA", {LA}},
                                                {"LV", {LV}},
                                                {"RA", {RA}},
                                                {"RV", {RV}},
                                                {"ventricles", {LV, RV}},
                                                {"heart", {LA, LV, RA, RV}}};
  return places;
}

WallPlan read_wall(SettingsReader& table, const WallPlace& place, const Scene& scene) {
  std::vector<std::string> fitting;
  for (const WallKind& kind : wall_kinds())
    if (std::find(kind.places.begin(), kind.places.end(), place.name) != kind.places.end())
      fitting.push_back(kind.name);
  WallPlan plan;
  plan.name = place.name;
  plan.cavities = place.cavities;
  plan.kind = table.choice("kind", fitting.front(), fitting, "kind of wall");
  kind_named(plan.kind, table.place("kind")).read(table, scene, plan);
  return plan;
}

void read_wall_as(std::string_view kind, SettingsReader& table, const Scene& scene, WallPlan& plan) {
  plan.kind = kind;
  kind_named(kind, table.place("kind")).read(table, scene, plan);
}

double strength_of(const FibrePlan& fibre) {
  return fibre.force_parameters[static_cast<std::size_t>(fibre.force->parameter(Role::strength))];
}

std::vector<NamedParameter> WallRecipe::numbers(const WallPlan&) const { return {}; }
std::unique_ptr<WallOf<Tangent>> WallRecipe::make(const WallPlan& plan, const WallSiteOf<Tangent>&,
                                                  std::span<const Tangent>) const {
  throw InputError(fmt::format("walls.{}: {} walls carry no derivatives", plan.name, plan.kind));
}
std::optional<std::size_t> WallRecipe::activation_number(const WallPlan&, int) const { return {}; }
std::optional<double> WallRecipe::activation_s(const WallPlan& plan, int chamber, double period_s) const {
  const auto k = activation_number(plan, chamber);
  if (!k) return {};
  const NamedParameter number = numbers(plan)[*k];
  return wrapped(number.quantity.unit == "ms" ? number.value * units::s_per_ms : number.value, period_s);
}

}  // namespace wiggers
