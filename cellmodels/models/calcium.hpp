// Calcium at the interface between ionic cell and force model.
//
// The whole-heart paper rescales "the calcium peak" of TTP06 by 0.48 without a formula. Both readings are
// offered: `scaled`, factor * Ca; `peak`, Ca_dia + factor * (Ca - Ca_dia). Never fed back to the ionic model.
#pragma once

#include <array>
#include <string_view>

namespace wiggers {

enum class CalciumReading { scaled, peak };
inline constexpr std::array<std::string_view, 2> calcium_reading_names = {"scaled", "peak"};

struct CalciumRescaling {
  CalciumReading reading = CalciumReading::scaled;
  double factor = 1;
  double diastolic_uM = 0;  // used by `peak`

  double operator()(double calcium_uM) const {
    return reading == CalciumReading::scaled ? factor * calcium_uM
                                             : diastolic_uM + factor * (calcium_uM - diastolic_uM);
  }
};

}  // namespace wiggers
