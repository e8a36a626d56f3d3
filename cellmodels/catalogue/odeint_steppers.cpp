// Compiled as C++17, see the header.
#include <algorithm>
#include <boost/numeric/odeint/stepper/generation.hpp>
#include <boost/numeric/odeint/stepper/rosenbrock4.hpp>
#include <boost/numeric/odeint/stepper/rosenbrock4_controller.hpp>
#include <boost/numeric/odeint/stepper/rosenbrock4_dense_output.hpp>
#include <boost/numeric/odeint/stepper/runge_kutta_dopri5.hpp>
#include <vector>
#include <wiggers/cellmodels/catalogue/odeint_steppers.hpp>

namespace wiggers {

namespace {

namespace odeint = boost::numeric::odeint;
using Vector = boost::numeric::ublas::vector<double>;
using Matrix = boost::numeric::ublas::matrix<double>;

template <class Stepper, class State, class System>
std::string drive(const OdeintProblem& problem, Stepper& stepper, System& system, double span, State& state,
                  double& h, long& steps) {
  State inside(state);
  std::size_t next = 0;
  stepper.initialize(state, 0.0, std::min(h, span));
  while (stepper.current_time() < span) {
    std::pair<double, double> range;
    try {
      range = stepper.do_step(system);
    } catch (const odeint::odeint_error&) {
      return "the step fails repeatedly at " + std::to_string(stepper.current_time()) + " of " +
             std::to_string(span) + "; try a looser tolerance";
    }
    ++steps;
    for (; next < problem.n_samples && problem.samples[next] <= range.second; ++next) {
      stepper.calc_state(problem.samples[next], inside);
      problem.on_sample(next, &inside[0]);
    }
    if (range.second < span && !(stepper.current_time_step() > 1e-13 * span))
      return "the step fell to zero at " + std::to_string(range.second) + " of " + std::to_string(span) +
             "; try a looser tolerance";
  }
  h = stepper.current_time_step();
  // The last step looks beyond the span with its inputs; the state at the end is interpolated.
  stepper.calc_state(span, inside);
  state = inside;
  return {};
}

}  // namespace

std::string odeint_dopri5(const OdeintProblem& problem, double span, double* y, double& h, long& steps) {
  using State = std::vector<double>;
  auto stepper =
      odeint::make_dense_output(problem.absolute, problem.relative, odeint::runge_kutta_dopri5<State>());
  State state(y, y + problem.size);
  const auto system = [&](const State& x, State& dx, double) { problem.rates(x.data(), dx.data()); };
  std::string failure = drive(problem, stepper, system, span, state, h, steps);
  std::copy(state.begin(), state.end(), y);
  return failure;
}

std::string odeint_rosenbrock4(const OdeintProblem& problem, double span, double* y, double& h, long& steps) {
  using Controller = odeint::rosenbrock4_controller<odeint::rosenbrock4<double>>;
  odeint::rosenbrock4_dense_output<Controller> stepper{Controller(problem.absolute, problem.relative)};
  const std::size_t n = problem.size;
  Vector state(n);
  std::copy(y, y + n, state.begin());
  std::vector<double> columns(n * n);
  const auto rates = [&](const Vector& x, Vector& dx, double) { problem.rates(&x[0], &dx[0]); };
  const auto jacobian = [&](const Vector& x, Matrix& j, double, Vector& dfdt) {
    problem.jacobian(&x[0], columns.data());
    for (std::size_t row = 0; row < n; ++row)
      for (std::size_t column = 0; column < n; ++column) j(row, column) = columns[row + n * column];
    std::fill(dfdt.begin(), dfdt.end(), 0.0);
  };
  const auto system = std::make_pair(rates, jacobian);
  std::string failure = drive(problem, stepper, system, span, state, h, steps);
  std::copy(state.begin(), state.end(), y);
  return failure;
}

}  // namespace wiggers
