// Tables of a model's functions of the membrane potential: for every gate that depends on V alone its steady
// value and its decay over one step, exp(-h/tau) or, for implicit steps, 1/(1 + h/tau), and the factors of
// the currents. Uniform spacing, linear interpolation, one contiguous row for each potential.
//
// The layout of a row: steady values of the voltage gates in state order, their decays, the factors, padding
// to whole cache lines.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <wiggers/core/evaluation.hpp>
#include <wiggers/core/numbers.hpp>

namespace wiggers {

template <class Model>
struct VoltageTableLayout {
  static constexpr std::size_t n_gates = [] {
    std::size_t n = 0;
    for (bool is : is_voltage_gate<Model>) n += is ? 1 : 0;
    return n;
  }();
  static constexpr std::size_t n_columns = 2 * n_gates + Model::n_voltage_factors;
  static constexpr std::size_t stride = (n_columns + 15) / 16 * 16;
};

// What a kernel needs of a table; the numbers are owned elsewhere.
template <class Real>
struct VoltageTableView {
  const Real* rows = nullptr;
  double first_mV = 0;
  double rows_per_mV = 0;
  long n_rows = 0;
  bool holds(double V) const {
    return V >= first_mV && V < first_mV + static_cast<double>(n_rows - 1) / rows_per_mV;
  }
};

enum class Decay { exponential, implicit };

// One row, for steps of length h.
template <class Model, class P>
std::array<double, VoltageTableLayout<Model>::stride> voltage_table_row(
    double V, double h, Decay decay, const typename Model::template Constants<P>& constants) {
  using Layout = VoltageTableLayout<Model>;
  std::array<double, Layout::stride> row{};
  EvaluationOf<Model, double> e{};
  Model::voltage_gates(V, constants, e);
  std::size_t column = 0;
  for (std::size_t i = 0; i < Model::states.size(); ++i) {
    if (!is_voltage_gate<Model>[i]) continue;
    row[column] = e.steady[i];
    row[column + Layout::n_gates] =
        decay == Decay::exponential ? std::exp(-h / e.tau[i]) : 1 / (1 + h / e.tau[i]);
    ++column;
  }
  const auto factors = Model::voltage_factors(V, constants);
  for (std::size_t k = 0; k < factors.size(); ++k) row[2 * Layout::n_gates + k] = factors[k];
  return row;
}

}  // namespace wiggers
