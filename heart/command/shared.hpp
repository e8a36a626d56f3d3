// What several verbs need.
#pragma once

#include <optional>
#include <string>
#include <vector>
#include <wiggers/cellmodels/catalogue/catalogue.hpp>
#include <wiggers/core/limit_cycle.hpp>

namespace wiggers::command {

// Values of a named set (empty: the first) with "name=value" changes, each checked against its range.
std::vector<double> parameters_from(const CellModel& model, const std::string& set,
                                    const std::vector<std::string>& changes);

// True: until the limit cycle; false: `beats` beats. Refuses both, neither, and other words.
bool end_of_run(const std::string& until, int beats);

// Refuses an option that is not finite or not within its range.
void check_option(std::string_view option, double value, double lower, double upper);
void check_limit_cycle_options(double distance, int max_beats);
}  // namespace wiggers::command
