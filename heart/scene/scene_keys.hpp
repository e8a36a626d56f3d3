// The numbers that a scene may set, beside those of models, circulation and elastance.
#pragma once

#include <wiggers/core/quantity.hpp>

namespace wiggers::scene_keys {

inline constexpr Quantity body_surface_area{
    "body_surface_area_m2", "m^2", 1.9, 0.1, 4, "divides volumes into indexed ones"};
inline constexpr Quantity calcium_factor{
    "calcium_factor", "1", 1, 0, 10, "rescaling of calcium at the force model's door"};
inline constexpr Quantity calcium_factor_period{"calcium_factor_period_s",
                                                "s",
                                                0,
                                                0,
                                                20,
                                                "period at which calcium_factor was chosen: a run at another "
                                                "one is warned if calcium differs; 0: not said"};
inline constexpr Quantity calcium_rest{
    "calcium_rest_uM", "uM", 0.05, 0, 2, "prescribed transient: resting calcium"};
inline constexpr Quantity calcium_peak{
    "calcium_peak_uM", "uM", 0.38, 0, 10, "prescribed transient: peak calcium"};
inline constexpr Quantity rise{"rise_ms", "ms", 20,
                               1,         500,  "prescribed transient: time constant of the rise"};
inline constexpr Quantity decay{"decay_ms", "ms", 60,
                                2,          2000, "prescribed transient: time constant of the decay"};
inline constexpr Quantity activation{
    "activation_ms", "ms", 0, 0, 20000, "when the wall is stimulated, from the beat's start"};
inline constexpr Quantity V0{"unloaded_volume_mL", "mL", 95, 1, 1500, "cavity volume of the unloaded sphere"};
inline constexpr Quantity Vw{"wall_volume_mL", "mL", 130, 1, 1500, "volume of the wall"};
inline constexpr Quantity V0_LV{"unloaded_LV_mL", "mL", 85, 1, 1500, "unloaded volume of the left ventricle"};
inline constexpr Quantity V0_RV{
    "unloaded_RV_mL", "mL", 100, 1, 1500, "unloaded volume of the right ventricle"};
inline constexpr Quantity septum_height{
    "septum_height", "1", 0.66, 0.2, 1.8, "unloaded height of the septal cap, in radii of the LV"};
inline constexpr Quantity reference_area{
    "reference_area_cm2",
    "cm^2",
    88.5,
    3,
    1000,
    "unloaded midwall area of the segment (follows from the unloaded volumes)"};
inline constexpr Quantity stiffness{"stiffness_kPa", "kPa", 0.88, 0.01, 50, "C of the Usyk law"};
inline constexpr Quantity b_ff{"b_ff", "1", 8, 0, 100, "exponent of the Usyk law along the fibre"};
inline constexpr Quantity b_ss{"b_ss", "1", 6, 0, 100, "exponent of the Usyk law through the wall"};
inline constexpr Quantity b_nn{"b_nn", "1", 3,
                               0,      100, "exponent of the Usyk law across the fibre in the wall"};
inline constexpr Quantity n_f{"n_f", "1", 1, 0, 1, "share of active stress along the fibre"};
inline constexpr Quantity n_n{"n_n", "1", 0.4, 0, 1, "share of active stress across the fibre in the wall"};
inline constexpr Quantity viscosity{"viscosity_Pa_s", "Pa s", 0, 0, 1e5, "viscosity of the wall"};
inline constexpr Quantity robin_k{"epicardial_stiffness_Pa_per_m",         "Pa/m", 0, 0, 1e7,
                                  "surroundings: spring on the epicardium"};
inline constexpr Quantity robin_c{"epicardial_damping_Pa_s_per_m",          "Pa s/m", 0, 0, 1e6,
                                  "surroundings: dashpot on the epicardium"};
inline constexpr Quantity bag_pressure{
    "pressure_mmHg", "mmHg", 0, 0, 200, "p0 of the pericardial bag; 0: no bag"};
inline constexpr Quantity bag_volume{
    "reference_volume_mL", "mL", 600, 20, 6000, "sum of the cavities' volumes at which the bag gets taut"};
inline constexpr Quantity bag_exponent{"exponent", "1", 10,
                                       1,          60,  "steepness of the bag, p0 ((V/V_ref)^n - 1)"};
inline constexpr Quantity dt{"dt_s", "s",  1e-3,
                             1e-6,   0.05, "step of mechanics and circulation; divides the period"};
inline constexpr Quantity substep{"electrophysiology_substep_ms", "ms", 0.1, 1e-4, 1,
                                  "step of the ionic cells"};
inline constexpr Quantity ru_substep{
    "regulatory_substep_us", "us", 25, 0.1, 1000, "sub-step of the force model's regulation"};
inline constexpr Quantity beats{"beats", "1", 1, 1, 1e6, "number of beats to run"};
inline constexpr Quantity distance{
    "distance", "1",  1e-6,
    1e-10,      1e-1, "scaled distance to the limit cycle at which to stop (100 mL, 10 mmHg, 100 mL/s)"};
inline constexpr Quantity max_beats{"max_beats", "1", 300,
                                    3,           1e6, "give up on the limit cycle after so many beats"};
inline constexpr Quantity checkpoint_ms{
    "checkpoint_every_ms", "ms", 50, 1, 1e6, "model time between checkpoints of a run with 3D tissue"};
inline constexpr Quantity stop_after{
    "stop_after_ms",
    "ms",
    0,
    0,
    1e7,
    "end the run at this model time, within a beat or not; 0: at the end of its beats"};
inline constexpr Quantity end{"end_ms", "ms", 400, 0.1, 1e7, "end of electrophysiology alone"};
inline constexpr Quantity rows_every{
    "rows_every_ms", "ms", 1, 0.01, 1000, "electrophysiology alone: time between rows of the result"};
inline constexpr Quantity load_steps{
    "load_steps", "1", 10, 1, 1e5, "mechanics alone: equilibria on the way to the whole load"};
inline constexpr Quantity checkpoint{
    "checkpoint_every_s", "s", 1, 0, 1e6, "wall time between checkpoints of a run"};

}  // namespace wiggers::scene_keys
