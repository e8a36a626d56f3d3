// The machinery of trade and extremes, and what it says of the presets.
#include <catch2/catch.hpp>
#include <cmath>
#include <limits>
#include <wiggers/core/errors.hpp>
#include <wiggers/heart/measure/extremes.hpp>
#include <wiggers/heart/measure/trade.hpp>

using namespace wiggers;

namespace {
TradeStudy toy() {
  TradeStudy study;
  study.measures = {{"apd90", "ms", "duration", 0}, {"ca_peak", "1", "calcium", 0}};
  study.rows = {{"slow", "a", {0.001, 0.1}, 10, 0, 0, {}},         {"fast", "b", {0.5, 0.01}, 1, 0, 0, {}},
                {"middle", "c", {0.05, 0.2}, 3, 0, 0, {}},         {"beaten", "d", {0.06, 0.2}, 4, 0, 0, {}},
                {"lost", "f", {std::nan(""), 0.2}, 0.1, 0, 0, {}}, {"broken", "e", {}, 0, 0, 0, "diverges"}};
  return study;
}
Progress silent() { return {"", Progress::Style::quiet}; }
}  // namespace

TEST_CASE("the recommended setting is the cheapest within all tolerances") {
  const TradeStudy study = toy();
  CHECK(recommended(study, read_tolerances(study.measures, {"apd90=0.1ms"})) == std::size_t(2));
  CHECK(recommended(study, read_tolerances(study.measures, {"apd90=1"})) == std::size_t(1));
  CHECK(recommended(study, read_tolerances(study.measures, {"apd90=0.1ms", "ca_peak=0.15"})) ==
        std::size_t(0));
  CHECK_FALSE(recommended(study, read_tolerances(study.measures, {"apd90=1e-9"})));
  CHECK(pareto_front(study, 0) == std::vector<std::size_t>{1, 2, 0});
  CHECK_THROWS_WITH(read_tolerances(study.measures, {"apd9=0.1"}), Catch::Contains("did you mean 'apd90'"));
  CHECK_THROWS_WITH(read_tolerances(study.measures, {"apd90=0.1mV"}), Catch::Contains("ms"));
  CHECK_THROWS_AS(read_tolerances(study.measures, {"apd90"}), InputError);
  CHECK_THROWS_AS(read_tolerances(study.measures, {"apd90=-1"}), InputError);
  const std::string table = trade_table(study, 2);
  CHECK(table.find("| ** | middle") != std::string::npos);
  CHECK(table.find("diverges") != std::string::npos);
}

TEST_CASE("RDQ20 at 1 ms: the midpoint's tension is within half a percent of its peak") {
  for (const char* set : {"fedele2023-ventricles", "fedele2023-atria", "human37"}) {
    Progress progress = silent();
    const TradeStudy study = trade_force(find_model("rdq20"), set, progress);
    CHECK(study.measures[0].reference_confirmed < 1e-2);
    bool found = false;
    for (const TradeRow& row : study.rows)
      if (row.method == "frozen-midpoint" && row.setting == "dt 1 ms") {
        INFO(set << " " << row.errors[0] << " %");
        CHECK(row.errors[0] < 0.5);
        found = true;
      }
    CHECK(found);
    // Order two where the stiff relaxations are resolved.
    double coarse = 0, fine = 0;
    for (const TradeRow& row : study.rows) {
      if (row.method == "frozen-midpoint" && row.setting == "dt 0.1 ms") coarse = row.errors[0];
      if (row.method == "frozen-midpoint" && row.setting == "dt 0.05 ms") fine = row.errors[0];
    }
    CHECK((coarse > 0 && fine > 0));
    CHECK(std::log2(coarse / fine) == Approx(2).margin(0.25));
  }
}

TEST_CASE("loop: the study's errors fall with the step as the orders say") {
  Progress progress = silent();
  const TradeStudy study = trade_loop(find_circulation_set("wiggers-healthy-0d").loop, progress);
  CHECK(study.measures[0].reference_confirmed < 1e-5);
  double one = 0, tenth = 0;
  std::string too_long;
  for (const TradeRow& row : study.rows) {
    if (row.method == "forward-euler" && row.setting == "dt 1 ms") one = row.errors[0];
    if (row.method == "forward-euler" && row.setting == "dt 0.1 ms") tenth = row.errors[0];
    if (row.method == "forward-euler" && row.setting == "dt 5 ms") too_long = row.failure;
  }
  CHECK(too_long == "diverges");
  CHECK(one / tenth == Approx(10).epsilon(0.1));
}

TEST_CASE("the largest step is found to ten percent") {
  for (double edge : {0.013, 0.7, 1.99}) {
    const auto h = largest_step(1e-3, 2, [&](double step) { return step <= edge; });
    REQUIRE(h);
    CHECK((*h <= edge && *h > edge / 1.1));
  }
  CHECK(largest_step(1e-3, 2, [](double) { return true; }) == 2.0);
  CHECK_FALSE(largest_step(1e-3, 2, [](double) { return false; }));
}

TEST_CASE("draws are booked by how they end") {
  DrawOutcome outcome;
  book_draw(outcome, "a", [] { return true; });
  book_draw(outcome, "b", []() -> bool { throw InputError("bad 1.5"); });
  book_draw(outcome, "c", []() -> bool { throw InputError("bad 2.5"); });
  book_draw(outcome, "d", []() -> bool { throw NumericalFailure("diverged at 3"); });
  book_draw(outcome, "e", [] { return std::isfinite(std::numeric_limits<double>::quiet_NaN()); });
  book_draw(outcome, "f", []() -> bool { throw std::bad_alloc(); });
  CHECK((outcome.draws == 6 && outcome.completed == 1 && outcome.refused == 2 && outcome.failed == 1));
  CHECK(outcome.reasons.at("refused: bad ") == 2);
  CHECK(outcome.unexplained.size() == 2);
}

TEST_CASE("random draws far outside the usual end in an answer or an explanation") {
  // The nightly set draws thousands.
  ExtremesSettings settings;
  settings.draws = 60;
  settings.beats = 1;
  Progress progress = silent();
  const ExtremesStudy force = extremes_force(find_model("rdq20"), settings, progress);
  CHECK(force.draws.unexplained.empty());
  CHECK((force.draws.completed > 20 && force.draws.refused > 5));
  const ExtremesStudy loop =
      extremes_loop(find_circulation_set("wiggers-healthy-0d").loop, settings, progress);
  CHECK(loop.draws.unexplained.empty());
  CHECK(loop.draws.completed > 30);
  // The midpoint bears what forward Euler does not.
  int n_midpoint = 0, n_euler = 0;
  for (const StabilityRow& row : force.rows) {
    if (row.scheme == "frozen-midpoint") {
      CHECK(row.stable == 5.0);
      ++n_midpoint;
    }
    if (row.scheme == "forward-euler") {
      CHECK(row.stable.value_or(0) < 0.6);
      ++n_euler;
    }
  }
  CHECK((n_midpoint > 20 && n_euler == n_midpoint));
}
