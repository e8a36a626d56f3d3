// What the fuzzers share. An input is put into a file in memory, read as a user's would be, and must end in a
// value that makes sense or in one of the errors with words; anything else (a crash, another exception, a
// sanitizer's finding, too much time or memory) is a finding.
#pragma once

#include <unistd.h>

#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <string>
#include <string_view>
#include <wiggers/core/errors.hpp>

namespace fuzzing {

inline const std::filesystem::path& folder() {
  static const std::filesystem::path made = [] {
    const std::filesystem::path memory = "/dev/shm";
    std::filesystem::path path =
        std::filesystem::is_directory(memory) ? memory : std::filesystem::temp_directory_path();
    path /= "wiggers-fuzz-" + std::to_string(getpid());
    std::filesystem::create_directories(path);
    std::atexit([] { std::filesystem::remove_all(folder()); });
    return path;
  }();
  return made;
}

// Of one name each, so that the memory of which files were read stays small.
inline std::filesystem::path file(const std::string& name, std::string_view bytes) {
  const std::filesystem::path path = folder() / name;
  std::ofstream(path, std::ios::binary | std::ios::trunc) << bytes;
  return path;
}

inline void require_words(std::string_view what) {
  if (what.size() >= 10 && what.size() <= 20000) return;
  std::fprintf(stderr, "no words for people (%zu bytes): %.200s\n", what.size(), what.data());
  std::abort();
}

// Runs the reader; what it says to whom it refuses must be words of a bearable length.
template <class Reader>
void must_end_in_words(Reader&& reader) {
  try {
    reader();
  } catch (const wiggers::InputError& error) {
    require_words(error.what());
  } catch (const wiggers::NumericalFailure& error) {
    require_words(error.what());
  } catch (const wiggers::ResourceError& error) {
    require_words(error.what());
  }
}

inline void require(bool good, const char* what) {
  if (good) return;
  std::fprintf(stderr, "taken, and makes no sense: %s\n", what);
  std::abort();
}

}  // namespace fuzzing
