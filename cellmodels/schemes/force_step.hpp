// A force model over one step of a wall: the scheme that reduced walls, TriSeg and tissue share, for any
// number.
//
// The wall gives calcium in the middle of the step, the length at its start and the velocity of the step
// before; it gets tension T and stiffness K, with which it sees T + K (lambda - lambda^n) in its own
// equilibrium (the stabilised active stress), and tells afterwards how fast it shortened in truth.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <string_view>
#include <wiggers/cellmodels/models/force_model.hpp>
#include <wiggers/core/evaluation.hpp>

namespace wiggers {

// How strain reaches the crossbridges in a step.
enum class RateScheme {
  lagged,    // the velocity of the step before
  implicit,  // predicted without sliding; K is what sliding in this step changes, and bridges then move with
             // the true one
  none       // no stretch-rate feedback: velocity and K are zero
};
inline constexpr std::array<std::string_view, 3> rate_scheme_names = {"lagged", "implicit", "none"};

// How the regulated states step.
enum class RegulationScheme {
  midpoint,      // the model's own regulate(): second order, positive and conserving for every step
  forward_euler  // sub-stepped, inputs held at the new time: the founding paper's
};
inline constexpr std::array<std::string_view, 2> regulation_scheme_names = {"frozen-midpoint",
                                                                            "forward-euler"};

struct ForceScheme {
  RegulationScheme regulation = RegulationScheme::midpoint;
  int substeps = 40;  // forward_euler
  RateScheme rate = RateScheme::implicit;
};

template <class Model, class N>
struct ForceStep {
  static constexpr std::size_t n = Model::states.size(), n_regulated = Model::n_regulated;
  typename Model::template Regulation<N> regulation{};
  std::array<N, n - n_regulated> cycled_before{};  // at the step's start
  N tension_kPa{}, stiffness_kPa{};

  // From the start of the step over h (s): y, which is then what finish() needs, and the forces. False where
  // the model cannot be stepped so far.
  template <class H, class Constants>
  bool begin(const ForceScheme& scheme, const H& h, N* y, const N& calcium_uM, const N& length_um,
             const N& velocity_before, const Constants& c) {
    if (!regulate(scheme, h, y, calcium_uM, length_um, c)) return false;
    std::copy(y + n_regulated, y + n, cycled_before.begin());
    const N still(0.0);
    const bool implicit = scheme.rate == RateScheme::implicit;
    const N detaching = scheme.rate == RateScheme::none ? still : velocity_before;
    if (!Model::cycle(h, y, regulation, implicit ? still : detaching, detaching, c)) return false;
    tension_kPa = Model::tension(y, length_um, c);
    if (implicit) {
      // The tension is linear in the velocity: of a shortening by one, what is lost.
      std::array<N, n> slid;
      std::copy(y, y + n_regulated, slid.begin());
      std::copy(cycled_before.begin(), cycled_before.end(), slid.begin() + n_regulated);
      if (!Model::cycle(h, slid.data(), regulation, N(1.0 / h), detaching, c)) return false;
      stiffness_kPa = tension_kPa - Model::tension(slid.data(), length_um, c);
    } else {
      stiffness_kPa = scheme.rate == RateScheme::none ? still : Model::stiffness(y, length_um, c);
    }
    return true;
  }

  // Implicit rate: the bridges again, from the step's start with the velocity that the step had (y as begin()
  // left it).
  template <class H, class Constants>
  bool finish(const H& h, N* y, const N& velocity, const Constants& c) const {
    std::copy(cycled_before.begin(), cycled_before.end(), y + n_regulated);
    return Model::cycle(h, y, regulation, velocity, velocity, c);
  }

 private:
  template <class H, class Constants>
  bool regulate(const ForceScheme& scheme, const H& h, N* y, const N& calcium, const N& length,
                const Constants& c) {
    if (scheme.regulation == RegulationScheme::midpoint) {
      if (!Model::regulate(h, y, calcium, length, c, regulation)) return false;
    } else {
      const H part = h / static_cast<double>(scheme.substeps);
      for (int k = 0; k < scheme.substeps; ++k) {
        const auto rates = Model::regulation(y, calcium, length, c);
        for (std::size_t i = 0; i < n_regulated; ++i) y[i] += part * rates.derivative[i];
      }
      regulation = Model::regulation(y, calcium, length, c);
    }
    if constexpr (requires { Model::normalise(y); }) Model::normalise(y);
    return true;
  }
};

// One step with a velocity that is known, shortening positive: what a force model does outside a wall.
template <class Model, class N, class H, class Constants>
bool force_midpoint_step(const H& h, N* y, const N* inputs, const Constants& c) {
  typename Model::template Regulation<N> middle;
  if (!Model::regulate(h, y, inputs[Model::Ca], inputs[Model::SL], c, middle)) return false;
  const N v = -inputs[Model::dSL_dt] / c.p[index_of(Model::parameters, Role::reference_length)];
  return Model::cycle(h, y, middle, v, v, c);
}

}  // namespace wiggers
