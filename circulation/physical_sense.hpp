// What no heart can be: bounds on volumes, pressures and flows, wide enough for every disease and every
// animal, that a beat must keep to before anything about it is called good. The equations themselves know
// no such bounds: an elastance goes on happily at a negative volume.
//
// One such check stands between any solver and any verdict; walls add what they know (fibre stretches).
#pragma once

#include <array>
#include <optional>
#include <string>
#include <string_view>
#include <wiggers/circulation/circulation.hpp>

namespace wiggers {

namespace physical_sense {
inline constexpr Quantity volume{"volume", "mL", 100, 0, 2000, "volume of a chamber"};
inline constexpr Quantity pressure{
    "pressure", "mmHg", 10,
    -50,        400,    "pressure in a chamber or a vessel; blood boils or vessels burst outside"};
inline constexpr Quantity flow{"flow", "mL/s", 0, -2e4, 2e4, "flow through a valve or a vessel"};
}  // namespace physical_sense

// The bounds of a state of the circulation.
const Quantity& physical_bounds(int state);

// Refuses a saved state, naming `place`, that no heart can be in.
void require_saved_circulation(const double* y, const std::string& place);
// Refuses one that holds other blood (mL) than it should.
void require_same_blood(double found_mL, double wanted_mL, const std::string& place);

// A quantity outside its bounds: where and when in the beat.
struct Unphysical {
  std::string quantity, unit;
  double value = 0, lower = 0, upper = 0;
  double t_s = 0;
  std::string text() const;  // a sentence, with what to look at
};

// Watches a beat row by row and keeps the worst excess of the quantity that left its bounds first.
class PhysicalSense {
 public:
  // y: the circulation's states; p: pressures of the chambers.
  void see(double t_s, const double* y, const double* p, const std::array<double, n_valves>& Q) {
    using namespace physical_sense;
    bool inside = true;
    for (int c = 0; c < n_chambers; ++c) inside = inside && keeps(volume, y[c]) && keeps(pressure, p[c]);
    for (int v = 0; v < n_valves; ++v) inside = inside && keeps(flow, Q[v]);
    for (int k = n_chambers; k < n_nodes; ++k) inside = inside && keeps(pressure, y[k]);
    for (int k = n_nodes; k < n_circulation_states; ++k) inside = inside && keeps(flow, y[k]);
    if (!inside) name(t_s, y, p, Q);
  }
  // Any other quantity.
  void see(double t_s, std::string_view quantity, std::string_view unit, double value, double lower,
           double upper);
  const std::optional<Unphysical>& finding() const { return finding_; }

 private:
  // False also for what is no number.
  static bool keeps(const Quantity& q, double value) { return value >= q.lower && value <= q.upper; }
  void name(double t_s, const double* y, const double* p, const std::array<double, n_valves>& Q);

  std::optional<Unphysical> finding_;
};

}  // namespace wiggers
