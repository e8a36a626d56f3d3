// The limit-cycle search on maps whose answer is known.
#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/limit_cycle_solve.hpp>
#include <wiggers/core/saved_numbers.hpp>

using namespace wiggers;

namespace {
// A map with multipliers 0.99, 0.6, -0.3, slightly nonlinear, fixed point (1, 2, 3).
std::vector<double> slow_map(const std::vector<double>& x) {
  const double a = x[0] - 1, b = x[1] - 2, c = x[2] - 3;
  return {1 + 0.99 * a + 0.1 * b + 1e-3 * a * a, 2 + 0.6 * b + 0.02 * a * c, 3 - 0.3 * c + 0.05 * b};
}
double error_of(const std::vector<double>& x) {
  return std::max({std::abs(x[0] - 1), std::abs(x[1] - 2), std::abs(x[2] - 3)});
}
}  // namespace

TEST_CASE(
    "Anderson finds a slow fixed point in a fraction of plain pacing's beats - the distance is honest") {
  int beats[2];
  for (LimitCycleMethod method : {LimitCycleMethod::anderson, LimitCycleMethod::pacing}) {
    LimitCycleSettings settings;
    settings.method = method;
    settings.distance = 1e-8;
    settings.max_beats = 5000;
    LimitCycleSearch search(settings, {1, 1, 1});
    std::vector<double> x = {0, 0, 0};
    while (search.running()) x = search.next(x, slow_map(x));
    CHECK(search.certificate().verdict == LimitCycleVerdict::period_1);
    CHECK(error_of(x) <= 2e-8);
    CHECK(search.certificate().multiplier == Approx(0.99).margin(0.005));
    beats[method == LimitCycleMethod::pacing] = search.certificate().beats;
  }
  CHECK(beats[0] < 30);
  CHECK(beats[1] > 1000);
}

TEST_CASE("the change over a beat understates the distance - the certificate does not") {
  LimitCycleSettings settings;
  settings.method = LimitCycleMethod::pacing;
  settings.distance = 1e-4;
  LimitCycleSearch search(settings, {1, 1, 1});
  std::vector<double> x = {0, 0, 0};
  while (search.running()) x = search.next(x, slow_map(x));
  CHECK(search.certificate().residual < 0.05 * error_of(x));
  CHECK(search.certificate().distance > 0.8 * error_of(x));
}

TEST_CASE("a period-2 cycle is called by its name") {
  LimitCycleSettings settings;
  settings.method = LimitCycleMethod::pacing;
  settings.max_beats = 400;
  LimitCycleSearch search(settings, {1});
  std::vector<double> x = {0.3};
  while (search.running()) x = search.next(x, {3.2 * x[0] * (1 - x[0])});  // logistic map: stable 2-cycle
  CHECK(search.certificate().verdict == LimitCycleVerdict::period_n);
  CHECK(search.certificate().period == 2);
}

TEST_CASE("a drifting map is not called a cycle") {
  LimitCycleSettings settings;
  settings.method = LimitCycleMethod::pacing;
  settings.max_beats = 100;
  LimitCycleSearch search(settings, {1});
  std::vector<double> x = {0};
  while (search.running()) x = search.next(x, {x[0] + 1e-3});
  CHECK(search.certificate().verdict == LimitCycleVerdict::drifting);
}

TEST_CASE("a search restored from its numbers goes on bit for bit") {
  const LimitCycleSettings settings;
  LimitCycleSearch through(settings, {1, 1, 1});
  std::vector<double> x = {0, 0, 0}, saved, x_saved;
  for (int beat = 0; through.running(); ++beat) {
    if (beat == 9) {
      saved = through.save();
      x_saved = x;
    }
    x = through.next(x, slow_map(x));
  }
  REQUIRE_FALSE(saved.empty());
  LimitCycleSearch resumed(settings, {1, 1, 1});
  resumed.restore(SavedNumbers(saved, "search"));
  std::vector<double> y = x_saved;
  while (resumed.running()) y = resumed.next(y, slow_map(y));
  CHECK(y == x);
  CHECK(resumed.certificate().distance == through.certificate().distance);
}

TEST_CASE("a positive component is never proposed negative, and a failed start falls back") {
  LimitCycleSettings settings;
  settings.plain_beats = 2;
  LimitCycleSearch search(settings, {1}, {true});
  std::vector<double> x = {1};
  bool failed = false;
  for (int k = 0; k < 40 && search.running(); ++k) {
    REQUIRE(x[0] > 0);
    if (k == 6) {
      bool recovered = false;
      x = search.after_failure(recovered);
      failed = recovered;
      if (!recovered) break;
      continue;
    }
    x = search.next(x, {0.5 * x[0] + 0.01 * std::sqrt(x[0])});
  }
  CHECK(failed);
  CHECK(search.certificate().verdict == LimitCycleVerdict::period_1);
}

namespace {
// A contraction in three dimensions with a slow direction, not linear; its fixed point solves the same
// equations.
BeatMap curved_map() {
  BeatMap map;
  map.scales = {1, 1, 1};
  map.beat = [](const std::vector<double>& x) {
    return std::vector<double>{0.99 * x[0] + 0.01 * std::cos(x[1]), 0.5 * x[1] + 0.1 * std::sin(x[0]),
                               0.2 * x[2] + std::sin(x[0])};
  };
  map.admit = [](std::vector<double>&) {};
  return map;
}
}  // namespace

TEST_CASE("all methods find the same cycle and Newton's multiplier is the eigenvalue") {
  const BeatMap map = curved_map();
  std::vector<double> exact = {0, 0, 0};
  for (int beat = 0; beat < 10000; ++beat) exact = map.beat(exact);
  for (const char* name : {"anderson", "newton", "kinsol", "pacing"}) {
    LimitCycleSettings settings;
    settings.method = limit_cycle_method(name);
    settings.distance = 1e-8;
    std::vector<double> x = {0, 0, 0};
    const auto certificate = find_limit_cycle(map, settings, x);
    INFO(name << " beats " << certificate.beats);
    CHECK(certificate.verdict == LimitCycleVerdict::period_1);
    for (int i = 0; i < 3; ++i) CHECK(x[i] == Approx(exact[i]).margin(3e-8));
    if (std::string(name) != "pacing") CHECK(certificate.beats < 60);
    if (std::string(name) == "newton" && certificate.beats > 10)
      CHECK(certificate.multiplier == Approx(0.988).margin(3e-3));
  }
  CHECK_THROWS_WITH(limit_cycle_method("andersson"), Catch::Contains("did you mean 'anderson'"));
}

TEST_CASE("a map without a fixed point is refused by Newton in words") {
  BeatMap map;
  map.scales = {1};
  map.beat = [](const std::vector<double>& x) { return std::vector<double>{x[0] + 0.1}; };
  map.admit = [](std::vector<double>&) {};
  LimitCycleSettings settings;
  settings.method = LimitCycleMethod::newton;
  settings.max_beats = 100;
  std::vector<double> x = {0};
  CHECK_THROWS_WITH(find_limit_cycle(map, settings, x), Catch::Contains("multiplier of one"));
}

TEST_CASE("what is known of the slowest direction counts on") {
  LimitCycleSettings settings;
  settings.distance = 1e-5;
  settings.known_multiplier = 0.995;
  settings.plain_beats = 0;
  // Far along the slow direction, where the change over a beat is small; the first pairs see the fast ones.
  const std::vector<double> multipliers = {0.995, 0.1, -0.05, 0.02};
  std::vector<double> x = {2e-4, 1e-3, 2e-3, -3e-3};
  LimitCycleSearch search(settings, {1, 1, 1, 1});
  while (search.running()) {
    std::vector<double> image = x;
    for (std::size_t i = 0; i < x.size(); ++i) image[i] *= multipliers[i];
    x = search.next(x, image);
  }
  CHECK(search.certificate().good());
  CHECK(std::abs(x[0]) <= 1e-5);
}

TEST_CASE("small irregular beats around a cycle that they leave are no cycle") {
  // The logistic map at r = 3.9, beside a slow quantity that settles. Its beats wander no farther from its
  // fixed point than what is added to see whether they come back.
  const double r = 3.9, size = 3e-4;
  BeatMap map;
  map.scales = {1, 1};
  map.beat = [&](const std::vector<double>& x) {
    const double u = (x[0] - 1) / size;
    return std::vector<double>{1 + size * r * u * (1 - u), 0.9 * x[1] + 0.1 * u};
  };
  map.admit = [&](std::vector<double>& x) { x[0] = std::clamp(x[0], 1 + 0.01 * size, 1 + 0.99 * size); };
  LimitCycleSettings settings;
  settings.attractor = Attractor::paced;
  settings.distance = 1e-6;
  settings.map_noise = 1e-9;
  settings.max_beats = 3000;
  for (int k = 1; k < 40; ++k) {
    std::vector<double> x = {1 + size * k / 40, 0};
    const LimitCycleCertificate found = find_limit_cycle(map, settings, x);
    INFO(k << ": " << found.text() << ", distance " << found.distance);
    CHECK(found.verdict == LimitCycleVerdict::not_converged);
    CHECK(found.distance > settings.distance);
    CHECK(!found.reason.empty());
  }
}

TEST_CASE("what is known of the slowest direction counts before a search has a model of the map") {
  LimitCycleSettings settings;
  settings.distance = 1e-4;
  settings.plain_beats = 5;
  settings.known_multiplier = 0.995;
  LimitCycleSearch search(settings, {1});
  std::vector<double> x = {1e-3};
  while (search.running()) x = search.next(x, {0.995 * x[0]});
  CHECK(search.certificate().good());
  CHECK(x[0] <= 1e-4);
}

TEST_CASE("where the slowest direction is known no differences are waited for") {
  int beats[2];
  for (bool known : {false, true}) {
    LimitCycleSettings settings;
    settings.method = LimitCycleMethod::pacing;
    settings.distance = 1e-3;
    settings.fewest_differences = 8;
    settings.known_multiplier = known ? 0.5 : 0;
    LimitCycleSearch search(settings, {1});
    std::vector<double> x = {1e-3};
    while (search.running()) x = search.next(x, {0.5 * x[0]});
    CHECK(search.certificate().good());
    beats[known] = search.certificate().beats;
  }
  CHECK(beats[true] == 3);
  CHECK(beats[false] > 5);
}

TEST_CASE("a search for the attractor that pacing reaches uses what is known of the slowest direction") {
  const std::vector<double> multipliers = {0.7, 0.5, -0.3, 0.2, 0.1};
  BeatMap map;
  map.scales.assign(multipliers.size(), 1);
  map.beat = [&](const std::vector<double>& x) {
    std::vector<double> image = x;
    for (std::size_t i = 0; i < x.size(); ++i) image[i] *= multipliers[i];
    return image;
  };
  map.admit = [](std::vector<double>&) {};
  int beats[2];
  for (bool known : {false, true}) {
    LimitCycleSettings settings;
    settings.attractor = Attractor::paced;
    settings.distance = 1e-2;
    settings.known_multiplier = known ? 0.7 : 0;
    std::vector<double> x = {1e-2, 1e-2, 2e-2, -3e-2, 1e-2};
    const LimitCycleCertificate found = find_limit_cycle(map, settings, x);
    CHECK(found.good());
    CHECK(std::abs(x[0]) <= 1e-2);
    beats[known] = found.beats;
  }
  CHECK(beats[true] < beats[false]);
}
