// Results that a run goes on from. First byte 'b': the rest are the bytes of a file. Else the rest are edits
// of a good result's entries, whose checksums are then made again: what must refuse them is their sense.
#include <algorithm>
#include <cmath>
#include <cstring>
#include <map>
#include <sstream>
#include <variant>
#include <vector>
#include <wiggers/core/result_file.hpp>
#include <wiggers/heart/run/run.hpp>
#include <wiggers/heart/scene/scene.hpp>

#include "fuzzing.hpp"

namespace {

using namespace wiggers;
using Entry = std::variant<std::vector<double>, double, std::string>;

// One beat in coarse steps: a small file, so that many are tried.
const Scene& scene() {
  static const Scene made =
      read_scene(WIGGERS_SCENES "/elastance_healthy.toml",
                 {"run.until=\"beats\"", "run.beats=1", "solver.inductors=\"implicit\"", "solver.dt_s=1e-2"});
  return made;
}

// A good result, entry by entry.
const std::map<std::string, Entry>& good() {
  static const std::map<std::string, Entry> entries = [] {
    const std::filesystem::path path = fuzzing::folder() / "good.h5";
    HeartRun run(scene());
    run.prepare(Progress::Style::quiet);
    run.advance(Progress::Style::quiet, path);
    std::map<std::string, Entry> all;
    const ResultReader file(path);
    std::istringstream list(file.text("/provenance/checksums"));
    std::string line;
    std::getline(list, line);
    while (std::getline(list, line)) {
      const std::string name = line.substr(line.find(' ') + 1);
      try {
        all[name] = file.dataset(name);
      } catch (const InputError&) {
        try {
          all[name] = file.scalar(name);
        } catch (const InputError&) {
          all[name] = file.text(name);
        }
      }
    }
    return all;
  }();
  return entries;
}

// Numbers from the input, zeros once it is at its end.
class Bytes {
 public:
  Bytes(const std::uint8_t* data, std::size_t size) : data_(data), size_(size) {}
  bool more() const { return at_ < size_; }
  template <class T>
  T take() {
    T value{};
    const std::size_t n = std::min(sizeof(T), size_ - at_);
    std::memcpy(&value, data_ + at_, n);
    at_ += n;
    return value;
  }

 private:
  const std::uint8_t* data_;
  std::size_t size_, at_ = 0;
};

constexpr int most_edits = 16;

void edit(std::map<std::string, Entry>& entries, Bytes& bytes) {
  auto place = entries.begin();
  std::advance(place, bytes.take<std::uint16_t>() % entries.size());
  const auto kind = bytes.take<std::uint8_t>() % 6;
  const auto where = bytes.take<std::uint16_t>();
  const double value = bytes.take<double>();
  Entry& entry = place->second;
  if (kind == 0) {
    entries.erase(place);
  } else if (kind == 1) {
    entry = value;
  } else if (kind == 2) {
    entry = std::string(where % 5000, 'x');
  } else if (auto* row = std::get_if<std::vector<double>>(&entry)) {
    if (kind == 3)
      row->resize(where % 5000, value);
    else if (!row->empty())
      (*row)[where % row->size()] = kind == 4 ? value : (*row)[where % row->size()] * value;
  } else if (auto* number = std::get_if<double>(&entry)) {
    *number = value;
  } else {
    std::string& text = std::get<std::string>(entry);
    if (!text.empty()) text[where % text.size()] = static_cast<char>(std::signbit(value) ? ' ' : '7');
  }
}

void go_on(const std::filesystem::path& path) {
  HeartRun run(scene());
  run.resume(path);
  for (const double value : run.driver().values())
    fuzzing::require(std::isfinite(value), "a value of the circulation");
  for (const Column& column : run.trace().columns)
    for (const double value : column.values) fuzzing::require(std::isfinite(value), "a row of the trace");
  const LimitCycleCertificate& c = run.certificate();
  fuzzing::require(std::isfinite(c.distance) && std::isfinite(c.residual) && !c.text().empty(),
                   "the certificate");
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  (void)good();  // what fails here is no finding: the fuzzer itself is wrong
  const std::filesystem::path path = fuzzing::folder() / "r.h5";
  fuzzing::must_end_in_words([&] {
    if (data[0] == 'b') {
      fuzzing::file("r.h5", {reinterpret_cast<const char*>(data) + 1, size - 1});
    } else {
      std::map<std::string, Entry> entries = good();
      Bytes bytes(data + 1, size - 1);
      for (int n = 0; n < most_edits && bytes.more() && !entries.empty(); ++n) edit(entries, bytes);
      std::filesystem::remove(path);
      ResultWriter file;
      for (const auto& [name, entry] : entries) {
        if (const auto* row = std::get_if<std::vector<double>>(&entry))
          file.dataset(name, *row, "1", "");
        else if (const auto* number = std::get_if<double>(&entry))
          file.scalar(name, *number, "1", "");
        else if (name != "/provenance/checksums")
          file.text(name, std::get<std::string>(entry));
      }
      file.write(path);
    }
    go_on(path);
  });
  return 0;
}
