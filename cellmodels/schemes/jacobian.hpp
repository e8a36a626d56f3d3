// Derivatives of a model's rates by its states, exactly, by dual numbers. Functions of V alone carry one
// derivative, the rest all of them: half the work of seeding everything.
#pragma once

#include <array>
#include <wiggers/core/dual.hpp>
#include <wiggers/core/evaluation.hpp>

namespace wiggers {

// rates[i], and jacobian[i][j] = d(rate_i)/d(y_j).
template <class Model>
void rates_and_jacobian(const double* y, const double* inputs,
                        const typename Model::template Constants<double>& constants, double* rates,
                        std::array<double, Model::states.size()>* jacobian) {
  constexpr int n = static_cast<int>(Model::states.size());
  using D = Dual<n>;
  std::array<D, Model::states.size()> yd;
  for (int i = 0; i < n; ++i) yd[i] = D::variable(y[i], i);
  std::array<D, Model::inputs.size()> in;
  for (std::size_t i = 0; i < in.size(); ++i) in[i] = D(inputs[i]);
  EvaluationOf<Model, D> e;
  if constexpr (InParts<Model>) {
    constexpr int V = potential_of<Model>;
    const auto V1 = Dual<1>::variable(y[V], 0);
    EvaluationOf<Model, Dual<1>> gates;
    Model::voltage_gates(V1, constants, gates);
    const auto f = Model::voltage_factors(V1, constants);
    std::array<D, Model::n_voltage_factors> factors;
    for (std::size_t k = 0; k < f.size(); ++k) {
      factors[k] = D(f[k].value);
      factors[k].derivative[V] = f[k].derivative[0];
    }
    Model::balances(yd.data(), in.data(), factors, constants, e);
    for (int i = 0; i < n; ++i) {
      if (!is_voltage_gate<Model>[i]) continue;
      const Dual<1> rate = (gates.steady[i] - y[i]) / gates.tau[i];
      rates[i] = rate.value;
      jacobian[i].fill(0.0);
      jacobian[i][V] = rate.derivative[0];
      jacobian[i][i] = -1.0 / gates.tau[i].value;
    }
  } else {
    e = Model::template evaluate<D>(yd.data(), in.data(), constants);
  }
  for (int i = 0; i < n; ++i) {
    if constexpr (InParts<Model>)
      if (is_voltage_gate<Model>[i]) continue;
    const D rate = is_gate<Model>[i] ? D((e.steady[i] - yd[i]) / e.tau[i]) : e.derivative[i];
    rates[i] = rate.value;
    jacobian[i] = rate.derivative;
  }
}

}  // namespace wiggers
