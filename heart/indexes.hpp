// Valve times, phases and clinical indexes of one beat, from its trace (any source: heart or 0D loop).
//
// Phases per side: AC atrial contraction (from the atrial stimulus), IVC isovolumetric contraction, VE
// ejection, IVR isovolumetric relaxation, VPF passive filling. A valve is open while the upstream pressure is
// higher; openings shorter than the debounce time do not count. EDV: ventricular volume at closure of the
// atrioventricular valve; ESV: smallest volume; atrial VpreAC: volume at the atrial stimulus.
#pragma once

#include <array>
#include <optional>
#include <string>
#include <string_view>
#include <vector>
#include <wiggers/circulation/names.hpp>
#include <wiggers/core/table.hpp>

namespace wiggers {

struct ValveTimes {
  std::optional<double> opens_s, closes_s;  // of the main opening, within the beat
  double peak_flow_mL_per_s = 0;
  double backward_volume_mL = 0;  // per beat
  double forward_volume_mL = 0;
};

struct VentricleIndexes {
  double EDV_mL = 0, ESV_mL = 0, SV_mL = 0, EF_percent = 0;
  double pressure_max_mmHg = 0, pressure_min_mmHg = 0;
  double stroke_work_J = 0;
  double dpdt_max_mmHg_per_s = 0, dpdt_min_mmHg_per_s = 0;
};

struct AtriumIndexes {
  double Vmax_mL = 0, VpreAC_mL = 0, Vmin_mL = 0;
  double PassEF_percent = 0, ActEF_percent = 0, TotEF_percent = 0;
  double pressure_mean_mmHg = 0, pressure_max_mmHg = 0, pressure_min_mmHg = 0;
  double work_J = 0;  // net: A-loop positive, V-loop negative
};

struct Phase {
  std::string name;                 // AC, IVC, VE, IVR, VPF
  double begins_s = 0, ends_s = 0;  // ends may exceed the period by wrapping: ends < begins
};

struct BeatIndexes {
  double period_s = 0;
  double atrial_stimulus_s = 0;
  std::array<VentricleIndexes, 2> ventricle;  // LV, RV
  std::array<AtriumIndexes, 2> atrium;        // LA, RA
  struct Artery {
    double pressure_max_mmHg = 0, pressure_min_mmHg = 0, pressure_mean_mmHg = 0;
  };
  Artery aorta, pulmonary_artery;
  std::array<ValveTimes, n_valves> valve;
  std::array<std::optional<double>, 2> E_mL_per_s, A_mL_per_s, E_over_A, atrial_kick_percent;  // left, right
  std::array<std::vector<Phase>, 2> phases;                                                    // left, right
  double cardiac_output_L_per_min = 0;
  double systemic_resistance_mmHg_s_per_mL = 0, pulmonary_resistance_mmHg_s_per_mL = 0;
};

// The trace needs time t_s (first row 0, last row the period), V_*, p_*, Q_* and the arteries' pressures.
BeatIndexes compute_indexes(const Table& trace, double atrial_stimulus_s, double debounce_s = 1.5e-3);

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
// The value an index has in this beat (volumes divided by the body surface area).
double indexed_value(const BeatIndexes& beat, std::string_view index, double body_surface_area_m2);

// Body surface area (m2) from height (cm) and mass (kg).
double body_surface_area_du_bois(double height_cm, double mass_kg);
double body_surface_area_mosteller(double height_cm, double mass_kg);

}  // namespace wiggers
