#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <ctime>
#include <fstream>
#include <nlohmann/json.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/files.hpp>
#include <wiggers/core/instruction_set.hpp>
#include <wiggers/heart/measure/trade.hpp>

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

std::vector<TradeMeasure> trade_measures(std::string_view kind) {
  if (kind == "cell")
    return {{"apd90", "ms", "action potential duration at 90 % repolarisation"},
            {"v_rms", "1", "root mean square of the potential's error, relative to that of the potential"},
            {"v_max", "mV", "largest error of the potential in the beat"},
            {"v_max_late", "mV", "the same after the first 10 ms"},
            {"activation", "ms", "time at which V crosses 0 mV"},
            {"ca_peak", "1", "peak cytosolic calcium, relative"},
            {"end_state", "1", "largest scaled error of the state after the beat"}};
  if (kind == "force")
    return {{"tension", "%", "largest error of the tension, of its peak"},
            {"peak", "%", "error of the peak tension"}};
  if (kind == "loop")
    return {{"pressure", "mmHg", "largest error of a chamber's or artery's pressure"},
            {"volume", "mL", "largest error of a chamber's volume"},
            {"flow", "mL/s", "largest error of a valve's flow"},
            {"stroke_volume", "mL", "error of the left ventricle's stroke volume"}};
  if (kind == "tissue")
    return {{"activation", "ms", "when the mean potential passes -40 mV"},
            {"p_LV", "mmHg", "left ventricular pressure at the window's end"},
            {"V_LV", "mL", "left ventricular volume at the window's end"},
            {"tension", "kPa", "mean active tension at the window's end"},
            {"Q_AV", "mL/s", "peak flow through the aortic valve in the window"}};
  return {{"p_LV", "mmHg", "peak left ventricular pressure"},
          {"EDV", "mL", "end-diastolic volume of the left ventricle"},
          {"SV", "mL", "stroke volume of the left ventricle"},
          {"EF", "%", "ejection fraction of the left ventricle, in percent points"},
          {"p_aorta", "mmHg", "systolic aortic pressure"},
          {"Q_AV", "mL/s", "peak flow through the aortic valve"},
          {"AV_opens", "ms", "opening of the aortic valve"},
          {"AV_closes", "ms", "closure of the aortic valve"},
          {"MV_opens", "ms", "opening of the mitral valve"}};
}

std::map<std::string, double> read_tolerances(const std::vector<TradeMeasure>& measures,
                                              const std::vector<std::string>& texts) {
  std::map<std::string, double> tolerances;
  std::vector<std::string> known;
  for (const TradeMeasure& m : measures) known.push_back(m.name);
  for (const std::string& text : texts) {
    const auto equals = text.find('=');
    if (equals == std::string::npos)
      throw InputError(fmt::format("--tolerance {}: give measure=value, for example {}=0.1{}", text,
                                   known.front(), measures.front().unit));
    const std::string name = text.substr(0, equals);
    const auto measure =
        std::find_if(measures.begin(), measures.end(), [&](const TradeMeasure& m) { return m.name == name; });
    if (measure == measures.end()) refuse_unknown("measure", name, known);
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
    if (study.rows[r].failure.empty() && std::isfinite(study.rows[r].errors[measure])) order.push_back(r);
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
  text += fmt::format("| | method | setting | cost of {}, ms |", study.costed);
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
               {"costed", study.costed},
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
