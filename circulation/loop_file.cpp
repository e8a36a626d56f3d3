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

// The numbers of the fact sheet from a table; what is absent keeps its value.
template <class Fields, class Quantities>
void read_numbers(SettingsReader& table, const Quantities& quantities, const Fields& fields) {
  for (std::size_t k = 0; k < fields.size(); ++k) *fields[k] = table.number(quantities[k], *fields[k]);
}

// The vessels of one circuit.
template <class F>
void for_each_vessel(int circuit, F f) {
  for (int v = 0; v < n_vessels; ++v)
    if (network::vessels[v].circuit == circuit) f(v);
}

}  // namespace

ElastanceParameters read_elastance(SettingsReader& table, const ElastanceParameters& defaults) {
  ElastanceParameters e = defaults;
  read_numbers(table, elastance_quantities, fields_of(e));
  return e;
}

void read_circulation(SettingsReader& reader, CirculationParameters& parameters) {
  const std::vector<std::string> laws(valve_law_names.begin(), valve_law_names.end());
  const std::string law =
      reader.choice("valve_law", valve_law_names[static_cast<int>(parameters.valve_law)], laws, "valve law");
  for (std::size_t k = 0; k < valve_law_names.size(); ++k)
    if (law == valve_law_names[k]) parameters.valve_law = static_cast<ValveLaw>(k);
  if (has_steepness(parameters.valve_law))
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
    parameters.vessels = set->loop.circulation.vessels;
  if (!reader.is_text("circuit")) {
    SettingsReader& circuits = reader.table("circuit");
    for (int c = 0; c < static_cast<int>(circuit_names.size()); ++c) {
      if (const CirculationSet* set = named_set(circuits, circuit_names[c], false))
        for_each_vessel(c, [&](int v) { parameters.vessels[v] = set->loop.circulation.vessels[v]; });
      if (!circuits.is_text(circuit_names[c]))
        for_each_vessel(c, [&](int v) {
          read_numbers(circuits.table(circuit_names[c]), network::vessels[v].quantities,
                       fields_of(parameters.vessels[v]));
        });
    }
  }
  // Shunts are there where they are named.
  for (int s = 0; reader.has("shunts") && s < n_shunts; ++s) {
    SettingsReader& named = reader.table("shunts");
    if (!named.has(shunt_names[s])) continue;
    if (named.is_flag(shunt_names[s]) && !named.flag(shunt_names[s], false)) continue;  // closed
    parameters.shunts[s].present = true;
    read_numbers(named.table(shunt_names[s]), shunt_quantities, fields_of(parameters.shunts[s]));
  }
}

CirculationValues read_initial(SettingsReader& table, const CirculationParameters& parameters,
                               const CirculationValues& defaults) {
  CirculationValues y{};
  const Quantity& held = circulation_state_quantities[pressure_of(reservoir)];
  const bool by_volume = table.has(total_volume_quantity.name);
  if (by_volume && table.has(held.name))
    throw InputError(fmt::format("{}: give total_volume or {}, not both: one follows from the other",
                                 table.place("total_volume"), held.name));
  for (int k = 0; k < n_circulation_states; ++k)
    if (!(by_volume && k == pressure_of(reservoir)))
      y[k] = table.number(circulation_state_quantities[k], defaults[k]);
  if (by_volume) {
    const double volume = table.number(total_volume_quantity);
    hold_total_volume(parameters, y.data(), volume);
    check_range(held, y[pressure_of(reservoir)],
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
