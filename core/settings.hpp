// Settings: TOML files read with manners.
//
// A reader takes each key by its Quantity or by its list of choices, checks type and range, remembers what
// was read (for `--full` listings), and refuses at the end every key that nobody asked for, with the nearest
// name.
#pragma once

#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <set>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <variant>
#include <vector>
#include <wiggers/core/quantity.hpp>

namespace wiggers {

class SettingsTable;

// One value of a settings file.
struct SettingsValue {
  std::variant<bool, double, std::string, std::shared_ptr<SettingsTable>> data;
  bool integer = false;  // a number written without point
};

class SettingsTable {
 public:
  std::map<std::string, SettingsValue> entries;
};

// Parses a TOML file, or text; errors name file and line. Dates and arrays are refused.
std::shared_ptr<SettingsTable> parse_settings_file(const std::filesystem::path& path);
std::shared_ptr<SettingsTable> parse_settings_text(const std::string& text, const std::string& name);

// Applies "a.b.c=value" to the table; the value is read as TOML (a bare word counts as a string).
void override_setting(SettingsTable& table, std::string_view assignment);
// The same for a number, which takes no way through text.
void override_setting(SettingsTable& table, std::string_view key, double value);

class SettingsReader {
 public:
  // `path` is the dotted place of this table in the file, for messages.
  SettingsReader(std::shared_ptr<SettingsTable> table, std::string file, std::string path = "");

  bool has(std::string_view key) const;
  bool is_text(std::string_view key) const;
  bool is_flag(std::string_view key) const;  // true or false
  bool is_table(std::string_view key) const;

  double number(const Quantity& quantity);                        // its default where absent
  double number(const Quantity& quantity, double default_value);  // another default than the quantity's own
  long integer(const Quantity& quantity);
  bool flag(std::string_view key, bool default_value);
  std::string text(std::string_view key, std::string_view default_value);
  std::string choice(std::string_view key, std::string_view default_value,
                     std::span<const std::string> choices, std::string_view kind);
  // The sub-table (empty where absent); finish() of the parent includes it.
  SettingsReader& table(std::string_view key);
  std::vector<std::string> keys() const;

  // Name of a key as a user would find it: "scene.toml: walls.LV.activation_ms".
  std::string place(std::string_view key) const;

  // Refuses every key that was not read. Call once, on the outermost reader, when all is read.
  void finish() const;

  // Everything that was read, defaults included, as TOML.
  std::string full() const;
  // The same as a table to change and to read again.
  std::shared_ptr<SettingsTable> filled() const;

 private:
  const SettingsValue* find(std::string_view key) const;
  void remember(std::string_view key, SettingsValue value);
  void write(std::string& out) const;

  mutable std::set<std::string> asked_;  // keys whose presence was asked for
  std::shared_ptr<SettingsTable> table_;
  std::string file_;
  std::string path_;
  std::vector<std::pair<std::string, SettingsValue>> read_;
  std::vector<std::pair<std::string, std::unique_ptr<SettingsReader>>> children_;
};

}  // namespace wiggers
