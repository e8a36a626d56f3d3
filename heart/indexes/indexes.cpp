#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <wiggers/heart/indexes/indexes_of.hpp>

namespace wiggers {

BeatIndexes compute_indexes(const Table& table, const AtrialActivations& atrial_activation, double debounce) {
  BeatTraceOf<double> trace;
  trace.t = table.at("t_s").values;
  for (int c = 0; c < n_chambers; ++c) {
    trace.V[c] = table.at(fmt::format("V_{}", chamber_names[c])).values;
    trace.p[c] = table.at(fmt::format("p_{}", chamber_names[c])).values;
  }
  for (int v = 0; v < n_valves; ++v) trace.Q[v] = table.at(fmt::format("Q_{}", valve_names[v])).values;
  for (int n = n_chambers; n < n_nodes; ++n)
    if (network::at_valve(n)) trace.p[n] = table.at(circulation_state_quantities[n].name).values;
  for (int s = 0; s < n_shunts; ++s)
    for (const Column& column : table.columns)
      if (column.name == fmt::format("Q_{}", shunt_names[s])) trace.shunts[s] = column.values;
  return compute_indexes_of(trace, atrial_activation, debounce);
}

double largest_flip(const std::vector<double>& a) {
  double flip = 0;
  for (std::size_t n = 2; n < a.size(); ++n) {
    const double d1 = a[n] - a[n - 1], d0 = a[n - 1] - a[n - 2];
    if (d1 * d0 < 0) flip = std::max(flip, std::min(std::abs(d1), std::abs(d0)));
  }
  return flip;
}

const std::vector<ReferenceRange>& reference_ranges() {
  // Kawel-Boehm et al. 2020 (men, cardiac magnetic resonance); entries of PassEF, ActEF and VpreAC from Li et
  // al. 2017; last column: table of volumetric indexes of Fedele et al. 2023.
  static const std::vector<ReferenceRange> table = {
      {"RA.Vmax", "mL/m2", 52, 12, 28, 76, 43.68}, {"RA.VpreAC", "mL/m2", 40, 10, 19, 61, 32.83},
      {"RA.Vmin", "mL/m2", 27, 9, 9, 45, 25.16},   {"RA.PassEF", "%", 23, 9, 4, 41, 24.82},
      {"RA.ActEF", "%", 33, 10, 11, 55, 23.39},    {"RA.TotEF", "%", 49, 10, 29, 68, 42.40},
      {"LA.Vmax", "mL/m2", 41, 8, 24, 57, 30.65},  {"LA.VpreAC", "mL/m2", 30, 8, 15, 46, 24.70},
      {"LA.Vmin", "mL/m2", 19, 5, 9, 28, 17.14},   {"LA.PassEF", "%", 26, 9, 8, 44, 19.43},
      {"LA.ActEF", "%", 37, 10, 17, 58, 30.59},    {"LA.TotEF", "%", 54, 8, 37, 70, 44.08},
      {"RV.EDV", "mL/m2", 88, 17, 53, 123, 86.78}, {"RV.ESV", "mL/m2", 38, 11, 17, 59, 41.73},
      {"RV.SV", "mL/m2", 52, 12, 28, 75, 45.06},   {"RV.EF", "%", 57, 8, 42, 72, 51.92},
      {"LV.EDV", "mL/m2", 77, 15, 47, 107, 85.28}, {"LV.ESV", "mL/m2", 29, 9, 11, 47, 41.28},
      {"LV.SV", "mL/m2", 48, 9, 30, 66, 44.00},    {"LV.EF", "%", 63, 6, 51, 76, 51.60},
  };
  return table;
}

std::optional<double> indexed_value(const BeatIndexes& beat, std::string_view index, double bsa) {
  const auto& v = beat.ventricle[index.starts_with("LV") ? 0 : 1];
  const auto& a = beat.atrium[index.starts_with("LA") ? 0 : 1];
  const std::string_view what = index.substr(3);
  if (what == "EDV") return v.EDV_mL / bsa;
  if (what == "ESV") return v.ESV_mL / bsa;
  if (what == "SV") return v.SV_mL / bsa;
  if (what == "EF") return v.EF_percent;
  if (what == "Vmax") return a.Vmax_mL / bsa;
  if (what == "VpreAC") return a.VpreAC_mL ? std::optional(*a.VpreAC_mL / bsa) : std::nullopt;
  if (what == "Vmin") return a.Vmin_mL / bsa;
  if (what == "PassEF") return a.PassEF_percent;
  if (what == "ActEF") return a.ActEF_percent;
  return a.TotEF_percent;
}

double body_surface_area_du_bois(double height_cm, double mass_kg) {
  return 0.007184 * std::pow(height_cm, 0.725) * std::pow(mass_kg, 0.425);
}
double body_surface_area_mosteller(double height_cm, double mass_kg) {
  return std::sqrt(height_cm * mass_kg / 3600);
}

}  // namespace wiggers
