#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <ctime>
#include <fstream>
#include <nlohmann/json.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/files.hpp>
#include <wiggers/core/instruction_set.hpp>
#include <wiggers/heart/trade.hpp>

namespace wiggers {

std::string machine_name() {
  std::ifstream info("/proc/cpuinfo");
  std::string line, name = "unknown processor";
  while (std::getline(info, line))
    if (line.starts_with("model name")) {
      name = line.substr(line.find(':') + 2);
      break;
    }
  return fmt::format("{}, {}, one core", name, to_string(best_instruction_set()));
}

double median_cost(const std::function<void()>& work) {
  const auto cpu = [] {
    timespec now{};
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
    return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
  };
  std::vector<double> times;
  double total = 0;
  while (times.size() < 5 || (total < 0.02 && times.size() < 200)) {
    const double begin = cpu();
    work();
    times.push_back(cpu() - begin);
    total += times.back();
    if (times.size() >= 3 && times.back() > 1) break;
  }
  std::nth_element(times.begin(), times.begin() + static_cast<long>(times.size() / 2), times.end());
  return times[times.size() / 2];
}

std::map<std::string, double> read_tolerances(const TradeStudy& study,
                                              const std::vector<std::string>& texts) {
  std::map<std::string, double> tolerances;
  std::vector<std::string> known;
  for (const TradeMeasure& m : study.measures) known.push_back(m.name);
  for (const std::string& text : texts) {
    const auto equals = text.find('=');
    if (equals == std::string::npos)
      throw InputError(fmt::format("--tolerance {}: give measure=value, for example {}=0.1{}", text,
                                   known.front(), study.measures.front().unit));
    const std::string name = text.substr(0, equals);
    const auto measure = std::find_if(study.measures.begin(), study.measures.end(),
                                      [&](const TradeMeasure& m) { return m.name == name; });
    if (measure == study.measures.end()) refuse_unknown("measure", name, known);
    std::string value = text.substr(equals + 1);
    const std::string& unit = measure->unit;
    if (unit != "1" && value.size() > unit.size() && value.ends_with(unit))
      value.resize(value.size() - unit.size());
    double number = 0;
    try {
      number = parse_number(value, name);
    } catch (const InputError&) {
      throw InputError(
          fmt::format("--tolerance {}: '{}' is no number in {}", text, text.substr(equals + 1), unit));
    }
    if (!(number > 0)) throw InputError(fmt::format("--tolerance {}: must be positive", text));
    tolerances[name] = number;
  }
  return tolerances;
}

std::optional<std::size_t> recommended(const TradeStudy& study,
                                       const std::map<std::string, double>& tolerances) {
  std::optional<std::size_t> best;
  for (std::size_t r = 0; r < study.rows.size(); ++r) {
    const TradeRow& row = study.rows[r];
    bool good = row.failure.empty();
    for (std::size_t m = 0; good && m < study.measures.size(); ++m) {
      const auto wanted = tolerances.find(study.measures[m].name);
      good = wanted == tolerances.end() || row.errors[m] <= wanted->second;
    }
    if (good && (!best || row.cost_s < study.rows[*best].cost_s)) best = r;
  }
  return best;
}

std::vector<std::size_t> pareto_front(const TradeStudy& study, std::size_t measure) {
  std::vector<std::size_t> order;
  for (std::size_t r = 0; r < study.rows.size(); ++r)
    if (study.rows[r].failure.empty()) order.push_back(r);
  std::sort(order.begin(), order.end(),
            [&](std::size_t a, std::size_t b) { return study.rows[a].cost_s < study.rows[b].cost_s; });
  std::vector<std::size_t> front;
  for (std::size_t r : order)
    if (front.empty() || study.rows[r].errors[measure] < study.rows[front.back()].errors[measure])
      front.push_back(r);
  return front;
}

std::string trade_table(const TradeStudy& study, std::optional<std::size_t> chosen) {
  std::string text = fmt::format("{}\n{}\nreference: {}\n{}\n\n", study.subject, study.protocol,
                                 study.reference, study.machine);
  text += "| | method | setting | cost of a beat, ms |";
  for (const TradeMeasure& m : study.measures)
    text += fmt::format(" {}{} |", m.name, m.unit == "1" ? "" : ", " + m.unit);
  text += "\n|---|---|---|---|";
  for (std::size_t m = 0; m < study.measures.size(); ++m) text += "---|";
  text += "\n";
  std::vector<bool> on_front(study.rows.size(), false);
  for (std::size_t r : pareto_front(study, 0)) on_front[r] = true;
  for (std::size_t r = 0; r < study.rows.size(); ++r) {
    const TradeRow& row = study.rows[r];
    text += fmt::format("| {} | {} | {} |",
                        chosen == r   ? "**"
                        : on_front[r] ? "*"
                                      : "",
                        row.method, row.setting);
    if (!row.failure.empty()) {
      text += fmt::format(" {} |\n", row.failure);
      continue;
    }
    text += fmt::format(" {:.3g} |", 1e3 * row.cost_s);
    for (double error : row.errors) text += fmt::format(" {:.2g} |", error);
    text += "\n";
  }
  text +=
      fmt::format("\n\\*: no other setting is both cheaper and nearer in {}.", study.measures.front().name);
  if (chosen) text += " \\*\\*: the cheapest that meets the tolerances.";
  text += "\n\n";
  for (const TradeMeasure& m : study.measures)
    text += fmt::format("- {}: {} (the two references differ by {:.1e})\n", m.name, m.meaning,
                        m.reference_confirmed);
  return text;
}

void write_trade(const TradeStudy& study, const std::map<std::string, double>& tolerances,
                 const std::filesystem::path& folder) {
  using Json = nlohmann::ordered_json;
  Json json = {{"subject", study.subject},
               {"protocol", study.protocol},
               {"reference", study.reference},
               {"machine", study.machine}};
  for (const TradeMeasure& m : study.measures)
    json["measures"].push_back({{"name", m.name},
                                {"unit", m.unit},
                                {"meaning", m.meaning},
                                {"reference_confirmed", m.reference_confirmed}});
  const auto chosen = recommended(study, tolerances);
  std::vector<bool> on_front(study.rows.size(), false);
  for (std::size_t r : pareto_front(study, 0)) on_front[r] = true;
  for (std::size_t r = 0; r < study.rows.size(); ++r) {
    const TradeRow& row = study.rows[r];
    Json entry = {{"method", row.method}, {"setting", row.setting}};
    if (!row.failure.empty()) {
      entry["failure"] = row.failure;
    } else {
      entry["cost_s"] = row.cost_s;
      entry["errors"] = row.errors;
      entry["steps"] = row.steps;
      entry["evaluations"] = row.evaluations;
      entry["pareto"] = static_cast<bool>(on_front[r]);
      entry["recommended"] = chosen == r && !tolerances.empty();
    }
    json["rows"].push_back(entry);
  }
  for (const auto& [name, value] : tolerances) json["tolerances"][name] = value;
  write_file_atomically(folder / "trade.json", json.dump(1) + "\n");
  write_file_atomically(folder / "trade.md", trade_table(study, tolerances.empty() ? std::nullopt : chosen));
}

}  // namespace wiggers
