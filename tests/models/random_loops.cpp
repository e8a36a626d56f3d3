// Random loops: what runge-kutta-4 calls good is what cvode finds; what it does not has a reason.
#include <catch2/catch.hpp>
#include <cmath>
#include <cstdlib>
#include <random>
#include <wiggers/core/errors.hpp>
#include <wiggers/heart/study/loop_study.hpp>

using namespace wiggers;

namespace {

// Every parameter 0.3 to 3 times its default, the blood volume kept; what no loop can be is drawn again.
Loop random_loop(std::mt19937& random) {
  std::uniform_real_distribution<double> log_factor(std::log(0.3), std::log(3));
  const char* sets[] = {"wiggers-healthy-0d", "baseline75"};
  while (true) {
    Loop loop = find_circulation_set(sets[random() % 2]).loop;
    loop.circulation.valve_law = ValveLaw(random() % n_valve_laws);
    std::vector<double> values;
    const auto parameters = loop_parameters(loop);
    for (const NamedParameter& p : parameters)
      values.push_back(p.value * (p.name == parameters.back().name ? 1 : std::exp(log_factor(random))));
    try {
      set_loop_parameters(loop, values);
      return loop;
    } catch (const InputError&) {
      // TC + TR longer than the period, or a value out of its range
    }
  }
}

std::vector<double> figures(const BeatIndexes& b) {
  std::vector<double> list = {b.aorta.pressure_mean_mmHg, b.pulmonary_artery.pressure_mean_mmHg};
  for (const auto& v : b.ventricle)
    list.insert(list.end(), {v.EDV_mL, v.ESV_mL, v.SV_mL, v.EF_percent, v.pressure_max_mmHg});
  for (const auto& a : b.atrium) list.insert(list.end(), {a.Vmax_mL, a.Vmin_mL, a.pressure_mean_mmHg});
  return list;
}

struct Answer {
  LimitCycleCertificate certificate;
  std::vector<double> figures;
};
Answer answer(const Loop& loop, const LoopIntegrator& integrator, double distance) {
  Answer a;
  try {
    const LoopSolver solver(loop, integrator);
    CirculationValues state = loop.initial;
    LimitCycleSettings settings = loop_cycle_settings(distance);
    settings.max_beats = 1000;
    a.certificate = solver.to_limit_cycle(state, settings);
    if (a.certificate.good()) a.figures = figures(loop_indexes(solver, state));
  } catch (const NumericalFailure& failure) {
    a.certificate.verdict = LimitCycleVerdict::not_converged;
    a.certificate.reason = failure.what();
  }
  return a;
}

}  // namespace

TEST_CASE("random loops: runge-kutta-4 and cvode agree within half a per cent, or there is a reason") {
  const char* wanted = std::getenv("WIGGERS_RANDOM_LOOPS");
  const int draws = wanted ? std::atoi(wanted) : 500;
  std::mt19937 random(20);
  int good = 0, unphysical = 0, other = 0;
  for (int draw = 0; draw < draws; ++draw) {
    const Loop loop = random_loop(random);
    const Answer rk = answer(loop, {"runge-kutta-4", 1e-9, 1e-9, 1e-3}, 1e-6);
    const Answer cvode = answer(loop, {"cvode", 1e-9, 1e-9, 1e-3}, 1e-6);
    INFO("draw " << draw << ", law " << valve_law_names[static_cast<int>(loop.circulation.valve_law)]
                 << ": runge-kutta-4 " << rk.certificate.text() << " " << rk.certificate.reason << "; cvode "
                 << cvode.certificate.text() << " " << cvode.certificate.reason);
    if (rk.certificate.good()) {
      ++good;
      REQUIRE(cvode.certificate.good());
      for (std::size_t k = 0; k < rk.figures.size(); ++k)
        CHECK(rk.figures[k] == Approx(cvode.figures[k]).epsilon(5e-3).margin(0.02));
    } else {
      CHECK(!rk.certificate.reason.empty());
      CHECK(!cvode.certificate.good());
      ++(rk.certificate.verdict == LimitCycleVerdict::unphysical ? unphysical : other);
    }
  }
  WARN(draws << " loops: " << good << " good, " << unphysical << " unphysical, " << other
             << " without a cycle");
  CHECK(good > 0.8 * draws);
}
