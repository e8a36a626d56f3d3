// Pacing stimuli: a rectangular current pulse, repeated with a period. Times in ms, currents in A/F
// (negative: depolarising).
#pragma once

#include <wiggers/core/quantity.hpp>

namespace wiggers {

inline constexpr Quantity pacing_period_quantity{"period_ms", "ms", 1000, 50, 20000, "period of the pacing"};
inline constexpr Quantity stimulus_amplitude_quantity{"stimulus_A_per_F",     "A/F", -25.71, -1000, 0,
                                                      "stimulus of the cells"};
inline constexpr Quantity stimulus_duration_quantity{"stimulus_ms", "ms", 3,
                                                     0.1,           20,   "duration of the stimulus"};

struct StimulusPulse {
  double amplitude_A_per_F = 0;
  double duration_ms = 0;
  double onset_ms = 0;  // within the period

  // The current on the whole span [t0, t1], which must not cross an edge; t0 in [0, period).
  double current_on_span(double t0_ms) const {
    return t0_ms >= onset_ms - 1e-9 && t0_ms < onset_ms + duration_ms - 1e-9 ? amplitude_A_per_F : 0.0;
  }
};

}  // namespace wiggers
