#include <fmt/format.h>

#include <array>
#include <wiggers/cellmodels/catalogue/catalogue.hpp>
#include <wiggers/cellmodels/catalogue/force_stepper.hpp>
#include <wiggers/cellmodels/models/facts.hpp>
#include <wiggers/core/cvode.hpp>

#include "common.hpp"

namespace wiggers::python {

namespace {

struct Muscle {
  const CellModel* model = nullptr;
  std::vector<double> parameters;
};

// Calcium, sarcomere length and its rate, each within its range and where the model holds.
std::array<double, 3> inputs_of(const Muscle& force, double calcium_uM, double SL_um,
                                double dSL_dt_um_per_s) {
  const std::array values{calcium_uM, SL_um, dSL_dt_um_per_s};
  constexpr std::array names{"calcium_uM", "SL_um", "dSL_dt_um_per_s"};
  for (std::size_t k = 0; k < values.size(); ++k) check_range(facts::force_inputs[k], values[k], names[k]);
  check_sarcomere_length(*force.model, force.parameters, SL_um);
  return values;
}

// What the model is: its numbers, states, rates.
void bind_numbers(py::class_<Muscle>& model) {
  model
      .def(py::init([](const std::string& set, const std::string& model) {
             Muscle force{&find_model(model), {}};
             if (force.model->is_ionic())
               throw InputError(fmt::format("model = {} is no force model", model));
             force.parameters =
                 force.model->parameter_values(set.empty() ? force.model->parameter_sets.front().name : set);
             return force;
           }),
           py::arg("set"), py::arg("model"))
      .def_property_readonly("name", [](const Muscle& force) { return std::string(force.model->name); })
      .def("copy", [](const Muscle& force) { return Muscle(force); })
      .def("parameters",
           [](const Muscle& force) {
             std::vector<NamedParameter> list;
             for (std::size_t k = 0; k < force.parameters.size(); ++k)
               list.push_back({std::string(force.model->parameters[k].name), force.model->parameters[k],
                               force.parameters[k]});
             return list;
           })
      .def(
          "set_parameters",
          [](Muscle& force, const Array& array) {
            const auto values = vector_of(array, force.parameters.size(), "values");
            for (std::size_t k = 0; k < values.size(); ++k)
              check_range(force.model->parameters[k], values[k], std::string(force.model->name));
            force.parameters = values;
          },
          py::arg("values"))
      .def(
          "set_parameter",
          [](Muscle& force, const std::string& name, double value) {
            const std::size_t k = require_index(force.model->parameters,
                                                fmt::format("parameter of {}", force.model->name), name);
            check_range(force.model->parameters[k], value, std::string(force.model->name));
            force.parameters[k] = value;
          },
          py::arg("name"), py::arg("value"))
      .def("state_names", [](const Muscle& force) { return names_of(force.model->states); })
      .def("initial_state", [](const Muscle& force) { return owned(force.model->default_state()); })
      .def(
          "rhs",
          [](const Muscle& force, const Array& y, double calcium_uM, double SL_um, double dSL_dt_um_per_s) {
            const auto state = vector_of(y, force.model->states.size(), "y");
            const auto inputs = inputs_of(force, calcium_uM, SL_um, dSL_dt_um_per_s);
            std::vector<double> rates(state.size());
            force.model->evaluate(state.data(), inputs.data(), force.parameters.data(), rates.data(),
                                  nullptr);
            return owned(std::move(rates));
          },
          py::arg("y"), py::arg("calcium_uM"), py::arg("SL_um"), py::arg("dSL_dt_um_per_s"))
      .def(
          "jacobian",
          [](const Muscle& force, const Array& y, double calcium_uM, double SL_um, double dSL_dt_um_per_s) {
            const auto state = vector_of(y, force.model->states.size(), "y");
            const auto inputs = inputs_of(force, calcium_uM, SL_um, dSL_dt_um_per_s);
            const std::size_t n = state.size();
            std::vector<double> columns(n * n), rows(n * n);
            force.model->jacobian(state.data(), inputs.data(), force.parameters.data(), columns.data());
            for (std::size_t i = 0; i < n; ++i)
              for (std::size_t j = 0; j < n; ++j) rows[i * n + j] = columns[i + n * j];
            return owned(std::move(rows), {static_cast<py::ssize_t>(n), static_cast<py::ssize_t>(n)});
          },
          py::arg("y"), py::arg("calcium_uM"), py::arg("SL_um"), py::arg("dSL_dt_um_per_s"));
}

// What it answers to calcium and length.
void bind_answers(py::class_<Muscle>& model) {
  model
      .def(
          "steady_state",
          [](const Muscle& force, double calcium_uM, double SL_um) {
            std::vector<double> state;
            {
              py::gil_scoped_release unlock;
              state = steady_force_state(*force.model, force.parameters, calcium_uM, SL_um);
            }
            return owned(std::move(state));
          },
          py::arg("calcium_uM"), py::arg("SL_um"))
      // Steady tensions (kPa), one a calcium, and their derivatives [calcium][parameter].
      .def(
          "steady_tension",
          [](const Muscle& force, const Array& calcium_uM, double SL_um) {
            const auto levels =
                vector_of(calcium_uM, static_cast<std::size_t>(calcium_uM.size()), "calcium_uM");
            const int m = static_cast<int>(force.parameters.size());
            std::vector<double> tension, derivatives(levels.size() * force.parameters.size());
            {
              py::gil_scoped_release unlock;
              for (std::size_t row = 0; row < levels.size(); ++row)
                for (int first = 0; first < m; first += tangent_lanes) {
                  std::vector<Tangent> parameters(force.parameters.begin(), force.parameters.end());
                  for (int k = 0; k < tangent_lanes && first + k < m; ++k)
                    parameters[static_cast<std::size_t>(first + k)].derivative[k] = 1;
                  const std::vector<Tangent> y =
                      steady_force_state(*force.model, parameters, levels[row], SL_um);
                  const Tangent T = make_force_stepper<Tangent>(*force.model, parameters)
                                        ->forces(y.data(), SL_um)
                                        .tension_kPa;
                  if (first == 0) tension.push_back(T.value);
                  for (int k = 0; k < tangent_lanes && first + k < m; ++k)
                    derivatives[row * force.parameters.size() + static_cast<std::size_t>(first + k)] =
                        T.derivative[k];
                }
            }
            const auto n = static_cast<py::ssize_t>(levels.size());
            return py::make_tuple(owned(std::move(tension)), owned(std::move(derivatives), {n, m}));
          },
          py::arg("calcium_uM"), py::arg("SL_um"))
      // Tension (kPa) along given samples of time (s), calcium (uM) and length (um).
      .def(
          "run",
          [](const Muscle& force, const Array& start, const Array& t_s, const Array& calcium_uM,
             const Array& SL_um) {
            std::vector<double> y = vector_of(start, force.model->states.size(), "start");
            const auto n = static_cast<std::size_t>(t_s.size());
            const auto t = vector_of(t_s, n, "t_s"), calcium = vector_of(calcium_uM, n, "calcium_uM"),
                       length = vector_of(SL_um, n, "SL_um");
            if (n < 2) throw InputError("t_s needs at least two samples");
            for (std::size_t k = 1; k < n; ++k)
              if (!(t[k] > t[k - 1]))
                throw InputError(fmt::format("t_s[{}] = {} does not increase", k, t[k]));
            for (std::size_t k = 0; k < n; ++k) {
              check_range(force.model->inputs[0], calcium[k], fmt::format("calcium_uM[{}]", k));
              check_range(force.model->inputs[1], length[k], fmt::format("SL_um[{}]", k));
              check_sarcomere_length(*force.model, force.parameters, length[k]);
            }
            std::vector<double> tension;
            {
              py::gil_scoped_release unlock;
              const auto stepper = make_force_stepper<double>(*force.model, force.parameters);
              const auto equations = force.model->equations(force.parameters);
              std::size_t row = 0;
              const auto share = [&](double time) { return (time - t[row]) / (t[row + 1] - t[row]); };
              const auto slope = [&](std::size_t k) {
                return (length[k + 1] - length[k]) / (t[k + 1] - t[k]);
              };
              OdeSystem system;
              system.size = y.size();
              const auto inputs = [&](double time, double* in) {
                const double s = share(time);
                in[0] = calcium[row] + s * (calcium[row + 1] - calcium[row]);
                in[1] = length[row] + s * (length[row + 1] - length[row]);
                in[2] = slope(row);
              };
              system.derivative = [&](double time, const double* state, double* rates) {
                double in[3];
                inputs(time, in);
                equations->evaluate(state, in, rates, nullptr);
              };
              system.jacobian = [&](double time, const double* state, double* jacobian) {
                double in[3];
                inputs(time, in);
                equations->jacobian(state, in, jacobian);
              };
              Cvode solver(system, {1e-7, std::vector<double>(y.size(), 1e-11)});
              tension.push_back(stepper->forces(y.data(), length[0]).tension_kPa);
              solver.restart(t[0], y);
              for (; row + 1 < n; ++row) {
                // Where the rate of length jumps, so do rates: what the solver knows of the past is no guide.
                if (row > 0 && slope(row) != slope(row - 1)) solver.restart(t[row], y);
                y = solver.advance(t[row + 1]);
                tension.push_back(stepper->forces(y.data(), length[row + 1]).tension_kPa);
                if ((row & 63) == 63) check_signals();
              }
            }
            return py::make_tuple(owned(std::move(tension)), owned(std::move(y)));
          },
          py::arg("start"), py::arg("t_s"), py::arg("calcium_uM"), py::arg("SL_um"));
}

}  // namespace

void bind_force(py::module_& m) {
  py::class_<Muscle> model(m, "ForceModel");
  bind_numbers(model);
  bind_answers(model);
}

}  // namespace wiggers::python
