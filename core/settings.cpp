#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <sstream>
#include <toml.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/files.hpp>
#include <wiggers/core/settings.hpp>

namespace wiggers {

namespace {

SettingsValue convert(const toml::value& value, const std::string& file, const std::string& place);

std::shared_ptr<SettingsTable> convert_table(const toml::value& value, const std::string& file,
                                             const std::string& place) {
  auto table = std::make_shared<SettingsTable>();
  for (const auto& [key, entry] : value.as_table())
    table->entries[key] = convert(entry, file, place.empty() ? key : place + "." + key);
  return table;
}

SettingsValue convert(const toml::value& value, const std::string& file, const std::string& place) {
  if (value.is_boolean()) return {value.as_boolean(), false};
  if (value.is_integer()) return {static_cast<double>(value.as_integer()), true};
  if (value.is_floating()) return {value.as_floating(), false};
  if (value.is_string()) return {value.as_string().str, false};
  if (value.is_table()) return {convert_table(value, file, place), false};
  throw InputError(
      fmt::format("{}: {}: only numbers, text, true/false and tables are understood", file, place));
}

// The parser descends once per bracket and per dot: text made to exhaust the stack is refused first.
void refuse_deep_nesting(const std::string& text, const std::string& name) {
  int depth = 0, dots = 0;
  for (char c : text) {
    if (c == '[' || c == '{') ++depth;
    if (c == ']' || c == '}') --depth;
    dots = c == '\n' || c == '=' ? 0 : dots + (c == '.');
    if (depth > 100 || dots > 1000)
      throw InputError(fmt::format("{}: nested too deeply to be settings", name));
  }
}

// Bytes of the UTF-8 character at the start of `text`; 0 if there is none (Unicode 15, table 3-7).
std::size_t utf8_length(std::string_view text) {
  const auto byte = [&](std::size_t k) { return k < text.size() ? static_cast<unsigned char>(text[k]) : 0u; };
  const unsigned first = byte(0);
  if (first < 0x80) return 1;
  if (first < 0xC2 || first > 0xF4) return 0;
  const std::size_t length = first < 0xE0 ? 2 : first < 0xF0 ? 3 : 4;
  const unsigned low = first == 0xE0 ? 0xA0 : first == 0xF0 ? 0x90 : 0x80;
  const unsigned high = first == 0xED ? 0x9F : first == 0xF4 ? 0x8F : 0xBF;
  if (byte(1) < low || byte(1) > high) return 0;
  for (std::size_t k = 2; k < length; ++k)
    if (byte(k) < 0x80 || byte(k) > 0xBF) return 0;
  return length;
}

// The parser leaves its text where it meets another encoding within quotes.
void refuse_other_encodings(const std::string& text, const std::string& name) {
  const std::string_view all = text;
  std::size_t line = 1;
  for (std::size_t at = 0, length = 0; at < all.size(); at += length) {
    length = utf8_length(all.substr(at));
    if (length == 0)
      throw InputError(fmt::format("{}: line {}: not valid TOML: byte {:#04x} is no UTF-8 text", name, line,
                                   static_cast<unsigned char>(all[at])));
    line += all[at] == '\n';
  }
}

std::string kind_of(const SettingsValue& value) {
  switch (value.data.index()) {
    case 0:
      return "true/false";
    case 1:
      return "a number";
    case 2:
      return "text";
    default:
      return "a table";
  }
}

std::string toml_text(std::string_view text) {
  std::string out = "\"";
  for (char c : text) {
    if (static_cast<unsigned char>(c) < 0x20) {
      out += fmt::format("\\u{:04x}", static_cast<int>(c));
      continue;
    }
    if (c == '"' || c == '\\') out += '\\';
    out += c;
  }
  return out + "\"";
}

// A key as it stands in TOML: quoted where it is no bare word.
std::string written_key(std::string_view key) {
  const bool bare = !key.empty() && std::all_of(key.begin(), key.end(), [](unsigned char c) {
    return std::isalnum(c) || c == '_' || c == '-';
  });
  return bare ? std::string(key) : toml_text(key);
}

// A value that is no table, as it stands in TOML.
std::string written_value(const SettingsValue& value) {
  if (const bool* flag = std::get_if<bool>(&value.data)) return *flag ? "true" : "false";
  if (const double* number = std::get_if<double>(&value.data)) return to_text(*number);
  return toml_text(std::get<std::string>(value.data));
}

}  // namespace

std::shared_ptr<SettingsTable> parse_settings_text(const std::string& text, const std::string& name) {
  try {
    refuse_other_encodings(text, name);
    refuse_deep_nesting(text, name);
    std::istringstream stream(text);
    return convert_table(toml::parse(stream, name), name, "");
  } catch (const toml::exception& error) {
    std::string message = error.what();
    while (!message.empty() && message.back() == '\n') message.pop_back();
    throw InputError(fmt::format("{}: not valid TOML:\n{}", name, message));
  }
}

std::shared_ptr<SettingsTable> parse_settings_file(const std::filesystem::path& path) {
  return parse_settings_text(read_file(path), path.string());
}

namespace {

// The value of a dotted key, made where there is none.
SettingsValue& entry_at(SettingsTable& root, std::string_view key) {
  SettingsTable* table = &root;
  std::string_view rest = key;
  for (std::size_t dot = rest.find('.'); dot != std::string_view::npos; dot = rest.find('.')) {
    SettingsValue& entry = table->entries[std::string(rest.substr(0, dot))];
    if (!std::holds_alternative<std::shared_ptr<SettingsTable>>(entry.data)) {
      if (const auto* name = std::get_if<std::string>(&entry.data)) {
        // A named set stands for the table: keep it as the base of the changes.
        auto replaced = std::make_shared<SettingsTable>();
        replaced->entries["parameters"] = {*name, false};
        entry = {replaced, false};
      } else {
        entry = {std::make_shared<SettingsTable>(), false};
      }
    }
    table = std::get<std::shared_ptr<SettingsTable>>(entry.data).get();
    rest.remove_prefix(dot + 1);
  }
  return table->entries[std::string(rest)];
}

}  // namespace

void override_setting(SettingsTable& table, std::string_view key, double value) {
  entry_at(table, key) = {value, false};
}

void override_setting(SettingsTable& table, std::string_view assignment) {
  const std::size_t equals = assignment.find('=');
  if (equals == std::string_view::npos || equals == 0)
    throw InputError(fmt::format("--set: expected key=value, got '{}'", assignment));
  const std::string key(assignment.substr(0, equals));
  const std::string value(assignment.substr(equals + 1));
  if (value.find('\n') != std::string::npos)
    throw InputError(fmt::format("--set {}: one key at a time", key));
  std::shared_ptr<SettingsTable> parsed;
  try {
    parsed = parse_settings_text("x = " + value, "--set " + key);
  } catch (const InputError&) {
    parsed = parse_settings_text("x = " + toml_text(value), "--set " + key);
  }
  entry_at(table, key) = parsed->entries.at("x");
}

SettingsReader::SettingsReader(std::shared_ptr<SettingsTable> table, std::string file, std::string path)
    : table_(std::move(table)), file_(std::move(file)), path_(std::move(path)) {}

const SettingsValue* SettingsReader::find(std::string_view key) const {
  const auto it = table_->entries.find(std::string(key));
  return it == table_->entries.end() ? nullptr : &it->second;
}

bool SettingsReader::has(std::string_view key) const {
  asked_.insert(std::string(key));
  return find(key) != nullptr;
}
bool SettingsReader::is_text(std::string_view key) const {
  asked_.insert(std::string(key));
  const SettingsValue* value = find(key);
  return value && std::holds_alternative<std::string>(value->data);
}
bool SettingsReader::is_flag(std::string_view key) const {
  asked_.insert(std::string(key));
  const SettingsValue* value = find(key);
  return value && std::holds_alternative<bool>(value->data);
}
bool SettingsReader::is_table(std::string_view key) const {
  asked_.insert(std::string(key));
  const SettingsValue* value = find(key);
  return value && std::holds_alternative<std::shared_ptr<SettingsTable>>(value->data);
}

std::string SettingsReader::place(std::string_view key) const {
  return fmt::format("{}: {}{}{}", file_, path_, path_.empty() ? "" : ".", key);
}

void SettingsReader::remember(std::string_view key, SettingsValue value) {
  for (auto& [known, there] : read_)
    if (known == key) {
      there = std::move(value);
      return;
    }
  read_.emplace_back(std::string(key), std::move(value));
}

double SettingsReader::number(const Quantity& quantity) { return number(quantity, quantity.default_value); }

double SettingsReader::number(const Quantity& quantity, double default_value) {
  double result = default_value;
  if (const SettingsValue* value = find(quantity.name)) {
    const double* number = std::get_if<double>(&value->data);
    if (!number)
      throw InputError(fmt::format("{} must be a number in {} ({} to {}), not {}; it is the {}",
                                   place(quantity.name), quantity.unit, to_text(quantity.lower),
                                   to_text(quantity.upper), kind_of(*value), quantity.meaning));
    result = *number;
    check_range(quantity, result, place(quantity.name));
  }
  remember(quantity.name, {result, false});
  return result;
}

long SettingsReader::integer(const Quantity& quantity) {
  const double value = number(quantity);
  if (value != std::floor(value))
    throw InputError(fmt::format("{} = {} must be a whole number", place(quantity.name), to_text(value)));
  return static_cast<long>(value);
}

bool SettingsReader::flag(std::string_view key, bool default_value) {
  bool result = default_value;
  if (const SettingsValue* value = find(key)) {
    const bool* flag = std::get_if<bool>(&value->data);
    if (!flag) throw InputError(fmt::format("{} must be true or false, not {}", place(key), kind_of(*value)));
    result = *flag;
  }
  remember(key, {result, false});
  return result;
}

std::string SettingsReader::text(std::string_view key, std::string_view default_value) {
  std::string result(default_value);
  if (const SettingsValue* value = find(key)) {
    const std::string* text = std::get_if<std::string>(&value->data);
    if (!text)
      throw InputError(fmt::format("{} must be text in quotes, not {}", place(key), kind_of(*value)));
    result = *text;
  }
  remember(key, {result, false});
  return result;
}

std::string SettingsReader::choice(std::string_view key, std::string_view default_value,
                                   std::span<const std::string> choices, std::string_view kind) {
  const std::string result = text(key, default_value);
  if (std::find(choices.begin(), choices.end(), result) == choices.end()) {
    try {
      refuse_unknown(kind, result, choices);
    } catch (const InputError& error) {
      throw InputError(fmt::format("{}: {}", place(key), error.what()));
    }
  }
  return result;
}

SettingsReader& SettingsReader::table(std::string_view key) {
  for (auto& [name, child] : children_)
    if (name == key) return *child;
  std::shared_ptr<SettingsTable> entries = std::make_shared<SettingsTable>();
  if (const SettingsValue* value = find(key)) {
    const auto* table = std::get_if<std::shared_ptr<SettingsTable>>(&value->data);
    if (!table) throw InputError(fmt::format("{} must be a table, not {}", place(key), kind_of(*value)));
    entries = *table;
  }
  const std::string part = written_key(key);
  const std::string inner = path_.empty() ? part : path_ + "." + part;
  children_.emplace_back(std::string(key), std::make_unique<SettingsReader>(entries, file_, inner));
  return *children_.back().second;
}

std::vector<std::string> SettingsReader::keys() const {
  std::vector<std::string> result;
  for (const auto& entry : table_->entries) result.push_back(entry.first);
  return result;
}

void SettingsReader::finish() const {
  std::vector<std::string> known;
  for (const auto& entry : read_) known.push_back(entry.first);
  for (const auto& entry : children_) known.push_back(entry.first);
  for (const auto& [key, value] : table_->entries) {
    if (std::find(known.begin(), known.end(), key) != known.end()) continue;
    // Keys that were asked for and are not here may stand in such a file as well: they help to find the right
    // name.
    std::vector<std::string> possible = known;
    for (const std::string& asked : asked_)
      if (std::find(known.begin(), known.end(), asked) == known.end()) possible.push_back(asked);
    try {
      refuse_unknown("key", key, possible);
    } catch (const InputError& error) {
      throw InputError(fmt::format("{}: {}", place(key), error.what()));
    }
  }
  for (const auto& entry : children_) entry.second->finish();
}

void SettingsReader::write(std::string& out) const {
  if (!path_.empty() && !read_.empty()) out += fmt::format("\n[{}]\n", path_);
  for (const auto& [key, value] : read_) {
    out += fmt::format("{} = {}\n", written_key(key), written_value(value));
  }
  for (const auto& entry : children_) entry.second->write(out);
}

std::string SettingsReader::full() const {
  std::string out;
  write(out);
  return out;
}

std::shared_ptr<SettingsTable> SettingsReader::filled() const {
  auto table = std::make_shared<SettingsTable>();
  for (const auto& [key, value] : read_) table->entries[key] = value;
  for (const auto& [key, child] : children_) table->entries[key] = {child->filled(), false};
  return table;
}

}  // namespace wiggers
