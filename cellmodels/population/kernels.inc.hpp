// The kernels' text, included by one small source file per instruction set. See kernels.hpp.
#pragma once

#include <wiggers/cellmodels/models/force_models.hpp>
#include <wiggers/cellmodels/models/ionic_models.hpp>
#include <wiggers/cellmodels/population/kernels.hpp>
#include <wiggers/cellmodels/schemes/force_step.hpp>
#include <wiggers/core/fixed_step.hpp>
#include <wiggers/core/simd.hpp>

namespace wiggers::kernels {

// The rows of all lanes, interpolated and turned into one vector a column. Each lane reads two contiguous
// rows. Returns the lanes whose potential is outside the table.
template <class Model, class V>
WIGGERS_INLINE typename V::Mask look_up(const VoltageTableView<typename V::Scalar>& table, const V& potential,
                                        V* columns) {
  using Real = typename V::Scalar;
  using Layout = VoltageTableLayout<Model>;
  const V position = (potential - V(table.first_mV)) * V(table.rows_per_mV);
  // min() gives the bound for a NaN, so that the row always exists.
  const V inside = max(V(0.0), min(position, V(static_cast<double>(table.n_rows) - 1.001)));
  const auto row_numbers = __builtin_convertvector(inside.v, typename V::NativeInteger);
  const V weights = inside - V(__builtin_convertvector(row_numbers, typename V::Native));
  Real weight[V::lanes];
  typename V::Integer row[V::lanes];
  weights.store(weight);
  __builtin_memcpy(row, &row_numbers, sizeof(row));
  constexpr std::size_t n_groups = (Layout::n_columns + V::lanes - 1) / V::lanes;
#pragma GCC unroll 16
  for (std::size_t group = 0; group < n_groups; ++group) {
    V lines[V::lanes];
#pragma GCC unroll 16
    for (int lane = 0; lane < V::lanes; ++lane) {
      const Real* from = table.rows + static_cast<std::size_t>(row[lane]) * Layout::stride + group * V::lanes;
      const V lower = V::load(from), upper = V::load(from + Layout::stride);
      lines[lane] = lower + V(static_cast<double>(weight[lane])) * (upper - lower);
    }
    transpose(lines);
#pragma GCC unroll 16
    for (int k = 0; k < V::lanes; ++k) columns[group * V::lanes + k] = lines[k];
  }
  return {inside.v != position.v};
}

// rush_larsen_update with the functions of V from a table; n_halves half steps' decay make a step.
template <class Model, class V, class Constants>
WIGGERS_INLINE typename V::Mask tabulated_update(const VoltageTableView<typename V::Scalar>& table,
                                                 bool square_decay, double h, const V* at, const V* inputs,
                                                 const Constants& constants, const V* from, V* y) {
  using Layout = VoltageTableLayout<Model>;
  constexpr std::size_t room = (Layout::n_columns + V::lanes - 1) / V::lanes * V::lanes;
  V columns[room];
  const auto outside = look_up<Model, V>(table, at[potential_of<Model>], columns);
  std::array<V, Model::n_voltage_factors> factors;
  for (std::size_t k = 0; k < factors.size(); ++k) factors[k] = columns[2 * Layout::n_gates + k];
  EvaluationOf<Model, V> e;
  Model::balances(at, inputs, factors, constants, e);
  std::size_t column = 0;
  for (std::size_t i = 0; i < Model::states.size(); ++i) {
    if (is_voltage_gate<Model>[i]) {
      const V steady = columns[column];
      const V decay = columns[column + Layout::n_gates];
      y[i] = steady + (from[i] - steady) * (square_decay ? decay * decay : decay);
      ++column;
    } else if (is_gate<Model>[i]) {
      y[i] = e.steady[i] + (from[i] - e.steady[i]) * exp(V(-h) / e.tau[i]);
    } else {
      y[i] = from[i] + V(h) * e.derivative[i];
    }
  }
  return outside;
}

template <class Model, class V, bool tabulated>
struct RushLarsen1Steps {
  template <class Constants>
  WIGGERS_INLINE static typename V::Mask step(const KernelCall<typename V::Scalar>& call, V* y,
                                              const V* inputs, const Constants& constants) {
    if constexpr (tabulated)
      return tabulated_update<Model, V>(call.table, false, call.h, y, inputs, constants, y, y);
    RushLarsen1<Model, V>().step(call.h, y, inputs, constants);
    return V::Mask::none();
  }
};

template <class Model, class V, bool tabulated>
struct RushLarsen2Steps {
  template <class Constants>
  WIGGERS_INLINE static typename V::Mask step(const KernelCall<typename V::Scalar>& call, V* y,
                                              const V* inputs, const Constants& constants) {
    if constexpr (tabulated) {
      V middle[Model::states.size()];
      const auto first =
          tabulated_update<Model, V>(call.table, false, 0.5 * call.h, y, inputs, constants, y, middle);
      return tabulated_update<Model, V>(call.table, true, call.h, middle, inputs, constants, y, y) | first;
    }
    RushLarsen2<Model, V>().step(call.h, y, inputs, constants);
    return V::Mask::none();
  }
};

// Steps of a force model at the velocity of its input.
template <class Model, class V, bool>
struct MidpointSteps {
  template <class Constants>
  WIGGERS_INLINE static typename V::Mask step(const KernelCall<typename V::Scalar>& call, V* y,
                                              const V* inputs, const Constants& constants) {
    if (force_midpoint_step<Model, V>(call.h, y, inputs, constants)) return V::Mask::none();
    return V(0.0) < V(1.0);
  }
};

// Subnormal numbers (a gate that has decayed to 1e-310, or 1e-40 in single precision) cost a hundred times an
// ordinary one and mean zero: flushed to it while a kernel runs.
class FlushSubnormals {
 public:
#if defined(__SSE2__)
  FlushSubnormals() : saved_(__builtin_ia32_stmxcsr()) { __builtin_ia32_ldmxcsr(saved_ | 0x8040u); }
  ~FlushSubnormals() { __builtin_ia32_ldmxcsr(saved_); }

 private:
  unsigned saved_;
#endif
};

template <class Model, class V, template <class, class, bool> class Steps, bool tabulated, bool per_point>
[[gnu::flatten]] bool run(const KernelCall<typename V::Scalar>& call, std::size_t first, std::size_t last) {
  using Real = typename V::Scalar;
  using Constants = typename Model::template Constants<std::conditional_t<per_point, V, Real>>;
  constexpr std::size_t n = Model::states.size(), n_in = Model::inputs.size(), width = block_lanes<Real>;
  constexpr std::size_t n_constants = sizeof(typename Model::template Constants<Real>) / sizeof(Real);
  Constants constants;
  if constexpr (!per_point) __builtin_memcpy(&constants, call.constants, sizeof(constants));
  const FlushSubnormals flush;
  auto bad = V::Mask::none();
  for (std::size_t block = first; block < last; ++block) {
    for (std::size_t offset = 0; offset < width; offset += V::lanes) {
      Real* states = call.states + block * n * width + offset;
      V y[n], inputs[n_in];
      for (std::size_t i = 0; i < n; ++i) y[i] = V::load(states + i * width);
      for (std::size_t i = 0; i < n_in; ++i)
        inputs[i] = call.inputs ? V::load(call.inputs + (block * n_in + i) * width + offset)
                                : V(static_cast<double>(call.uniform_inputs[i]));
      if constexpr (per_point) {
        static_assert(sizeof(Constants) == n_constants * sizeof(V));
        const Real* from = call.point_constants + block * n_constants * width + offset;
        V* to = reinterpret_cast<V*>(&constants);
        for (std::size_t i = 0; i < n_constants; ++i) to[i] = V::load(from + i * width);
      }
      for (int k = 0; k < call.n_steps; ++k)
        bad = bad | Steps<Model, V, tabulated>::step(call, y, inputs, constants);
      for (std::size_t i = 0; i < n; ++i) {
        y[i].store(states + i * width);
        // Negated, so that a NaN is outside.
        const V lower(static_cast<double>(call.lower[i])), upper(static_cast<double>(call.upper[i]));
        bad.bits |= ~((y[i].v >= lower.v) & (y[i].v <= upper.v));
      }
    }
  }
  bool good = true;
  for (int lane = 0; lane < V::lanes; ++lane) good = good && bad.bits[lane] == 0;
  return good;
}

// One step of the founding paper's scheme for the cells of a tissue, whose potential u* (extrapolated) is
// given: gates implicitly (they are linear in themselves), everything else explicitly at states extrapolated
// to the step's end, the rate of the potential with the new gates (of a model in parts: the others enter with
// their extrapolated values). Second order; `first`: BDF1 for want of history.
template <class Model, class V, bool tabulated>
[[gnu::flatten]] bool run_bdf2(const KernelCall<typename V::Scalar>& call, std::size_t first_block,
                               std::size_t last_block) {
  using Real = typename V::Scalar;
  constexpr std::size_t n = Model::states.size(), n_in = Model::inputs.size(), width = block_lanes<Real>;
  typename Model::template Constants<Real> constants;
  __builtin_memcpy(&constants, call.constants, sizeof(constants));
  const FlushSubnormals flush;
  // a0 y^{n+1} = a1 y^n + a2 y^{n-1} + h f, divided by a0; y* = e1 y^n + e2 y^{n-1}.
  const double a0 = call.first ? 1.0 : 1.5;
  const V now_share(call.first ? 1.0 : 2.0 / a0), before_share(call.first ? 0.0 : -0.5 / a0),
      step(call.h / a0);
  const V now_ahead(call.first ? 1.0 : 2.0), before_ahead(call.first ? 0.0 : -1.0);
  auto bad = V::Mask::none();
  for (std::size_t block = first_block; block < last_block; ++block) {
    for (std::size_t offset = 0; offset < width; offset += V::lanes) {
      Real* states = call.states + block * n * width + offset;
      Real* previous = call.previous + block * n * width + offset;
      V inputs[n_in], at[n], past[n];
      for (std::size_t i = 0; i < n_in; ++i) inputs[i] = V(static_cast<double>(call.uniform_inputs[i]));
      for (std::size_t i = 0; i < n; ++i) {
        const V now = V::load(states + i * width), before = V::load(previous + i * width);
        past[i] = now_share * now + before_share * before;
        const V ahead = now_ahead * now + before_ahead * before;
        // A concentration must not leave its positive range on the way.
        at[i] =
            !is_gate<Model>[i] && Model::states[i].lower >= 0 ? select(ahead > V(0.0), ahead, now) : ahead;
        now.store(previous + i * width);
      }
      const V potential = V::load(states + potential_of<Model> * width);
      at[potential_of<Model>] = potential;
      EvaluationOf<Model, V> e;
      V next[n];
      if constexpr (InParts<Model>) {
        std::array<V, Model::n_voltage_factors> factors;
        if constexpr (tabulated) {
          using Layout = VoltageTableLayout<Model>;
          constexpr std::size_t room = (Layout::n_columns + V::lanes - 1) / V::lanes * V::lanes;
          V columns[room];
          bad = bad | look_up<Model, V>(call.table, potential, columns);
          for (std::size_t k = 0; k < factors.size(); ++k) factors[k] = columns[2 * Layout::n_gates + k];
          std::size_t column = 0;
          for (std::size_t i = 0; i < n; ++i) {
            if (!is_voltage_gate<Model>[i]) continue;
            const V steady = columns[column], decay = columns[column + Layout::n_gates];
            at[i] = next[i] = steady + (past[i] - steady) * decay;
            ++column;
          }
        } else {
          Model::voltage_gates(potential, constants, e);
          factors = Model::voltage_factors(potential, constants);
          for (std::size_t i = 0; i < n; ++i)
            if (is_voltage_gate<Model>[i]) {
              const V rate = step / e.tau[i];
              at[i] = next[i] = (past[i] + rate * e.steady[i]) / (V(1.0) + rate);
            }
        }
        Model::balances(at, inputs, factors, constants, e);
      } else {
        e = Model::template evaluate<V>(at, inputs, constants);
      }
      for (std::size_t i = 0; i < n; ++i) {
        if (i == static_cast<std::size_t>(potential_of<Model>)) continue;
        if (is_gate<Model>[i] && !is_voltage_gate<Model>[i]) {
          const V rate = step / e.tau[i];
          next[i] = (past[i] + rate * e.steady[i]) / (V(1.0) + rate);
        } else if (!is_gate<Model>[i]) {
          next[i] = past[i] + step * e.derivative[i];
        }
        next[i].store(states + i * width);
        const V lower(static_cast<double>(call.lower[i])), upper(static_cast<double>(call.upper[i]));
        bad.bits |= ~((next[i].v >= lower.v) & (next[i].v <= upper.v));
      }
      const V rate = e.derivative[potential_of<Model>];
      rate.store(call.rates + block * width + offset);
      bad.bits |= ~(rate.v == rate.v);
    }
  }
  bool good = true;
  for (int lane = 0; lane < V::lanes; ++lane) good = good && bad.bits[lane] == 0;
  return good;
}

// Spelt out and inlined: a library function here would be compiled for this file's instruction set and could
// be the copy that the linker keeps for everybody.
WIGGERS_INLINE bool same(std::string_view a, std::string_view b) {
  if (a.size() != b.size()) return false;
  for (std::size_t i = 0; i < a.size(); ++i)
    if (a.data()[i] != b.data()[i]) return false;
  return true;
}

// One step of the scheme that walls share (force_step.hpp); tension and stiffness are written.
// It has a loop of its own: one that both kernels share costs the tabulated CRN kernel or the RDQ20 kernel 4
// to 11 %, as compilers lay it out.
template <class Model, class V, bool per_point>
[[gnu::flatten]] bool run_in_wall(const KernelCall<typename V::Scalar>& call, std::size_t first,
                                  std::size_t last) {
  using Real = typename V::Scalar;
  using Constants = typename Model::template Constants<std::conditional_t<per_point, V, Real>>;
  constexpr std::size_t n = Model::states.size(), n_in = Model::inputs.size(), width = block_lanes<Real>;
  constexpr std::size_t n_constants = sizeof(typename Model::template Constants<Real>) / sizeof(Real);
  constexpr auto SL0 = static_cast<std::size_t>(index_of(Model::parameters, Role::reference_length));
  Constants constants;
  if constexpr (!per_point) __builtin_memcpy(&constants, call.constants, sizeof(constants));
  const FlushSubnormals flush;
  auto bad = V::Mask::none();
  for (std::size_t block = first; block < last; ++block) {
    for (std::size_t offset = 0; offset < width; offset += V::lanes) {
      Real* states = call.states + block * n * width + offset;
      V y[n], inputs[n_in];
      for (std::size_t i = 0; i < n; ++i) y[i] = V::load(states + i * width);
      for (std::size_t i = 0; i < n_in; ++i)
        inputs[i] = call.inputs ? V::load(call.inputs + (block * n_in + i) * width + offset)
                                : V(static_cast<double>(call.uniform_inputs[i]));
      if constexpr (per_point) {
        const Real* from = call.point_constants + block * n_constants * width + offset;
        V* to = reinterpret_cast<V*>(&constants);
        for (std::size_t i = 0; i < n_constants; ++i) to[i] = V::load(from + i * width);
      }
      ForceStep<Model, V> step;
      const V velocity = -inputs[Model::dSL_dt] / constants.p[SL0];
      if (!step.begin(*call.scheme, call.h, y, inputs[Model::Ca], inputs[Model::SL], velocity, constants))
        bad = bad | (V(0.0) < V(1.0));
      step.tension_kPa.store(call.forces + 2 * block * width + offset);
      step.stiffness_kPa.store(call.forces + (2 * block + 1) * width + offset);
      for (std::size_t i = 0; i < n; ++i) {
        y[i].store(states + i * width);
        const V lower(static_cast<double>(call.lower[i])), upper(static_cast<double>(call.upper[i]));
        bad.bits |= ~((y[i].v >= lower.v) & (y[i].v <= upper.v));
      }
    }
  }
  bool good = true;
  for (int lane = 0; lane < V::lanes; ++lane) good = good && bad.bits[lane] == 0;
  return good;
}

template <class Model, class V>
Kernel<typename V::Scalar> find_force(const KernelKey& key) {
  if (key.tabulated) return nullptr;
  if (same(key.integrator, "frozen-midpoint"))
    return key.per_point ? run<Model, V, MidpointSteps, false, true>
                         : run<Model, V, MidpointSteps, false, false>;
  if (same(key.integrator, "in-wall"))
    return key.per_point ? run_in_wall<Model, V, true> : run_in_wall<Model, V, false>;
  return nullptr;
}

template <class Model, class V>
Kernel<typename V::Scalar> ionic_bdf2(const KernelKey& key) {
  if (key.per_point) return nullptr;
  if constexpr (InParts<Model>)
    if (key.tabulated) return run_bdf2<Model, V, true>;
  return key.tabulated ? nullptr : run_bdf2<Model, V, false>;
}

template <class Model, class V, template <class, class, bool> class Steps>
Kernel<typename V::Scalar> ionic(const KernelKey& key) {
  if constexpr (InParts<Model>)
    if (key.tabulated)
      return key.per_point ? run<Model, V, Steps, true, true> : run<Model, V, Steps, true, false>;
  if (key.tabulated) return nullptr;
  return key.per_point ? run<Model, V, Steps, false, true> : run<Model, V, Steps, false, false>;
}

template <class Model, class V>
Kernel<typename V::Scalar> find_ionic(const KernelKey& key) {
  if (same(key.integrator, "rush-larsen")) return ionic<Model, V, RushLarsen1Steps>(key);
  if (same(key.integrator, "rush-larsen-2")) return ionic<Model, V, RushLarsen2Steps>(key);
  if (same(key.integrator, "bdf2-imex")) return ionic_bdf2<Model, V>(key);
  return nullptr;
}

template <class V>
Kernel<typename V::Scalar> find_for(const KernelKey& key) {
  Kernel<typename V::Scalar> found = nullptr;
  IonicModels::each([&]<class Model>() {
    if (same(key.model, Model::name)) found = find_ionic<typename SameEquationsOf<Model>::type, V>(key);
  });
  ForceModels::each([&]<class Model>() {
    if (same(key.model, Model::name)) found = find_force<Model, V>(key);
  });
  return found;
}

}  // namespace wiggers::kernels
