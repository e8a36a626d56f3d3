// Unit conversions. They stand here only, and are used at module doors only.
#pragma once

namespace wiggers::units {

inline constexpr double Pa_per_mmHg = 133.322387415;  // conventional millimetre of mercury
inline constexpr double mmHg_per_kPa = 1000.0 / Pa_per_mmHg;
inline constexpr double kPa_per_mmHg = Pa_per_mmHg / 1000.0;
inline constexpr double m3_per_mL = 1e-6;
inline constexpr double Pa_per_kPa = 1000.0;
inline constexpr double m_per_mm = 1e-3, mm_per_m = 1e3;
inline constexpr double J_per_mmHg_mL = Pa_per_mmHg * m3_per_mL;
inline constexpr double s_per_ms = 1e-3;
inline constexpr double ms_per_s = 1e3;
inline constexpr double uM_per_mM = 1e3;
inline constexpr double L_per_min_from_mL_per_s = 60.0 / 1000.0;

}  // namespace wiggers::units
