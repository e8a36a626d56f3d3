// The trade of speed for accuracy, measured: every setting of a method with its errors against a reference
// and its cost, on this machine, in this run.
//
// A study runs its subject once by a reference far finer than anything offered (and confirms that reference
// by a second method), then by each setting. A setting that fails is a row with the reason, not a gap.
#pragma once

#include <filesystem>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>
#include <wiggers/cellmodels/catalogue/catalogue.hpp>
#include <wiggers/circulation/loop.hpp>
#include <wiggers/core/progress.hpp>

namespace wiggers {

struct TradeMeasure {
  std::string name;  // as in --tolerance NAME=VALUE
  std::string unit;
  std::string meaning;
  double reference_confirmed = 0;  // difference of the two references in this measure
};

// The measures of a kind of study: cell | force | loop | heart.
std::vector<TradeMeasure> trade_measures(std::string_view kind);

struct TradeRow {
  std::string method;          // e.g. "rush-larsen"
  std::string setting;         // e.g. "dt 0.02 ms, tables 0.1 mV"
  std::vector<double> errors;  // one a measure; empty if it failed
  double cost_s = 0;  // CPU seconds of what is costed (of one cell, loop or heart), median of at least five
  long evaluations = 0;  // of the model, where the method counts them
  long steps = 0;
  std::string failure;
};

// The processor and the best SIMD instructions it offers.
std::string machine_name();

struct TradeStudy {
  std::string subject, protocol, reference;
  std::string costed = "a beat";  // what cost_s of the rows is the cost of
  std::string machine = machine_name();
  std::vector<TradeMeasure> measures;
  std::vector<TradeRow> rows;
};

TradeStudy trade_cell(const CellModel& model, const std::vector<double>& parameters, Progress& progress);
TradeStudy trade_force(const CellModel& model, std::string_view parameter_set, Progress& progress);
// Whether probabilities are within [0, 1] (to `below`) and a model's invariants what they start with (to
// `sum`).
bool probabilities_kept(const CellModel& model, const std::vector<double>& y, double below, double sum);
TradeStudy trade_loop(const Loop& loop, Progress& progress);
// The scene with the overrides, then with each combination of solver settings on top.
// Whether a scene has a wall of 3D tissue, and the trade of such a scene.
bool has_tissue(const std::filesystem::path& scene, const std::vector<std::string>& overrides);
TradeStudy trade_tissue(const std::filesystem::path& scene, const std::vector<std::string>& overrides,
                        Progress& progress);
TradeStudy trade_heart(const std::filesystem::path& scene, const std::vector<std::string>& overrides,
                       Progress& progress);

// Tolerances by measure, in the measure's unit: "apd90=0.1ms". Refuses an unknown measure or another unit.
std::map<std::string, double> read_tolerances(const std::vector<TradeMeasure>& measures,
                                              const std::vector<std::string>& texts);

// The cheapest row that meets all tolerances; nothing if none does.
std::optional<std::size_t> recommended(const TradeStudy& study,
                                       const std::map<std::string, double>& tolerances);

// Rows that no other row beats in both cost and the given measure, cheapest first.
std::vector<std::size_t> pareto_front(const TradeStudy& study, std::size_t measure);

std::string trade_table(const TradeStudy& study, std::optional<std::size_t> chosen);
// trade.json (everything), trade.md (the table).
void write_trade(const TradeStudy& study, const std::map<std::string, double>& tolerances,
                 const std::filesystem::path& folder);

// CPU seconds of `work`, the median of at least five runs (three if one takes longer than a second).
double median_cost(const std::function<void()>& work);

}  // namespace wiggers
