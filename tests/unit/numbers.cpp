// The number vocabulary: safe functions, duals, SIMD lanes, quantities.
#include <catch2/catch.hpp>
#include <cmath>
#include <random>
#include <wiggers/cellmodels/models/crn.hpp>
#include <wiggers/cellmodels/models/rdq20.hpp>
#include <wiggers/cellmodels/models/ttp06.hpp>
#include <wiggers/core/dual.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/simd.hpp>
#include <wiggers/core/units.hpp>

using namespace wiggers;

namespace {
// What this file is compiled for; the kernels' own widths are tested in models/population.cpp.
using Batch = Vec<double, 4, isa::Baseline>;
constexpr int batch_lanes = Batch::lanes;
}  // namespace

TEST_CASE("x/(exp(x)-1) is exact at and around its removable singularity") {
  CHECK(x_over_expm1(0.0) == 1.0);
  for (double scale : {1e-300, 1e-12, 1e-9, 9.9e-6, 1.01e-5, 1e-3, 0.1, 1.0, 30.0, 600.0})
    for (double x : {scale, -scale}) {
      const long double exact = static_cast<long double>(x) / std::expm1(static_cast<long double>(x));
      CHECK(std::abs(x_over_expm1(x) - static_cast<double>(exact)) <=
            1e-14 * std::abs(static_cast<double>(exact)));
      CHECK(x_over_one_minus_exp(x) == x_over_expm1(-x));
      CHECK(std::abs(expm1_over_x(x) * x_over_expm1(x) - 1) < 1e-15);
    }
}

TEST_CASE("the logistic function saturates without overflow") {
  CHECK(logistic(0.0) == 0.5);
  CHECK(logistic(1e9) == 1.0);
  CHECK(logistic(-1e9) < 1e-300);
  CHECK(logistic(-1e9) >= 0);
}

TEST_CASE("dual numbers differentiate every function of the vocabulary") {
  const auto check = [](auto f, double x) {
    const Dual<1> d = f(Dual<1>::variable(x, 0));
    const double h = 1e-6 * std::max(1.0, std::abs(x));
    const double difference = (value_of(f(Dual<1>(x + h))) - value_of(f(Dual<1>(x - h)))) / (2 * h);
    CHECK(d.derivative[0] == Approx(difference).epsilon(1e-7).margin(1e-9));
  };
  using D = Dual<1>;
  for (double x : {0.3, 1.7, 4.0}) {
    check([](D v) { return exp(v) * log(v) / (1.0 + v); }, x);
    check([](D v) { return sqrt(v) - pow(v, 1.5) + cbrt(v); }, x);
    check([](D v) { return tanh(v) + atan(v) * cos(v) - abs(-v); }, x);
    check([](D v) { return x_over_expm1(v) + x_over_expm1(D(1e-6 * v)) + expm1_over_x(v); }, x);
    check([](D v) { return select(v > 1.0, square(v), cube(v)); }, x);
  }
}

namespace {
// Scalar, SIMD and dual evaluation of one model at random states agree, lane by lane.
template <class Model>
void compare_lanes() {
  std::mt19937 random(7);
  std::uniform_real_distribution<double> unit(0.02, 0.98);
  constexpr std::size_t n = Model::states.size();
  const auto parameters = defaults_of(Model::parameters);
  const auto constants = Model::constants(parameters.data());
  for (int trial = 0; trial < 50; ++trial) {
    std::array<std::array<double, n>, batch_lanes> states;
    std::array<Batch, n> lanes, lane_rates;
    for (std::size_t i = 0; i < n; ++i) {
      alignas(64) double values[batch_lanes];
      for (int lane = 0; lane < batch_lanes; ++lane) {
        const Quantity& q = Model::states[i];
        double value = unit(random);
        if (q.unit == "mV") value = -95 + 150 * value;
        if (q.unit == "mM") value = q.default_value * (0.5 + value);
        if (trial == 0 && q.unit == "mV") value = lane == 0 ? -47.13 : 15.0;  // removable singularities
        states[lane][i] = values[lane] = value;
      }
      lanes[i] = Batch::load(values);
    }
    std::array<double, Model::inputs.size()> in{};
    std::array<Batch, Model::inputs.size()> in_lanes;
    for (std::size_t i = 0; i < in.size(); ++i) {
      in[i] = Model::inputs[i].default_value;
      in_lanes[i] = Batch(in[i]);
    }
    rates_from<Model, Batch>(Model::template evaluate<Batch>(lanes.data(), in_lanes.data(), constants),
                             lanes.data(), lane_rates.data());
    for (int lane = 0; lane < batch_lanes; ++lane) {
      std::array<double, n> rates;
      rates_from<Model, double>(Model::template evaluate<double>(states[lane].data(), in.data(), constants),
                                states[lane].data(), rates.data());
      std::array<Dual<2>, n> y, dual_rates;
      std::array<Dual<2>, Model::inputs.size()> dual_in;
      for (std::size_t i = 0; i < n; ++i) y[i] = Dual<2>(states[lane][i]);
      for (std::size_t i = 0; i < in.size(); ++i) dual_in[i] = Dual<2>(in[i]);
      rates_from<Model, Dual<2>>(Model::template evaluate<Dual<2>>(y.data(), dual_in.data(), constants),
                                 y.data(), dual_rates.data());
      for (std::size_t i = 0; i < n; ++i) {
        INFO(Model::name << " state " << Model::states[i].name << " trial " << trial);
        alignas(64) double values[batch_lanes];
        lane_rates[i].store(values);
        CHECK(values[lane] == Approx(rates[i]).epsilon(1e-12).margin(1e-12));
        CHECK(dual_rates[i].value == Approx(rates[i]).epsilon(1e-12).margin(1e-12));
      }
    }
  }
}
}  // namespace

namespace {
template <class V>
void check_vector_functions(double exp_bar, double log_bar, double range) {
  using Real = typename V::Scalar;
  std::mt19937_64 random(3);
  std::uniform_real_distribution<double> argument(-range, range);
  double exp_error = 0, log_error = 0, divide_error = 0;
  for (int k = 0; k < 200000; ++k) {
    Real x[V::lanes], result[V::lanes];
    for (Real& entry : x) entry = static_cast<Real>(argument(random));
    exp(V::load(x)).store(result);
    for (int lane = 0; lane < V::lanes; ++lane) {
      const long double exact = std::exp(static_cast<long double>(x[lane]));
      exp_error = std::max(exp_error, static_cast<double>(std::abs((result[lane] - exact) / exact)));
      x[lane] = static_cast<Real>(exact);
    }
    log(V::load(x)).store(result);
    for (int lane = 0; lane < V::lanes; ++lane) {
      const long double exact = std::log(static_cast<long double>(x[lane]));
      if (exact != 0)
        log_error = std::max(log_error, static_cast<double>(std::abs((result[lane] - exact) / exact)));
    }
    (V(1.0) / V::load(x)).store(result);
    for (int lane = 0; lane < V::lanes; ++lane)
      divide_error = std::max(
          divide_error, static_cast<double>(std::abs(result[lane] * static_cast<long double>(x[lane]) - 1)));
  }
  CHECK(exp_error < exp_bar);
  CHECK(log_error < log_bar);
  CHECK(divide_error < exp_bar);
  const Real nan = log(V(-1.0))[0];
  CHECK(nan != nan);
  CHECK(log(V(1.0))[0] == 0);
  CHECK(exp(V(0.0))[0] == 1);
  CHECK(std::isfinite(exp(V(1e6))[0]));
  CHECK(exp(V(-1e6))[0] >= 0);
  CHECK(exp(V(-1e6))[0] < 1e-30);
  CHECK(pow(V(2.0), 1.5)[0] == Approx(std::pow(2.0, 1.5)).epsilon(4 * exp_bar));
  CHECK(sqrt(V(2.0))[0] == static_cast<Real>(std::sqrt(2.0)));
  CHECK(abs(V(-2.5))[0] == Real(2.5));
}
}  // namespace

TEST_CASE("vector functions keep their stated accuracy") {
  check_vector_functions<Vec<double, 2, isa::Baseline>>(2.5e-16, 3e-16, 700);
  check_vector_functions<Vec<double, 8, isa::Baseline>>(2.5e-16, 3e-16, 50);
  check_vector_functions<Vec<float, 4, isa::Baseline>>(1.5e-7, 1.5e-7, 80);
  check_vector_functions<Vec<float, 16, isa::Baseline>>(1.5e-7, 1.5e-7, 20);
}

TEST_CASE("transposing vectors turns rows into columns") {
  using V = Vec<float, 8, isa::Baseline>;
  V rows[8];
  for (int i = 0; i < 8; ++i) {
    float values[8];
    for (int j = 0; j < 8; ++j) values[j] = static_cast<float>(10 * i + j);
    rows[i] = V::load(values);
  }
  transpose(rows);
  for (int i = 0; i < 8; ++i)
    for (int j = 0; j < 8; ++j) CHECK(rows[i][j] == static_cast<float>(10 * j + i));
}

TEST_CASE("SIMD lanes, scalar and dual evaluation of the models agree") {
  compare_lanes<Crn>();
  compare_lanes<Ttp06<Ttp06Type::endo>>();
  compare_lanes<Ttp06<Ttp06Type::epi>>();
  compare_lanes<Rdq20>();
}

TEST_CASE("fact sheets with a gap do not compile - the checker sees each gap") {
  constexpr std::array good = {Quantity{"a", "1", 0, 0, 1, "m"}, Quantity{"b", "1", 0, 0, 1, "m"}};
  constexpr std::array same_name = {Quantity{"a", "1", 0, 0, 1, "m"}, Quantity{"a", "1", 0, 0, 1, "m"}};
  constexpr std::array no_unit = {Quantity{"a", "", 0, 0, 1, "m"}};
  constexpr std::array no_meaning = {Quantity{"a", "1", 0, 0, 1, ""}};
  constexpr std::array outside = {Quantity{"a", "1", 2, 0, 1, "m"}};
  STATIC_REQUIRE(well_formed(good));
  STATIC_REQUIRE_FALSE(well_formed(same_name));
  STATIC_REQUIRE_FALSE(well_formed(no_unit));
  STATIC_REQUIRE_FALSE(well_formed(no_meaning));
  STATIC_REQUIRE_FALSE(well_formed(outside));
}

TEST_CASE("units agree with their definitions") {
  // 1 mmHg: 1 mm of mercury of 13595.1 kg/m3 under 9.80665 m/s2.
  CHECK(units::Pa_per_mmHg == Approx(13.5951 * 9.80665).epsilon(1e-12));
  CHECK(units::J_per_mmHg_mL == Approx(1.33322387415e-4).epsilon(1e-15));
  CHECK(units::mmHg_per_kPa * units::kPa_per_mmHg == Approx(1).epsilon(1e-15));
  CHECK(units::L_per_min_from_mL_per_s * 1000 / 60 == Approx(1).epsilon(1e-15));
}

TEST_CASE("unknown names are refused with the nearest") {
  const std::vector<std::string> names = {"g_Na", "g_CaL", "activation_ms"};
  CHECK(nearest_name("g_na", names) == "g_Na");
  CHECK(nearest_name("g_cal", names) == "g_CaL");
  CHECK(nearest_name("activation", names) == "activation_ms");
  CHECK(nearest_name("completely_else", names).empty());
  CHECK_THROWS_WITH(refuse_unknown("parameter", "g_na", names), Catch::Contains("did you mean 'g_Na'?"));
  CHECK_THROWS_AS(check_range({"EB", "mmHg/mL", 1, 0.5, 2, "elastance"}, std::nan(""), "here"), InputError);
  CHECK_THROWS_WITH(check_range({"EB", "mmHg/mL", 1, 0.5, 2, "elastance"}, 3, "loop.toml"),
                    Catch::Contains("EB = 3") && Catch::Contains("0.5 to 2") && Catch::Contains("loop.toml"));
  CHECK(parse_number("2.35e-112", "x") == 2.35e-112);
  CHECK_THROWS_AS(parse_number("1.2.3", "x"), InputError);
  CHECK_THROWS_AS(parse_assignment("novalue", "--set"), InputError);
}
