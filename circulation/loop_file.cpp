// Reading of loop files and of the circulation tables of scenes.
#include <fmt/format.h>

#include <wiggers/circulation/loop.hpp>
#include <wiggers/core/errors.hpp>

namespace wiggers {

namespace {

// A key that is text names the set whose table stands here; a table may name its base set by `parameters`.
const CirculationSet* named_set(SettingsReader& reader, std::string_view key, bool needs_elastances) {
  std::string name;
  std::string place = reader.place(key);
  if (reader.is_text(key)) {
    name = reader.text(key, "");
  } else if (reader.is_table(key) && reader.table(key).is_text("parameters")) {
    name = reader.table(key).text("parameters", "");
  } else {
    return nullptr;
  }
  const auto names = circulation_set_names(needs_elastances);
  for (const CirculationSet& set : circulation_sets())
    if (set.name == name && (set.has_elastances || !needs_elastances)) return &set;
  try {
    refuse_unknown("circulation parameter set", name, names);
  } catch (const InputError& error) {
    throw InputError(fmt::format("{}: {}", place, error.what()));
  }
}

ValveParameters read_valve(SettingsReader& table, const ValveParameters& defaults) {
  ValveParameters v;
  v.Rmin = table.number(valve_quantities[0], defaults.Rmin);
  v.Rmax = table.number(valve_quantities[1], defaults.Rmax);
  if (v.Rmax < v.Rmin)
    throw InputError(
        fmt::format("{} = {} is below Rmin = {}: the closed valve would leak more than the open one passes",
                    table.place("Rmax"), v.Rmax, v.Rmin));
  return v;
}

CircuitParameters read_circuit(SettingsReader& table, const CircuitParameters& d) {
  CircuitParameters c;
  for (std::size_t k = 0; k < circuit_quantities.size(); ++k)
    *fields_of(c)[k] = table.number(circuit_quantities[k], *fields_of(d)[k]);
  return c;
}

}  // namespace

ElastanceParameters read_elastance(SettingsReader& table, const ElastanceParameters& d) {
  ElastanceParameters e;
  for (std::size_t k = 0; k < elastance_quantities.size(); ++k)
    *fields_of(e)[k] = table.number(elastance_quantities[k], *fields_of(d)[k]);
  return e;
}

void read_circulation(SettingsReader& reader, CirculationParameters& parameters) {
  const std::vector<std::string> laws(valve_law_names.begin(), valve_law_names.end());
  const std::string law =
      reader.choice("valve_law", valve_law_names[static_cast<int>(parameters.valve_law)], laws, "valve law");
  for (std::size_t k = 0; k < valve_law_names.size(); ++k)
    if (law == valve_law_names[k]) parameters.valve_law = static_cast<ValveLaw>(k);
  if (parameters.valve_law == ValveLaw::tanh)
    parameters.tanh_steepness = reader.number(tanh_steepness_quantity, parameters.tanh_steepness);

  if (const CirculationSet* set = named_set(reader, "valves", false))
    parameters.valves = set->loop.circulation.valves;
  if (!reader.is_text("valves")) {
    SettingsReader& valves = reader.table("valves");
    for (int v = 0; v < n_valves; ++v) {
      if (const CirculationSet* set = named_set(valves, valve_names[v], false))
        parameters.valves[v] = set->loop.circulation.valves[v];
      if (!valves.is_text(valve_names[v]))
        parameters.valves[v] = read_valve(valves.table(valve_names[v]), parameters.valves[v]);
    }
  }
  if (const CirculationSet* set = named_set(reader, "circuit", false))
    parameters.circuits = set->loop.circulation.circuits;
  if (!reader.is_text("circuit")) {
    SettingsReader& circuits = reader.table("circuit");
    for (int c = 0; c < 2; ++c) {
      if (const CirculationSet* set = named_set(circuits, circuit_names[c], false))
        parameters.circuits[c] = set->loop.circulation.circuits[c];
      if (!circuits.is_text(circuit_names[c]))
        parameters.circuits[c] = read_circuit(circuits.table(circuit_names[c]), parameters.circuits[c]);
    }
  }
}

CirculationValues read_initial(SettingsReader& table, const CirculationParameters& parameters,
                               const CirculationValues& defaults) {
  CirculationValues y{};
  const bool by_volume = table.has(total_volume_quantity.name);
  if (by_volume && table.has("p_VEN_SYS"))
    throw InputError(fmt::format("{}: give total_volume or p_VEN_SYS, not both: one follows from the other",
                                 table.place("total_volume")));
  for (int k = 0; k < n_circulation_states; ++k)
    if (!(by_volume && k == p_VEN_SYS)) y[k] = table.number(circulation_state_quantities[k], defaults[k]);
  if (by_volume) {
    const double volume = table.number(total_volume_quantity);
    hold_total_volume(parameters, y.data(), volume);
    check_range(circulation_state_quantities[p_VEN_SYS], y[p_VEN_SYS],
                fmt::format("{} = {} mL", table.place("total_volume"), volume));
  }
  return y;
}

Loop read_loop(SettingsReader& reader) {
  const auto with_elastances = circulation_set_names(true);
  const std::string base =
      reader.choice("parameters", "wiggers-healthy-0d", with_elastances, "circulation parameter set");
  Loop loop = find_circulation_set(base).loop;
  loop.period_s = reader.number(period_quantity, loop.period_s);
  read_circulation(reader, loop.circulation);
  if (const CirculationSet* set = named_set(reader, "elastance", true)) loop.elastance = set->loop.elastance;
  if (!reader.is_text("elastance")) {
    SettingsReader& chambers = reader.table("elastance");
    for (int c = 0; c < n_chambers; ++c) {
      if (const CirculationSet* set = named_set(chambers, chamber_names[c], true))
        loop.elastance[c] = set->loop.elastance[c];
      if (!chambers.is_text(chamber_names[c]))
        loop.elastance[c] = read_elastance(chambers.table(chamber_names[c]), loop.elastance[c]);
    }
  }
  for (int c = 0; c < n_chambers; ++c)
    check_elastance(loop.elastance[c], loop.period_s,
                    reader.place(fmt::format("elastance.{}", chamber_names[c])).c_str());
  if (const CirculationSet* set = named_set(reader, "initial", true)) loop.initial = set->loop.initial;
  if (!reader.is_text("initial"))
    loop.initial = read_initial(reader.table("initial"), loop.circulation, loop.initial);
  reader.finish();
  return loop;
}

}  // namespace wiggers
