// Tables of named columns with units: CSV in and out ("name [unit]" in the first row).
#pragma once

#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

namespace wiggers {

struct Column {
  std::string name;
  std::string unit;
  std::string meaning;
  std::vector<double> values;
};

class Table {
 public:
  Column& add(std::string name, std::string unit, std::string meaning = "");
  const Column* find(std::string_view name) const;
  const Column& at(std::string_view name) const;  // refuses an unknown name with the nearest
  std::size_t n_rows() const { return columns.empty() ? 0 : columns.front().values.size(); }
  void clear_rows();

  std::vector<Column> columns;
};

// Reads a CSV file whose first row has names, with or without " [unit]". Refuses ragged rows and text that is
// no number, naming line and column.
Table read_csv(const std::filesystem::path& path);

// 17 significant digits: reads back to the same doubles. Units are written when `with_units`.
void write_csv(const std::filesystem::path& path, const Table& table, bool with_units = true);

}  // namespace wiggers
