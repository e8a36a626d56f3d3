#include <fmt/format.h>

#include <algorithm>
#include <wiggers/cellmodels/pacing/cell_lanes.hpp>
#include <wiggers/cellmodels/pacing/cell_sense.hpp>
#include <wiggers/cellmodels/pacing/cell_study.hpp>
#include <wiggers/core/memory.hpp>

#include "common.hpp"

namespace wiggers::python {

namespace {

struct CellModelOfPython {
  CellStudy study;

  std::size_t n_states() const { return study.model->states.size(); }
  std::vector<double> state(const Array& array) const {
    auto values = vector_of(array, n_states(), "state");
    for (std::size_t i = 0; i < values.size(); ++i) check_range(study.model->states[i], values[i], "state");
    return values;
  }
  double stimulus(double t) const {
    const double within = std::fmod(t, study.protocol.period_ms);
    return study.protocol.stimulus.current_on_span(within < 0 ? within + study.protocol.period_ms : within);
  }
};

// Every index a cell can have; those of the start's states after them.
std::pair<std::vector<std::string>, std::vector<std::string>> cell_index_names(const CellModel& model) {
  std::pair<std::vector<std::string>, std::vector<std::string>> list{
      {"APD90_ms", "APD50_ms", "V_rest_mV", "V_peak_mV", "V_min_mV", "dVdt_max_mV_per_ms"},
      {"ms", "ms", "mV", "mV", "mV", "mV/ms"}};
  if (model.has_calcium()) {
    for (const char* name :
         {"calcium_diastolic_uM", "calcium_peak_uM", "calcium_amplitude_uM", "calcium_time_to_peak_ms"})
      list.first.emplace_back(name);
    for (const char* unit : {"uM", "uM", "uM", "ms"}) list.second.emplace_back(unit);
  }
  for (const Quantity& q : model.states) {
    list.first.push_back(fmt::format("start.{}", q.name));
    list.second.emplace_back(q.unit);
  }
  return list;
}

// What the model is: its numbers, states, rates.
void bind_numbers(py::class_<CellModelOfPython>& model) {
  model
      .def(py::init([](const std::string& model, const std::string& set) {
             return CellModelOfPython{make_cell_study(find_model(model), set)};
           }),
           py::arg("model"), py::arg("set"))
      .def("copy", [](const CellModelOfPython& cell) { return CellModelOfPython(cell); })
      .def_property_readonly(
          "name", [](const CellModelOfPython& cell) { return std::string(cell.study.model->name); })
      .def_property_readonly(
          "title", [](const CellModelOfPython& cell) { return std::string(cell.study.model->title); })
      .def_property_readonly(
          "source", [](const CellModelOfPython& cell) { return std::string(cell.study.model->source); })
      .def("parameters", [](const CellModelOfPython& cell) { return cell_study_parameters(cell.study); })
      .def(
          "set_parameters",
          [](CellModelOfPython& cell, const Array& values) {
            set_cell_study_parameters(cell.study,
                                      vector_of(values, cell_study_parameters(cell.study).size(), "values"));
          },
          py::arg("values"))
      .def(
          "set_parameter",
          [](CellModelOfPython& cell, const std::string& name, double value) {
            set_cell_study_parameter(cell.study, name, value);
          },
          py::arg("name"), py::arg("value"))
      .def(
          "set_integrator",
          [](CellModelOfPython& cell, const std::string& name, double dt_ms) {
            CellStudy changed = cell.study;
            changed.integrator = name;
            changed.dt_ms = dt_ms;
            check_study(changed);
            cell.study = changed;
          },
          py::arg("name"), py::arg("dt_ms"))
      .def("state_names", [](const CellModelOfPython& cell) { return names_of(cell.study.model->states); })
      .def("state_units",
           [](const CellModelOfPython& cell) {
             std::vector<std::string> units;
             for (const Quantity& q : cell.study.model->states) units.emplace_back(q.unit);
             return units;
           })
      .def("index_names",
           [](const CellModelOfPython& cell) { return cell_index_names(*cell.study.model).first; })
      .def("index_units",
           [](const CellModelOfPython& cell) { return cell_index_names(*cell.study.model).second; })
      .def("initial_state", [](const CellModelOfPython& cell) { return owned(start_of(cell.study)); })
      .def("fingerprint",
           [](const CellModelOfPython& cell) { return cell.study.model->fingerprint(cell.study.parameters); })
      .def(
          "rhs",
          [](const CellModelOfPython& cell, double t, const Array& y) {
            const auto state = vector_of(y, cell.n_states(), "y");
            std::vector<double> rates(state.size());
            const double current[1] = {cell.stimulus(t)};
            cell.study.model->evaluate(state.data(), current, cell.study.parameters.data(), rates.data(),
                                       nullptr);
            return owned(std::move(rates));
          },
          py::arg("t"), py::arg("y"))
      .def(
          "jacobian",
          [](const CellModelOfPython& cell, double t, const Array& y) {
            const auto state = vector_of(y, cell.n_states(), "y");
            const std::size_t n = state.size();
            std::vector<double> columns(n * n), rows(n * n);
            const double current[1] = {cell.stimulus(t)};
            cell.study.model->jacobian(state.data(), current, cell.study.parameters.data(), columns.data());
            for (std::size_t i = 0; i < n; ++i)
              for (std::size_t j = 0; j < n; ++j) rows[i * n + j] = columns[i + n * j];
            return owned(std::move(rows), {static_cast<py::ssize_t>(n), static_cast<py::ssize_t>(n)});
          },
          py::arg("t"), py::arg("y"));
}

// What is computed: cycles, beats, their indexes and derivatives.
void bind_beats(py::class_<CellModelOfPython>& model) {
  model
      .def(
          "to_limit_cycle",
          [](CellModelOfPython cell, std::optional<Array> near, double distance, int max_beats,
             const std::string& method, const ProgressCall& progress) {
            std::vector<double> state = near ? cell.state(*near) : start_of(cell.study);
            LimitCycleSettings settings = cycle_settings(distance, max_beats, method);
            // A cycle nearby was chosen by the caller.
            if (!near) settings.attractor = Attractor::paced;
            LimitCycleCertificate certificate;
            {
              py::gil_scoped_release unlock;
              certificate = to_limit_cycle(cell.study, state, settings, after_beat(progress));
            }
            return py::make_tuple(owned(std::move(state)), certificate);
          },
          py::arg("near"), py::arg("distance"), py::arg("max_beats"), py::arg("method"), py::arg("progress"))
      .def(
          "refined",
          [](CellModelOfPython cell, const Array& near) {
            std::vector<double> state = cell.state(near);
            {
              py::gil_scoped_release unlock;
              state = refined_limit_cycle(cell.study, state, newton_at(cell.study, state));
            }
            return owned(std::move(state));
          },
          py::arg("near"))
      .def(
          "run",
          [](CellModelOfPython cell, const Array& start, int beats, double sample_ms,
             const std::string& integrator, double rtol, double atol, const ProgressCall& progress) {
            std::vector<double> state = cell.state(start);
            auto table = std::make_shared<Table>();
            table->add("t_ms", "ms", "time");
            for (const Quantity& q : cell.study.model->states)
              table->add(std::string(q.name), std::string(q.unit), std::string(q.meaning));
            table->add("stimulus_A_per_F", "A/F", "stimulus current");
            if (!(sample_ms >= 1e-4 && sample_ms <= cell.study.protocol.period_ms))
              throw InputError(fmt::format("sample_ms = {} is outside 1e-4 to the period", sample_ms));
            require_memory(beats * cell.study.protocol.period_ms / sample_ms,
                           static_cast<double>(table->columns.size()),
                           fmt::format("{} beats with sample_ms = {}", beats, sample_ms),
                           "Take a larger sample_ms or fewer beats.");
            PacedCell paced(*cell.study.model, cell.study.parameters, cell.study.protocol,
                            {integrator, rtol, atol, cell.study.dt_ms});
            {
              py::gil_scoped_release unlock;
              for (int beat = 0; beat < beats; ++beat) {
                // The end of a beat is the start of the next.
                if (beat > 0)
                  for (Column& column : table->columns) column.values.pop_back();
                paced.beat(state, sample_ms, [&](double t, const double* y, double current) {
                  std::size_t c = 0;
                  table->columns[c++].values.push_back(beat * cell.study.protocol.period_ms + t);
                  for (std::size_t i = 0; i < cell.n_states(); ++i)
                    table->columns[c++].values.push_back(y[i]);
                  table->columns[c].values.push_back(current);
                });
                after_beat(progress)(beats_done(beat + 1));
              }
            }
            return py::make_tuple(table, owned(std::move(state)));
          },
          py::arg("start"), py::arg("beats"), py::arg("sample_ms"), py::arg("integrator"), py::arg("rtol"),
          py::arg("atol"), py::arg("progress"))
      .def(
          "require_state",
          [](const CellModelOfPython& cell, const Array& given) {
            require_saved_state(*cell.study.model, cell.study.parameters, cell.study.charge_offset_mV,
                                cell.state(given), "state");
          },
          py::arg("state"), "Refuses what is on no cycle of this cell: ranges and charge are looked at.")
      .def(
          "indexes",
          [](const CellModelOfPython& cell, const Array& start) {
            std::vector<std::pair<std::string, double>> list;
            BeatWords words;
            for (const NamedValue& value : cell_indexes(cell.study, cell.state(start), &words))
              list.push_back({value.name, value.value});
            return std::make_pair(list, words.no_action_potential);
          },
          py::arg("start"), "The indexes, and why the beat is no action potential (empty: it is one).")
      .def(
          "sensitivities",
          [](CellModelOfPython cell, const Array& on_cycle, const std::function<void(double)>& progress) {
            const std::vector<double> state = cell.state(on_cycle);
            py::gil_scoped_release unlock;
            return cell_sensitivities(cell.study, state, after_pass(progress));
          },
          py::arg("on_cycle"), py::arg("progress"));
}

// Many of them at once.
void bind_batch(py::class_<CellModelOfPython>& model) {
  model.def(
      "batch",
      [](CellModelOfPython cell, const std::vector<std::string>& names, const Array& samples,
         std::optional<Array> near, double distance, int max_beats, int threads,
         const std::function<void(double)>& progress, bool lanes) {
        const Samples points(cell_study_parameters(cell.study), "parameter", names, samples);
        auto [indexes, units] = cell_index_names(*cell.study.model);
        std::vector<double> start;
        if (near) start = cell.state(*near);
        LimitCycleSettings settings = cycle_settings(distance, max_beats, "anderson");
        if (!near) settings.attractor = Attractor::paced;
        const std::vector<std::string> order = indexes;
        py::gil_scoped_release unlock;
        const auto study_of = [&](std::size_t sample) {
          CellStudy study = cell.study;
          set_cell_study_parameters(study, points(sample));
          return study;
        };
        const auto fill = [&](const CellStudy& study, const std::vector<double>& y, double* out,
                              double* state) {
          std::size_t next = 0;
          BeatWords words;
          for (const NamedValue& value : cell_indexes(study, y, &words)) {
            while (order[next] != value.name) ++next;
            out[next++] = value.value;
          }
          std::copy(y.begin(), y.end(), state);
          if (!words.unphysical.empty()) throw NumericalFailure(words.unphysical);
          const std::string& why_not = words.no_action_potential;
          return why_not.empty() ? why_not : "no action potential: " + why_not;
        };
        const auto one_by_one = [&](std::size_t sample, double* out, double* state) {
          const CellStudy study = study_of(sample);
          std::vector<double> y = near ? start : start_of(study);
          const auto certificate = to_limit_cycle(study, y, settings);
          if (!certificate.good()) throw NumericalFailure(limit_cycle_failure(certificate));
          return fill(study, y, out, state);
        };
        const auto side_by_side = [&](const std::vector<std::size_t>& group, const BatchFill& fill_row) {
          std::vector<CellStudy> studies;
          std::vector<std::vector<double>> states;
          for (std::size_t sample : group) {
            studies.push_back(study_of(sample));
            states.push_back(near ? start : start_of(studies.back()));
          }
          if (!share_pacing(studies)) return false;
          const auto results = to_limit_cycles_in_lanes(studies, std::move(states), settings);
          for (std::size_t i = 0; i < group.size(); ++i)
            fill_row(group[i], "", [&](double* out, double* state) {
              if (!results[i].settled) return one_by_one(group[i], out, state);
              return fill(studies[i], results[i].state, out, state);
            });
          return true;
        };
        return run_batch(points.count(), threads, indexes, units, cell.n_states(), one_by_one, progress,
                         lanes ? cells_in_lanes : 1, side_by_side);
      },
      py::arg("names"), py::arg("samples"), py::arg("near"), py::arg("distance"), py::arg("max_beats"),
      py::arg("threads"), py::arg("progress"), py::arg("lanes"));
}

}  // namespace

void bind_cell(py::module_& m) {
  m.def(
      "models",
      [](const std::string& kind) {
        std::vector<std::string> names;
        if (kind != "ionic" && kind != "force" && kind != "all")
          refuse_unknown("kind of models", kind, std::vector<std::string>{"all", "ionic", "force"});
        for (const CellModel* model : catalogue())
          if (kind == "all" || (kind == "ionic") == model->is_ionic()) names.emplace_back(model->name);
        return names;
      },
      "Names of the models: kind \"ionic\", \"force\" or \"all\".", py::arg("kind") = "all");

  py::class_<CellModelOfPython> model(m, "CellModel");
  bind_numbers(model);
  bind_beats(model);
  bind_batch(model);
}

}  // namespace wiggers::python
