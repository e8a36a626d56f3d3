#include <fmt/format.h>

#include <algorithm>
#include <wiggers/circulation/elastance.hpp>
#include <wiggers/heart/run/rate_warnings.hpp>

namespace wiggers {

namespace {

// Each a sign that a beat has too little time, chosen to be silent for the healthy sets at 60 to 90 a minute.
constexpr double largest_rest_share = 0.1;       // of the peak tension, left in diastole
constexpr double smallest_EF_percent = 5;        // of a ventricle; the gravest failures seen leave 10
constexpr double smallest_tension_kPa = 1;       // below there is no contraction to speak of
constexpr double longest_overlap_s = 5e-3;       // both valves of a side open
constexpr double smallest_forward_mL_per_s = 5;  // a valve that passes less is not open in earnest
constexpr double shortest_filling_s = 0.1;       // from the inlet's opening to the atrium's contraction
constexpr double largest_calcium_change = 0.15;

void tensions(const Table& beat, std::vector<std::string>& out) {
  for (const Column& column : beat.columns) {
    if (!column.name.ends_with("active_tension")) continue;
    const auto [low, high] = std::minmax_element(column.values.begin(), column.values.end());
    if (*high > smallest_tension_kPa && *low > largest_rest_share * *high)
      out.push_back(fmt::format(
          "{} does not fall in diastole: {:.1f} of {:.1f} kPa stay; the wall has no time to relax at this "
          "rate, or calcium stays high",
          column.name, *low, *high));
  }
}

void overlaps(const Table& beat, std::vector<std::string>& out) {
  const auto& t = beat.at("t_s").values;
  for (const auto& [inlet, outlet] : {std::pair{"MV", "AV"}, std::pair{"TV", "PV"}}) {
    const auto& in = beat.at(fmt::format("Q_{}", inlet)).values;
    const auto& through = beat.at(fmt::format("Q_{}", outlet)).values;
    double overlap = 0;
    for (std::size_t k = 1; k < t.size(); ++k)
      if (in[k] > smallest_forward_mL_per_s && through[k] > smallest_forward_mL_per_s)
        overlap += t[k] - t[k - 1];
    if (overlap > longest_overlap_s)
      out.push_back(
          fmt::format("{} and {} are open at once for {:.0f} ms: the ventricle fills while it ejects", inlet,
                      outlet, 1e3 * overlap));
  }
}

void fillings(const BeatIndexes& indexes, std::vector<std::string>& out) {
  for (int side = 0; side < 2; ++side) {
    const ValveTimes& inlet = indexes.valve[side == 0 ? MV : TV];
    const auto& activation = indexes.atrial_activation_s[side];
    if (!activation || !inlet.opens_s || !inlet.closes_s) continue;
    const double open = wrapped(*inlet.closes_s - *inlet.opens_s, indexes.period_s);
    const double until = wrapped(*activation - *inlet.opens_s, indexes.period_s);
    const std::string_view ventricle = chamber_names[side == 0 ? LV : RV],
                           valve = valve_names[side == 0 ? MV : TV];
    if (until > open)
      out.push_back(fmt::format("filling of {} is cut short: the atrium contracts while {} is closed",
                                ventricle, valve));
    else if (until < shortest_filling_s)
      out.push_back(
          fmt::format("filling of {} is cut short: {} opens only {:.0f} ms before the atrium contracts",
                      ventricle, valve, 1e3 * until));
  }
}

}  // namespace

std::vector<std::string> ejection_warnings(const BeatIndexes& indexes) {
  std::vector<std::string> out;
  for (int side = 0; side < 2; ++side) {
    const std::string_view ventricle = chamber_names[side == 0 ? LV : RV];
    const int outlet = side == 0 ? AV : PV;
    const double EF = indexes.ventricle[side].EF_percent;
    if (!indexes.valve[outlet].opens_s)
      out.push_back(fmt::format("{} does not eject: {} never opens", ventricle, valve_names[outlet]));
    else if (EF < smallest_EF_percent)
      out.push_back(fmt::format("{} hardly ejects: EF {:.1f} %", ventricle, EF));
  }
  return out;
}

std::vector<std::string> verdict_warnings(const Table& beat, const BeatIndexes& indexes) {
  std::vector<std::string> out = ejection_warnings(indexes);
  tensions(beat, out);
  return out;
}

std::vector<std::string> rate_warnings(const Table& beat, const BeatIndexes& indexes,
                                       const std::map<std::string, PacedCellType>& cells) {
  std::vector<std::string> out = verdict_warnings(beat, indexes);
  overlaps(beat, out);
  fillings(indexes, out);
  for (const auto& [name, paced] : cells) {
    const double there = paced.calcium_max_where_chosen_uM;
    if (there > 0 && std::abs(paced.calcium_max_uM / there - 1) > largest_calcium_change)
      out.push_back(fmt::format(
          "cells {}: peak calcium is {:.3g} uM, {:.0f} % of the {:.3g} uM where calcium_factor was "
          "chosen: the factor does not fit this rate",
          name, paced.calcium_max_uM, 100 * paced.calcium_max_uM / there, there));
  }
  return out;
}

}  // namespace wiggers
