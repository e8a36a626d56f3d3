// What the parts of the Python module share: arrays without copies, progress, parameters, errors.
#pragma once

#include <pybind11/functional.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <functional>
#include <memory>
#include <string>
#include <vector>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/limit_cycle.hpp>
#include <wiggers/core/quantity.hpp>
#include <wiggers/core/sensitivity.hpp>
#include <wiggers/core/table.hpp>

namespace wiggers::python {

namespace py = pybind11;
using Array = py::array_t<double, py::array::c_style | py::array::forcecast>;
using ProgressCall = std::function<void(int, double)>;  // beats done, distance

// A NumPy array that owns a vector's memory: moved, not copied.
py::array_t<double> owned(std::vector<double> values, std::vector<py::ssize_t> shape = {});
// A read-only view of memory that `owner` holds.
py::array_t<double> view_of(const py::object& owner, const double* values, std::vector<py::ssize_t> shape);
// Reads an argument; refuses a wrong number of values and what is not finite, naming `what`.
std::vector<double> vector_of(const Array& array, std::size_t size, const std::string& what);

// Goes on with the rows of one more beat: its first row stands in place of the last so far, its first column
// is moved on to `begin`.
void append_beat(Table& table, const Table& beat, double begin);

// Calls Python's signal handlers, so that Ctrl-C ends a long call: the interpreter's lock is taken for it.
void check_signals();
// After every beat: signals, then the caller's progress function if there is one.
LimitCycleCertificate beats_done(int beats);  // what after_beat is told of beats that are no search
std::function<void(const LimitCycleCertificate&)> after_beat(const ProgressCall& progress);
std::function<void(double)> after_pass(const std::function<void(double)>& progress);

LimitCycleSettings cycle_settings(double distance, int max_beats, const std::string& method,
                                  const LimitCycleSettings& base = {});

// The points of a batch: rows of values for the named parameters of a model; its others keep theirs. Refuses
// unknown names.
class Samples {
 public:
  Samples(const std::vector<NamedParameter>& all, const std::string& kind,
          const std::vector<std::string>& names, const Array& rows);
  std::size_t count() const { return count_; }
  std::vector<double> operator()(std::size_t sample) const;  // of all parameters

 private:
  std::vector<double> base_;
  std::vector<std::size_t> position_;  // of each named parameter
  const double* rows_;                 // of an array that the caller holds
  std::size_t count_;
};

// One sample of a batch: what became of it.
struct BatchRows {
  std::vector<std::string> names, units;  // of the outputs
  std::vector<double> values;             // [sample][output], NaN where a sample has no such output
  std::vector<std::string> reasons;       // empty: good; else why this sample has no result
  std::vector<std::string> notes;  // of good samples: why outputs are missing, warnings; empty: nothing
  std::vector<double> states;      // [sample][state] on the cycles, NaN where there is none
  std::size_t n_states = 0;
};
// Writes values and state of one sample and returns the note on it.
using BatchWrite = std::function<std::string(double*, double*)>;
// Fills the row of one sample, unless it has a reason to have none.
using BatchFill = std::function<void(std::size_t, const std::string& reason, const BatchWrite& write)>;
// Warnings in one line.
std::string joined(const std::vector<std::string>& warnings);
// Solves n samples in threads; solve(k, values, state) fills one row and returns its note. What it throws is
// the sample's reason.
// together(samples, fill), if given, may solve up to `group` samples at once; where it returns false or
// throws, they are solved one by one.
BatchRows run_batch(
    std::size_t n, int threads, std::vector<std::string> names, std::vector<std::string> units,
    std::size_t n_states, const std::function<std::string(std::size_t, double*, double*)>& solve,
    const std::function<void(double)>& progress, std::size_t group = 1,
    const std::function<bool(const std::vector<std::size_t>&, const BatchFill&)>& together = {});

void bind_common(py::module_& m);
void bind_cell(py::module_& m);
void bind_force(py::module_& m);
void bind_loop(py::module_& m);
void bind_heart(py::module_& m);

}  // namespace wiggers::python
