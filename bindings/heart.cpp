#include <fmt/format.h>

#include <algorithm>
#include <wiggers/heart/run/rate_warnings.hpp>
#include <wiggers/heart/scene/accuracy.hpp>
#include <wiggers/heart/study/heart_study.hpp>

#include "common.hpp"

namespace wiggers::python {

std::vector<std::pair<std::string, double>> named_indexes(const BeatIndexes& beat);
void fill_indexes(const BeatIndexes& beat, const std::vector<std::string>& names, double* values);
std::pair<std::vector<std::string>, std::vector<std::string>> index_names_and_units();

namespace {

Scene scene_of(const std::string& text, const std::string& path, std::vector<std::string> overrides,
               const std::string& accuracy) {
  if (!accuracy.empty()) {
    const auto& preset = heart_accuracy(accuracy).overrides;
    overrides.insert(overrides.begin(), preset.begin(), preset.end());
  }
  return path.empty() ? read_scene_text(text, "scene", overrides) : read_scene(path, overrides);
}

HeartState state_of(const Array& array) {
  return {vector_of(array, static_cast<std::size_t>(array.size()), "state"), {}};
}

// One heart runs at a time: its driver and its cells are shared by all calls. The interpreter's lock guards
// the flag; it is set before the lock is freed and cleared after it is back.
struct HeartOfPython {
  std::unique_ptr<HeartStudy> study;
  bool busy = false;

  class Turn {
   public:
    explicit Turn(HeartOfPython& heart) : heart_(heart) {
      if (heart.busy)
        throw InputError("this heart is running: wait for it, or use a copy() of it in another thread");
      heart.busy = true;
    }
    ~Turn() { heart_.busy = false; }
    Turn(const Turn&) = delete;
    HeartStudy* operator->() { return heart_.study.get(); }
    HeartStudy& operator*() { return *heart_.study; }

   private:
    HeartOfPython& heart_;
  };
};

// What the model is: its numbers, states, rates.
void bind_numbers(py::class_<HeartOfPython>& model) {
  model
      .def(py::init([](const std::string& text, const std::string& path,
                       const std::vector<std::string>& overrides, const std::string& accuracy) {
             auto heart = std::make_unique<HeartOfPython>();
             heart->study = std::make_unique<HeartStudy>(scene_of(text, path, overrides, accuracy));
             heart->study->set_between_beats(after_beat({}));
             return heart;
           }),
           py::arg("text"), py::arg("path"), py::arg("overrides"), py::arg("accuracy"))
      .def_property_readonly("text", [](const HeartOfPython& heart) { return heart.study->scene().text(); })
      .def_property_readonly("title", [](const HeartOfPython& heart) { return heart.study->scene().title; })
      .def_property_readonly(
          "body_surface_area_m2",
          [](const HeartOfPython& heart) { return heart.study->scene().body_surface_area_m2; })
      .def("parameters", [](const HeartOfPython& heart) { return heart.study->parameters(); })
      .def(
          "set_parameters",
          [](HeartOfPython& heart, const Array& values) {
            HeartOfPython::Turn study(heart);
            study->set_parameters(vector_of(values, study->parameters().size(), "values"));
          },
          py::arg("values"))
      .def(
          "set_parameter",
          [](HeartOfPython& heart, const std::string& name, double value) {
            HeartOfPython::Turn study(heart);
            study->set_parameter(name, value);
          },
          py::arg("name"), py::arg("value"))
      .def("copy", [](HeartOfPython& heart) {
        HeartOfPython::Turn study(heart);
        auto other = std::make_unique<HeartOfPython>();
        other->study = std::make_unique<HeartStudy>(study->copy());
        return other;
      });
}

// What is computed: cycles, beats, their indexes and derivatives.
void bind_beats(py::class_<HeartOfPython>& model) {
  model
      .def(
          "to_limit_cycle",
          [](HeartOfPython& heart, std::optional<Array> near, double distance, int max_beats,
             const std::string& method, const ProgressCall& progress) {
            HeartOfPython::Turn study(heart);
            const LimitCycleSettings settings = cycle_settings(distance, max_beats, method);
            HeartState start;
            if (near) start = state_of(*near);
            HeartState state;
            {
              py::gil_scoped_release unlock;
              state = study->to_limit_cycle(settings, near ? &start : nullptr, after_beat(progress));
              if (state.certificate.good()) state.certificate.warnings = study->warnings(state);
            }
            return py::make_tuple(owned(std::move(state.driver)), state.certificate);
          },
          py::arg("near"), py::arg("distance"), py::arg("max_beats"), py::arg("method"), py::arg("progress"))
      .def(
          "refined",
          [](HeartOfPython& heart, const Array& near) {
            HeartOfPython::Turn study(heart);
            HeartState state = state_of(near);
            {
              py::gil_scoped_release unlock;
              state = study->refined(state, study->newton_at(state));
            }
            return owned(std::move(state.driver));
          },
          py::arg("near"))
      .def(
          "require_state",
          [](HeartOfPython& heart, const Array& state) {
            HeartOfPython::Turn study(heart);
            const HeartState given = state_of(state);
            py::gil_scoped_release unlock;
            study->check_size(given);
          },
          py::arg("state"), "Refuses what is no state of this heart.")
      .def(
          "run",
          [](HeartOfPython& heart, const Array& start, int beats, const ProgressCall& progress) {
            HeartOfPython::Turn study(heart);
            HeartState state = state_of(start);
            auto table = std::make_shared<Table>();
            {
              py::gil_scoped_release unlock;
              for (int beat = 0; beat < beats; ++beat) {
                const Table rows = study->beat(state);
                if (beat == 0)
                  *table = rows;
                else
                  append_beat(*table, rows, beat * study->scene().period_s);
                after_beat(progress)(beats_done(beat + 1));
              }
            }
            return py::make_tuple(table, owned(std::move(state.driver)));
          },
          py::arg("start"), py::arg("beats"), py::arg("progress"))
      .def(
          "indexes",
          [](HeartOfPython& heart, const Array& start) {
            HeartOfPython::Turn study(heart);
            return named_indexes(study->indexes(state_of(start)));
          },
          py::arg("start"))
      .def(
          "sensitivities",
          [](HeartOfPython& heart, const Array& on_cycle, const std::vector<std::string>& parameters,
             const std::function<void(double)>& progress) {
            HeartOfPython::Turn study(heart);
            const HeartState state = state_of(on_cycle);
            py::gil_scoped_release unlock;
            return study->sensitivities(state, parameters, after_pass(progress));
          },
          py::arg("on_cycle"), py::arg("parameters"), py::arg("progress"));
}

// Many of them at once.
void bind_batch(py::class_<HeartOfPython>& model) {
  model.def(
      "batch",
      [](HeartOfPython& heart, const std::vector<std::string>& names, const Array& samples,
         std::optional<Array> near, double distance, int max_beats, int threads,
         const std::function<void(double)>& progress) {
        HeartOfPython::Turn study(heart);
        const Samples points(study->parameters(), "parameter of the heart", names, samples);
        auto [indexes, units] = index_names_and_units();
        const std::vector<std::string> order = indexes;
        const LimitCycleSettings settings = cycle_settings(distance, max_beats, "anderson");
        HeartState start;
        if (near) start = state_of(*near);
        py::gil_scoped_release unlock;
        // The cells' cycles once, for all samples that do not move them.
        HeartState first = start;
        std::size_t n_numbers = start.driver.size();
        try {
          first = study->to_limit_cycle(settings, near ? &start : nullptr, after_beat({}));
          n_numbers = first.driver.size();
        } catch (const NumericalFailure&) {
          // The base point has no cycle; the samples may have theirs.
        }
        // Workers leave the interpreter alone.
        HeartStudy quiet = study->copy();
        quiet.set_between_beats({});
        return run_batch(
            points.count(), threads, indexes, units, n_numbers,
            [&](std::size_t sample, double* out, double* state) {
              HeartStudy one = quiet.copy();
              one.set_parameters(points(sample));
              const HeartState y = one.to_limit_cycle(settings, first.driver.empty() ? nullptr : &first);
              if (!y.certificate.good()) throw NumericalFailure(limit_cycle_failure(y.certificate));
              const BeatIndexes found = one.indexes(y);
              fill_indexes(found, order, out);
              if (y.driver.size() == n_numbers) std::copy(y.driver.begin(), y.driver.end(), state);
              return joined(ejection_warnings(found));
            },
            progress);
      },
      py::arg("names"), py::arg("samples"), py::arg("near"), py::arg("distance"), py::arg("max_beats"),
      py::arg("threads"), py::arg("progress"));
}

}  // namespace

void bind_heart(py::module_& m) {
  py::class_<HeartOfPython> model(m, "HeartModel");
  bind_numbers(model);
  bind_beats(model);
  bind_batch(model);
}

}  // namespace wiggers::python
