#include "shared.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <wiggers/core/errors.hpp>

namespace wiggers::command {

std::vector<double> parameters_from(const CellModel& model, const std::string& set,
                                    const std::vector<std::string>& changes) {
  std::vector<double> values = model.parameter_values(set.empty() ? model.parameter_sets.front().name : set);
  for (const std::string& change : changes) {
    const auto [name, value] = parse_assignment(change, "--set");
    const std::size_t index =
        require_index(model.parameters, fmt::format("parameter of {}", model.name), name);
    check_range(model.parameters[index], value, "--set");
    values[index] = value;
  }
  return values;
}

bool end_of_run(const std::string& until, int beats) {
  if (!until.empty() && until != "limit-cycle")
    throw InputError(fmt::format("--until: '{}' is not known; the only end it names is limit-cycle", until));
  if (!until.empty() && beats != 0) throw InputError("give --beats N or --until limit-cycle, not both");
  if (until.empty() && beats == 0) throw InputError("say how long to run: --beats N or --until limit-cycle");
  if (beats < 0 || beats > 1000000)
    throw InputError(fmt::format("--beats {} is outside 1 to 1000000", beats));
  return !until.empty();
}

void check_option(std::string_view option, double value, double lower, double upper) {
  if (!(value >= lower && value <= upper))
    throw InputError(
        fmt::format("{} {} is outside {} to {}", option, to_text(value), to_text(lower), to_text(upper)));
}

void check_limit_cycle_options(double distance, int max_beats) {
  check_option("--distance", distance, 1e-12, 0.1);
  check_option("--max-beats", max_beats, 3, 1e6);
}

}  // namespace wiggers::command
