#include <fmt/core.h>
#include <fmt/format.h>

#include <memory>
#include <wiggers/cellmodels/catalogue/catalogue.hpp>
#include <wiggers/circulation/loop.hpp>
#include <wiggers/core/errors.hpp>

#include "verbs.hpp"

namespace wiggers::command {

namespace {

void print_quantities(std::string_view heading, std::span<const Quantity> quantities, bool with_values) {
  fmt::print("\n{}\n", heading);
  for (const Quantity& q : quantities) {
    if (with_values)
      fmt::print("  {:<20} {:<12} {:>14}  [{}, {}]  {}\n", q.name, q.unit, to_text(q.default_value),
                 to_text(q.lower), to_text(q.upper), q.meaning);
    else
      fmt::print("  {:<20} {:<12} {}\n", q.name, q.unit, q.meaning);
  }
}

void print_sets(const CellModel& model) {
  fmt::print("\nparameter sets of {}\n", model.name);
  for (const ParameterSet& set : model.parameter_sets) {
    fmt::print("  {} (version {}): {}\n", set.name, set.version, set.source);
    for (std::size_t k = 0; k < set.n_changes; ++k)
      fmt::print("      {} = {}\n", set.changes[k].name, to_text(set.changes[k].value));
  }
}

}  // namespace

void add_models(CLI::App& app) {
  struct Options {
    std::string name;
    bool sets = false, names = false;
  };
  auto o = std::make_shared<Options>();
  CLI::App* verb =
      app.add_subcommand("models", "List models; states, parameters, units, ranges and sources of one");
  verb->add_option("name", o->name, "model, or circulation");
  verb->add_flag("--sets", o->sets, "list the parameter sets");
  verb->add_flag("--names", o->names, "only the names, one a line");
  verb->callback([o] {
    if (o->names) {
      for (const CellModel* model : catalogue()) fmt::print("{}\n", model->name);
      fmt::print("circulation\n");
      return;
    }
    if (o->name.empty()) {
      for (const CellModel* model : catalogue())
        fmt::print("{:<14} {:>2} states, {:>2} parameters   {}\n", model->name, model->states.size(),
                   model->parameters.size(), model->title);
      fmt::print("{:<14} {:>2} states                   closed RLC loop, four valves, elastance chambers\n",
                 "circulation", circulation_state_quantities.size());
      if (o->sets)
        for (const CellModel* model : catalogue()) print_sets(*model);
    }
    if (o->name == "circulation" || (o->name.empty() && o->sets)) {
      if (!o->sets) {
        print_quantities("states (mmHg, mL, s)", circulation_state_quantities, true);
        print_quantities(fmt::format("elastance.{{{}}}", fmt::join(chamber_names, ",")), elastance_quantities,
                         true);
        print_quantities(fmt::format("valves.{{{}}}", fmt::join(valve_names, ",")), valve_quantities, true);
        for (std::size_t c = 0; c < circuit_names.size(); ++c) {
          std::vector<Quantity> quantities;
          for (const network::VesselEntry& vessel : network::vessels)
            if (vessel.circuit == static_cast<int>(c))
              quantities.insert(quantities.end(), vessel.quantities.begin(), vessel.quantities.end());
          print_quantities(fmt::format("circuit.{}", circuit_names[c]), quantities, true);
        }
        print_quantities(fmt::format("shunts.{{{}}}: there where named", fmt::join(shunt_names, ",")),
                         shunt_quantities, true);
      }
      fmt::print("\nparameter sets of circulation\n");
      for (const CirculationSet& set : circulation_sets()) fmt::print("  {}: {}\n", set.name, set.source);
    }
    if (o->name.empty() || o->name == "circulation") return;
    std::vector<std::string> known = {"circulation"};
    for (const CellModel* model : catalogue()) known.emplace_back(model->name);
    if (std::find(known.begin(), known.end(), o->name) == known.end())
      refuse_unknown("model", o->name, known);
    const CellModel& model = find_model(o->name);
    if (o->sets) {
      print_sets(model);
      return;
    }
    fmt::print("{}: {}\n{}\ntime in {}\n", model.name, model.title, model.source, model.time_unit);
    if (model.is_ionic())
      fmt::print("default stimulus {} A/F for {} ms\n", model.default_stimulus.amplitude_A_per_F,
                 model.default_stimulus.duration_ms);
    for (const Invariant& invariant : model.invariants)
      fmt::print("invariant: {} ({}), {}\n", invariant.name, invariant.unit, invariant.meaning);
    if (model.invariants.empty()) fmt::print("no invariant: {}\n", model.no_invariants);
    print_quantities("states (name, unit, start, range, meaning)", model.states, true);
    print_quantities("parameters (name, unit, default, range, meaning)", model.parameters, true);
    print_quantities("inputs (name, unit, default, range, meaning)", model.inputs, true);
    print_quantities("observables", model.observables, false);
    print_sets(model);
  });
}

}  // namespace wiggers::command
