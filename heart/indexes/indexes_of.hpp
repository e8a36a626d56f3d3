// The text of the indexes, for numbers of any kind: plain ones, or dual ones that carry sensitivities. Users
// include indexes.hpp.
#pragma once

#include <algorithm>
#include <cmath>
#include <wiggers/circulation/elastance.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/units.hpp>
#include <wiggers/heart/indexes/indexes.hpp>

namespace wiggers {
namespace index_text {

template <class T>
using Series = std::vector<T>;

template <class T>
struct Interval {
  T begins, ends;  // ends > begins; may exceed the period
  T length() const { return ends - begins; }
};

// A series as pieces between the ends of steps: parabolas y0 + a s + b s^2, s in [0, h], where the trace has
// the steps' middles, straight lines where it has not. Kinks stand at ends of steps only.
template <class T>
struct Piece {
  T t, h, y0, a = 0, b = 0;
  T at(const T& s) const { return y0 + s * (a + s * b); }
  T slope(const T& s) const { return a + 2.0 * s * b; }
  T integral(const T& from, const T& to) const {
    const auto antiderivative = [&](const T& s) { return s * (y0 + s * (0.5 * a + s * (b / 3.0))); };
    return antiderivative(to) - antiderivative(from);
  }
  // Where the slope vanishes inside, if it does.
  bool vertex(T& s) const {
    if (value_of(b) == 0) return false;
    s = -0.5 * a / b;
    return s > 0.0 && s < h;
  }
};
template <class T>
struct Pieces {
  const Series<T>& t;
  std::size_t stride;
  std::size_t count() const { return (t.size() - 1) / stride; }
  Piece<T> operator()(const Series<T>& y, std::size_t k) const {
    const std::size_t i = k * stride, j = i + stride;
    Piece<T> piece{t[i], t[j] - t[i], y[i]};
    // An event may stand within rounding of a step's end: no slope is read off so short a step.
    if (value_of(piece.h) < 1e-9 * value_of(t.back())) return piece;
    if (stride == 1) {
      piece.a = (y[j] - y[i]) / piece.h;
    } else {
      const T rise = y[i + 1] - y[i], fall = y[j] - y[i + 1];
      piece.a = (3.0 * rise - fall) / piece.h;
      piece.b = 2.0 * (fall - rise) / (piece.h * piece.h);
    }
    return piece;
  }
  bool is_short(const Piece<T>& piece) const { return value_of(piece.h) < 1e-9 * value_of(t.back()); }
};

// Value at any time of the periodic beat.
template <class T>
T at_time(const Pieces<T>& pieces, const Series<T>& y, const T& any_time) {
  const Series<T>& t = pieces.t;
  const T when = wrapped(any_time, t.back());
  const auto upper = std::upper_bound(t.begin(), t.end(), when);
  if (upper == t.begin()) return y.front();
  if (upper == t.end()) return y.back();
  const auto row = static_cast<std::size_t>(upper - t.begin()) - 1;
  const Piece<T> piece = pieces(y, row / pieces.stride);
  return piece.at(when - piece.t);
}

// Intervals in which dp > 0, the beat taken as periodic; gaps and openings shorter than the debounce vanish.
template <class T>
std::vector<Interval<T>> open_intervals(const Series<T>& t, const Series<T>& dp, double debounce) {
  const T period = t.back();
  std::vector<Interval<T>> found;
  T begin = dp[0] > 0.0 ? 0.0 : -1.0;
  for (std::size_t k = 1; k < t.size(); ++k) {
    if ((dp[k] > 0.0) == (dp[k - 1] > 0.0)) continue;
    const T crossing = t[k - 1] + (t[k] - t[k - 1]) * dp[k - 1] / (dp[k - 1] - dp[k]);
    if (dp[k] > 0.0) {
      begin = crossing;
    } else {
      found.push_back({begin, crossing});
      begin = -1.0;
    }
  }
  if (begin >= 0.0) {
    // Open at the end: joins an opening at the start of the beat.
    if (!found.empty() && value_of(found.front().begins) == 0 && dp[0] > 0.0) {
      found.front().begins = begin;
      found.front().ends += period;
    } else {
      found.push_back({begin, period});
    }
  }
  std::sort(found.begin(), found.end(),
            [](const Interval<T>& a, const Interval<T>& b) { return a.begins < b.begins; });
  std::vector<Interval<T>> joined;
  for (const Interval<T>& interval : found) {
    if (!joined.empty() && interval.begins - joined.back().ends < debounce)
      joined.back().ends = interval.ends;
    else
      joined.push_back(interval);
  }
  std::erase_if(joined, [&](const Interval<T>& i) { return i.length() < debounce; });
  return joined;
}

template <class T>
T integral(const Pieces<T>& pieces, const Series<T>& y) {
  T sum(0.0);
  for (std::size_t k = 0; k < pieces.count(); ++k) {
    const Piece<T> piece = pieces(y, k);
    sum += piece.integral(T(0.0), piece.h);
  }
  return sum;
}

// Extreme of a series of rows without middles: the vertex of the parabola through the extreme row and its
// neighbours, so that it moves smoothly with the parameters, unlike the row. At the beat's ends, and where
// the vertex is nearer to a neighbour (a kink), the row itself.
template <class T>
T vertex_of_rows(const Series<T>& t, const Series<T>& y, std::size_t k) {
  if (k == 0 || k + 1 >= y.size()) return y[k];
  const T left = t[k] - t[k - 1], right = t[k + 1] - t[k];
  if (!(left > 0.0 && right > 0.0)) return y[k];
  const T rise = (y[k] - y[k - 1]) / left, fall = (y[k + 1] - y[k]) / right;
  const T curvature = (fall - rise) / (left + right);
  if (value_of(curvature) == 0) return y[k];
  const T slope = (rise * right + fall * left) / (left + right);
  const T shift = -0.5 * slope / curvature;
  if (!(shift > -0.5 * left && shift < 0.5 * right)) return y[k];
  return y[k] + 0.5 * slope * shift;
}

// sign 1: the largest value; -1: the smallest.
template <class T>
T extreme(const Pieces<T>& pieces, const Series<T>& y, double sign) {
  std::size_t row = 0;
  for (std::size_t k = 1; k < y.size(); ++k)
    if (sign * value_of(y[k]) > sign * value_of(y[row])) row = k;
  if (pieces.stride == 1) return vertex_of_rows(pieces.t, y, row);
  T best = y[row];
  const std::size_t first = row / pieces.stride;
  for (std::size_t k : {first == 0 ? 0 : first - 1, first}) {
    if (k >= pieces.count()) continue;
    const Piece<T> piece = pieces(y, k);
    T s(0.0);
    if (piece.vertex(s) && sign * value_of(piece.at(s)) > sign * value_of(best)) best = piece.at(s);
  }
  return best;
}
template <class T>
T largest(const Pieces<T>& pieces, const Series<T>& y) {
  return extreme(pieces, y, 1);
}
template <class T>
T smallest(const Pieces<T>& pieces, const Series<T>& y) {
  return extreme(pieces, y, -1);
}

// Work of the chamber on the blood: -loop integral of p dV (mmHg mL); Simpson's rule is exact for pieces.
template <class T>
T loop_work(const Pieces<T>& pieces, const Series<T>& p, const Series<T>& V) {
  T sum(0.0);
  for (std::size_t k = 0; k < pieces.count(); ++k) {
    const Piece<T> pressure = pieces(p, k), volume = pieces(V, k);
    const auto power = [&](const T& s) { return pressure.at(s) * volume.slope(s); };
    const T half = 0.5 * pressure.h;
    sum -= pressure.h / 6.0 * (power(T(0.0)) + 4.0 * power(half) + power(pressure.h));
  }
  return sum;
}

// Time from `from` forward to `to` in a periodic beat.
template <class T>
T forward(const T& from, const T& to, const T& period) {
  return wrapped(T(to - from), period);
}

// Largest flow while the time lies in [begins, begins + length) of the periodic beat, and the volume passed.
template <class T>
std::pair<T, T> flow_in(const Pieces<T>& pieces, const Series<T>& Q, const T& begins, const T& length) {
  const T period = pieces.t.back();
  T peak(0.0), volume(0.0);
  for (std::size_t k = 0; k < pieces.count(); ++k) {
    const Piece<T> piece = pieces(Q, k);
    // The window's part of this piece, so that the volume moves smoothly with the window's ends.
    // An end within rounding of a row is the window's, not the row's.
    const double rounding = 1e-9 * value_of(period);
    T low = forward(piece.t, begins, period);
    if (value_of(low) > value_of(period) - rounding) low -= period;
    T high = piece.h;
    if (value_of(low) < value_of(high) - rounding) {
      if (value_of(length) < value_of(high) - value_of(low) + rounding) high = low + length;
    } else {
      const T since = forward(begins, piece.t, period);
      if (value_of(since) > value_of(length) - rounding) continue;
      low = T(0.0);
      if (value_of(length) - value_of(since) < value_of(high) + rounding) high = length - since;
    }
    if (!(high > low)) continue;
    volume += piece.integral(low, high);
    T s(0.0);
    for (const T& candidate : {piece.at(low), piece.at(high)})
      if (candidate > peak) peak = candidate;
    if (piece.vertex(s) && s > low && s < high && piece.at(s) > peak) peak = piece.at(s);
  }
  if (pieces.stride > 1) return {peak, volume};
  // Rows alone: the peak row's vertex, if it lies well inside the window.
  for (std::size_t k = 1; k + 1 < Q.size(); ++k)
    if (value_of(Q[k]) == value_of(peak) && forward(begins, pieces.t[k - 1], period) < length &&
        forward(begins, pieces.t[k + 1], period) < length)
      return {vertex_of_rows(pieces.t, Q, k), volume};
  return {peak, volume};
}

// Mean flow (mL/s) that an artery, of the lungs or of the body, passes on: what its valve gives, and shunts.
template <class T>
T passed_on(const Pieces<T>& rows, const BeatTraceOf<T>& trace, const BeatIndexesOf<T>& known, bool lungs) {
  const int artery = network::valves[lungs ? PV : AV].to;
  T volume(0.0);
  for (int v = 0; v < n_valves; ++v)
    if (network::valves[v].to == artery)
      volume += known.valve[v].forward_volume_mL - known.valve[v].backward_volume_mL;
  for (int s = 0; s < n_shunts; ++s) {
    if (trace.shunts[s].empty()) continue;
    const T through = integral(rows, trace.shunts[s]);
    if (network::shunts[s].to == artery) volume += through;
    if (network::shunts[s].from == artery) volume -= through;
  }
  return T(volume / known.period_s);
}

}  // namespace index_text

template <class T>
BeatIndexesOf<T> compute_indexes_of(const BeatTraceOf<T>& trace,
                                    const AtrialActivationsOf<T>& atrial_activation, double debounce) {
  using namespace index_text;
  BeatIndexesOf<T> r;
  const Series<T>& t = trace.t;
  const Pieces<T> rows{t, trace.with_middles ? 2u : 1u};
  if (t.size() < 10) throw InputError("the trace of a beat needs at least ten rows");
  const T period = r.period_s = t.back();
  for (int side = 0; side < 2; ++side)
    if (atrial_activation[side]) r.atrial_activation_s[side] = wrapped(*atrial_activation[side], period);

  std::array<std::vector<Interval<T>>, n_valves> openings;
  for (int v = 0; v < n_valves; ++v) {
    const Series<T>& Q = trace.Q[v];
    const Series<T>&p1 = trace.p[network::valves[v].from], &p2 = trace.p[network::valves[v].to];
    Series<T> dp(t.size()), forward_flow(t.size()), backward_flow(t.size());
    for (std::size_t k = 0; k < t.size(); ++k) {
      dp[k] = p1[k] - p2[k];
      forward_flow[k] = Q[k] > 0.0 ? Q[k] : T(0.0);
      backward_flow[k] = Q[k] < 0.0 ? T(-Q[k]) : T(0.0);
    }
    openings[v] = open_intervals(t, dp, debounce);
    r.valve[v].peak_flow_mL_per_s = largest(rows, Q);
    r.valve[v].forward_volume_mL = integral(rows, forward_flow);
    r.valve[v].backward_volume_mL = integral(rows, backward_flow);
  }

  for (int side = 0; side < 2; ++side) {
    const int atrial_valve = side == 0 ? MV : TV, outlet = side == 0 ? AV : PV;
    const int atrium = side == 0 ? LA : RA, ventricle = side == 0 ? LV : RV;
    const Series<T>&V = trace.V[ventricle], &p = trace.p[ventricle];
    const Series<T>&Va = trace.V[atrium], &pa = trace.p[atrium];
    const Series<T>& Q = trace.Q[atrial_valve];
    const std::optional<T>& activation = r.atrial_activation_s[side];

    // Ejection is the longest opening of the outlet; the atrioventricular valve is timed around it.
    if (!openings[outlet].empty()) {
      const Interval<T> ejection = *std::max_element(
          openings[outlet].begin(), openings[outlet].end(),
          [](const Interval<T>& a, const Interval<T>& b) { return a.length() < b.length(); });
      ValveTimesOf<T>& out = r.valve[outlet];
      out.opens_s = wrapped(ejection.begins, period);
      out.closes_s = wrapped(ejection.ends, period);
      ValveTimesOf<T>& in = r.valve[atrial_valve];
      T best_close = 2.0 * period, best_open = 2.0 * period;
      for (const Interval<T>& i : openings[atrial_valve]) {
        const T until_ejection = forward(i.ends, *out.opens_s, period);
        const T after_ejection = forward(*out.closes_s, i.begins, period);
        if (until_ejection < best_close) {
          best_close = until_ejection;
          in.closes_s = wrapped(i.ends, period);
        }
        if (after_ejection < best_open) {
          best_open = after_ejection;
          in.opens_s = wrapped(i.begins, period);
        }
      }
      if (in.opens_s && in.closes_s) {
        const T filling = forward(*in.opens_s, *in.closes_s, period);
        // Without a contraction all of it is passive.
        const T until_AC = activation ? forward(*in.opens_s, *activation, period) : filling;
        const T before_AC = until_AC < filling ? until_AC : filling;
        const auto [E, passive_volume] = flow_in(rows, Q, *in.opens_s, before_AC);
        r.E_mL_per_s[side] = E;
        if (activation) {
          const auto [A, active_volume] = flow_in(rows, Q, *activation, T(filling - before_AC));
          r.A_mL_per_s[side] = A;
          if (A > 0.0) r.E_over_A[side] = E / A;
          if (passive_volume + active_volume > 0.0)
            r.atrial_kick_percent[side] = 100.0 * active_volume / (passive_volume + active_volume);
        }
        const double closes = value_of(*in.closes_s),
                     passive_ends = activation ? value_of(*activation) : closes;
        r.phases[side] = {{"IVC", closes, value_of(*out.opens_s)},
                          {"VE", value_of(*out.opens_s), value_of(*out.closes_s)},
                          {"IVR", value_of(*out.closes_s), value_of(*in.opens_s)},
                          {"VPF", value_of(*in.opens_s), passive_ends}};
        if (activation) r.phases[side].insert(r.phases[side].begin(), {"AC", passive_ends, closes});
      }
    }

    VentricleIndexesOf<T>& w = r.ventricle[side];
    w.EDV_mL =
        r.valve[atrial_valve].closes_s ? at_time(rows, V, *r.valve[atrial_valve].closes_s) : largest(rows, V);
    w.ESV_mL = smallest(rows, V);
    w.SV_mL = w.EDV_mL - w.ESV_mL;
    w.EF_percent = 100.0 * w.SV_mL / w.EDV_mL;
    w.pressure_max_mmHg = largest(rows, p);
    w.pressure_min_mmHg = smallest(rows, p);
    w.stroke_work_J = loop_work(rows, p, V) * units::J_per_mmHg_mL;
    w.dpdt_max_mmHg_per_s = w.dpdt_min_mmHg_per_s = T(0.0);
    for (std::size_t k = 0; k < rows.count(); ++k) {
      const Piece<T> piece = rows(p, k);
      if (rows.is_short(piece)) continue;
      for (const T& slope : {piece.slope(T(0.0)), piece.slope(piece.h)}) {
        if (slope > w.dpdt_max_mmHg_per_s) w.dpdt_max_mmHg_per_s = slope;
        if (slope < w.dpdt_min_mmHg_per_s) w.dpdt_min_mmHg_per_s = slope;
      }
    }
    AtriumIndexesOf<T>& a = r.atrium[side];
    a.Vmax_mL = largest(rows, Va);
    a.Vmin_mL = smallest(rows, Va);
    if (activation) {
      const T before = at_time(rows, Va, *activation);
      a.VpreAC_mL = before;
      a.PassEF_percent = 100.0 * (a.Vmax_mL - before) / a.Vmax_mL;
      a.ActEF_percent = 100.0 * (before - a.Vmin_mL) / before;
    }
    a.TotEF_percent = 100.0 * (a.Vmax_mL - a.Vmin_mL) / a.Vmax_mL;
    a.pressure_mean_mmHg = integral(rows, pa) / period;
    a.pressure_max_mmHg = largest(rows, pa);
    a.pressure_min_mmHg = smallest(rows, pa);
    a.work_J = loop_work(rows, pa, Va) * units::J_per_mmHg_mL;
  }

  const auto artery = [&](const Series<T>& p) {
    return ArteryIndexesOf<T>{largest(rows, p), smallest(rows, p), integral(rows, p) / period};
  };
  r.aorta = artery(trace.p[network::valves[AV].to]);
  r.pulmonary_artery = artery(trace.p[network::valves[PV].to]);
  const T mean_flow = (r.valve[AV].forward_volume_mL - r.valve[AV].backward_volume_mL) / period;
  r.cardiac_output_L_per_min = mean_flow * units::L_per_min_from_mL_per_s;
  // Without shunts both sides carry the same; the aortic valve's flow stands for both.
  const bool has_shunts = trace.has_shunts();
  const T body = has_shunts ? passed_on(rows, trace, r, false) : mean_flow;
  const T lungs = has_shunts ? passed_on(rows, trace, r, true) : mean_flow;
  if (body > 0.0)
    r.systemic_resistance_mmHg_s_per_mL =
        (r.aorta.pressure_mean_mmHg - r.atrium[1].pressure_mean_mmHg) / body;
  if (lungs > 0.0)
    r.pulmonary_resistance_mmHg_s_per_mL =
        (r.pulmonary_artery.pressure_mean_mmHg - r.atrium[0].pressure_mean_mmHg) / lungs;
  for_each_further_index([&](std::size_t k, auto index) { r.further[k] = index.of(rows, trace, r); });
  return r;
}

}  // namespace wiggers
