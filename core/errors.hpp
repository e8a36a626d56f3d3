// Errors for people. Three kinds, one meaning each:
//   InputError        the user asked for something impossible; refused before any work (exit status 2)
//   NumericalFailure  a computation broke down; says what, where, and what to try (exit status 1)
//   ResourceError     the machine refused: a file cannot be read or written, the disk is full (exit status 1)
// Programmer errors are assertions. Messages quote what stands in files: each is kept to a bounded length and
// to printable characters when it is made.
#pragma once

#include <span>
#include <stdexcept>
#include <string>
#include <string_view>
#include <utility>
#include <vector>
#include <wiggers/core/quantity.hpp>

namespace wiggers {

// What is left of a message for people: long quotations are cut in their middle, control characters shown as
// '?'.
std::string presentable(std::string message);

struct InputError : std::runtime_error {
  explicit InputError(std::string message) : std::runtime_error(presentable(std::move(message))) {}
};
struct NumericalFailure : std::runtime_error {
  explicit NumericalFailure(std::string message) : std::runtime_error(presentable(std::move(message))) {}
};
struct ResourceError : std::runtime_error {
  explicit ResourceError(std::string message) : std::runtime_error(presentable(std::move(message))) {}
};
// The user pressed Ctrl-C (or the process was asked to end); the last good state has been saved.
struct Interrupted : std::runtime_error {
  using std::runtime_error::runtime_error;
};

// The candidate with the smallest edit distance to `name` (case-insensitive); empty if none is close.
std::string nearest_name(std::string_view name, std::span<const std::string> candidates);

// "unknown parameter 'g_na'; did you mean 'g_Na'? Known: ..."
[[noreturn]] void refuse_unknown(std::string_view kind, std::string_view name,
                                 std::span<const std::string> candidates);

// Throws InputError unless value is finite and inside the quantity's range. `where` names file or option.
void check_range(const Quantity& quantity, double value, std::string_view where);

// Names of a list of quantities, as strings.
std::vector<std::string> names_of(std::span<const Quantity> quantities);

// Position of `name`; refuses an unknown one with the nearest valid name.
std::size_t require_index(std::span<const Quantity> quantities, std::string_view kind, std::string_view name);

// "name=value": splits, and refuses a value that is not a number, with the option's name.
std::pair<std::string, double> parse_assignment(std::string_view text, std::string_view option);

// Parses a whole string as a finite or infinite number; refuses anything else, naming `where`.
double parse_number(std::string_view text, std::string_view where);

// A failure's message as a sentence, followed by where the last good state is, if it was kept.
std::string failure_text(std::string_view message, const std::string& kept_in = "");

// Shortest text that reads back as the same double.
std::string to_text(double value);

// A figure for people: that many decimals, or, where this would be a long row of digits, six figures.
std::string figure_text(double value, int decimals);

}  // namespace wiggers
