// How to add a kind of wall: one file of its own, and one line in wall_kinds.cpp.
//
//  1. Write the wall (heart/walls/wall.hpp says what it answers), for numbers T: plain, or dual with
//     sensitivities.
//  2. Write its numbers, template <class T> struct XNumbers:
//       for_each(self, plan, visit)    visit(key, quantity, field, present) for every number that indexes
//                                      depend on, by its key below walls.NAME; present: whether the scene has
//                                      the term at all
//       make(plan, site)               the wall of these numbers
//       activation_key(plan, chamber)  the number that is the chamber's onset of contraction; empty: none
//       continuous(period_s)           optional: its equations in continuous time, for the monolithic
//       reference
//     and give plan.recipe = std::make_shared<RecipeOf<XNumbers>>(numbers). A wall without derivatives or
//     numbers that change writes a WallRecipe itself.
//  3. Write read(table, scene, plan), which fills plan.fibres and plan.recipe from the wall's table, and
//     declare `WallKind x_wall_kind();`: name, the places in [walls] it may take (wall_places()), read.
//
// Scene, run, study, sensitivities, calibration, Python and report then know it.
// tests/models/own_wall_kind.cpp follows this.
#pragma once

#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>
#include <wiggers/core/sensitivity.hpp>
#include <wiggers/core/settings.hpp>
#include <wiggers/heart/scene/scene.hpp>
#include <wiggers/heart/walls/active_fibre.hpp>
#include <wiggers/heart/walls/continuous_wall.hpp>
#include <wiggers/heart/walls/wall.hpp>

namespace wiggers {

struct PacedCellType;

// What a wall gets from its heart.
template <class T>
struct WallSiteOf {
  const Scene& scene;
  T period_s;
  // The active fibre of a piece of wall; `place` names it in messages.
  std::function<ActiveFibreOf<T>(const FibrePlan& plan, const T& activation_ms, const T& strength_kPa,
                                 const std::string& place)>
      fibre;
  const std::map<std::string, PacedCellType>* cells = nullptr;  // paced; none in studies
};

// A wall as the scene describes it; makes any number of walls.
class WallRecipe {
 public:
  virtual ~WallRecipe() = default;
  // Numbers that indexes depend on, by their keys below walls.NAME.
  virtual std::vector<NamedParameter> numbers(const WallPlan& plan) const;
  // The wall with other values of these numbers, in their order.
  virtual std::unique_ptr<Wall> make(const WallPlan& plan, const WallSiteOf<double>& site,
                                     std::span<const double> values) const = 0;
  virtual bool carries_derivatives() const { return false; }
  virtual std::unique_ptr<WallOf<Tangent>> make(const WallPlan& plan, const WallSiteOf<Tangent>& site,
                                                std::span<const Tangent> values) const;
  // Which of numbers() is a chamber's onset of contraction (s or ms).
  virtual std::optional<std::size_t> activation_number(const WallPlan& plan, int chamber) const;
  virtual std::optional<double> activation_s(const WallPlan& plan, int chamber, double period_s) const;
  // The wall's equations in continuous time; null: none that the monolithic reference could integrate.
  virtual std::unique_ptr<ContinuousWall> continuous(double period_s) const {
    (void)period_s;
    return nullptr;
  }
  // A body in space: has fields, checkpoints within a beat, and steps of its own.
  virtual bool in_space() const { return false; }
};

template <template <class> class Numbers>
class RecipeOf final : public WallRecipe {
 public:
  explicit RecipeOf(Numbers<double> plain) : plain_(std::move(plain)) {}

  std::vector<NamedParameter> numbers(const WallPlan& plan) const override {
    std::vector<NamedParameter> list;
    Numbers<double>::for_each(
        plain_, plan, [&](std::string_view key, const Quantity& quantity, const double& value, bool present) {
          if (present) list.push_back({std::string(key), quantity, value});
        });
    return list;
  }
  bool carries_derivatives() const override { return true; }
  std::unique_ptr<Wall> make(const WallPlan& plan, const WallSiteOf<double>& site,
                             std::span<const double> values) const override {
    return with(plan, values).make(plan, site);
  }
  std::unique_ptr<WallOf<Tangent>> make(const WallPlan& plan, const WallSiteOf<Tangent>& site,
                                        std::span<const Tangent> values) const override {
    return with(plan, values).make(plan, site);
  }
  std::optional<std::size_t> activation_number(const WallPlan& plan, int chamber) const override {
    const std::string key = plain_.activation_key(plan, chamber);
    const auto list = numbers(plan);
    for (std::size_t k = 0; k < list.size(); ++k)
      if (list[k].name == key) return k;
    return {};
  }
  std::unique_ptr<ContinuousWall> continuous(double period_s) const override {
    if constexpr (requires { plain_.continuous(period_s); }) return plain_.continuous(period_s);
    return nullptr;
  }

 private:
  template <class T>
  Numbers<T> with(const WallPlan& plan, std::span<const T> values) const {
    std::vector<std::pair<double, bool>> plain;
    Numbers<double>::for_each(plain_, plan,
                              [&](std::string_view, const Quantity&, const double& value, bool present) {
                                plain.emplace_back(value, present);
                              });
    Numbers<T> numbers(plain_);
    std::size_t k = 0, next = 0;
    Numbers<T>::for_each(numbers, plan, [&](std::string_view, const Quantity&, T& field, bool) {
      field = plain[k].second ? values[next++] : T(plain[k].first);
      ++k;
    });
    return numbers;
  }

  Numbers<double> plain_;
};

// A name that may stand in [walls], and what it encloses.
struct WallPlace {
  std::string name;
  std::vector<int> cavities;
};
const std::vector<WallPlace>& wall_places();

struct WallKind {
  std::string name;
  std::vector<std::string> places;
  // Fills plan.fibres and plan.recipe; empty where this build does not have the kind.
  std::function<void(SettingsReader& table, const Scene& scene, WallPlan& plan)> read;
};
const std::vector<WallKind>& wall_kinds();
// Takes the place of the kind of the same name.
void register_wall_kind(WallKind kind);
// Reads a wall's table: its kind, which by default is the first that fits the place, and all that follows.
WallPlan read_wall(SettingsReader& table, const WallPlace& place, const Scene& scene);
// By a kind that the scene does not name.
void read_wall_as(std::string_view kind, SettingsReader& table, const Scene& scene, WallPlan& plan);

// For read(): a piece of wall with its cells, active force and activation; cells and activation alone; the
// passive law.
FibrePlan read_fibre(SettingsReader& table, const Scene& scene);
FibrePlan read_fibre_cells(SettingsReader& table, const Scene& scene);
UsykLaw read_usyk(SettingsReader& table);

double strength_of(const FibrePlan& fibre);  // kPa

}  // namespace wiggers
