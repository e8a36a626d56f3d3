#include <fmt/format.h>

#include <cmath>
#include <nlohmann/json.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/files.hpp>
#include <wiggers/heart/measure/extremes.hpp>

namespace wiggers {

std::optional<double> largest_step(double smallest, double largest, const std::function<bool(double)>& good) {
  double h = largest;
  while (h >= smallest && !good(h)) h *= 0.5;
  if (h < smallest) return {};
  if (h == largest) return h;
  double lower = h, upper = 2 * h;
  while (upper > 1.1 * lower) {
    const double middle = std::sqrt(lower * upper);
    (good(middle) ? lower : upper) = middle;
  }
  return lower;
}

void book_draw(DrawOutcome& outcome, const std::string& what, const std::function<bool()>& work) {
  ++outcome.draws;
  // The reason without its numbers: what is counted.
  const auto shortened = [](std::string text) {
    std::string words;
    for (char c : text)
      if (!((c >= '0' && c <= '9') || c == '.' || c == '-' || c == '+')) words += c;
    return words.substr(0, 90);
  };
  try {
    if (work())
      ++outcome.completed;
    else
      outcome.unexplained.push_back(what + ": ended in numbers that are not physical");
  } catch (const InputError& error) {
    ++outcome.refused;
    ++outcome.reasons["refused: " + shortened(error.what())];
  } catch (const NumericalFailure& error) {
    ++outcome.failed;
    ++outcome.reasons["failed: " + shortened(error.what())];
  } catch (const Interrupted&) {
    throw;
  } catch (const std::exception& error) {
    outcome.unexplained.push_back(what + ": " + error.what());
  }
}

std::string extremes_table(const ExtremesStudy& study) {
  std::string text = fmt::format(
      "{}\n\n| scheme | condition | largest stable step, {} | {} | {} | |\n|---|---|---|---|---|---|\n",
      study.subject, study.step_unit, study.accurate_means, study.roughly_means);
  const auto cell = [](const std::optional<double>& h) {
    return h ? fmt::format("{:.3g}", *h) : std::string("none");
  };
  for (const StabilityRow& row : study.rows)
    text += fmt::format("| {} | {} | {} | {} | {} | {} |\n", row.scheme, row.condition, cell(row.stable),
                        cell(row.accurate), cell(row.roughly), row.note);
  const DrawOutcome& d = study.draws;
  if (d.draws > 0) {
    text +=
        fmt::format("\n{} random draws: {} completed, {} refused, {} failed with a reason, {} unexplained\n",
                    d.draws, d.completed, d.refused, d.failed, d.unexplained.size());
    for (const auto& [reason, count] : d.reasons) text += fmt::format("  {:5}  {}\n", count, reason);
    for (const std::string& what : d.unexplained) text += fmt::format("  UNEXPLAINED  {}\n", what);
  }
  return text;
}

void write_extremes(const ExtremesStudy& study, const std::filesystem::path& path) {
  using Json = nlohmann::ordered_json;
  const auto step = [](const std::optional<double>& h) { return h ? Json(*h) : Json(nullptr); };
  Json json = {{"subject", study.subject},
               {"step_unit", study.step_unit},
               {"accurate_means", study.accurate_means},
               {"roughly_means", study.roughly_means}};
  for (const StabilityRow& row : study.rows)
    json["rows"].push_back({{"scheme", row.scheme},
                            {"condition", row.condition},
                            {"stable", step(row.stable)},
                            {"accurate", step(row.accurate)},
                            {"roughly", step(row.roughly)},
                            {"note", row.note}});
  json["draws"] = {{"draws", study.draws.draws},     {"completed", study.draws.completed},
                   {"refused", study.draws.refused}, {"failed", study.draws.failed},
                   {"reasons", study.draws.reasons}, {"unexplained", study.draws.unexplained}};
  write_file_atomically(path, json.dump(1) + "\n");
}

}  // namespace wiggers
