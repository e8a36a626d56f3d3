#include "common.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <limits>
#include <mutex>
#include <set>
#include <system_error>
#include <thread>

namespace wiggers::python {

namespace {

// Facts of a parameter that came out of a pickle: their texts stay for the life of the process, as those that
// are compiled in do.
std::string_view kept(const std::string& text) {
  static std::set<std::string> texts;  // under the interpreter's lock
  return *texts.insert(text).first;
}

// Equal if they pickle alike.
bool equal_states(const py::object& a, const py::object& b) {
  return py::type::of(a).is(py::type::of(b)) && a.attr("__getstate__")().equal(b.attr("__getstate__")());
}

py::array_t<double> array_of(const std::vector<double>& values) {
  return py::array_t<double>(static_cast<py::ssize_t>(values.size()), values.data());
}
std::vector<double> values_in(const py::handle& array) {
  const auto values = array.cast<Array>();
  return {values.data(), values.data() + values.size()};
}

}  // namespace

py::array_t<double> owned(std::vector<double> values, std::vector<py::ssize_t> shape) {
  auto* kept = new std::vector<double>(std::move(values));
  py::capsule owner(kept, [](void* p) { delete static_cast<std::vector<double>*>(p); });
  if (shape.empty()) shape = {static_cast<py::ssize_t>(kept->size())};
  return py::array_t<double>(shape, kept->data(), owner);
}

py::array_t<double> view_of(const py::object& owner, const double* values, std::vector<py::ssize_t> shape) {
  py::array_t<double> view(std::move(shape), values, owner);
  py::detail::array_proxy(view.ptr())->flags &= ~py::detail::npy_api::NPY_ARRAY_WRITEABLE_;
  return view;
}

std::vector<double> vector_of(const Array& array, std::size_t size, const std::string& what) {
  if (array.ndim() != 1 || static_cast<std::size_t>(array.size()) != size) {
    std::string shape;
    for (py::ssize_t i = 0; i < array.ndim(); ++i)
      shape += fmt::format("{}{}", i ? ", " : "", array.shape(i));
    throw InputError(fmt::format("{} has shape ({}), wanted is ({},)", what, shape, size));
  }
  std::vector<double> values(array.data(), array.data() + array.size());
  for (std::size_t i = 0; i < values.size(); ++i)
    if (!std::isfinite(values[i]))
      throw InputError(fmt::format("{}[{}] = {} is not finite", what, i, values[i]));
  return values;
}

void append_beat(Table& table, const Table& beat, double begin) {
  for (std::size_t c = 0; c < beat.columns.size(); ++c) {
    auto& all = table.columns[c].values;
    if (!all.empty()) all.pop_back();
    for (double value : beat.columns[c].values) all.push_back(c == 0 ? begin + value : value);
  }
}

void check_signals() {
  py::gil_scoped_acquire lock;
  if (PyErr_CheckSignals() != 0) throw py::error_already_set();
}

LimitCycleCertificate beats_done(int beats) {
  LimitCycleCertificate certificate;
  certificate.beats = beats;
  return certificate;
}

std::function<void(const LimitCycleCertificate&)> after_beat(const ProgressCall& progress) {
  return [progress](const LimitCycleCertificate& c) {
    check_signals();
    if (!progress) return;
    py::gil_scoped_acquire lock;
    progress(c.beats, c.distance);
  };
}

std::function<void(double)> after_pass(const std::function<void(double)>& progress) {
  return [progress](double share) {
    check_signals();
    if (!progress) return;
    py::gil_scoped_acquire lock;
    progress(share);
  };
}

LimitCycleSettings cycle_settings(double distance, int max_beats, const std::string& method,
                                  const LimitCycleSettings& base) {
  if (!(distance >= 1e-13 && distance <= 0.1))
    throw InputError(fmt::format("distance = {} is outside 1e-13 to 0.1", distance));
  if (max_beats < 3 || max_beats > 1000000)
    throw InputError(fmt::format("max_beats = {} is outside 3 to 1e6", max_beats));
  LimitCycleSettings settings = base;
  settings.distance = distance;
  settings.max_beats = max_beats;
  settings.method = limit_cycle_method(method);
  return settings;
}

std::string joined(const std::vector<std::string>& warnings) {
  std::string all;
  for (const std::string& warning : warnings) all += (all.empty() ? "" : "; ") + warning;
  return all;
}

Samples::Samples(const std::vector<NamedParameter>& all, const std::string& kind,
                 const std::vector<std::string>& names, const Array& rows)
    : rows_(rows.data()), count_(static_cast<std::size_t>(rows.shape(0))) {
  std::vector<std::string> known;
  for (const NamedParameter& p : all) {
    known.push_back(p.name);
    base_.push_back(p.value);
  }
  for (const std::string& name : names) {
    const auto found = std::find(known.begin(), known.end(), name);
    if (found == known.end()) refuse_unknown(kind, name, known);
    position_.push_back(static_cast<std::size_t>(found - known.begin()));
  }
}

std::vector<double> Samples::operator()(std::size_t sample) const {
  std::vector<double> all = base_;
  for (std::size_t j = 0; j < position_.size(); ++j) all[position_[j]] = rows_[sample * position_.size() + j];
  return all;
}

BatchRows run_batch(std::size_t n, int threads, std::vector<std::string> names,
                    std::vector<std::string> units, std::size_t n_states,
                    const std::function<std::string(std::size_t, double*, double*)>& solve,
                    const std::function<void(double)>& progress, std::size_t group,
                    const std::function<bool(const std::vector<std::size_t>&, const BatchFill&)>& together) {
  if (threads < 1 || threads > 1024)
    throw InputError(fmt::format("threads = {} is outside 1 to 1024", threads));
  BatchRows rows;
  rows.names = std::move(names);
  rows.units = std::move(units);
  rows.n_states = n_states;
  const std::size_t m = rows.names.size();
  constexpr double nothing = std::numeric_limits<double>::quiet_NaN();
  rows.values.assign(n * m, nothing);
  rows.states.assign(n * n_states, nothing);
  rows.reasons.assign(n, "");
  rows.notes.assign(n, "");
  std::atomic<std::size_t> next{0};
  std::atomic<bool> stop{false};
  // Rows are written whole or not at all.
  const BatchFill fill = [&](std::size_t k, const std::string& reason, const BatchWrite& write) {
    if (!reason.empty()) {
      rows.reasons[k] = reason;
      return;
    }
    std::vector<double> values(m, nothing), state(n_states, nothing);
    try {
      const std::string note = write(values.data(), state.data());
      std::copy(values.begin(), values.end(), rows.values.begin() + static_cast<long>(k * m));
      std::copy(state.begin(), state.end(), rows.states.begin() + static_cast<long>(k * n_states));
      rows.notes[k] = note;
    } catch (const std::exception& error) {
      rows.reasons[k] = error.what();
    }
  };
  const auto work = [&] {
    for (std::size_t first = next.fetch_add(group); first < n && !stop; first = next.fetch_add(group)) {
      std::vector<std::size_t> samples;
      for (std::size_t k = first; k < std::min(n, first + group); ++k) samples.push_back(k);
      bool solved = false;
      if (together && samples.size() > 1) {
        try {
          solved = together(samples, fill);
        } catch (const std::exception&) {
          // Whichever sample it was: each for itself says.
        }
      }
      for (std::size_t k : samples)
        if (!solved && !stop)
          fill(k, "", [&](double* values, double* state) { return solve(k, values, state); });
    }
  };
  const auto count = std::min<std::size_t>(static_cast<std::size_t>(threads), std::max<std::size_t>(1, n));
  std::vector<std::thread> pool;
  std::atomic<std::size_t> ended{0};
  for (std::size_t t = 0; t < count; ++t) try {
      pool.emplace_back([&] {
        work();
        ++ended;
      });
    } catch (const std::system_error&) {
      // No more threads to be had: those that run do the work; without any it is done here.
      if (pool.empty()) work();
      break;
    }
  // This thread looks after signals and progress meanwhile; both may end the batch.
  std::exception_ptr failure;
  auto shown = std::chrono::steady_clock::now();
  while (ended < pool.size()) {
    std::this_thread::sleep_for(std::chrono::milliseconds(ended == 0 && n < 64 ? 1 : 5));
    if (failure || std::chrono::steady_clock::now() - shown < std::chrono::milliseconds(100)) continue;
    shown = std::chrono::steady_clock::now();
    try {
      check_signals();
      if (progress) {
        py::gil_scoped_acquire lock;
        progress(static_cast<double>(std::min(n, next.load())) /
                 static_cast<double>(std::max<std::size_t>(1, n)));
      }
    } catch (...) {
      failure = std::current_exception();
      stop = true;
    }
  }
  for (std::thread& thread : pool) thread.join();
  if (failure) std::rethrow_exception(failure);
  if (progress) {
    py::gil_scoped_acquire lock;
    progress(1.0);
  }
  return rows;
}

namespace {

void bind_parameter(py::module_& m) {
  py::class_<NamedParameter>(m, "Parameter", "A parameter's fact sheet and value.")
      .def_readonly("name", &NamedParameter::name)
      .def_readonly("value", &NamedParameter::value)
      .def_property_readonly("unit", [](const NamedParameter& p) { return std::string(p.quantity.unit); })
      .def_property_readonly("meaning",
                             [](const NamedParameter& p) { return std::string(p.quantity.meaning); })
      .def_property_readonly("default", [](const NamedParameter& p) { return p.quantity.default_value; })
      .def_property_readonly("lower", [](const NamedParameter& p) { return p.quantity.lower; })
      .def_property_readonly("upper", [](const NamedParameter& p) { return p.quantity.upper; })
      .def("__repr__",
           [](const NamedParameter& p) {
             return fmt::format("{} = {} {} ({} to {}; default {}): {}", p.name, p.value, p.quantity.unit,
                                p.quantity.lower, p.quantity.upper, p.quantity.default_value,
                                p.quantity.meaning);
           })
      .def("__eq__", &equal_states, py::is_operator())
      .def(py::pickle(
          [](const NamedParameter& p) {
            const Quantity& q = p.quantity;
            return py::make_tuple(p.name, p.value, std::string(q.name), std::string(q.unit), q.default_value,
                                  q.lower, q.upper, std::string(q.meaning));
          },
          [](const py::tuple& t) {
            const auto fact = [&](int k) { return kept(t[k].cast<std::string>()); };
            const auto number = [&](int k) { return t[k].cast<double>(); };
            return NamedParameter{t[0].cast<std::string>(),
                                  {fact(2), fact(3), number(4), number(5), number(6), fact(7)},
                                  number(1)};
          }));
}

void bind_certificate(py::module_& m) {
  py::class_<LimitCycleCertificate>(m, "Certificate", "How close to the limit cycle a search ended.")
      .def(py::init([](const std::string& verdict, double distance, double residual, double multiplier,
                       int beats, const std::string& reason, const std::vector<std::string>& warnings) {
             const auto [v, period] = limit_cycle_verdict(verdict);
             return LimitCycleCertificate{v,      distance, residual, multiplier, beats,
                                          period, false,    reason,   warnings};
           }),
           py::arg("verdict"), py::arg("distance"), py::arg("residual"), py::arg("multiplier"),
           py::arg("beats"), py::arg("reason") = "", py::arg("warnings") = std::vector<std::string>())
      .def(py::pickle(
          [](const LimitCycleCertificate& c) {
            return py::make_tuple(c.text(), c.distance, c.residual, c.multiplier, c.beats, c.reason,
                                  c.warnings);
          },
          [](const py::tuple& t) {
            const auto [verdict, period] = limit_cycle_verdict(t[0].cast<std::string>());
            return LimitCycleCertificate{verdict,
                                         t[1].cast<double>(),
                                         t[2].cast<double>(),
                                         t[3].cast<double>(),
                                         t[4].cast<int>(),
                                         period,
                                         false,
                                         t[5].cast<std::string>(),
                                         t[6].cast<std::vector<std::string>>()};
          }))
      .def("__eq__", &equal_states, py::is_operator())
      .def_property_readonly("verdict", [](const LimitCycleCertificate& c) { return c.text(); })
      .def_property_readonly("converged", [](const LimitCycleCertificate& c) { return c.good(); })
      .def_readonly("distance", &LimitCycleCertificate::distance)
      .def_readonly("residual", &LimitCycleCertificate::residual)
      .def_readonly("multiplier", &LimitCycleCertificate::multiplier)
      .def_readonly("beats", &LimitCycleCertificate::beats)
      .def_readonly("period", &LimitCycleCertificate::period)
      .def_readonly("reason", &LimitCycleCertificate::reason)
      .def_readonly(
          "warnings", &LimitCycleCertificate::warnings,
          "What the cycle is like where it can be, but is no good one: a ventricle that hardly ejects.")
      .def_property_readonly("failure", &limit_cycle_failure,
                             "Why the search ended without a cycle of one beat, and what to try.")
      .def("__repr__", [](const LimitCycleCertificate& c) {
        return fmt::format(
            "Certificate({}, distance {:.2g}, residual {:.2g}, leading multiplier {:.4f}, {} beats{}{})",
            c.text_with_warnings(), c.distance, c.residual, c.multiplier, c.beats,
            c.reason.empty() ? "" : ": ", c.reason);
      });
}

void bind_columns(py::module_& m) {
  py::class_<Table, std::shared_ptr<Table>>(m, "Columns",
                                            "Named columns with units; arrays are views, not copies.")
      .def_property_readonly("names",
                             [](const Table& t) {
                               std::vector<std::string> names;
                               for (const Column& c : t.columns) names.push_back(c.name);
                               return names;
                             })
      .def(
          "unit", [](const Table& t, const std::string& name) { return t.at(name).unit; }, py::arg("name"))
      .def(
          "meaning", [](const Table& t, const std::string& name) { return t.at(name).meaning; },
          py::arg("name"))
      .def("__len__", &Table::n_rows)
      .def(
          "__getitem__",
          [](py::object self, const std::string& name) {
            const auto& values = self.cast<Table&>().at(name).values;
            return view_of(self, values.data(), {static_cast<py::ssize_t>(values.size())});
          },
          py::arg("name"))
      .def(py::pickle(
          [](const Table& t) {
            py::list columns;
            for (const Column& c : t.columns)
              columns.append(py::make_tuple(c.name, c.unit, c.meaning, array_of(c.values)));
            return py::make_tuple(columns);
          },
          [](const py::tuple& state) {
            auto table = std::make_shared<Table>();
            for (const py::handle& entry : state[0].cast<py::list>()) {
              const auto c = entry.cast<py::tuple>();
              table->add(c[0].cast<std::string>(), c[1].cast<std::string>(), c[2].cast<std::string>())
                  .values = values_in(c[3]);
            }
            return table;
          }));
}

void bind_sensitivities(py::module_& m) {
  py::class_<Sensitivities>(m, "SensitivityTable", "Derivatives of outputs by parameters, on a limit cycle.")
      .def_readonly("outputs", &Sensitivities::outputs)
      .def_readonly("output_units", &Sensitivities::output_units)
      .def_readonly("parameters", &Sensitivities::parameters)
      .def_readonly("parameter_units", &Sensitivities::parameter_units)
      .def_property_readonly("values",
                             [](const py::object& self) {
                               const auto& s = self.cast<Sensitivities&>();
                               return view_of(self, s.values.data(),
                                              {static_cast<py::ssize_t>(s.values.size())});
                             })
      .def_property_readonly("derivatives",
                             [](const py::object& self) {
                               const auto& s = self.cast<Sensitivities&>();
                               return view_of(self, s.derivatives.data(),
                                              {static_cast<py::ssize_t>(s.outputs.size()),
                                               static_cast<py::ssize_t>(s.parameters.size())});
                             })
      .def_property_readonly(
          "state_derivatives",
          [](const py::object& self) {
            const auto& s = self.cast<Sensitivities&>();
            const auto m = static_cast<py::ssize_t>(s.parameters.size());
            return view_of(self, s.state_derivatives.data(),
                           {m == 0 ? 0 : static_cast<py::ssize_t>(s.state_derivatives.size()) / m, m});
          })
      .def(py::pickle(
          [](const Sensitivities& s) {
            return py::make_tuple(s.outputs, s.output_units, s.parameters, s.parameter_units,
                                  array_of(s.values), array_of(s.derivatives), array_of(s.state_derivatives));
          },
          [](const py::tuple& t) {
            using Names = std::vector<std::string>;
            return Sensitivities{t[0].cast<Names>(), t[1].cast<Names>(), t[2].cast<Names>(),
                                 t[3].cast<Names>(), values_in(t[4]),    values_in(t[5]),
                                 values_in(t[6])};
          }));
}

void bind_batch_rows(py::module_& m) {
  py::class_<BatchRows>(m, "BatchRows",
                        "Outputs of many samples, with a reason in place of each that failed.")
      .def_readonly("names", &BatchRows::names)
      .def_readonly("units", &BatchRows::units)
      .def_readonly("reasons", &BatchRows::reasons)
      .def_readonly("notes", &BatchRows::notes)
      .def_property_readonly("values",
                             [](const py::object& self) {
                               const auto& b = self.cast<BatchRows&>();
                               return view_of(self, b.values.data(),
                                              {static_cast<py::ssize_t>(b.reasons.size()),
                                               static_cast<py::ssize_t>(b.names.size())});
                             })
      .def_property_readonly("states", [](const py::object& self) {
        const auto& b = self.cast<BatchRows&>();
        return view_of(self, b.states.data(),
                       {static_cast<py::ssize_t>(b.reasons.size()), static_cast<py::ssize_t>(b.n_states)});
      });
}

}  // namespace

void bind_common(py::module_& m) {
  py::register_exception<InputError>(m, "InputError", PyExc_ValueError).doc() =
      "Something impossible was asked for; refused before any work. Names the key, the value and the range.";
  py::register_exception<NumericalFailure>(m, "NumericalFailure", PyExc_RuntimeError).doc() =
      "A computation broke down; says what, where, and what to try.";
  py::register_exception<ResourceError>(m, "ResourceError", PyExc_OSError).doc() =
      "The machine refused: a file cannot be read or written.";
  py::register_exception<Interrupted>(m, "Interrupted", PyExc_KeyboardInterrupt);

  bind_parameter(m);
  bind_certificate(m);
  bind_columns(m);
  bind_sensitivities(m);
  bind_batch_rows(m);
}

}  // namespace wiggers::python
