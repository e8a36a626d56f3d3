// Valve times, phases and clinical indexes of one beat, from its trace (any source: heart or 0D loop).
//
// Phases per side: AC atrial contraction (from the atrial stimulus), IVC isovolumetric contraction, VE
// ejection, IVR isovolumetric relaxation, VPF passive filling. A valve is open while the upstream pressure is
// higher; openings shorter than the debounce time do not count. EDV: ventricular volume at closure of the
// atrioventricular valve; ESV: smallest volume; atrial VpreAC: volume at the atrium's own activation. What
// belongs to a contraction (VpreAC, passive and active emptying, A wave, kick) is absent where an atrium does
// not contract.
#pragma once

#include <array>
#include <optional>
#include <string>
#include <string_view>
#include <vector>
#include <wiggers/circulation/circulation.hpp>
#include <wiggers/core/table.hpp>
#include <wiggers/heart/indexes/further_indexes.hpp>

namespace wiggers {

// Numbers of any kind: plain, or dual to carry sensitivities.
template <class T>
struct ValveTimesOf {
  std::optional<T> opens_s, closes_s;  // of the main opening, within the beat
  T peak_flow_mL_per_s = 0;
  T backward_volume_mL = 0;  // per beat
  T forward_volume_mL = 0;
};

template <class T>
struct VentricleIndexesOf {
  T EDV_mL = 0, ESV_mL = 0, SV_mL = 0, EF_percent = 0;
  T pressure_max_mmHg = 0, pressure_min_mmHg = 0;
  T stroke_work_J = 0;
  T dpdt_max_mmHg_per_s = 0, dpdt_min_mmHg_per_s = 0;
};

template <class T>
struct AtriumIndexesOf {
  T Vmax_mL = 0, Vmin_mL = 0, TotEF_percent = 0;
  std::optional<T> VpreAC_mL, PassEF_percent, ActEF_percent;
  T pressure_mean_mmHg = 0, pressure_max_mmHg = 0, pressure_min_mmHg = 0;
  T work_J = 0;  // net: A-loop positive, V-loop negative
};

template <class T>
struct ArteryIndexesOf {
  T pressure_max_mmHg = 0, pressure_min_mmHg = 0, pressure_mean_mmHg = 0;
};

// When the atria (left, right) begin to contract within the beat; nothing for one that does not.
template <class T>
using AtrialActivationsOf = std::array<std::optional<T>, 2>;
using AtrialActivations = AtrialActivationsOf<double>;

struct Phase {
  std::string name;                 // AC, IVC, VE, IVR, VPF
  double begins_s = 0, ends_s = 0;  // ends may exceed the period by wrapping: ends < begins
};

template <class T>
struct BeatIndexesOf {
  T period_s = 0;
  AtrialActivationsOf<T> atrial_activation_s;
  std::array<VentricleIndexesOf<T>, 2> ventricle;  // LV, RV
  std::array<AtriumIndexesOf<T>, 2> atrium;        // LA, RA
  ArteryIndexesOf<T> aorta, pulmonary_artery;
  std::array<ValveTimesOf<T>, n_valves> valve;
  std::array<std::optional<T>, 2> E_mL_per_s, A_mL_per_s, E_over_A, atrial_kick_percent;  // left, right
  std::array<std::vector<Phase>, 2> phases;                                               // left, right
  T cardiac_output_L_per_min = 0;
  T systemic_resistance_mmHg_s_per_mL = 0, pulmonary_resistance_mmHg_s_per_mL = 0;
  FurtherValues<T> further;
};
using ValveTimes = ValveTimesOf<double>;
using VentricleIndexes = VentricleIndexesOf<double>;
using AtriumIndexes = AtriumIndexesOf<double>;
using ArteryIndexes = ArteryIndexesOf<double>;
using BeatIndexes = BeatIndexesOf<double>;

// visit(name, unit, value) for every index that this beat has: "LV.EDV_mL", "valves.MV.opens_s".
template <class Indexes, class Visit>
void for_each_index(const Indexes& b, Visit visit) {
  const char* ventricles[] = {"LV.", "RV."};
  const char* atria[] = {"LA.", "RA."};
  using Name = std::string;
  for (int s = 0; s < 2; ++s) {
    const auto& v = b.ventricle[s];
    const Name at = ventricles[s];
    visit(at + "EDV_mL", "mL", v.EDV_mL);
    visit(at + "ESV_mL", "mL", v.ESV_mL);
    visit(at + "SV_mL", "mL", v.SV_mL);
    visit(at + "EF_percent", "%", v.EF_percent);
    visit(at + "pressure_max_mmHg", "mmHg", v.pressure_max_mmHg);
    visit(at + "pressure_min_mmHg", "mmHg", v.pressure_min_mmHg);
    visit(at + "stroke_work_J", "J", v.stroke_work_J);
    visit(at + "dpdt_max_mmHg_per_s", "mmHg/s", v.dpdt_max_mmHg_per_s);
    visit(at + "dpdt_min_mmHg_per_s", "mmHg/s", v.dpdt_min_mmHg_per_s);
  }
  for (int s = 0; s < 2; ++s) {
    const auto& a = b.atrium[s];
    const Name at = atria[s];
    visit(at + "Vmax_mL", "mL", a.Vmax_mL);
    if (a.VpreAC_mL) visit(at + "VpreAC_mL", "mL", *a.VpreAC_mL);
    visit(at + "Vmin_mL", "mL", a.Vmin_mL);
    if (a.PassEF_percent) visit(at + "PassEF_percent", "%", *a.PassEF_percent);
    if (a.ActEF_percent) visit(at + "ActEF_percent", "%", *a.ActEF_percent);
    visit(at + "TotEF_percent", "%", a.TotEF_percent);
    visit(at + "pressure_mean_mmHg", "mmHg", a.pressure_mean_mmHg);
    visit(at + "pressure_max_mmHg", "mmHg", a.pressure_max_mmHg);
    visit(at + "pressure_min_mmHg", "mmHg", a.pressure_min_mmHg);
    visit(at + "work_J", "J", a.work_J);
  }
  const auto artery = [&](const Name& at, const auto& a) {
    visit(at + ".pressure_max_mmHg", "mmHg", a.pressure_max_mmHg);
    visit(at + ".pressure_min_mmHg", "mmHg", a.pressure_min_mmHg);
    visit(at + ".pressure_mean_mmHg", "mmHg", a.pressure_mean_mmHg);
  };
  artery("aorta", b.aorta);
  artery("pulmonary_artery", b.pulmonary_artery);
  for (int v = 0; v < n_valves; ++v) {
    const Name at = "valves." + Name(valve_names[v]) + ".";
    if (b.valve[v].opens_s) visit(at + "opens_s", "s", *b.valve[v].opens_s);
    if (b.valve[v].closes_s) visit(at + "closes_s", "s", *b.valve[v].closes_s);
    visit(at + "peak_flow_mL_per_s", "mL/s", b.valve[v].peak_flow_mL_per_s);
    visit(at + "forward_volume_mL", "mL", b.valve[v].forward_volume_mL);
    visit(at + "backward_volume_mL", "mL", b.valve[v].backward_volume_mL);
  }
  const char* inlets[] = {"MV", "TV"};
  for (int s = 0; s < 2; ++s) {
    const auto wave = [&](const Name& name, const char* unit, const auto& value) {
      if (value) visit(name + "." + inlets[s], unit, *value);
    };
    wave("E_over_A", "1", b.E_over_A[s]);
    wave("E_mL_per_s", "mL/s", b.E_mL_per_s[s]);
    wave("A_mL_per_s", "mL/s", b.A_mL_per_s[s]);
    wave("atrial_kick_percent", "%", b.atrial_kick_percent[s]);
  }
  visit(Name("cardiac_output_L_per_min"), "L/min", b.cardiac_output_L_per_min);
  visit(Name("systemic_resistance_mmHg_s_per_mL"), "mmHg s/mL", b.systemic_resistance_mmHg_s_per_mL);
  visit(Name("pulmonary_resistance_mmHg_s_per_mL"), "mmHg s/mL", b.pulmonary_resistance_mmHg_s_per_mL);
  for_each_further_index([&](std::size_t k, auto index) {
    if (b.further[k]) visit(Name(index.name), index.unit.data(), *b.further[k]);
  });
}

// What the indexes are computed from: one beat, first row at 0, last row at the period.
template <class T>
struct BeatTraceOf {
  std::vector<T> t;
  std::array<std::vector<T>, n_chambers> V;
  std::array<std::vector<T>, n_nodes> p;  // of chambers, and of vessels at valves
  std::array<std::vector<T>, n_valves> Q;
  std::array<std::vector<T>, n_shunts> shunts;  // flows; empty where absent
  bool with_middles = false;                    // every second row is the middle of a step

  void clear() { *this = {}; }
  bool has_shunts() const {
    for (const auto& flow : shunts)
      if (!flow.empty()) return true;
    return false;
  }
  // y: the circulation's states.
  void append(const CirculationParametersOf<T>& c, const T& time, const T* y, const T* pressures,
              const std::array<T, n_valves>& flows) {
    t.push_back(time);
    for (int c = 0; c < n_chambers; ++c) {
      V[c].push_back(y[c]);
      p[c].push_back(pressures[c]);
    }
    for (int v = 0; v < n_valves; ++v) Q[v].push_back(flows[v]);
    network::unrolled<n_nodes>([&](auto n) {
      if constexpr (n >= n_chambers && network::at_valve(n)) p[n].push_back(y[n]);
    });
    for_each_shunt_flow(c, pressures, y, [&](int s, const T& flow) { shunts[s].push_back(flow); });
  }
};

// Openings of a valve shorter than this do not count.
inline constexpr double valve_debounce_s = 1.5e-3;

// The trace needs time t_s (first row 0, last row the period), V_*, p_*, Q_* and the arteries' pressures.
BeatIndexes compute_indexes(const Table& trace, const AtrialActivations& atrial_activation_s,
                            double debounce_s = valve_debounce_s);

// Largest alternating step-to-step change: max over n of min(|d_n|, |d_n-1|) where d_n d_n-1 < 0.
double largest_flip(const std::vector<double>& series);

// Reference range of one volumetric index (men, cardiac magnetic resonance; sources with the table in the
// .cpp).
struct ReferenceRange {
  std::string_view index;  // "LV.EDV"
  std::string_view unit;   // mL/m2 or %
  double mean, sd, lower, upper;
  double founding_paper;  // value of the whole-heart paper (Fedele et al. 2023)
};
const std::vector<ReferenceRange>& reference_ranges();
// The value an index has in this beat (volumes divided by the body surface area); nothing where it has none.
std::optional<double> indexed_value(const BeatIndexes& beat, std::string_view index,
                                    double body_surface_area_m2);

// Body surface area (m2) from height (cm) and mass (kg).
double body_surface_area_du_bois(double height_cm, double mass_kg);
double body_surface_area_mosteller(double height_cm, double mass_kg);

}  // namespace wiggers
