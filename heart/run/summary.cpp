#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <wiggers/heart/run/rate_warnings.hpp>
#include <wiggers/heart/run/run.hpp>
#include <wiggers/heart/run/summary.hpp>

#ifndef WIGGERS_VERSION
#define WIGGERS_VERSION "unknown"
#endif
#ifndef WIGGERS_REVISION
#define WIGGERS_REVISION "unknown"
#endif

namespace wiggers {

using Json = nlohmann::ordered_json;

std::string version_text() { return fmt::format("wiggers {} ({})", WIGGERS_VERSION, WIGGERS_REVISION); }

namespace {

Json index_json(const BeatIndexes& b) {
  Json out;
  for_each_index(b, [&](const std::string& name, const char*, double value) {
    std::string pointer = "/" + name;
    std::replace(pointer.begin(), pointer.end(), '.', '/');
    out[Json::json_pointer(pointer)] = value;
  });
  for (int s = 0; s < 2; ++s)
    for (const Phase& phase : b.phases[s])
      out["phases"][s == 0 ? "left" : "right"][phase.name] = {{"begins_s", phase.begins_s},
                                                              {"ends_s", phase.ends_s}};
  return out;
}

Json certificate_json(const LimitCycleCertificate& c) {
  Json out = {{"verdict", c.text()},
              {"distance", c.distance},
              {"beats", c.beats},
              {"residual", c.residual},
              {"multiplier", c.multiplier}};
  if (!c.reason.empty()) out["reason"] = c.reason;
  if (!c.warnings.empty()) out["warnings"] = c.warnings;
  return out;
}

Json flips_json(const Table& trace) {
  return {{"p_LV_mmHg", largest_flip(trace.at("p_LV").values)},
          {"Q_AV_mL_per_s", largest_flip(trace.at("Q_AV").values)}};
}

double imbalance(double work, double dissipated) {
  // Below 1 mmHg mL a beat nothing flows: the difference then counts as it is.
  return std::abs(work - dissipated) / std::max(1.0, std::abs(dissipated));
}

// f(shunt, net volume in mL a beat from its first node to its second) for the shunts of a trace.
template <class F>
void for_each_shunt_volume(const Table& trace, F f) {
  const std::vector<double>& t = trace.at("t_s").values;
  for (const Column& column : trace.columns)
    for (const network::Branch& shunt : network::shunts) {
      if (column.name != fmt::format("Q_{}", shunt.name)) continue;
      double volume = 0;
      for (std::size_t k = 1; k < t.size(); ++k)
        volume += 0.5 * (column.values[k] + column.values[k - 1]) * (t[k] - t[k - 1]);
      f(shunt, volume);
    }
}
Json shunts_json(const Table& trace) {
  Json out = Json::object();
  for_each_shunt_volume(trace, [&](const network::Branch& shunt, double volume) {
    out[std::string(shunt.name)] = {{"volume_mL", volume}};
  });
  return out;
}

}  // namespace

std::string shunt_lines(const Table& trace) {
  std::string text;
  for_each_shunt_volume(trace, [&](const network::Branch& shunt, double volume) {
    text += fmt::format("{} ({}): {:.1f} mL a beat from {} to {}\n", shunt.name, shunt.meaning, volume,
                        network::node_name(shunt.from), network::node_name(shunt.to));
  });
  return text;
}

Json summarise(const HeartRun& run) {
  Json out;
  std::optional<BeatIndexes> b;
  if (run.has_whole_beat()) b = run.indexes();
  out["title"] = run.scene().title;
  if (b) out["indexes"] = index_json(*b);
  out["limit_cycle"] = certificate_json(run.certificate());
  Json cells;
  for (const auto& [name, paced] : run.cells()) {
    cells[name] = {{"calcium_min_uM", paced.calcium_min_uM}, {"calcium_max_uM", paced.calcium_max_uM}};
    if (paced.certificate.verdict != LimitCycleVerdict::running) {
      cells[name]["limit_cycle"] = certificate_json(paced.certificate);
      cells[name]["charge_drift_mV_per_beat"] = paced.charge_drift_mV;
    }
  }
  if (!cells.is_null()) out["cells"] = cells;
  const BeatAudit& audit = run.audit();
  out["audits"] = {
      {"blood_volume_drift_mL", run.blood_volume_drift_mL()},
      {"energy_imbalance", imbalance(audit.chamber_work_mmHg_mL, audit.dissipated_mmHg_mL)},
      {"chamber_work_mmHg_mL", audit.chamber_work_mmHg_mL},
      {"dissipated_mmHg_mL", audit.dissipated_mmHg_mL},
      {"volume_mismatch_mL", audit.volume_mismatch_mL},
      {"stroke_volume_difference_mL", std::abs(audit.valve_volume_mL[AV] - audit.valve_volume_mL[PV])}};
  if (run.scene().circulation.has_shunts()) out["shunts"] = shunts_json(run.trace());
  out["flips"] = flips_json(run.trace());
  out["cost"] = {{"wall_s", run.cost().cells_s + run.cost().heart_s},
                 {"beats", run.cost().beats},
                 {"cells_s", run.cost().cells_s},
                 {"heart_s", run.cost().heart_s},
                 {"newton_iterations_last_beat", audit.newton_iterations}};
  Json warnings = Json::array();
  for (const std::string& warning : run.scene().warnings) warnings.push_back(warning);
  for (const auto& [name, paced] : run.cells())
    if (run.scene().cells.at(name).ionic && paced.potential_max_mV < 0)
      warnings.push_back(fmt::format("cells {} do not fire: their potential stays below {:.0f} mV", name,
                                     paced.potential_max_mV));
  if (b)
    for (const std::string& warning : rate_warnings(run.trace(), *b, run.cells()))
      warnings.push_back(warning);
  if (!run.has_whole_beat()) warnings.push_back("the run was ended within a beat: there are no indexes");
  const LimitCycleCertificate& certificate = run.certificate();
  if (certificate.verdict == LimitCycleVerdict::unphysical)
    warnings.push_back(certificate.reason);
  else if (run.scene().until_limit_cycle && !certificate.good())
    warnings.push_back("the limit cycle was not reached; the indexes are of the last beat");
  if (out["flips"]["p_LV_mmHg"].get<double>() > 1)
    warnings.push_back(
        "pressure and flow oscillate from step to step: see flips; switch the stabilisations on");
  if (audit.newton_iterations > 12 * run.scene().period_s / run.scene().dt_s)
    warnings.push_back("the cavity Newton needs more than 12 iterations a step on average");
  out["warnings"] = warnings;
  return out;
}

Json summarise(const LoopSummary& loop) {
  Json out;
  out["title"] = loop.title;
  out["indexes"] = index_json(loop.indexes);
  if (loop.limit_cycle_wanted) {
    out["limit_cycle"] = certificate_json(loop.certificate);
    out["limit_cycle"]["integrator_shift"] = nullptr;
    if (loop.integrator_shift) out["limit_cycle"]["integrator_shift"] = *loop.integrator_shift;
  }
  // Energy over the sampled beat, trapezoidal: chambers' work against losses.
  double work = 0, dissipated = 0;
  const std::vector<double>& t = loop.trace.at("t_s").values;
  double power_before = 0;
  for (std::size_t k = 0; k < t.size(); ++k) {
    double y[n_circulation_states], p[n_chambers];
    std::array<double, n_valves> Q{};
    for (int i = 0; i < n_circulation_states; ++i) y[i] = loop.trace.columns[1 + i].values[k];
    for (int i = 0; i < n_chambers; ++i) p[i] = loop.trace.columns[1 + n_circulation_states + i].values[k];
    for (int i = 0; i < n_valves; ++i)
      Q[i] = loop.trace.columns[1 + n_circulation_states + n_chambers + i].values[k];
    const double power = dissipated_power(loop.circulation, y, p, Q);
    if (k > 0) {
      dissipated += 0.5 * (power + power_before) * (t[k] - t[k - 1]);
      for (int c = 0; c < n_chambers; ++c) {
        const auto& V = loop.trace.columns[1 + c].values;
        const auto& pc = loop.trace.columns[1 + n_circulation_states + c].values;
        work -= 0.5 * (pc[k] + pc[k - 1]) * (V[k] - V[k - 1]);
      }
    }
    power_before = power;
  }
  out["audits"] = {{"blood_volume_drift_mL", loop.blood_volume_drift_mL},
                   {"energy_imbalance", imbalance(work, dissipated)},
                   {"chamber_work_mmHg_mL", work},
                   {"dissipated_mmHg_mL", dissipated}};
  if (loop.circulation.has_shunts()) out["shunts"] = shunts_json(loop.trace);
  out["flips"] = flips_json(loop.trace);
  out["cost"] = {{"wall_s", loop.wall_s}, {"beats", loop.beats}};
  out["warnings"] = Json::array();
  for (const std::string& warning : ejection_warnings(loop.indexes)) out["warnings"].push_back(warning);
  if (loop.certificate.verdict == LimitCycleVerdict::unphysical) {
    out["warnings"].push_back(loop.certificate.reason);
    out["limit_cycle"]["verdict"] = loop.certificate.text();
  } else if (loop.limit_cycle_wanted && !loop.certificate.good())
    out["warnings"].push_back("the limit cycle was not reached; the indexes are of the last beat");
  if (loop.limit_cycle_wanted && loop.certificate.verdict == LimitCycleVerdict::period_1 &&
      loop.certificate.distance > loop.wanted_distance)
    out["warnings"].push_back(
        "the integrator's tolerance allows no smaller distance to the limit cycle than stated");
  return out;
}

void write_indexes(ResultWriter& file, const BeatIndexes& b, double bsa) {
  const char* meaning = "clinical index; definitions in the docs";
  for_each_index(b, [&](std::string name, const char* unit, double value) {
    std::replace(name.begin(), name.end(), '.', '/');
    file.scalar("/indexes/" + name, value, unit, meaning);
  });
  for (const ReferenceRange& range : reference_ranges()) {
    const std::string group = fmt::format("/reference_ranges/{}", range.index);
    const std::string unit(range.unit);
    if (const auto value = indexed_value(b, range.index, bsa))
      file.scalar(group + "/value", *value, unit, "value of this beat, per body surface area");
    file.scalar(group + "/lower", range.lower, unit, "lower end of the reference range");
    file.scalar(group + "/upper", range.upper, unit, "upper end of the reference range");
    file.scalar(group + "/mean", range.mean, unit, "mean of the reference population");
    file.scalar(group + "/founding_paper", range.founding_paper, unit, "Fedele et al. 2023");
  }
  for (int side = 0; side < 2; ++side)
    for (const Phase& phase : b.phases[side]) {
      const std::string group = fmt::format("/phases/{}/{}", side == 0 ? "left" : "right", phase.name);
      file.dataset(group, {phase.begins_s, phase.ends_s}, "s", "begin and end within the beat");
    }
}

std::string index_table(const BeatIndexes& b, double bsa) {
  std::string out;
  const auto line = [&](const std::string& text) { out += text + "\n"; };
  line(fmt::format("{:<26}{:>12}{:>12}", "", "left", "right"));
  const auto& v = b.ventricle;
  const auto& a = b.atrium;
  const auto cell = [](const std::optional<double>& value, int digits) {
    return value ? fmt::format("{:.{}f}", *value, digits) : std::string("-");
  };
  const auto row = [&](const char* name, double left, double right, int digits = 1) {
    line(fmt::format("{:<26}{:>12.{}f}{:>12.{}f}", name, left, digits, right, digits));
  };
  row("ventricle EDV [mL]", v[0].EDV_mL, v[1].EDV_mL);
  row("ventricle ESV [mL]", v[0].ESV_mL, v[1].ESV_mL);
  row("stroke volume [mL]", v[0].SV_mL, v[1].SV_mL, 2);
  row("ejection fraction [%]", v[0].EF_percent, v[1].EF_percent);
  row("ventricle p max [mmHg]", v[0].pressure_max_mmHg, v[1].pressure_max_mmHg);
  row("ventricle p min [mmHg]", v[0].pressure_min_mmHg, v[1].pressure_min_mmHg);
  row("artery p max [mmHg]", b.aorta.pressure_max_mmHg, b.pulmonary_artery.pressure_max_mmHg);
  row("artery p min [mmHg]", b.aorta.pressure_min_mmHg, b.pulmonary_artery.pressure_min_mmHg);
  row("stroke work [J]", v[0].stroke_work_J, v[1].stroke_work_J, 3);
  row("atrium Vmax [mL]", a[0].Vmax_mL, a[1].Vmax_mL);
  if (a[0].VpreAC_mL || a[1].VpreAC_mL)
    line(fmt::format("{:<26}{:>12}{:>12}", "atrium VpreAC [mL]", cell(a[0].VpreAC_mL, 1),
                     cell(a[1].VpreAC_mL, 1)));
  row("atrium Vmin [mL]", a[0].Vmin_mL, a[1].Vmin_mL);
  row("atrium mean p [mmHg]", a[0].pressure_mean_mmHg, a[1].pressure_mean_mmHg);
  row("peak inflow [mL/s]", b.valve[MV].peak_flow_mL_per_s, b.valve[TV].peak_flow_mL_per_s);
  row("peak outflow [mL/s]", b.valve[AV].peak_flow_mL_per_s, b.valve[PV].peak_flow_mL_per_s);
  if (b.E_over_A[0] || b.E_over_A[1])
    line(fmt::format("{:<26}{:>12}{:>12}", "E/A", cell(b.E_over_A[0], 2), cell(b.E_over_A[1], 2)));
  line("");
  line(fmt::format("{:<6}{:>9}{:>9}", "valve", "opens s", "closes s"));
  for (int k = 0; k < n_valves; ++k)
    if (b.valve[k].opens_s && b.valve[k].closes_s)
      line(fmt::format("{:<6}{:>9.3f}{:>9.3f}", valve_names[k], *b.valve[k].opens_s, *b.valve[k].closes_s));
  line("");
  line(fmt::format("{:<11}{:>9} {:<6}{:>18}   {:>7}", "index", "value", "", "reference range", ""));
  for (const ReferenceRange& range : reference_ranges()) {
    const auto found = indexed_value(b, range.index, bsa);
    if (!found) continue;
    const double value = *found;
    const char* flag = value < range.lower ? "below" : value > range.upper ? "above" : "";
    line(fmt::format("{:<11}{:>9.1f} {:<6}{:>8.0f} to {:>6.0f}   {}", range.index, value, range.unit,
                     range.lower, range.upper, flag));
  }
  line(fmt::format("(volumes per body surface area of {} m2)", bsa));
  return out;
}

}  // namespace wiggers
