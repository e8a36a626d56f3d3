// Indexes that follow from a beat's trace and from indexes known before.
//
// How to add one: a struct here, and its entry in FurtherIndexes.
//
//   name            as users see it, "LV.something_mL": the unit at its end unless it is "1"
//   unit, meaning   with definition and source
//   of(rows, trace, known)   its value as an optional, over any number type; nothing where this beat has
//   none.
//     trace is a BeatTraceOf, known a BeatIndexesOf, rows the pieces of which indexes_of.hpp takes
//     integral(), largest(), smallest(), at_time() of any series.
//
// Summaries, Python, batches, derivatives and targets of calibration then have it. tests/own_index.cmake
// follows this.
#pragma once

#include <array>
#include <optional>
#include <string_view>
#include <tuple>
#include <utility>

namespace wiggers {

struct PulmonaryToSystemicFlow {
  static constexpr std::string_view name = "Qp_over_Qs", unit = "1",
                                    meaning =
                                        "flow through the lungs over that through the body, of hearts with "
                                        "shunts";
  template <class Rows, class Trace, class Known>
  static auto of(const Rows& rows, const Trace& trace, const Known& known) {
    using T = std::decay_t<decltype(known.period_s)>;
    const T lungs = passed_on(rows, trace, known, true), body = passed_on(rows, trace, known, false);
    return trace.has_shunts() && body > 0.0 ? std::optional<T>(lungs / body) : std::nullopt;
  }
};

using FurtherIndexes = std::tuple<PulmonaryToSystemicFlow>;

template <class T>
using FurtherValues = std::array<std::optional<T>, std::tuple_size_v<FurtherIndexes>>;

// visit(number in the list, index)
template <class Visit>
void for_each_further_index(Visit visit) {
  std::apply(
      [&](auto... index) {
        std::size_t k = 0;
        (visit(k++, index), ...);
      },
      FurtherIndexes{});
}

}  // namespace wiggers
