// The closed loop with four elastance chambers: parameter sets, the file that describes one, and its
// solution.
#pragma once

#include <array>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>
#include <wiggers/circulation/circulation.hpp>
#include <wiggers/circulation/elastance.hpp>
#include <wiggers/circulation/physical_sense.hpp>
#include <wiggers/core/limit_cycle.hpp>
#include <wiggers/core/settings.hpp>
#include <wiggers/core/table.hpp>

namespace wiggers {

// Parameters may be plain, or dual to carry sensitivities.
template <class P>
struct LoopOf {
  P period_s = 0.8;
  CirculationParametersOf<P> circulation;
  std::array<ElastanceParametersOf<P>, n_chambers> elastance;  // LA, LV, RA, RV
  CirculationValues initial{};
};
using Loop = LoopOf<double>;
inline constexpr Quantity period_quantity = {"period_s", "s", 0.8, 0.15, 20, "duration of a heart beat"};
inline constexpr Quantity total_volume_quantity = {
    "total_volume", "mL",
    2850,           50,
    15000,          "stressed blood volume; fixes the initial systemic venous pressure"};

// visit(name, quantity, field) for every parameter, by its name in a loop file.
template <class Circulation, class Visit>
void for_each_circulation_parameter(Circulation& c, Visit visit) {
  const auto table = [&](std::string_view group, std::string_view member, const auto& quantities,
                         const auto& fields) {
    for (std::size_t k = 0; k < quantities.size(); ++k) {
      std::string name(group);
      name.append(".").append(member).append(".").append(quantities[k].name);
      visit(name, quantities[k], *fields[k]);
    }
  };
  for (int v = 0; v < n_valves; ++v)
    table("valves", valve_names[v], valve_quantities, fields_of(c.valves[v]));
  if (has_steepness(c.valve_law))
    visit(std::string(tanh_steepness_quantity.name), tanh_steepness_quantity, c.tanh_steepness);
  for (int v = 0; v < n_vessels; ++v)
    table("circuit", circuit_names[network::vessels[v].circuit], network::vessels[v].quantities,
          fields_of(c.vessels[v]));
  for (int s = 0; s < n_shunts; ++s)
    if (c.shunts[s].present) table("shunts", shunt_names[s], shunt_quantities, fields_of(c.shunts[s]));
}
template <class AnyLoop, class Visit>
void for_each_loop_parameter(AnyLoop& loop, Visit visit) {
  visit(std::string(period_quantity.name), period_quantity, loop.period_s);
  for_each_circulation_parameter(loop.circulation, visit);
  for (int c = 0; c < n_chambers; ++c) {
    const auto fields = fields_of(loop.elastance[c]);
    for (std::size_t k = 0; k < elastance_quantities.size(); ++k) {
      std::string name("elastance.");
      name.append(chamber_names[c]).append(".").append(elastance_quantities[k].name);
      visit(name, elastance_quantities[k], *fields[k]);
    }
  }
}
// The same values in numbers of another kind, without derivatives.
template <class To, class From>
CirculationParametersOf<To> converted(const CirculationParametersOf<From>& from) {
  CirculationParametersOf<To> result;
  result.valve_law = from.valve_law;
  result.tanh_steepness = To(value_of(from.tanh_steepness));
  for (int v = 0; v < n_valves; ++v) copy_values(fields_of(from.valves[v]), fields_of(result.valves[v]));
  for (int v = 0; v < n_vessels; ++v) copy_values(fields_of(from.vessels[v]), fields_of(result.vessels[v]));
  for (int s = 0; s < n_shunts; ++s) {
    result.shunts[s].present = from.shunts[s].present;
    copy_values(fields_of(from.shunts[s]), fields_of(result.shunts[s]));
  }
  return result;
}
template <class To, class From>
LoopOf<To> converted(const LoopOf<From>& from) {
  LoopOf<To> result;
  result.period_s = To(value_of(from.period_s));
  result.circulation = converted<To>(from.circulation);
  for (int c = 0; c < n_chambers; ++c)
    copy_values(fields_of(from.elastance[c]), fields_of(result.elastance[c]));
  result.initial = from.initial;
  return result;
}

// Named sets with their sources. A set without elastances (the whole-heart paper's) leaves chambers to
// others.
struct CirculationSet {
  std::string_view name;
  std::string_view source;
  Loop loop;
  bool has_elastances = true;  // elastances and initial state
};
std::span<const CirculationSet> circulation_sets();
const CirculationSet& find_circulation_set(std::string_view name);
std::vector<std::string> circulation_set_names(bool with_elastances);

// Reads valves, circuits (shared by loop files and scenes): tables, or names of sets standing for a table.
void read_circulation(SettingsReader& reader, CirculationParameters& parameters);
// One chamber's elastance table.
ElastanceParameters read_elastance(SettingsReader& table, const ElastanceParameters& defaults);
// The initial state: its values by name; total_volume may stand for the reservoir's pressure.
CirculationValues read_initial(SettingsReader& table, const CirculationParameters& parameters,
                               const CirculationValues& defaults);
// A whole loop file. Keys absent take the values of the set `parameters` (default: wiggers-healthy-0d).
Loop read_loop(SettingsReader& reader);

struct LoopIntegrator {
  std::string name = "cvode";  // cvode | forward-euler | runge-kutta-4
  double relative_tolerance = 1e-9;
  double absolute_tolerance = 1e-9;  // mmHg, mL, mL/s
  double dt_s = 1e-3;                // fixed steps
};
inline constexpr std::array<std::string_view, 3> loop_integrators = {"cvode", "forward-euler",
                                                                     "runge-kutta-4"};

struct PlainStep;
template <class T, class Step = PlainStep>
class LoopBeat;  // loop_beat.hpp

class LoopSolver {
 public:
  LoopSolver(Loop loop, LoopIntegrator integrator);

  const Loop& loop() const { return loop_; }
  const LoopIntegrator& integrator() const { return integrator_; }

  // Advances the state by one period; appends rows at multiples of sample_s and at the end if a table is
  // given; shows the beat to `sense` if that is given.
  void beat(CirculationValues& state, double sample_s = 0, Table* table = nullptr,
            PhysicalSense* sense = nullptr) const;

  // To the limit cycle on the leaf of the initial total volume. A cycle that no heart can be in is called
  // unphysical; one by an integrator that may be too coarse for this loop (forward-euler, cvode with a loose
  // tolerance) is confirmed by a finer one, or not called a cycle.
  LimitCycleCertificate to_limit_cycle(
      CirculationValues& state, LimitCycleSettings settings,
      const std::function<void(const LimitCycleCertificate&)>& after_beat = {}) const;

  // How far the cycle moves, in scaled units, if the step is halved (cvode: the tolerance divided by ten).
  // Nothing if the finer integrator finds no cycle.
  std::optional<double> integrator_shift(const CirculationValues& on_cycle) const;

  std::array<double, n_chambers> pressures(double t, const double* y) const;

 private:
  LimitCycleCertificate search(CirculationValues& state, LimitCycleSettings settings,
                               const std::function<void(const LimitCycleCertificate&)>& after_beat,
                               PhysicalSense* sense) const;

  Loop loop_;
  LoopIntegrator integrator_;
  std::shared_ptr<const LoopBeat<double>> steps_;  // runge-kutta-4
  std::vector<double> breaks_;  // activation break points within the period (cvode restarts there)
};

// Columns t_s, the states, chamber pressures, valve flows, flows of the shunts that are present.
Table circulation_table(const CirculationParameters& c);
std::size_t circulation_columns(const CirculationParameters& c);  // how many
void append_circulation_row(const CirculationParameters& c, Table& table, double t, const double* y,
                            const double* p, const std::array<double, n_valves>& Q);

// A loop has no fast directions that a jump upsets: it is accelerated after two beats, at every beat.
LimitCycleSettings loop_cycle_settings(double distance);

// Scales of the distance to a limit cycle: 100 mL, 10 mmHg, 100 mL/s.
std::vector<double> circulation_scales();

}  // namespace wiggers
