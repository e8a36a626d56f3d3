// Active force in the tissue: the same tension as the one fibre of a reduced wall under the same calcium and
// stretch, its distribution between the ventricles, its limits.
#include <catch2/catch.hpp>
#include <cmath>
#include <wiggers/cellmodels/catalogue/force_stepper.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/units.hpp>
#include <wiggers/tissue/physics/activation.hpp>

#include "bodies.hpp"

using namespace wiggers;
using namespace wiggers::bodies;
using Catch::Contains;

namespace {

constexpr double dt_s = 1e-3;
const CalciumShape transient{0.05, 0.5, 20, 60};

std::vector<double> ventricles() { return find_model("rdq20").parameter_values("fedele2023-ventricles"); }

ForceRegion region(double right_share = 1) {
  return {{mesh_tags::ventricles},
          &find_model("rdq20"),
          ventricles(),
          transient.rest_uM,
          right_share,
          true,
          true};
}

// Lengthened, then shortened, with speeds of a beat.
double stretch_at(int step) { return 1 + 0.03 * std::sin(2 * M_PI * step / 150.0); }

}  // namespace

TEST_CASE("activation: tension is that of the reduced wall's fibre") {
  const auto mesh = shared(rough_box({4e-3, 4e-3, 4e-3}, {1, 1, 1}));
  const Partition partition(mesh, MPI_COMM_SELF);
  for (const CellModel* model : force_models())
    for (const RateScheme rate : {RateScheme::lagged, RateScheme::implicit, RateScheme::none}) {
      const bool is_rdq20 = model->name == "rdq20";
      const auto parameters =
          is_rdq20 ? ventricles() : model->parameter_values(model->parameter_sets.front().name);
      const CalciumShape transient{0.05, is_rdq20 ? 0.5 : 1.2, 20, 60};
      Activation activation(partition, nullptr,
                            {{{mesh_tags::ventricles}, model, parameters, transient.rest_uM, 1, true, true}},
                            rate, true);
      const auto n = static_cast<std::size_t>(activation.nodes().n_local);
      ActiveFibreSettings settings;
      settings.scheme = {RegulationScheme::midpoint, 1, rate};
      ActiveFibre fibre(settings, *model, parameters, transient.rest_uM,
                        std::make_unique<PrescribedCalcium>(transient, 800.0, 0.0), "fibre");
      fibre.start(stretch_at(0));
      double peak = 0, before = transient.at(0.0);
      for (int step = 0; step < 300; ++step) {
        const double t = step * dt_s, now = transient.at((t + dt_s) * units::ms_per_s);
        // The fibre's first middle is its calcium itself, as it knows none before.
        const double mean = step == 0 ? now : 0.5 * (before + now);
        before = now;
        const double start = stretch_at(step), last = stretch_at(std::max(0, step - 1)),
                     end = stretch_at(step + 1);
        activation.begin_step(dt_s, std::vector<double>(n, mean), std::vector<double>(n, start),
                              std::vector<double>(n, last), dt_s);
        fibre.begin_step(t, dt_s);
        const FibreLaw<double> law = fibre.law();
        peak = std::max(peak, law.tension_kPa);
        // Of a tension of tens of kPa.
        INFO(model->name << " step " << step << ", scheme " << rate_scheme_names[static_cast<int>(rate)]);
        for (std::size_t k = 0; k < n; ++k) {
          REQUIRE(activation.tension()[k] / units::Pa_per_kPa ==
                  Approx(law.tension_kPa).epsilon(1e-12).margin(3e-11));
          REQUIRE(activation.stiffness()[k] / units::Pa_per_kPa ==
                  Approx(law.stiffness_kPa).epsilon(1e-12).margin(3e-10));
        }
        activation.accept(std::vector<double>(n, end));
        fibre.accept_step(end);
      }
      CHECK(peak > 20);
    }
}

TEST_CASE("activation: the implicit rate agrees with the lagged one as the step shrinks") {
  const auto mesh = shared(rough_box({4e-3, 4e-3, 4e-3}, {1, 1, 1}));
  const Partition partition(mesh, MPI_COMM_SELF);
  const auto tension_with = [&](RateScheme rate, int n_steps) {
    Activation activation(partition, nullptr, {region()}, rate, true);
    const auto n = static_cast<std::size_t>(activation.nodes().n_local);
    const double dt = 0.1 / n_steps;
    const auto stretch = [&](double t) { return std::vector<double>(n, 1 - 0.5 * t); };
    for (int step = 0; step < n_steps; ++step) {
      const double t = step * dt;
      activation.begin_step(dt, std::vector<double>(n, transient.at((t + 0.5 * dt) * 1e3)), stretch(t),
                            stretch(std::max(0.0, t - dt)), dt);
      activation.accept(stretch(t + dt));
    }
    return activation.accepted_tension()[0] / units::Pa_per_kPa;
  };
  const double exact = tension_with(RateScheme::implicit, 6400);
  const auto error = [&](int n_steps) {
    return std::abs(tension_with(RateScheme::implicit, n_steps) - exact);
  };
  CHECK(exact > 1);
  CHECK(tension_with(RateScheme::lagged, 6400) == Approx(exact).epsilon(5e-3));
  CHECK(error(100) < 1e-3 * exact);
  CHECK(error(800) < 0.6 * error(400));
}

TEST_CASE("activation: strength goes over from the left to the right ventricle") {
  const auto mesh = shared(rough_box({4e-3, 4e-3, 4e-3}, {1, 1, 1}));
  const Partition partition(mesh, MPI_COMM_SELF);
  FibreField fibres = twisted_fibres(*mesh, 0);
  fibres.interventricular.assign(mesh->points.size(), 0.0);
  for (std::size_t k = 0; k < mesh->points.size(); ++k)
    fibres.interventricular[k] = static_cast<double>(k) / static_cast<double>(mesh->points.size() - 1);
  Activation activation(partition, &fibres, {region(0.7)}, RateScheme::lagged, true);
  Activation uniform_one(partition, nullptr, {region(0.7)}, RateScheme::lagged, true);
  const auto n = static_cast<std::size_t>(activation.nodes().n_local);
  for (Activation* one : {&activation, &uniform_one})
    for (int step = 0; step < 60; ++step) {
      one->begin_step(dt_s, std::vector<double>(n, 0.6), std::vector<double>(n, 1.0),
                      std::vector<double>(n, 1.0), dt_s);
      one->accept(std::vector<double>(n, 1.0));
    }
  const double whole = uniform_one.tension()[0];
  CHECK(whole > 1e3);
  for (std::size_t k = 0; k < n; ++k) {
    const double xi = fibres.interventricular[activation.nodes().vertex[k]];
    CHECK(activation.tension()[k] == Approx(whole * (xi + 0.7 * (1 - xi))).epsilon(1e-12));
  }
}

TEST_CASE("activation: the tension of rest is there from the start or never") {
  const auto mesh = shared(rough_box({4e-3, 4e-3, 4e-3}, {1, 1, 1}));
  const Partition partition(mesh, MPI_COMM_SELF);
  for (const bool subtracted : {true, false}) {
    ForceRegion at_rest = region();
    at_rest.subtract_rest_tension = subtracted;
    at_rest.rest_calcium_uM = 0.2;
    Activation activation(partition, nullptr, {at_rest}, RateScheme::lagged, true);
    const auto n = static_cast<std::size_t>(activation.nodes().n_local);
    const double before = activation.tension()[0];
    for (int step = 0; step < 100; ++step) {
      activation.begin_step(dt_s, std::vector<double>(n, 0.2), std::vector<double>(n, 1.0),
                            std::vector<double>(n, 1.0), dt_s);
      activation.accept(std::vector<double>(n, 1.0));
    }
    if (subtracted) {
      CHECK(before == 0);
      CHECK(activation.tension()[0] < 1);
    } else {
      CHECK(before > 100);
      CHECK(activation.tension()[0] == Approx(before).epsilon(1e-3));
    }
  }
}

TEST_CASE("activation: a saved state goes on the same and lengths beyond muscle are refused") {
  const auto mesh = shared(rough_box({4e-3, 4e-3, 4e-3}, {1, 1, 1}));
  const Partition partition(mesh, MPI_COMM_SELF);
  Activation activation(partition, nullptr, {region()}, RateScheme::implicit, true);
  const auto n = static_cast<std::size_t>(activation.nodes().n_local);
  const std::vector<double> calcium(n, 0.6), ones(n, 1.0);
  const auto step = [&](Activation& one) {
    one.begin_step(dt_s, calcium, ones, ones, dt_s);
    one.accept(ones);
  };
  for (int k = 0; k < 20; ++k) step(activation);
  std::vector<double> saved;
  activation.save(saved);
  Activation other(partition, nullptr, {region()}, RateScheme::implicit, true);
  std::span<const double> in = saved;
  other.restore(in);
  CHECK(in.empty());
  step(activation);
  step(other);
  CHECK(activation.tension() == other.tension());

  activation.begin_step(dt_s, calcium, ones, ones, dt_s);
  CHECK_NOTHROW(activation.require_in_range(ones));
  CHECK_THROWS_WITH(activation.require_in_range(std::vector<double>(n, 2.5)),
                    Contains("sarcomere length") && Contains("volume tag 1") && Contains("mm"));
  CHECK_THROWS_WITH(activation.require_in_range(std::vector<double>(n, 0.8)),
                    Contains("change their length"));
}
