// Where the figures are that tests compare with.
#pragma once

#include <filesystem>
#include <string>
#include <wiggers/core/table.hpp>

// A committed file of tests/data.
inline wiggers::Table data_table(const std::string& name) {
  return wiggers::read_csv(std::string(WIGGERS_TEST_DATA) + "/" + name);
}

// A file of the full reference set; `have_reference` says whether this machine has it.
inline std::string reference_path(const std::string& name) {
  return std::string(WIGGERS_REFERENCE_DIR) + "/" + name;
}
inline bool have_reference(const std::string& name) { return std::filesystem::exists(reference_path(name)); }
inline wiggers::Table reference_table(const std::string& name) {
  return wiggers::read_csv(reference_path(name));
}
