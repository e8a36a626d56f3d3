// What every force model of the list must do, without a line about it; and Land et al. 2017 against a second
// writing of it (tests/data/make_land2017.py).
#include <fmt/format.h>

#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <wiggers/cellmodels/catalogue/force_stepper.hpp>
#include <wiggers/cellmodels/models/force_models.hpp>
#include <wiggers/core/cvode.hpp>
#include <wiggers/core/errors.hpp>

#include "figures.hpp"

using namespace wiggers;

namespace {

// A twitch of 0.4 s with shortening by 8 %, at a rate that has no kinks within.
struct Twitch {
  double SL0;
  double calcium(double t) const { return 0.12 + 1.5 * (std::exp(-t / 0.1) - std::exp(-t / 0.03)); }
  double stretch(double t) const { return 1.04 - 0.04 * (1 - std::cos(2 * M_PI * t / 0.4)); }
  double stretch_rate(double t) const { return -0.04 * 2 * M_PI / 0.4 * std::sin(2 * M_PI * t / 0.4); }
};

std::vector<double> exact_tension(const CellModel& model, const std::vector<double>& parameters,
                                  const Twitch& twitch, const std::vector<double>& start, double every) {
  OdeSystem system;
  system.size = model.states.size();
  system.derivative = [&](double t, const double* y, double* dy) {
    const double in[3] = {twitch.calcium(t), twitch.SL0 * twitch.stretch(t),
                          twitch.SL0 * twitch.stretch_rate(t)};
    model.evaluate(y, in, parameters.data(), dy, nullptr);
  };
  Cvode solver(system, {1e-10, std::vector<double>(system.size, 1e-13)});
  solver.restart(0, start);
  const auto stepper = make_force_stepper<double>(model, parameters);
  std::vector<double> tension;
  for (double t = every; t < 0.4 + 1e-9; t += every)
    tension.push_back(stepper->forces(solver.advance(t).data(), twitch.SL0 * twitch.stretch(t)).tension_kPa);
  return tension;
}

// The same by the scheme of walls, the stretch being given.
std::vector<double> stepped_tension(const CellModel& model, const std::vector<double>& parameters,
                                    const Twitch& twitch, std::vector<double> y, double every,
                                    const ForceScheme& scheme, double dt) {
  const auto stepper = make_force_stepper<double>(model, parameters);
  const auto per_sample = std::lround(every / dt);
  std::vector<double> tension;
  for (long k = 0; k < std::lround(0.4 / dt); ++k) {
    const double t = static_cast<double>(k) * dt, now = twitch.stretch(t), end = twitch.stretch(t + dt);
    const double before = twitch.stretch(std::max(0.0, t - dt));
    ForcesOf<double> forces;
    REQUIRE(stepper->begin(scheme, dt, y.data(), twitch.calcium(t + 0.5 * dt), twitch.SL0 * now,
                           -(now - before) / dt, forces));
    if (scheme.rate == RateScheme::implicit) REQUIRE(stepper->finish(dt, y.data(), -(end - now) / dt));
    if ((k + 1) % per_sample == 0) tension.push_back(forces.tension_kPa + forces.stiffness_kPa * (end - now));
  }
  return tension;
}

double largest_difference(const std::vector<double>& a, const std::vector<double>& b) {
  double most = 0, peak = 0;
  REQUIRE(a.size() == b.size());
  for (std::size_t k = 0; k < a.size(); ++k) {
    most = std::max(most, std::abs(a[k] - b[k]));
    peak = std::max(peak, std::abs(b[k]));
  }
  return most / peak;
}

const char* const land_sets[] = {"intact", "skinned", "margara2021"};

}  // namespace

TEST_CASE("every force model: the step of walls converges to the equations") {
  int n_models = 0;
  for (const CellModel* model : force_models()) {
    ++n_models;
    const auto parameters = model->parameter_values(model->parameter_sets.front().name);
    const auto stepper = make_force_stepper<double>(*model, parameters);
    const Twitch twitch{stepper->reference_length_um()};
    const auto start =
        steady_force_state(*model, parameters, twitch.calcium(0), twitch.SL0 * twitch.stretch(0));
    const auto exact = exact_tension(*model, parameters, twitch, start, 0.01);
    REQUIRE(*std::max_element(exact.begin(), exact.end()) > 10);
    for (const RegulationScheme regulation : {RegulationScheme::midpoint, RegulationScheme::forward_euler})
      for (const RateScheme rate : {RateScheme::lagged, RateScheme::implicit}) {
        const auto error = [&](double dt) {
          const ForceScheme scheme = {regulation, std::max(1, static_cast<int>(std::lround(dt / 2.5e-5))),
                                      rate};
          return largest_difference(stepped_tension(*model, parameters, twitch, start, 0.01, scheme, dt),
                                    exact);
        };
        const double coarse = error(1e-3), fine = error(2.5e-4);
        INFO(model->name << " " << regulation_scheme_names[static_cast<int>(regulation)] << " "
                         << rate_scheme_names[static_cast<int>(rate)] << ": " << coarse << ", " << fine);
        CHECK(coarse < 0.05);
        CHECK(fine < 0.4 * coarse);
      }
  }
  CHECK(n_models >= 2);
}

TEST_CASE("every force model: implicit stiffness is what sliding in the step changes") {
  for (const CellModel* model : force_models()) {
    const auto parameters = model->parameter_values(model->parameter_sets.front().name);
    const auto stepper = make_force_stepper<double>(*model, parameters);
    const double SL0 = stepper->reference_length_um(), h = 1e-3;
    const auto start = steady_force_state(*model, parameters, 0.7, SL0);
    const ForceScheme scheme = {RegulationScheme::midpoint, 1, RateScheme::implicit};
    std::vector<double> y = start;
    ForcesOf<double> forces;
    REQUIRE(stepper->begin(scheme, h, y.data(), 0.8, SL0, 0, forces));
    CHECK(forces.tension_kPa == Approx(stepper->forces(y.data(), SL0).tension_kPa));
    // Both ways, so that the detachment by |v| drops out; that by strong bridges pulled one way alone (Land
    // 2017) is a thousandth.
    double changes[2];
    for (int side = 0; side < 2; ++side) {
      std::vector<double> moved = y;
      REQUIRE(stepper->finish(h, moved.data(), side == 0 ? 1e-5 : -1e-5));
      changes[side] = stepper->forces(moved.data(), SL0).tension_kPa - forces.tension_kPa;
    }
    INFO(model->name);
    CHECK(0.5 * (changes[0] - changes[1]) == Approx(-1e-5 * h * forces.stiffness_kPa).epsilon(2e-3));
    CHECK(forces.stiffness_kPa > forces.tension_kPa);
  }
}

TEST_CASE("every force model: derivatives of a step and of the steady state are those of differences") {
  for (const CellModel* model : force_models()) {
    const auto parameters = model->parameter_values(model->parameter_sets.front().name);
    const double length = make_force_stepper<double>(*model, parameters)->reference_length_um() * 1.02;
    for (const RegulationScheme regulation : {RegulationScheme::midpoint, RegulationScheme::forward_euler})
      for (const RateScheme rate : {RateScheme::lagged, RateScheme::implicit, RateScheme::none}) {
        const ForceScheme scheme = {regulation, 40, rate};
        // Tension a step after the steady state, by every parameter.
        const auto tension = [&]<class T>(const std::vector<T>& p) {
          const auto stepper = make_force_stepper<T>(*model, p);
          std::vector<T> y = steady_force_state(*model, p, T(0.5), T(length));
          ForcesOf<T> forces;
          REQUIRE(stepper->begin(scheme, T(1e-3), y.data(), T(0.7), T(length), T(0.3), forces));
          return T(forces.tension_kPa + 0.01 * forces.stiffness_kPa);
        };
        for (std::size_t k = 0; k < parameters.size(); ++k) {
          std::vector<Tangent> seeded(parameters.begin(), parameters.end());
          seeded[k].derivative[3] = 1;
          const double step = 1e-4 * std::max(1e-3, std::abs(parameters[k]));
          std::vector<double> up = parameters, down = parameters;
          up[k] += step;
          down[k] -= step;
          const double difference = (tension(up) - tension(down)) / (2 * step),
                       scale = std::abs(tension(parameters));
          INFO(model->name << " " << model->parameters[k].name << " "
                           << regulation_scheme_names[static_cast<int>(regulation)] << " "
                           << rate_scheme_names[static_cast<int>(rate)]);
          CHECK(tension(seeded).derivative[3] ==
                Approx(difference)
                    .epsilon(2e-4)
                    .margin(2e-6 * scale / std::max(1e-3, std::abs(parameters[k]))));
        }
      }
  }
}

TEST_CASE("Land 2017: troponin that is bound at once has a steady state") {
  const CellModel& model = find_model("land2017");
  auto parameters = model.parameter_values("intact");
  parameters[Land2017::n_TRPN] = 6;
  const auto y = steady_force_state(model, parameters, 1000, 1.9);
  CHECK(y[Land2017::CaTRPN] == Approx(1).epsilon(1e-12));
  // The same as for twice as cooperative a troponin as the paper's, and a tenth of this calcium.
  parameters[Land2017::n_TRPN] = 4;
  const auto less = steady_force_state(model, parameters, 100, 1.9);
  CHECK(y[Land2017::S] == Approx(less[Land2017::S]).epsilon(1e-6));
}

TEST_CASE("Land 2017: rates and tension of a second writing") {
  const CellModel& model = find_model("land2017");
  const Table table = data_table("cell/land2017_rhs.csv");
  REQUIRE(table.n_rows() == 36);
  for (std::size_t row = 0; row < table.n_rows(); ++row) {
    const auto parameters = model.parameter_values(land_sets[static_cast<int>(table.at("set").values[row])]);
    std::vector<double> y, in, rates(model.states.size()), out(model.observables.size());
    for (const Quantity& q : model.states) y.push_back(table.at(q.name).values[row]);
    for (const Quantity& q : model.inputs) in.push_back(table.at(q.name).values[row]);
    model.evaluate(y.data(), in.data(), parameters.data(), rates.data(), out.data());
    for (std::size_t i = 0; i < y.size(); ++i) {
      INFO("row " << row << " " << model.states[i].name);
      CHECK(rates[i] ==
            Approx(table.at(fmt::format("d{}/dt", model.states[i].name)).values[row]).epsilon(1e-10));
    }
    CHECK(out[static_cast<std::size_t>(model.observable(Role::tension))] ==
          Approx(table.at("Ta").values[row]).epsilon(1e-12));
  }
}

TEST_CASE("Land 2017: steady tension is the closed form of the paper's equations") {
  const CellModel& model = find_model("land2017");
  const Table table = data_table("cell/land2017_force_calcium.csv");
  REQUIRE(table.n_rows() == 144);
  for (std::size_t row = 0; row < table.n_rows(); row += 5) {
    const auto parameters = model.parameter_values(land_sets[static_cast<int>(table.at("set").values[row])]);
    const double length = table.at("SL").values[row];
    const auto y = steady_force_state(model, parameters, table.at("Ca").values[row], length);
    INFO("row " << row);
    CHECK(make_force_stepper<double>(model, parameters)->forces(y.data(), length).tension_kPa ==
          Approx(table.at("Ta").values[row]).epsilon(1e-6).margin(1e-9));
  }
  // Half of the tension where 35 % of the troponin is bound, all of it far above: 120 kPa at SL0.
  const auto parameters = model.parameter_values("intact");
  const auto at = [&](double calcium) {
    return make_force_stepper<double>(model, parameters)
        ->forces(steady_force_state(model, parameters, calcium, 1.9).data(), 1.9)
        .tension_kPa;
  };
  CHECK(at(0.805 * std::sqrt(0.35 / 0.65)) == Approx(60).epsilon(1e-6));
  CHECK(at(900) == Approx(120 / (1 + std::pow(0.35, 5))).epsilon(1e-4));
}

TEST_CASE("Land 2017: a twitch with shortening") {
  const CellModel& model = find_model("land2017");
  const Table table = data_table("cell/land2017_twitch.csv");
  const auto calcium = [](double t) {
    if (t < 0.02) return 0.1;
    const double at_peak = std::log(90.0 / 20) * 0.09 * 0.02 / 0.07;
    const auto shape = [](double s) { return std::exp(-s / 0.09) - std::exp(-s / 0.02); };
    return 0.1 + 0.7 * shape(t - 0.02) / shape(at_peak);
  };
  const auto stretch = [](double t) {
    return t <= 0.1 ? 1.1 : t < 0.25 ? 1.1 - 0.1 * (t - 0.1) / 0.15 : 1.0;
  };
  for (int set = 0; set < 3; ++set) {
    const auto parameters = model.parameter_values(land_sets[set]);
    const auto stepper = make_force_stepper<double>(model, parameters);
    double rate = 0, worst = 0, peak = 0;
    OdeSystem system;
    system.size = model.states.size();
    system.derivative = [&](double t, const double* y, double* dy) {
      const double in[3] = {calcium(t), 1.9 * stretch(t), 1.9 * rate};
      model.evaluate(y, in, parameters.data(), dy, nullptr);
    };
    Cvode solver(system, {1e-10, std::vector<double>(system.size, 1e-13)});
    std::vector<double> y = steady_force_state(model, parameters, 0.1, 1.9 * 1.1);
    int n = 0;
    for (const auto& [begin, end] : {std::pair{0.0, 0.02}, {0.02, 0.1}, {0.1, 0.25}, {0.25, 0.6}}) {
      rate = begin == 0.1 ? -0.1 / 0.15 : 0;
      solver.restart(begin, y);
      for (std::size_t row = 0; row < table.n_rows(); ++row) {
        const double t = table.at("t").values[row];
        if (table.at("set").values[row] != set || t < begin + 1e-9 || t > end + 1e-9) continue;
        y = solver.advance(std::min(t, end), end);
        const double T = stepper->forces(y.data(), 1.9 * stretch(t)).tension_kPa;
        worst = std::max(worst, std::abs(T - table.at("Ta").values[row]));
        peak = std::max(peak, T);
        ++n;
      }
    }
    INFO(land_sets[set] << ": " << worst << " of " << peak);
    CHECK(n == 60);
    CHECK(worst < 1e-5 * peak);
  }
}
