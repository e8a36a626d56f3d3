// The attractor that plain pacing is heading for, on maps whose answer is known.
#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/limit_cycle_solve.hpp>
#include <wiggers/core/rhythm.hpp>

using namespace wiggers;

namespace {

// A fast variable of the logistic map, r x (1 - x), with a slow one that drifts to 1 and moves r a little.
BeatMap logistic(double r, double slow_multiplier = 0.99) {
  BeatMap map;
  map.scales = {1, 1};
  map.positive = {false, false};
  map.beat = [r, slow_multiplier](const std::vector<double>& x) {
    const double slow = 1 + slow_multiplier * (x[1] - 1);
    return std::vector<double>{(r + 0.01 * (x[1] - 1)) * x[0] * (1 - x[0]), slow};
  };
  map.admit = [](std::vector<double>&) {};
  return map;
}

LimitCycleCertificate paced(const BeatMap& map, std::vector<double>& x, int max_beats = 2000) {
  LimitCycleSettings settings;
  settings.attractor = Attractor::paced;
  settings.distance = 1e-9;
  settings.max_beats = max_beats;
  return find_limit_cycle(map, settings, x);
}

// After how many beats the state comes back.
int comes_back(const BeatMap& map, const std::vector<double>& x) {
  std::vector<double> y = x;
  for (int n = 1; n <= 16; ++n) {
    y = map.beat(y);
    if (scaled_distance(x, y, map.scales) < 1e-6) return n;
  }
  return 0;
}

}  // namespace

TEST_CASE("cycles of one to eight beats are told apart while a slow variable drifts") {
  struct Case {
    double r;
    int beats;
  };
  for (const Case& c : {Case{2.5, 1}, {3.2, 2}, {3.5, 4}, {3.55, 8}, {3.835, 3}, {3.739, 5}}) {
    const BeatMap map = logistic(c.r);
    std::vector<double> x = {0.31, 0.5};
    const auto certificate = paced(map, x);
    INFO("r " << c.r << ": " << certificate.text() << " after " << certificate.beats << " beats; "
              << certificate.reason);
    CHECK(certificate.period == c.beats);
    CHECK(certificate.verdict == (c.beats == 1 ? LimitCycleVerdict::period_1 : LimitCycleVerdict::period_n));
    CHECK(comes_back(map, x) == c.beats);
    CHECK(x[1] == Approx(1).margin(1e-7));
  }
}

TEST_CASE("a chaotic map is not called a cycle") {
  std::vector<double> x = {0.31, 0.5};
  const auto certificate = paced(logistic(3.9), x, 500);
  CHECK(certificate.verdict == LimitCycleVerdict::not_converged);
  CHECK_THAT(certificate.reason, Catch::Contains("no rhythm"));
}

TEST_CASE("an alternation that only comes with the drift is found") {
  // Stable at the start (r = 2.9), a cycle of two beats where the slow variable ends (r = 3.3).
  BeatMap map = logistic(0);
  map.beat = [](const std::vector<double>& x) {
    return std::vector<double>{(2.9 + 0.4 * x[1]) * x[0] * (1 - x[0]), 1 + 0.98 * (x[1] - 1)};
  };
  std::vector<double> x = {1 - 1 / 2.9, 0};
  const auto certificate = paced(map, x);
  INFO(certificate.text() << " " << certificate.reason);
  CHECK(certificate.period == 2);
  CHECK(comes_back(map, x) == 2);
}

TEST_CASE("of two attractors the one that pacing reaches") {
  // x -> a cycle of two beats around 0 with |x| = 1 (flip), or a fixed point at 4; the border is at 2.
  BeatMap map;
  map.scales = {1, 1};
  map.admit = [](std::vector<double>&) {};
  map.beat = [](const std::vector<double>& s) {
    const double x = s[0], slow = 1 + 0.99 * (s[1] - 1);
    const double fast = x > 2 ? 4 + 0.3 * (x - 4) : -(x > 0 ? 1 : -1) * (1 + 0.2 * (std::abs(x) - 1));
    return std::vector<double>{fast + 1e-3 * (slow - 1), slow};
  };
  for (double start : {0.5, 3.0}) {
    std::vector<double> x = {start, 0};
    const auto certificate = paced(map, x);
    INFO("start " << start << ": " << certificate.text());
    CHECK(certificate.period == (start > 2 ? 1 : 2));
  }
}

TEST_CASE("a long bent way is followed to its end") {
  // Slow drift over decades of rate, as of an ion that leaves a cell: no linear model of the map sees the
  // end.
  BeatMap map;
  map.scales = {1, 1};
  map.positive = {true, false};
  map.admit = [](std::vector<double>&) {};
  map.beat = [](const std::vector<double>& x) {
    const double rate = 2e-3 * (std::exp(-3 * (x[0] - 1)) - std::exp(-3.0));
    return std::vector<double>{x[0] + rate, 0.5 * x[1] + std::sin(3 * x[0])};
  };
  std::vector<double> x = {0.3, 0};
  const auto certificate = paced(map, x, 3000);
  INFO(certificate.text() << " after " << certificate.beats << " " << certificate.reason);
  CHECK(certificate.good());
  CHECK(x[0] == Approx(2).margin(1e-5));
  CHECK(certificate.beats < 600);
}

TEST_CASE("what beats did that found no cycle is said") {
  Rhythm drifting({1});
  for (int n = 0; n < 12; ++n) drifting.see({0.1 * n});
  CHECK_THAT(describe(drifting), Catch::Contains("without slowing down"));
  Rhythm alternating({1});
  for (int n = 0; n < 12; ++n) alternating.see({(n % 2) + 1e-4 * n});
  CHECK(alternating.period() == 2);
  CHECK_THAT(describe(alternating), Catch::Contains("every 2 beats"));
  CHECK(attractor_named("paced") == Attractor::paced);
  CHECK_THROWS_WITH(attractor_named("pacd"), Catch::Contains("did you mean 'paced'"));
}

namespace {
// A rotation by 5/13 of a turn that locks: thirteen beats, and a slow variable beside.
BeatMap thirteen_beats() {
  BeatMap map;
  map.scales = {1, 1, 1};
  map.admit = [](std::vector<double>&) {};
  map.beat = [](const std::vector<double>& x) {
    const double angle = std::atan2(x[1], x[0]), radius = 1 + 0.5 * (std::hypot(x[0], x[1]) - 1);
    const double turned = angle + 2 * M_PI * 5 / 13 - 0.03 * std::sin(13 * angle);
    return std::vector<double>{radius * std::cos(turned), radius * std::sin(turned), 1 + 0.98 * (x[2] - 1)};
  };
  return map;
}
}  // namespace

TEST_CASE("a rhythm longer than eight beats is no cycle, and is told") {
  std::vector<double> x = {0.3, 0.2, 0};
  const auto certificate = paced(thirteen_beats(), x, 4000);
  INFO(certificate.text() << " after " << certificate.beats << " beats; " << certificate.reason);
  CHECK(certificate.verdict == LimitCycleVerdict::not_converged);
  CHECK(certificate.period == 13);
  CHECK(certificate.beats < 3000);
  CHECK_THAT(certificate.reason, Catch::Contains("every 13 beats"));
  CHECK_THAT(limit_cycle_failure(certificate),
             Catch::Contains("no limit cycle of up to 8 beats") && !Catch::Contains("Allow more beats"));
}

TEST_CASE("alternation that slips now and then is none when it is watched for long enough") {
  Rhythm slipping({1});
  for (int n = 0; n < 60; ++n) slipping.see({(n % 11) % 2 + 1e-3 * (n % 11)});
  CHECK(slipping.period() == 2);
  CHECK(slipping.period(20) == 0);
  CHECK(slipping.longer_period() == 11);
  // A release that is missed every fifteen beats, at the 0th, 15th, 30th ...
  Rhythm missing({1});
  for (int n = 0; n < 56; ++n) missing.see({0.1 * std::exp(-0.5 * (n % 15))});
  CHECK(missing.period() == 1);
  CHECK(missing.period(20) == 0);
  CHECK(missing.longer_period() == 15);
}
