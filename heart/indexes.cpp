#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/units.hpp>
#include <wiggers/heart/indexes.hpp>

namespace wiggers {

namespace {

struct Interval {
  double begins, ends;  // ends > begins; may exceed the period
  double contains_length() const { return ends - begins; }
};

// Linear interpolation of a periodic series sampled at `t`.
double at_time(const std::vector<double>& t, const std::vector<double>& y, double when) {
  const double period = t.back();
  when = std::fmod(when, period);
  if (when < 0) when += period;
  const auto upper = std::upper_bound(t.begin(), t.end(), when);
  if (upper == t.begin()) return y.front();
  if (upper == t.end()) return y.back();
  const std::size_t k = static_cast<std::size_t>(upper - t.begin());
  const double share = (when - t[k - 1]) / (t[k] - t[k - 1]);
  return y[k - 1] + share * (y[k] - y[k - 1]);
}

// Intervals in which dp > 0, the beat taken as periodic; gaps and openings shorter than the debounce vanish.
std::vector<Interval> open_intervals(const std::vector<double>& t, const std::vector<double>& dp,
                                     double debounce) {
  const double period = t.back();
  std::vector<Interval> found;
  double begin = dp[0] > 0 ? 0 : -1;
  for (std::size_t k = 1; k < t.size(); ++k) {
    if ((dp[k] > 0) == (dp[k - 1] > 0)) continue;
    const double crossing = t[k - 1] + (t[k] - t[k - 1]) * dp[k - 1] / (dp[k - 1] - dp[k]);
    if (dp[k] > 0) {
      begin = crossing;
    } else {
      found.push_back({begin, crossing});
      begin = -1;
    }
  }
  if (begin >= 0) {
    // Open at the end: joins an opening at the start of the beat.
    if (!found.empty() && found.front().begins == 0 && dp[0] > 0) {
      found.front().begins = begin;
      found.front().ends += period;
    } else {
      found.push_back({begin, period});
    }
  }
  std::sort(found.begin(), found.end(),
            [](const Interval& a, const Interval& b) { return a.begins < b.begins; });
  std::vector<Interval> joined;
  for (const Interval& interval : found) {
    if (!joined.empty() && interval.begins - joined.back().ends < debounce)
      joined.back().ends = interval.ends;
    else
      joined.push_back(interval);
  }
  std::erase_if(joined, [&](const Interval& i) { return i.contains_length() < debounce; });
  return joined;
}

double integral(const std::vector<double>& t, const std::vector<double>& y) {
  double sum = 0;
  for (std::size_t k = 1; k < t.size(); ++k) sum += 0.5 * (y[k] + y[k - 1]) * (t[k] - t[k - 1]);
  return sum;
}

double largest(const std::vector<double>& y) { return *std::max_element(y.begin(), y.end()); }
double smallest(const std::vector<double>& y) { return *std::min_element(y.begin(), y.end()); }

// Work of the chamber on the blood: -loop integral of p dV (mmHg mL).
double loop_work(const std::vector<double>& p, const std::vector<double>& V) {
  double sum = 0;
  for (std::size_t k = 1; k < p.size(); ++k) sum -= 0.5 * (p[k] + p[k - 1]) * (V[k] - V[k - 1]);
  return sum;
}

// Time from `from` forward to `to` in a periodic beat.
double forward(double from, double to, double period) {
  double d = std::fmod(to - from, period);
  return d < 0 ? d + period : d;
}

// Largest flow while the time lies in [begins, begins + length) of the periodic beat, and the volume passed.
std::pair<double, double> flow_in(const std::vector<double>& t, const std::vector<double>& Q, double begins,
                                  double length) {
  const double period = t.back();
  double peak = 0, volume = 0;
  for (std::size_t k = 1; k < t.size(); ++k) {
    const double middle = 0.5 * (t[k] + t[k - 1]);
    if (forward(begins, middle, period) >= length) continue;
    peak = std::max({peak, Q[k - 1], Q[k]});
    volume += 0.5 * (Q[k] + Q[k - 1]) * (t[k] - t[k - 1]);
  }
  return {peak, volume};
}

}  // namespace

BeatIndexes compute_indexes(const Table& trace, double atrial_stimulus, double debounce) {
  BeatIndexes r;
  const std::vector<double>& t = trace.at("t_s").values;
  if (t.size() < 10) throw InputError("the trace of a beat needs at least ten rows");
  const double period = r.period_s = t.back();
  r.atrial_stimulus_s = std::fmod(atrial_stimulus, period);

  const char* upstream[] = {"p_LA", "p_LV", "p_RA", "p_RV"};
  const char* downstream[] = {"p_LV", "p_AR_SYS", "p_RV", "p_AR_PUL"};
  std::array<std::vector<Interval>, n_valves> openings;
  for (int v = 0; v < n_valves; ++v) {
    const auto& Q = trace.at(fmt::format("Q_{}", valve_names[v])).values;
    const auto& p1 = trace.at(upstream[v]).values;
    const auto& p2 = trace.at(downstream[v]).values;
    std::vector<double> dp(t.size()), forward_flow(t.size()), backward_flow(t.size());
    for (std::size_t k = 0; k < t.size(); ++k) {
      dp[k] = p1[k] - p2[k];
      forward_flow[k] = std::max(Q[k], 0.0);
      backward_flow[k] = std::max(-Q[k], 0.0);
    }
    openings[v] = open_intervals(t, dp, debounce);
    r.valve[v].peak_flow_mL_per_s = largest(Q);
    r.valve[v].forward_volume_mL = integral(t, forward_flow);
    r.valve[v].backward_volume_mL = integral(t, backward_flow);
  }

  for (int side = 0; side < 2; ++side) {
    const int atrial_valve = side == 0 ? MV : TV, outlet = side == 0 ? AV : PV;
    const int atrium = side == 0 ? LA : RA, ventricle = side == 0 ? LV : RV;
    const auto name = [](std::string_view prefix, int chamber) {
      return fmt::format("{}_{}", prefix, chamber_names[chamber]);
    };
    const auto& V = trace.at(name("V", ventricle)).values;
    const auto& p = trace.at(name("p", ventricle)).values;
    const auto& Va = trace.at(name("V", atrium)).values;
    const auto& pa = trace.at(name("p", atrium)).values;
    const auto& Q = trace.at(fmt::format("Q_{}", valve_names[atrial_valve])).values;

    // Ejection is the longest opening of the outlet; the atrioventricular valve is timed around it.
    if (!openings[outlet].empty()) {
      const Interval ejection = *std::max_element(
          openings[outlet].begin(), openings[outlet].end(),
          [](const Interval& a, const Interval& b) { return a.contains_length() < b.contains_length(); });
      ValveTimes& out = r.valve[outlet];
      out.opens_s = std::fmod(ejection.begins, period);
      out.closes_s = std::fmod(ejection.ends, period);
      ValveTimes& in = r.valve[atrial_valve];
      double best_close = 2 * period, best_open = 2 * period;
      for (const Interval& i : openings[atrial_valve]) {
        const double until_ejection = forward(i.ends, *out.opens_s, period);
        const double after_ejection = forward(*out.closes_s, i.begins, period);
        if (until_ejection < best_close) {
          best_close = until_ejection;
          in.closes_s = std::fmod(i.ends, period);
        }
        if (after_ejection < best_open) {
          best_open = after_ejection;
          in.opens_s = std::fmod(i.begins, period);
        }
      }
      if (in.opens_s && in.closes_s) {
        const double filling = forward(*in.opens_s, *in.closes_s, period);
        const double before_AC = std::min(forward(*in.opens_s, r.atrial_stimulus_s, period), filling);
        const auto [E, passive_volume] = flow_in(t, Q, *in.opens_s, before_AC);
        const auto [A, active_volume] =
            flow_in(t, Q, r.atrial_stimulus_s, std::max(0.0, filling - before_AC));
        r.E_mL_per_s[side] = E;
        r.A_mL_per_s[side] = A;
        if (A > 0) r.E_over_A[side] = E / A;
        if (passive_volume + active_volume > 0)
          r.atrial_kick_percent[side] = 100 * active_volume / (passive_volume + active_volume);
        r.phases[side] = {{"AC", r.atrial_stimulus_s, *in.closes_s},
                          {"IVC", *in.closes_s, *out.opens_s},
                          {"VE", *out.opens_s, *out.closes_s},
                          {"IVR", *out.closes_s, *in.opens_s},
                          {"VPF", *in.opens_s, r.atrial_stimulus_s}};
      }
    }

    VentricleIndexes& w = r.ventricle[side];
    w.EDV_mL = r.valve[atrial_valve].closes_s ? at_time(t, V, *r.valve[atrial_valve].closes_s) : largest(V);
    w.ESV_mL = smallest(V);
    w.SV_mL = w.EDV_mL - w.ESV_mL;
    w.EF_percent = 100 * w.SV_mL / w.EDV_mL;
    w.pressure_max_mmHg = largest(p);
    w.pressure_min_mmHg = smallest(p);
    w.stroke_work_J = loop_work(p, V) * units::J_per_mmHg_mL;
    for (std::size_t k = 1; k < t.size(); ++k) {
      const double slope = (p[k] - p[k - 1]) / (t[k] - t[k - 1]);
      w.dpdt_max_mmHg_per_s = std::max(w.dpdt_max_mmHg_per_s, slope);
      w.dpdt_min_mmHg_per_s = std::min(w.dpdt_min_mmHg_per_s, slope);
    }
    AtriumIndexes& a = r.atrium[side];
    a.Vmax_mL = largest(Va);
    a.VpreAC_mL = at_time(t, Va, r.atrial_stimulus_s);
    a.Vmin_mL = smallest(Va);
    a.PassEF_percent = 100 * (a.Vmax_mL - a.VpreAC_mL) / a.Vmax_mL;
    a.ActEF_percent = 100 * (a.VpreAC_mL - a.Vmin_mL) / a.VpreAC_mL;
    a.TotEF_percent = 100 * (a.Vmax_mL - a.Vmin_mL) / a.Vmax_mL;
    a.pressure_mean_mmHg = integral(t, pa) / period;
    a.pressure_max_mmHg = largest(pa);
    a.pressure_min_mmHg = smallest(pa);
    a.work_J = loop_work(pa, Va) * units::J_per_mmHg_mL;
  }

  const auto artery = [&](const char* name) {
    const auto& p = trace.at(name).values;
    return BeatIndexes::Artery{largest(p), smallest(p), integral(t, p) / period};
  };
  r.aorta = artery("p_AR_SYS");
  r.pulmonary_artery = artery("p_AR_PUL");
  const double mean_flow = (r.valve[AV].forward_volume_mL - r.valve[AV].backward_volume_mL) / period;
  r.cardiac_output_L_per_min = mean_flow * units::L_per_min_from_mL_per_s;
  if (mean_flow > 0) {
    r.systemic_resistance_mmHg_s_per_mL =
        (r.aorta.pressure_mean_mmHg - r.atrium[1].pressure_mean_mmHg) / mean_flow;
    r.pulmonary_resistance_mmHg_s_per_mL =
        (r.pulmonary_artery.pressure_mean_mmHg - r.atrium[0].pressure_mean_mmHg) / mean_flow;
  }
  return r;
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

double indexed_value(const BeatIndexes& beat, std::string_view index, double bsa) {
  const auto& v = beat.ventricle[index.starts_with("LV") ? 0 : 1];
  const auto& a = beat.atrium[index.starts_with("LA") ? 0 : 1];
  const std::string_view what = index.substr(3);
  if (what == "EDV") return v.EDV_mL / bsa;
  if (what == "ESV") return v.ESV_mL / bsa;
  if (what == "SV") return v.SV_mL / bsa;
  if (what == "EF") return v.EF_percent;
  if (what == "Vmax") return a.Vmax_mL / bsa;
  if (what == "VpreAC") return a.VpreAC_mL / bsa;
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
