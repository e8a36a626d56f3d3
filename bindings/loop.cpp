#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <wiggers/circulation/loop_beat.hpp>
#include <wiggers/circulation/physical_sense.hpp>
#include <wiggers/core/memory.hpp>
#include <wiggers/core/settings.hpp>
#include <wiggers/heart/run/rate_warnings.hpp>
#include <wiggers/heart/study/loop_study.hpp>

#include "common.hpp"

namespace wiggers::python {

namespace {

constexpr double largest_relative_noise = 1e-14;

struct LoopModel {
  Loop loop;
  LoopIntegrator integrator{"runge-kutta-4", 1e-9, 1e-9, 1e-3};

  CirculationValues start_from(const Array* near) const {
    CirculationValues state = loop.initial;
    if (near) {
      const auto values = vector_of(*near, n_circulation_states, "state");
      std::copy(values.begin(), values.end(), state.begin());
      // A state that has this loop's volume but for rounding goes on bit by bit.
      const double volume = total_volume(loop.circulation, loop.initial.data());
      if (std::abs(total_volume(loop.circulation, state.data()) - volume) > 1e-12 * std::abs(volume))
        hold_total_volume(loop.circulation, state.data(), volume);
    }
    return state;
  }
  void require_steps(const char* what) const {
    if (integrator.name != "runge-kutta-4")
      throw InputError(
          fmt::format("{} need integrator = \"runge-kutta-4\" (now \"{}\")", what, integrator.name));
  }
};

// Names and units of every index there is.
std::pair<std::vector<std::string>, std::vector<std::string>> all_indexes() {
  BeatIndexes every;
  for (auto& valve : every.valve) valve.opens_s = valve.closes_s = 0;
  for (int side = 0; side < 2; ++side) {
    every.E_mL_per_s[side] = every.A_mL_per_s[side] = every.E_over_A[side] = every.atrial_kick_percent[side] =
        0;
    every.atrium[side].VpreAC_mL = every.atrium[side].PassEF_percent = every.atrium[side].ActEF_percent = 0;
  }
  every.further.fill(0.0);
  std::pair<std::vector<std::string>, std::vector<std::string>> result;
  for_each_index(every, [&](const std::string& name, const char* unit, double) {
    result.first.push_back(name);
    result.second.emplace_back(unit);
  });
  return result;
}

}  // namespace

std::vector<std::pair<std::string, double>> named_indexes(const BeatIndexes& beat) {
  std::vector<std::pair<std::string, double>> list;
  for_each_index(beat, [&](const std::string& name, const char*, double value) {
    list.push_back({name, value});
  });
  return list;
}
void fill_indexes(const BeatIndexes& beat, const std::vector<std::string>& names, double* values) {
  std::size_t next = 0;
  for_each_index(beat, [&](const std::string& name, const char*, double value) {
    while (names[next] != name) ++next;
    values[next++] = value;
  });
}
std::pair<std::vector<std::string>, std::vector<std::string>> index_names_and_units() {
  return all_indexes();
}

namespace {

// What the model is: its numbers, states, rates.
void bind_numbers(py::class_<LoopModel>& model) {
  model
      .def(py::init([](const std::string& set) {
             LoopModel model;
             model.loop = find_circulation_set(set).loop;
             if (!find_circulation_set(set).has_elastances)
               refuse_unknown("circulation parameter set with elastances", set, circulation_set_names(true));
             return model;
           }),
           py::arg("set"))
      .def_static(
          "from_text",
          [](const std::string& text, const std::string& name) {
            SettingsReader reader(parse_settings_text(text, name), name);
            LoopModel model;
            model.loop = read_loop(reader);
            return model;
          },
          py::arg("text"), py::arg("name"))
      .def("copy", [](const LoopModel& model) { return LoopModel(model); })
      .def("parameters", [](const LoopModel& model) { return loop_parameters(model.loop); })
      .def(
          "set_parameters",
          [](LoopModel& model, const Array& values) {
            set_loop_parameters(model.loop, vector_of(values, loop_parameters(model.loop).size(), "values"));
          },
          py::arg("values"))
      .def(
          "set_parameter",
          [](LoopModel& model, const std::string& name, double value) {
            set_loop_parameter(model.loop, name, value);
          },
          py::arg("name"), py::arg("value"))
      .def(
          "set_integrator",
          [](LoopModel& model, const std::string& name, double dt_s, double rtol, double atol) {
            const LoopIntegrator integrator{name, rtol, atol, dt_s};
            LoopSolver(model.loop, integrator);
            model.integrator = integrator;
          },
          py::arg("name"), py::arg("dt_s"), py::arg("rtol"), py::arg("atol"))
      .def_property_readonly(
          "valve_law",
          [](const LoopModel& model) {
            return std::string(valve_law_names[static_cast<std::size_t>(model.loop.circulation.valve_law)]);
          })
      .def("state_names",
           [](const LoopModel&) {
             std::vector<std::string> names;
             for (const Quantity& q : circulation_state_quantities) names.emplace_back(q.name);
             return names;
           })
      // All numbers of another loop, bit by bit: its blood volume is a sum, which assigning would round.
      .def(
          "take",
          [](LoopModel& model, const Array& values, const Array& initial) {
            set_loop_parameters(model.loop, vector_of(values, loop_parameters(model.loop).size(), "values"));
            const auto state = vector_of(initial, n_circulation_states, "initial");
            std::copy(state.begin(), state.end(), model.loop.initial.begin());
          },
          py::arg("values"), py::arg("initial"))
      .def("initial_state",
           [](const LoopModel& model) {
             return owned({model.loop.initial.begin(), model.loop.initial.end()});
           })
      .def(
          "rhs",
          [](const LoopModel& model, double t, const Array& y) {
            const auto state = vector_of(y, n_circulation_states, "y");
            std::vector<double> rates(n_circulation_states);
            double p[n_chambers];
            loop_pressures(model.loop, t, state.data(), p);
            const auto Q = valve_flows(model.loop.circulation, p, state.data());
            circulation_rates(model.loop.circulation, state.data(), p, Q, rates.data());
            return owned(std::move(rates));
          },
          py::arg("t"), py::arg("y"))
      .def(
          "jacobian",
          [](const LoopModel& model, double t, const Array& y) {
            using Jet = Dual<n_circulation_states>;
            const auto state = vector_of(y, n_circulation_states, "y");
            Jet x[n_circulation_states], rates[n_circulation_states], p[n_chambers];
            for (int i = 0; i < n_circulation_states; ++i) x[i] = Jet::variable(state[i], i);
            loop_pressures(model.loop, t, x, p);
            const auto Q = valve_flows(model.loop.circulation, p, x);
            circulation_rates(model.loop.circulation, x, p, Q, rates);
            std::vector<double> rows;
            for (const Jet& rate : rates)
              rows.insert(rows.end(), rate.derivative.begin(), rate.derivative.end());
            return owned(std::move(rows), {n_circulation_states, n_circulation_states});
          },
          py::arg("t"), py::arg("y"));
}

// What is computed: cycles, beats, their indexes and derivatives.
void bind_beats(py::class_<LoopModel>& model) {
  model
      .def(
          "to_limit_cycle",
          [](LoopModel model, std::optional<Array> near, double distance, int max_beats,
             const std::string& method, const ProgressCall& progress) {
            CirculationValues state = model.start_from(near ? &*near : nullptr);
            LimitCycleSettings settings =
                cycle_settings(distance, max_beats, method, loop_cycle_settings(distance));
            settings.map_noise = largest_relative_noise;
            LimitCycleCertificate certificate;
            {
              py::gil_scoped_release unlock;
              const LoopSolver solver(model.loop, model.integrator);
              certificate = solver.to_limit_cycle(state, settings, after_beat(progress));
              if (certificate.good()) certificate.warnings = ejection_warnings(loop_indexes(solver, state));
            }
            return py::make_tuple(owned({state.begin(), state.end()}), certificate);
          },
          py::arg("near"), py::arg("distance"), py::arg("max_beats"), py::arg("method"), py::arg("progress"))
      .def(
          "run",
          [](LoopModel model, const Array& start, int beats, double sample_s, const ProgressCall& progress) {
            CirculationValues state = model.start_from(&start);
            if (!(sample_s >= 1e-7 && sample_s <= model.loop.period_s))
              throw InputError(fmt::format("sample_s = {} s is outside 1e-7 to the period, {} s", sample_s,
                                           model.loop.period_s));
            auto table = std::make_shared<Table>(circulation_table(model.loop.circulation));
            require_memory(beats * model.loop.period_s / sample_s, static_cast<double>(table->columns.size()),
                           fmt::format("{} beats with sample_s = {}", beats, sample_s),
                           "Take a larger sample_s or fewer beats.");
            const LoopSolver solver(model.loop, model.integrator);
            {
              py::gil_scoped_release unlock;
              for (int beat = 0; beat < beats; ++beat) {
                Table rows = circulation_table(model.loop.circulation);
                solver.beat(state, sample_s, &rows);
                append_beat(*table, rows, beat * model.loop.period_s);
                after_beat(progress)(beats_done(beat + 1));
              }
            }
            return py::make_tuple(table, owned({state.begin(), state.end()}));
          },
          py::arg("start"), py::arg("beats"), py::arg("sample_s"), py::arg("progress"))
      .def(
          "require_state",
          [](const LoopModel& model, const Array& given) {
            const auto state = vector_of(given, n_circulation_states, "state");
            require_saved_circulation(state.data(), "state");
            require_same_blood(total_volume(model.loop.circulation, state.data()),
                               total_volume(model.loop.circulation, model.loop.initial.data()), "state");
          },
          py::arg("state"),
          "Refuses what is on no cycle of this loop: bounds and blood volume are looked at.")
      .def(
          "indexes",
          [](const LoopModel& model, const Array& start) {
            const CirculationValues state = model.start_from(&start);
            return named_indexes(loop_indexes(LoopSolver(model.loop, model.integrator), state));
          },
          py::arg("start"))
      .def(
          "sensitivities",
          [](LoopModel model, const Array& on_cycle) {
            model.require_steps("sensitivities");
            const CirculationValues state = model.start_from(&on_cycle);
            py::gil_scoped_release unlock;
            return loop_sensitivities(model.loop, state, model.integrator.dt_s);
          },
          py::arg("on_cycle"));
}

// Many of them at once.
void bind_batch(py::class_<LoopModel>& model) {
  model.def(
      "batch",
      [](LoopModel model, const std::vector<std::string>& names, const Array& samples,
         std::optional<Array> near, double distance, int max_beats, int threads,
         const std::function<void(double)>& progress) {
        const Samples points(loop_parameters(model.loop), "parameter of the loop", names, samples);
        const CirculationValues start = model.start_from(near ? &*near : nullptr);
        auto [indexes, units] = all_indexes();
        const std::vector<std::string> order = indexes;
        const LimitCycleSettings settings =
            cycle_settings(distance, max_beats, "anderson", loop_cycle_settings(distance));
        py::gil_scoped_release unlock;
        return run_batch(
            points.count(), threads, indexes, units, n_circulation_states,
            [&](std::size_t sample, double* out, double* state) {
              Loop loop = model.loop;
              set_loop_parameters(loop, points(sample));
              CirculationValues y = near ? start : loop.initial;
              hold_total_volume(loop.circulation, y.data(),
                                total_volume(loop.circulation, loop.initial.data()));
              const LoopSolver solver(loop, model.integrator);
              const auto certificate = solver.to_limit_cycle(y, settings);
              if (!certificate.good()) throw NumericalFailure(limit_cycle_failure(certificate));
              const BeatIndexes found = loop_indexes(solver, y);
              fill_indexes(found, order, out);
              std::copy(y.begin(), y.end(), state);
              return joined(ejection_warnings(found));
            },
            progress);
      },
      py::arg("names"), py::arg("samples"), py::arg("near"), py::arg("distance"), py::arg("max_beats"),
      py::arg("threads"), py::arg("progress"));
}

}  // namespace

void bind_loop(py::module_& m) {
  m.def(
      "index_names", [] { return all_indexes().first; }, "Names of every index of a beat.");
  m.def(
      "index_units", [] { return all_indexes().second; },
      "Units of the indexes, in the order of index_names().");
  m.def(
      "reference_ranges",
      [] {
        py::list rows;
        for (const ReferenceRange& r : reference_ranges())
          rows.append(py::dict(py::arg("index") = std::string(r.index), py::arg("unit") = std::string(r.unit),
                               py::arg("mean") = r.mean, py::arg("sd") = r.sd, py::arg("lower") = r.lower,
                               py::arg("upper") = r.upper, py::arg("founding_paper") = r.founding_paper));
        return rows;
      },
      "Reference ranges of the volumetric indexes (men, cardiac magnetic resonance) and the founding paper's "
      "values.");
  m.def(
      "loop_sets", [] { return circulation_set_names(true); },
      "Names of the parameter sets with elastances.");

  py::class_<LoopModel> model(m, "LoopModel");
  bind_numbers(model);
  bind_beats(model);
  bind_batch(model);
}

}  // namespace wiggers::python
