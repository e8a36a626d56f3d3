#include <fmt/format.h>

#include <array>
#include <wiggers/cellmodels/catalogue/catalogue.hpp>
#include <wiggers/cellmodels/catalogue/rdq20_stepper.hpp>
#include <wiggers/core/cvode.hpp>

#include "common.hpp"

namespace wiggers::python {

namespace {

struct ForceModel {
  const CellModel* model = &find_model("rdq20");
  std::vector<double> parameters;
};

// Calcium, sarcomere length and its rate, each within its range.
std::array<double, 3> inputs_of(double calcium_uM, double SL_um, double dSL_dt_um_per_s) {
  const std::array values{calcium_uM, SL_um, dSL_dt_um_per_s};
  constexpr std::array names{"calcium_uM", "SL_um", "dSL_dt_um_per_s"};
  for (std::size_t k = 0; k < values.size(); ++k) check_range(Rdq20::inputs[k], values[k], names[k]);
  return values;
}

}  // namespace

void bind_force(py::module_& m) {
  py::class_<ForceModel>(m, "ForceModel")
      .def(py::init([](const std::string& set) {
             ForceModel force;
             force.parameters = force.model->parameter_values(set);
             return force;
           }),
           py::arg("set"))
      .def("copy", [](const ForceModel& force) { return ForceModel(force); })
      .def("parameters",
           [](const ForceModel& force) {
             std::vector<NamedParameter> list;
             for (std::size_t k = 0; k < force.parameters.size(); ++k)
               list.push_back({std::string(force.model->parameters[k].name), force.model->parameters[k],
                               force.parameters[k]});
             return list;
           })
      .def(
          "set_parameters",
          [](ForceModel& force, const Array& array) {
            const auto values = vector_of(array, force.parameters.size(), "values");
            for (std::size_t k = 0; k < values.size(); ++k)
              check_range(force.model->parameters[k], values[k], "rdq20");
            force.parameters = values;
          },
          py::arg("values"))
      .def(
          "set_parameter",
          [](ForceModel& force, const std::string& name, double value) {
            const std::size_t k = require_index(force.model->parameters, "parameter of rdq20", name);
            check_range(force.model->parameters[k], value, "rdq20");
            force.parameters[k] = value;
          },
          py::arg("name"), py::arg("value"))
      .def("state_names", [](const ForceModel& force) { return names_of(force.model->states); })
      .def("initial_state", [](const ForceModel& force) { return owned(force.model->default_state()); })
      .def(
          "rhs",
          [](const ForceModel& force, const Array& y, double calcium_uM, double SL_um,
             double dSL_dt_um_per_s) {
            const auto state = vector_of(y, force.model->states.size(), "y");
            const auto inputs = inputs_of(calcium_uM, SL_um, dSL_dt_um_per_s);
            std::vector<double> rates(state.size());
            force.model->evaluate(state.data(), inputs.data(), force.parameters.data(), rates.data(),
                                  nullptr);
            return owned(std::move(rates));
          },
          py::arg("y"), py::arg("calcium_uM"), py::arg("SL_um"), py::arg("dSL_dt_um_per_s"))
      .def(
          "jacobian",
          [](const ForceModel& force, const Array& y, double calcium_uM, double SL_um,
             double dSL_dt_um_per_s) {
            const auto state = vector_of(y, force.model->states.size(), "y");
            const auto inputs = inputs_of(calcium_uM, SL_um, dSL_dt_um_per_s);
            const std::size_t n = state.size();
            std::vector<double> columns(n * n), rows(n * n);
            force.model->jacobian(state.data(), inputs.data(), force.parameters.data(), columns.data());
            for (std::size_t i = 0; i < n; ++i)
              for (std::size_t j = 0; j < n; ++j) rows[i * n + j] = columns[i + n * j];
            return owned(std::move(rows), {static_cast<py::ssize_t>(n), static_cast<py::ssize_t>(n)});
          },
          py::arg("y"), py::arg("calcium_uM"), py::arg("SL_um"), py::arg("dSL_dt_um_per_s"))
      .def(
          "steady_state",
          [](const ForceModel& force, double calcium_uM, double SL_um) {
            std::vector<double> state;
            {
              py::gil_scoped_release unlock;
              state = rdq20_steady_state(force.parameters, calcium_uM, SL_um);
            }
            return owned(std::move(state));
          },
          py::arg("calcium_uM"), py::arg("SL_um"))
      // Steady tensions (kPa), one a calcium, and their derivatives [calcium][parameter].
      .def(
          "steady_tension",
          [](const ForceModel& force, const Array& calcium_uM, double SL_um) {
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
                  const std::vector<Tangent> y = rdq20_steady_state(parameters, levels[row], SL_um);
                  const Tangent T = Rdq20StepperOf<Tangent>(parameters).tension_kPa(y.data(), SL_um);
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
          [](const ForceModel& force, const Array& start, const Array& t_s, const Array& calcium_uM,
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
              check_range(Rdq20::inputs[Rdq20::Ca], calcium[k], fmt::format("calcium_uM[{}]", k));
              check_range(Rdq20::inputs[Rdq20::SL], length[k], fmt::format("SL_um[{}]", k));
            }
            std::vector<double> tension;
            {
              py::gil_scoped_release unlock;
              const Rdq20Stepper stepper(force.parameters);
              const auto equations = force.model->equations(force.parameters);
              std::size_t row = 0;
              const auto share = [&](double time) { return (time - t[row]) / (t[row + 1] - t[row]); };
              OdeSystem system;
              system.size = y.size();
              const auto inputs = [&](double time, double* in) {
                const double s = share(time);
                in[0] = calcium[row] + s * (calcium[row + 1] - calcium[row]);
                in[1] = length[row] + s * (length[row + 1] - length[row]);
                in[2] = (length[row + 1] - length[row]) / (t[row + 1] - t[row]);
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
              tension.push_back(stepper.tension_kPa(y.data(), length[0]));
              solver.restart(t[0], y);
              for (; row + 1 < n; ++row) {
                y = solver.advance(t[row + 1]);
                tension.push_back(stepper.tension_kPa(y.data(), length[row + 1]));
                if ((row & 63) == 63) check_signals();
              }
            }
            return py::make_tuple(owned(std::move(tension)), owned(std::move(y)));
          },
          py::arg("start"), py::arg("t_s"), py::arg("calcium_uM"), py::arg("SL_um"));
}

}  // namespace wiggers::python
