// The parameters of the material laws, as scenes read them, and the laws they make.
#pragma once

#include <array>
#include <wiggers/core/quantity.hpp>
#include <wiggers/tissue/laws/laws.hpp>

namespace wiggers {

// Bulk modulus of myocardium, last in each of its lists.
inline constexpr Quantity bulk_quantity = {
    "bulk_Pa", "Pa", 50e3, 0, 1e9, "bulk modulus B of the penalty B/2 (J - 1) ln J on changes of volume"};

// Defaults: ventricles (Fedele et al. 2023); the atria differ in C_Pa (right 1470, left 1760).
inline constexpr std::array usyk_quantities = {
    Quantity{"C_Pa", "Pa", 880, 0, 1e7, "stiffness C of the law C/2 (e^Q - 1)"},
    Quantity{"b_ff", "1", 8, 0, 1e3, "exponent of stretch along the fibre"},
    Quantity{"b_ss", "1", 6, 0, 1e3, "exponent of stretch along the sheet, across the fibre"},
    Quantity{"b_nn", "1", 3, 0, 1e3, "exponent of stretch normal to the sheet"},
    Quantity{"b_fs", "1", 12, 0, 1e3, "exponent of shear between fibre and sheet"},
    Quantity{"b_fn", "1", 3, 0, 1e3, "exponent of shear between fibre and normal"},
    Quantity{"b_sn", "1", 3, 0, 1e3, "exponent of shear between sheet and normal"},
    bulk_quantity,
};
static_assert(well_formed(usyk_quantities));

// Defaults: the bending beam of Land et al., Proc R Soc A 471:20150641, 2015, problem 1.
inline constexpr std::array guccione_quantities = {
    Quantity{"C_Pa", "Pa", 2000, 0, 1e7, "stiffness C of the law C/2 (e^Q - 1)"},
    Quantity{"b_f", "1", 8, 0, 1e3, "exponent of stretch along the fibre"},
    Quantity{"b_t", "1", 2, 0, 1e3, "exponent of stretch and shear across the fibre"},
    Quantity{"b_fs", "1", 4, 0, 1e3, "exponent of shear between the fibre and directions across it"},
    bulk_quantity,
};
static_assert(well_formed(guccione_quantities));

// Defaults: valves and caps; the great arteries have mu_Pa 5.25e5 and kappa_Pa 1e6.
inline constexpr std::array neo_hookean_quantities = {
    Quantity{"mu_Pa", "Pa", 1e6, 0, 1e9, "shear modulus"},
    Quantity{"kappa_Pa", "Pa", 5e6, 0, 1e10, "bulk modulus"},
};
static_assert(well_formed(neo_hookean_quantities));

// Defaults: Holzapfel, Ogden, Phil Trans R Soc A 367:3445-3475, 2009, Table 1 (simple shear of pig
// myocardium).
inline constexpr std::array holzapfel_ogden_quantities = {
    Quantity{"a_Pa", "Pa", 59, 0, 1e7, "stiffness of the matrix between fibres"},
    Quantity{"b", "1", 8.023, 0, 1e3, "exponent of the matrix"},
    Quantity{"a_f_Pa", "Pa", 18472, 0, 1e7, "stiffness along the fibre"},
    Quantity{"b_f", "1", 16.026, 0, 1e3, "exponent along the fibre"},
    Quantity{"a_s_Pa", "Pa", 2481, 0, 1e7, "stiffness along the sheet"},
    Quantity{"b_s", "1", 11.120, 0, 1e3, "exponent along the sheet"},
    Quantity{"a_fs_Pa", "Pa", 216, 0, 1e7, "stiffness of shear between fibre and sheet"},
    Quantity{"b_fs", "1", 11.436, 0, 1e3, "exponent of shear between fibre and sheet"},
    Quantity{"kappa_f", "1", 0, 0, 1.0 / 3.0, "dispersion of fibres: 0 none, 1/3 all directions alike"},
    Quantity{"fibres_bear_compression", "1", 0, 0, 1,
             "1: the terms of fibre and sheet resist shortening too; 0: stretch only"},
    bulk_quantity,
};
static_assert(well_formed(holzapfel_ogden_quantities));

inline constexpr std::array active_stress_quantities = {
    Quantity{"n_f", "1", 1, 0, 1, "part of the active tension that acts along the fibre"},
    Quantity{"n_s", "1", 0, 0, 1, "part of the active tension that acts along the sheet"},
    Quantity{"n_n", "1", 0.4, 0, 1, "part of the active tension that acts normal to the sheet"},
};
static_assert(well_formed(active_stress_quantities));

inline constexpr std::array wall_viscosity_quantities = {
    Quantity{"eta_Pa_s", "Pa s", 0, 0, 1e6, "viscosity of the wall, S = eta dE/dt; 0: none"},
};
static_assert(well_formed(wall_viscosity_quantities));

// From values in the order of the lists.

constexpr UsykLaw3 usyk_law(const std::array<double, usyk_quantities.size()>& v) {
  return UsykLaw3::from(v[0], v[1], v[2], v[3], v[4], v[5], v[6]);
}
constexpr UsykLaw3 guccione_law(const std::array<double, guccione_quantities.size()>& v) {
  return UsykLaw3::guccione(v[0], v[1], v[2], v[3]);
}
constexpr NeoHookean neo_hookean_law(const std::array<double, neo_hookean_quantities.size()>& v) {
  return {v[0], v[1]};
}
constexpr HolzapfelOgden holzapfel_ogden_law(const std::array<double, holzapfel_ogden_quantities.size()>& v) {
  return {v[0], v[1], v[2], v[3], v[4], v[5], v[6], v[7], v[8], v[9] > 0.5};
}
// Of a list of myocardium, which ends with the bulk modulus.
template <std::size_t N>
constexpr VolumetricPenalty volumetric_penalty(const std::array<double, N>& v) {
  return {v[N - 1]};
}

}  // namespace wiggers
