#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <wiggers/circulation/physical_sense.hpp>
#include <wiggers/core/errors.hpp>

namespace wiggers {

namespace {
constexpr double saved_volume_tolerance = 1e-6;  // relative: rounding over very many beats
}  // namespace

const Quantity& physical_bounds(int state) {
  return state < n_chambers ? physical_sense::volume
         : state < n_nodes  ? physical_sense::pressure
                            : physical_sense::flow;
}

void require_saved_circulation(const double* y, const std::string& place) {
  for (int k = 0; k < n_circulation_states; ++k) {
    Quantity named = circulation_state_quantities[k];
    named.lower = physical_bounds(k).lower;
    named.upper = physical_bounds(k).upper;
    check_range(named, y[k], place);
  }
}

void require_same_blood(double found_mL, double wanted_mL, const std::string& place) {
  if (!(std::abs(found_mL - wanted_mL) <= saved_volume_tolerance * std::abs(wanted_mL)))
    throw InputError(
        fmt::format("{}: it holds {:.9g} mL of blood, it should be {:.9g} mL", place, found_mL, wanted_mL));
}

std::string Unphysical::text() const {
  const char* hint = unit == "mL"     ? "its unloaded volume, its stiffness, or the blood volume"
                     : unit == "mmHg" ? "stiffnesses, compliances, resistances and the blood volume"
                     : unit == "mL/s" ? "the resistances of the valves and vessels beside it"
                                      : "the parameters of this wall";
  return fmt::format(
      "unphysical: {} is {:.4g} {} at t = {:.4g} s of the beat; no heart is outside {} to {} {}. Look at {}.",
      quantity, value, unit, t_s, lower, upper, unit, hint);
}

void PhysicalSense::see(double t_s, std::string_view quantity, std::string_view unit, double value,
                        double lower, double upper) {
  if (value >= lower && value <= upper) return;
  const auto excess = [&](double v) { return std::isnan(v) ? INFINITY : std::max(lower - v, v - upper); };
  if (finding_ && (finding_->quantity != quantity || excess(finding_->value) >= excess(value))) return;
  finding_ = {std::string(quantity), std::string(unit), value, lower, upper, t_s};
}

void PhysicalSense::name(double t_s, const double* y, const double* p,
                         const std::array<double, n_valves>& Q) {
  using namespace physical_sense;
  const auto look = [&](const Quantity& q, const std::string& quantity, double value) {
    see(t_s, quantity, q.unit, value, q.lower, q.upper);
  };
  for (int c = 0; c < n_chambers; ++c) look(volume, fmt::format("the volume of {}", chamber_names[c]), y[c]);
  for (int c = 0; c < n_chambers; ++c)
    look(pressure, fmt::format("the pressure in {}", chamber_names[c]), p[c]);
  for (int k = n_chambers; k < n_nodes; ++k)
    look(pressure, fmt::format("the {}", circulation_state_quantities[k].meaning), y[k]);
  for (int v = 0; v < n_valves; ++v) look(flow, fmt::format("the flow through {}", valve_names[v]), Q[v]);
  for (int k = n_nodes; k < n_circulation_states; ++k)
    look(flow, fmt::format("the {}", circulation_state_quantities[k].meaning), y[k]);
}

}  // namespace wiggers
