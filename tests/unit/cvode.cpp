// The CVODE wrapper: accuracy, restarts, and failures that say what happened.
#include <catch2/catch.hpp>
#include <cmath>
#include <wiggers/core/cvode.hpp>
#include <wiggers/core/errors.hpp>

using namespace wiggers;

TEST_CASE("CVODE follows a stiff oscillator and hits the end exactly") {
  OdeSystem system;
  system.size = 2;
  // y0' = -1000 (y0 - cos t) - sin t with solution cos t; y1' = y0.
  system.derivative = [](double t, const double* y, double* dy) {
    dy[0] = -1000 * (y[0] - std::cos(t)) - std::sin(t);
    dy[1] = y[0];
  };
  Cvode solver(system, {1e-10, {1e-12, 1e-12}});
  solver.restart(0, {1, 0});
  for (double t : {0.5, 1.0, 2.0, 10.0}) {
    const auto y = solver.advance(t);
    CHECK(y[0] == Approx(std::cos(t)).margin(1e-8));
    CHECK(y[1] == Approx(std::sin(t)).margin(1e-7));
  }
  CHECK(solver.counts().steps > 10);
}

TEST_CASE("more than 500 internal steps are no failure") {
  OdeSystem system;
  system.size = 2;
  system.derivative = [](double, const double* y, double* dy) {
    dy[0] = y[1];
    dy[1] = -y[0];
  };
  Cvode solver(system, {1e-10, {1e-12, 1e-12}});
  solver.restart(0, {1, 0});
  const auto y = solver.advance(200);
  CHECK(solver.counts().steps > 500);
  CHECK(y[0] == Approx(std::cos(200)).margin(1e-5));
}

TEST_CASE("a right-hand side that blows up or throws ends in words, not in numbers") {
  OdeSystem system;
  system.size = 1;
  system.derivative = [](double, const double* y, double* dy) { dy[0] = y[0] * y[0]; };  // blows up at t = 1
  Cvode solver(system, {1e-8, {1e-10}});
  solver.restart(0, {1});
  CHECK_THROWS_WITH(solver.advance(2), Catch::Contains("time integration failed at t = "));

  system.derivative = [](double t, const double*, double* dy) {
    if (t > 0.5) throw NumericalFailure("the cell left its range");
    dy[0] = 1;
  };
  Cvode thrower(system, {1e-8, {1e-10}});
  thrower.restart(0, {1});
  CHECK_THROWS_WITH(thrower.advance(2), "the cell left its range");
}
