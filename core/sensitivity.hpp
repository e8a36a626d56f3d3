// Derivatives of a limit cycle and of what is read off it, by parameters.
//
// The cycle x = P(x, theta) moves with the parameters by the implicit function theorem,
//   dx/dtheta = (I - dP/dx)^-1 dP/dtheta,
// with both derivatives of the beat map from dual numbers, exactly those of the computed map. Where P keeps
// an invariant (blood volume, charge) it is to hold its value itself, as a parameter; I - dP/dx is then
// regular. Any output of a beat follows from one more beat whose start moves by dx/dtheta.
#pragma once

#include <cmath>
#include <string>
#include <string_view>
#include <vector>
#include <wiggers/core/dense.hpp>
#include <wiggers/core/dual.hpp>
#include <wiggers/core/errors.hpp>

// Functions that do most of the work on Tangents: everything they call is inlined into them, and they are
// compiled for several instruction sets, of which the loader takes the best.
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && !defined(__SANITIZE_ADDRESS__)
#define WIGGERS_WIDE __attribute__((target_clones("arch=skylake-avx512", "arch=haswell", "default"), flatten))
#else
#define WIGGERS_WIDE
#endif

namespace wiggers {

struct Sensitivities {
  std::vector<std::string> outputs, output_units;        // one an output
  std::vector<std::string> parameters, parameter_units;  // one a parameter
  std::vector<double> values;                            // of the outputs
  std::vector<double> derivatives;                       // [output][parameter]
  std::vector<double> state_derivatives;                 // [state at the beat's start][parameter]

  // Takes one parameter's column out.
  void leave_out(std::size_t parameter) {
    const std::size_t m = parameters.size();
    if (parameter >= m) return;
    const auto shorten = [&](std::vector<double>& rows) {
      std::vector<double> kept;
      for (std::size_t k = 0; k < rows.size(); ++k)
        if (k % m != parameter) kept.push_back(rows[k]);
      rows = std::move(kept);
    };
    shorten(derivatives);
    shorten(state_derivatives);
    parameters.erase(parameters.begin() + static_cast<long>(parameter));
    parameter_units.erase(parameter_units.begin() + static_cast<long>(parameter));
  }
};

// Directions that one pass carries.
inline constexpr int tangent_lanes = 16;
using Tangent = Dual<tangent_lanes>;

// How a fixed point moves, and how to come closer to it.
struct FixedPointDerivatives {
  Eigen::MatrixXd moves;                        // dx/dtheta: [state][parameter]
  Eigen::PartialPivLU<Eigen::MatrixXd> newton;  // of I - dP/dx
};

// Newton with the derivatives at hand, until rounding stops it: x + (I - dP/dx)^-1 (P(x) - x).
template <class Beat>
std::vector<double> refined_fixed_point(std::vector<double> x, const FixedPointDerivatives& derivatives,
                                        Beat beat) {
  using Map = Eigen::Map<Eigen::VectorXd>;
  const auto n = static_cast<Eigen::Index>(x.size());
  double smallest = 1e300;
  std::vector<double> best = x;
  for (int iteration = 0; iteration < 30; ++iteration) {
    std::vector<double> image = beat(x);
    const Eigen::VectorXd step = derivatives.newton.solve(Map(image.data(), n) - Map(x.data(), n));
    const double size = (step.array() / (Map(x.data(), n).array().abs() + 1e-3)).abs().maxCoeff();
    if (!(size < smallest)) break;
    smallest = size;
    Map(x.data(), n) += step;
    best = x;
    if (size < 1e-15) break;
  }
  if (!(smallest < 1e-6))
    throw NumericalFailure(
        "Newton's iteration does not reach the limit cycle from this state: start nearer, from a cycle that "
        "was searched for");
  return best;
}

// Derivatives of the beat map's fixed point; beat(states, parameters) gives the image, by dual numbers.
// Passes: (n_states + n_parameters) / tangent_lanes beats.
template <class Beat>
FixedPointDerivatives fixed_point_derivatives(const std::vector<double>& x,
                                              const std::vector<double>& parameters, Beat beat) {
  const int n = static_cast<int>(x.size()), m = static_cast<int>(parameters.size());
  Eigen::MatrixXd by_all(n, n + m);
  for (int first = 0; first < n + m; first += tangent_lanes) {
    std::vector<Tangent> state, parameter;
    const auto seed = [&](double value, int index) {
      Tangent t(value);
      if (index >= first && index < first + tangent_lanes) t.derivative[index - first] = 1;
      return t;
    };
    for (int i = 0; i < n; ++i) state.push_back(seed(x[i], i));
    for (int j = 0; j < m; ++j) parameter.push_back(seed(parameters[j], n + j));
    const std::vector<Tangent> image = beat(state, parameter);
    for (int i = 0; i < n; ++i)
      for (int k = 0; k < tangent_lanes && first + k < n + m; ++k)
        by_all(i, first + k) = image[i].derivative[k];
  }
  const Eigen::MatrixXd system = Eigen::MatrixXd::Identity(n, n) - by_all.leftCols(n);
  FixedPointDerivatives result;
  result.newton.compute(system);
  result.moves = result.newton.solve(by_all.rightCols(m));
  if (!result.moves.allFinite())
    throw NumericalFailure(
        "the limit cycle has no derivatives here: a multiplier of its beat map is one, so the smallest "
        "change "
        "of a parameter may move it anywhere");
  return result;
}

// The seeded numbers of one pass over the parameters, the start moving with them.
struct TangentPass {
  std::vector<Tangent> state, parameter;
};
inline TangentPass tangent_pass(const std::vector<double>& x, const std::vector<double>& parameters,
                                const Eigen::MatrixXd& dx, int first) {
  const int m = static_cast<int>(parameters.size());
  TangentPass pass;
  for (int i = 0; i < static_cast<int>(x.size()); ++i) {
    Tangent t(x[i]);
    for (int k = 0; k < tangent_lanes && first + k < m; ++k) t.derivative[k] = dx(i, first + k);
    pass.state.push_back(t);
  }
  for (int j = 0; j < m; ++j) {
    Tangent t(parameters[j]);
    if (j >= first && j < first + tangent_lanes) t.derivative[j - first] = 1;
    pass.parameter.push_back(t);
  }
  return pass;
}

// Copies one output's derivatives of a pass into the table; the first pass also adds its name and value.
inline void store_output(Sensitivities& table, int first, std::size_t index, const std::string& name,
                         std::string_view unit, const Tangent& value) {
  const std::size_t m = table.parameters.size();
  if (first == 0) {
    table.outputs.push_back(name);
    table.output_units.emplace_back(unit);
    table.values.push_back(value.value);
    table.derivatives.resize(table.derivatives.size() + m);
  }
  for (std::size_t k = 0; k < tangent_lanes && first + k < m; ++k)
    table.derivatives[index * m + first + k] = value.derivative[k];
}

}  // namespace wiggers
