#include <fmt/format.h>

#include <algorithm>
#include <wiggers/circulation/loop_beat.hpp>
#include <wiggers/core/cvode.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/heart/indexes/indexes_of.hpp>
#include <wiggers/heart/study/loop_study.hpp>

namespace wiggers {

namespace {

constexpr std::string_view total_volume_name = "initial.total_volume";
constexpr double index_sample_s = 1e-4;

// When the atria begin to contract.
template <class T>
AtrialActivationsOf<T> activations_of(const LoopOf<T>& loop) {
  AtrialActivationsOf<T> atria;
  for (int side = 0; side < 2; ++side) {
    const ElastanceParametersOf<T>& atrium = loop.elastance[side == 0 ? LA : RA];
    if (value_of(atrium.EA) > 0) atria[side] = wrapped(atrium.tC, loop.period_s);
  }
  return atria;
}

WIGGERS_WIDE void wide_step(const LoopOf<Tangent>& loop, const ValveStates& open, const Tangent& t,
                            const Tangent& h, const Tangent* y, Tangent* end, Tangent* middle) {
  runge_kutta_4_of<false>(loop, open, t, h, y, end, middle);
}
struct WideStep {
  template <class T>
  static void step(const LoopOf<T>& loop, const ValveStates& open, const T& t, const T& h, const T* y, T* end,
                   T* middle) {
    if constexpr (std::is_same_v<T, Tangent>)
      if (!loop.circulation.has_shunts()) return wide_step(loop, open, t, h, y, end, middle);
    runge_kutta_4(loop, open, t, h, y, end, middle);
  }
};

template <class T>
BeatIndexesOf<T> indexes_of(const LoopOf<T>& loop, T* state, double dt_s) {
  BeatTraceOf<T> trace;
  trace.with_middles = true;
  LoopBeat<T, WideStep>(loop, dt_s)
      .template run<true>(state, [&](const T& t, const T* y, const T* p, const ValveStates& open) {
        trace.append(loop.circulation, t, y, p, flows_when(loop, open, p, y));
      });
  return compute_indexes_of(trace, activations_of(loop), valve_debounce_s);
}

// What must hold between parameters.
void check_loop(const Loop& loop) {
  for (int v = 0; v < n_valves; ++v) {
    const ValveParameters& valve = loop.circulation.valves[v];
    if (valve.Rmax < valve.Rmin)
      throw InputError(fmt::format(
          "valves.{}.Rmax = {} is below Rmin = {}: the closed valve would leak more than the open one passes",
          valve_names[v], valve.Rmax, valve.Rmin));
  }
  for (int c = 0; c < n_chambers; ++c)
    check_elastance(loop.elastance[c], loop.period_s, fmt::format("elastance.{}", chamber_names[c]).c_str());
  check_range(
      circulation_state_quantities[pressure_of(reservoir)], loop.initial[pressure_of(reservoir)],
      fmt::format("{} = {} mL", total_volume_name, total_volume(loop.circulation, loop.initial.data())));
}

using TangentBeat = LoopBeat<Tangent, WideStep>;

LoopOf<Tangent> seeded_loop(const Loop& loop, const std::vector<Tangent>& parameters) {
  LoopOf<Tangent> result = converted<Tangent>(loop);
  std::size_t k = 0;
  for_each_loop_parameter(
      result, [&](const std::string&, const Quantity&, Tangent& field) { field = parameters[k++]; });
  return result;
}

FixedPointDerivatives cycle_derivatives(const Loop& loop, const std::vector<double>& x,
                                        const std::vector<double>& parameters, double dt_s) {
  return fixed_point_derivatives(
      x, parameters, [&](std::vector<Tangent> state, const std::vector<Tangent>& parameter) {
        const LoopOf<Tangent> moving = seeded_loop(loop, parameter);
        TangentBeat(moving, dt_s)
            .run(state.data(), [](const Tangent&, const Tangent*, const Tangent*, const ValveStates&) {});
        hold_total_volume(moving.circulation, state.data(), parameter.back());
        return state;
      });
}

}  // namespace

std::vector<NamedParameter> loop_parameters(const Loop& loop) {
  std::vector<NamedParameter> list;
  for_each_loop_parameter(loop, [&](const std::string& name, const Quantity& quantity, double value) {
    list.push_back({name, quantity, value});
  });
  list.push_back({std::string(total_volume_name), total_volume_quantity,
                  total_volume(loop.circulation, loop.initial.data())});
  return list;
}

void set_loop_parameters(Loop& loop, std::span<const double> values) {
  const std::vector<NamedParameter> list = loop_parameters(loop);
  if (values.size() != list.size())
    throw InputError(
        fmt::format("a loop has {} parameters, {} values were given", list.size(), values.size()));
  for (std::size_t k = 0; k < list.size(); ++k) check_range(list[k].quantity, values[k], list[k].name);
  Loop changed = loop;
  std::size_t k = 0;
  for_each_loop_parameter(changed,
                          [&](const std::string&, const Quantity&, double& field) { field = values[k++]; });
  hold_total_volume(changed.circulation, changed.initial.data(), values[k]);
  check_loop(changed);
  loop = changed;
}

void set_loop_parameter(Loop& loop, std::string_view name, double value) {
  std::vector<std::string> names;
  std::vector<double> values;
  for (const NamedParameter& p : loop_parameters(loop)) {
    names.push_back(p.name);
    values.push_back(p.value);
  }
  const auto found = std::find(names.begin(), names.end(), name);
  if (found == names.end()) refuse_unknown("parameter of the loop", name, names);
  values[static_cast<std::size_t>(found - names.begin())] = value;
  set_loop_parameters(loop, values);
}

BeatIndexes loop_indexes(const LoopSolver& solver, const CirculationValues& start) {
  const Loop& loop = solver.loop();
  CirculationValues state = start;
  if (solver.integrator().name == "runge-kutta-4")
    return indexes_of<double>(loop, state.data(), solver.integrator().dt_s);
  // Rows so close that a valve that moves between two of them does not show.
  Table rows = circulation_table(loop.circulation);
  solver.beat(state, std::min(index_sample_s, loop.period_s / 20), &rows);
  return compute_indexes(rows, activations_of(loop));
}

Sensitivities loop_sensitivities(const Loop& loop, const CirculationValues& on_cycle, double dt_s) {
  Sensitivities table;
  std::vector<double> parameters;
  for (const NamedParameter& p : loop_parameters(loop)) {
    table.parameters.push_back(p.name);
    table.parameter_units.emplace_back(p.quantity.unit);
    parameters.push_back(p.value);
  }
  std::vector<double> x(on_cycle.begin(), on_cycle.end());
  const Eigen::MatrixXd dx = cycle_derivatives(loop, x, parameters, dt_s).moves;
  const int m = static_cast<int>(parameters.size());
  for (int first = 0; first < m; first += tangent_lanes) {
    TangentPass pass = tangent_pass(x, parameters, dx, first);
    const auto indexes = indexes_of(seeded_loop(loop, pass.parameter), pass.state.data(), dt_s);
    std::size_t index = 0;
    for_each_index(indexes, [&](const std::string& name, const char* unit, const Tangent& value) {
      store_output(table, first, index++, name, unit, value);
    });
  }
  for (int i = 0; i < n_circulation_states; ++i)
    for (int j = 0; j < m; ++j) table.state_derivatives.push_back(dx(i, j));
  return table;
}

std::vector<double> loop_cycle_derivatives_by_cvodes(const Loop& loop, const CirculationValues& on_cycle,
                                                     double relative_tolerance) {
  constexpr int n = n_circulation_states;
  std::vector<double> values;
  for (const NamedParameter& p : loop_parameters(loop)) values.push_back(p.value);
  const int m = static_cast<int>(values.size()), all = n + m;
  // The loop whose parameters move along the directions of one pass.
  std::vector<LoopOf<Tangent>> moving;
  std::vector<std::vector<Tangent>> parameters;
  for (int first = 0; first < all; first += tangent_lanes) {
    std::vector<Tangent> seeds(values.begin(), values.end());
    for (int j = 0; j < m; ++j)
      if (n + j >= first && n + j < first + tangent_lanes) seeds[j].derivative[n + j - first] = 1;
    moving.push_back(seeded_loop(loop, seeds));
    parameters.push_back(std::move(seeds));
  }
  const auto rates = [](const auto& in, const auto& t, const auto* y, auto* dy) {
    using T = std::remove_cvref_t<decltype(*y)>;
    T p[n_chambers];
    loop_pressures(in, t, y, p);
    circulation_rates(in.circulation, y, p, valve_flows(in.circulation, p, y), dy);
  };
  OdeSystem system;
  system.size = n;
  system.derivative = [&](double t, const double* y, double* dy) { rates(loop, t, y, dy); };
  system.n_directions = static_cast<std::size_t>(all);
  system.variation = [&](double t, const double* y, const double* const* S, double* const* dS) {
    for (int first = 0; first < all; first += tangent_lanes) {
      Tangent x[n], dx[n];
      for (int i = 0; i < n; ++i) {
        x[i] = y[i];
        for (int k = 0; k < tangent_lanes && first + k < all; ++k) x[i].derivative[k] = S[first + k][i];
      }
      rates(moving[static_cast<std::size_t>(first / tangent_lanes)], Tangent(t), x, dx);
      for (int i = 0; i < n; ++i)
        for (int k = 0; k < tangent_lanes && first + k < all; ++k) dS[first + k][i] = dx[i].derivative[k];
    }
  };
  if (has_kink(loop.circulation.valve_law)) {
    system.n_roots = n_valves;
    system.roots = [&](double t, const double* y, double* drops) {
      double p[n_chambers];
      loop_pressures(loop, t, y, p);
      const auto drop = valve_drops(p, y);
      std::copy(drop.begin(), drop.end(), drops);
    };
  }
  Cvode solver(system, {relative_tolerance, std::vector<double>(n, relative_tolerance)});
  std::vector<double> y(on_cycle.begin(), on_cycle.end());
  std::vector<std::vector<double>> S(static_cast<std::size_t>(all), std::vector<double>(n, 0.0));
  for (int i = 0; i < n; ++i) S[static_cast<std::size_t>(i)][static_cast<std::size_t>(i)] = 1;
  double begin = 0;
  for (double end : LoopBeat<double>(loop, 1e-3).ends()) {
    solver.set_directions(S);
    solver.restart(begin, y);
    y = solver.advance(end);
    S = solver.directions();
    begin = end;
  }
  // The beat ends when the period does, and keeps its volume.
  std::vector<double> last(n);
  rates(loop, loop.period_s, y.data(), last.data());
  for (int i = 0; i < n; ++i)
    S[static_cast<std::size_t>(n)][static_cast<std::size_t>(i)] += last[static_cast<std::size_t>(i)];
  Eigen::MatrixXd by_all(n, all);
  for (int first = 0; first < all; first += tangent_lanes) {
    const std::size_t pass = static_cast<std::size_t>(first / tangent_lanes);
    std::vector<Tangent> image(y.begin(), y.end());
    for (int i = 0; i < n; ++i)
      for (int k = 0; k < tangent_lanes && first + k < all; ++k) image[i].derivative[k] = S[first + k][i];
    hold_total_volume(moving[pass].circulation, image.data(), parameters[pass].back());
    for (int i = 0; i < n; ++i)
      for (int k = 0; k < tangent_lanes && first + k < all; ++k)
        by_all(i, first + k) = image[i].derivative[k];
  }
  const Eigen::MatrixXd moves =
      (Eigen::MatrixXd::Identity(n, n) - by_all.leftCols(n)).partialPivLu().solve(by_all.rightCols(m));
  std::vector<double> result;
  for (int i = 0; i < n; ++i)
    for (int j = 0; j < m; ++j) result.push_back(moves(i, j));
  return result;
}

}  // namespace wiggers
