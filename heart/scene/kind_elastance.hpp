// Elastance walls in scenes.
#pragma once

#include <wiggers/circulation/elastance.hpp>
#include <wiggers/heart/scene/wall_kind.hpp>

namespace wiggers {

template <class T>
struct ElastanceNumbers {
  ElastanceParametersOf<T> elastance;

  ElastanceNumbers() = default;
  template <class U>
  explicit ElastanceNumbers(const ElastanceNumbers<U>&) {}

  template <class Self, class Visit>
  static void for_each(Self& self, const WallPlan&, Visit visit) {
    const auto fields = fields_of(self.elastance);
    for (std::size_t k = 0; k < fields.size(); ++k)
      visit(elastance_quantities[k].name, elastance_quantities[k], *fields[k], true);
  }
  std::unique_ptr<WallOf<T>> make(const WallPlan& plan, const WallSiteOf<T>& site) const;
  std::unique_ptr<ContinuousWall> continuous(double period_s) const;
  std::string activation_key(const WallPlan&, int) const { return elastance.EA > 0.0 ? "tC" : ""; }
};

WallKind elastance_wall_kind();

}  // namespace wiggers
