#include <fmt/format.h>

#include <iterator>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/files.hpp>
#include <wiggers/core/table.hpp>

namespace wiggers {

Column& Table::add(std::string name, std::string unit, std::string meaning) {
  columns.push_back({std::move(name), std::move(unit), std::move(meaning), {}});
  return columns.back();
}

const Column* Table::find(std::string_view name) const {
  for (const Column& column : columns)
    if (column.name == name) return &column;
  return nullptr;
}

const Column& Table::at(std::string_view name) const {
  if (const Column* column = find(name)) return *column;
  std::vector<std::string> names;
  for (const Column& column : columns) names.push_back(column.name);
  refuse_unknown("column", name, names);
}

void Table::clear_rows() {
  for (Column& column : columns) column.values.clear();
}

namespace {
std::vector<std::string_view> split(std::string_view line, char separator) {
  std::vector<std::string_view> parts;
  while (true) {
    const std::size_t at = line.find(separator);
    parts.push_back(line.substr(0, at));
    if (at == std::string_view::npos) return parts;
    line.remove_prefix(at + 1);
  }
}
std::string_view trim(std::string_view text) {
  const auto first = text.find_first_not_of(" \t\r\"");
  if (first == std::string_view::npos) return {};
  return text.substr(first, text.find_last_not_of(" \t\r\"") - first + 1);
}
}  // namespace

Table read_csv(const std::filesystem::path& path) {
  std::string text = read_file(path);
  if (text.starts_with("\xEF\xBB\xBF")) text.erase(0, 3);  // byte-order mark
  Table table;
  std::size_t line_number = 0;
  for (std::string_view line : split(text, '\n')) {
    ++line_number;
    if (trim(line).empty()) continue;
    const auto cells = split(line, ',');
    if (table.columns.empty()) {
      for (std::string_view cell : cells) {
        const std::string_view heading = trim(cell);
        const std::size_t bracket = heading.find(" [");
        if (heading.empty())
          throw InputError(fmt::format("{}: line {}: a column has no name", path.string(), line_number));
        if (bracket != std::string_view::npos && heading.ends_with("]"))
          table.add(std::string(heading.substr(0, bracket)),
                    std::string(heading.substr(bracket + 2, heading.size() - bracket - 3)));
        else
          table.add(std::string(heading), "");
      }
      continue;
    }
    if (cells.size() != table.columns.size())
      throw InputError(fmt::format("{}: line {} has {} values, the first row has {} names", path.string(),
                                   line_number, cells.size(), table.columns.size()));
    for (std::size_t c = 0; c < cells.size(); ++c)
      table.columns[c].values.push_back(parse_number(
          trim(cells[c]),
          fmt::format("{}: line {}, column '{}'", path.string(), line_number, table.columns[c].name)));
  }
  if (table.columns.empty()) throw InputError(fmt::format("{}: no column names", path.string()));
  if (table.n_rows() == 0) throw InputError(fmt::format("{}: no rows below the column names", path.string()));
  return table;
}

void write_csv(const std::filesystem::path& path, const Table& table, bool with_units) {
  fmt::memory_buffer out;
  auto to = std::back_inserter(out);
  for (std::size_t c = 0; c < table.columns.size(); ++c) {
    const Column& column = table.columns[c];
    if (with_units && !column.unit.empty())
      fmt::format_to(to, "{}{} [{}]", c ? "," : "", column.name, column.unit);
    else
      fmt::format_to(to, "{}{}", c ? "," : "", column.name);
  }
  fmt::format_to(to, "\n");
  for (std::size_t row = 0; row < table.n_rows(); ++row) {
    for (std::size_t c = 0; c < table.columns.size(); ++c)
      fmt::format_to(to, "{}{:.17g}", c ? "," : "", table.columns[c].values[row]);
    fmt::format_to(to, "\n");
  }
  write_file_atomically(path, {out.data(), out.size()});
}

}  // namespace wiggers
