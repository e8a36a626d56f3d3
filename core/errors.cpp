#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <charconv>
#include <cmath>
#include <wiggers/core/errors.hpp>

namespace wiggers {

namespace {

std::string lower_case(std::string_view text) {
  std::string result(text);
  for (char& c : result) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  return result;
}

// Edit distance with swaps of neighbours counted as one slip.
std::size_t edit_distance(std::string_view a, std::string_view b) {
  std::vector<std::vector<std::size_t>> d(a.size() + 1, std::vector<std::size_t>(b.size() + 1));
  for (std::size_t i = 0; i <= a.size(); ++i)
    for (std::size_t k = 0; k <= b.size(); ++k) {
      if (i == 0 || k == 0) {
        d[i][k] = i + k;
        continue;
      }
      d[i][k] =
          std::min({d[i - 1][k] + 1, d[i][k - 1] + 1, d[i - 1][k - 1] + (a[i - 1] == b[k - 1] ? 0 : 1)});
      if (i > 1 && k > 1 && a[i - 1] == b[k - 2] && a[i - 2] == b[k - 1])
        d[i][k] = std::min(d[i][k], d[i - 2][k - 2] + 1);
    }
  return d[a.size()][b.size()];
}

// Longer names than this are no slips of known ones, and comparing them would take long.
constexpr std::size_t longest_name = 200;
// Of a message, and of an unbroken word in it.
constexpr std::size_t longest_message = 4000, longest_word = 400;

// The text with its middle left out.
std::string cut(const std::string& text, std::size_t wanted) {
  if (text.size() <= wanted) return text;
  std::size_t head = wanted * 3 / 4, tail = text.size() - wanted / 4;
  // Not within a character of UTF-8.
  const auto within = [&](std::size_t at) { return (static_cast<unsigned char>(text[at]) & 0xC0) == 0x80; };
  while (head > 0 && within(head)) --head;
  while (tail < text.size() && within(tail)) ++tail;
  return fmt::format("{}[... {} characters ...]{}", text.substr(0, head), tail - head, text.substr(tail));
}

}  // namespace

std::string presentable(std::string message) {
  for (char& c : message) {
    const auto code = static_cast<unsigned char>(c);
    if ((code < 0x20 && c != '\n' && c != '\t') || code == 0x7F) c = '?';
  }
  std::string out;
  for (std::size_t begin = 0; begin < message.size();) {
    const std::size_t end = std::min(message.find_first_of(" \n\t", begin), message.size());
    out += cut(message.substr(begin, end - begin), longest_word);
    if (end < message.size()) out += message[end];
    begin = end + 1;
  }
  return cut(out, longest_message);
}

std::string nearest_name(std::string_view name, std::span<const std::string> candidates) {
  if (name.size() > longest_name) return {};
  const std::string wanted = lower_case(name);
  std::string best;
  std::size_t best_distance = std::max<std::size_t>(2, (name.size() + 1) / 2) + 1;
  for (const std::string& candidate : candidates) {
    if (candidate.size() > longest_name) continue;
    const std::string present = lower_case(candidate);
    std::size_t distance = edit_distance(wanted, present);
    // A key without its unit ("activation" for "activation_ms") is as near as one slip of a key.
    if (wanted.size() > 2 && present.starts_with(wanted)) distance = std::min<std::size_t>(distance, 1);
    if (distance < best_distance) {
      best_distance = distance;
      best = candidate;
    }
  }
  return best;
}

void refuse_unknown(std::string_view kind, std::string_view name, std::span<const std::string> candidates) {
  std::string message = fmt::format("unknown {} '{}'", kind, name);
  const std::string nearest = nearest_name(name, candidates);
  if (!nearest.empty()) message += fmt::format("; did you mean '{}'?", nearest);
  if (!candidates.empty() && candidates.size() <= 40)
    message += fmt::format("{} Known: {}.", nearest.empty() ? "." : "", fmt::join(candidates, ", "));
  throw InputError(message);
}

void check_range(const Quantity& quantity, double value, std::string_view where) {
  if (std::isfinite(value) && value >= quantity.lower && value <= quantity.upper) return;
  const std::string_view unit = quantity.unit == "1" ? "" : quantity.unit;
  const std::string_view space = unit.empty() ? "" : " ";
  throw InputError(fmt::format("{}: {} = {}{}{} is outside its range {} to {}{}{} ({})", where, quantity.name,
                               to_text(value), space, unit, to_text(quantity.lower), to_text(quantity.upper),
                               space, unit, quantity.meaning));
}

std::vector<std::string> names_of(std::span<const Quantity> quantities) {
  std::vector<std::string> names;
  names.reserve(quantities.size());
  for (const Quantity& q : quantities) names.emplace_back(q.name);
  return names;
}

std::size_t require_index(std::span<const Quantity> quantities, std::string_view kind,
                          std::string_view name) {
  for (std::size_t i = 0; i < quantities.size(); ++i)
    if (quantities[i].name == name) return i;
  refuse_unknown(kind, name, names_of(quantities));
}

double parse_number(std::string_view text, std::string_view where) {
  std::string_view trimmed = text;
  while (!trimmed.empty() && std::isspace(static_cast<unsigned char>(trimmed.front())))
    trimmed.remove_prefix(1);
  while (!trimmed.empty() && std::isspace(static_cast<unsigned char>(trimmed.back())))
    trimmed.remove_suffix(1);
  if (trimmed.starts_with('+')) trimmed.remove_prefix(1);
  double value = 0;
  const auto [end, code] = std::from_chars(trimmed.data(), trimmed.data() + trimmed.size(), value);
  if (code == std::errc::result_out_of_range) {
    // Denormal or overflowing text: strtod rounds it to the nearest representable value.
    value = std::strtod(std::string(trimmed).c_str(), nullptr);
  } else if (code != std::errc() || end != trimmed.data() + trimmed.size() || trimmed.empty()) {
    throw InputError(fmt::format("{}: '{}' is not a number", where, text));
  }
  return value;
}

std::pair<std::string, double> parse_assignment(std::string_view text, std::string_view option) {
  const std::size_t equals = text.find('=');
  if (equals == std::string_view::npos || equals == 0)
    throw InputError(fmt::format("{}: expected name=value, got '{}'", option, text));
  std::string name(text.substr(0, equals));
  return {name, parse_number(text.substr(equals + 1), fmt::format("{} {}", option, name))};
}

std::string failure_text(std::string_view message, const std::string& kept_in) {
  std::string text(message);
  if (!text.empty() && text.back() != '.') text += '.';
  if (!kept_in.empty()) text += fmt::format(" The last good state is in {}.", kept_in);
  return text;
}

std::string to_text(double value) { return fmt::format("{}", value); }

std::string figure_text(double value, int decimals) {
  constexpr double longest = 1e9;
  return std::abs(value) < longest ? fmt::format("{:.{}f}", value, decimals) : fmt::format("{:.6g}", value);
}

}  // namespace wiggers
