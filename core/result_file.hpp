// The result file: one HDF5 file, always whole.
//
// The file is assembled in memory and written in one go by write_file_atomically: a kill at any moment leaves
// the previous complete state. Datasets carry `unit` and `meaning` attributes. /provenance/checksums lists a
// checksum of every entry, and one of the list.
//
// What is read is believed in nothing: kind, rank and length of an entry are looked at before its content.
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <string>
#include <vector>

namespace wiggers {

class ResultWriter {
 public:
  ResultWriter();
  ~ResultWriter();
  ResultWriter(const ResultWriter&) = delete;
  ResultWriter& operator=(const ResultWriter&) = delete;

  // Groups on the way are made as needed: "/cavities/LV/pressure".
  void dataset(const std::string& path, const std::vector<double>& values, const std::string& unit,
               const std::string& meaning);
  void scalar(const std::string& path, double value, const std::string& unit, const std::string& meaning);
  void text(const std::string& path, const std::string& value);

  // Ends the assembly and writes the file.
  void write(const std::filesystem::path& path);

 private:
  struct Implementation;
  std::unique_ptr<Implementation> implementation_;
};

class ResultReader {
 public:
  // Refuses, with the reason, what is no readable HDF5 file.
  explicit ResultReader(const std::filesystem::path& path);
  ~ResultReader();
  ResultReader(const ResultReader&) = delete;
  ResultReader& operator=(const ResultReader&) = delete;

  bool has(const std::string& path) const;
  // One row of numbers; `finite` refuses others, `n` another length.
  std::vector<double> dataset(const std::string& path) const;
  std::vector<double> finite(const std::string& path) const;
  std::vector<double> finite(const std::string& path, std::size_t n) const;
  double scalar(const std::string& path) const;
  std::string text(const std::string& path) const;
  // "FILE: ENTRY", for messages.
  std::string place(const std::string& path) const;

  // Looks at every entry as the readers above do, before another program reads the file: refuses links to
  // other places and files, sizes that the file cannot hold, and more than fits into the memory.
  void require_sensible_sizes() const;

  // Refuses a file without checksums, or of which an entry is not as it was written, by name.
  void verify() const;

 private:
  struct Implementation;
  std::unique_ptr<Implementation> implementation_;
};

}  // namespace wiggers
