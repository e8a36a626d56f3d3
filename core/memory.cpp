#include <fmt/format.h>
#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <fstream>
#include <string>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/memory.hpp>

namespace wiggers {

double available_memory() {
  double bytes = static_cast<double>(sysconf(_SC_PHYS_PAGES)) * static_cast<double>(sysconf(_SC_PAGESIZE));
  std::ifstream facts("/proc/meminfo");
  for (std::string line; std::getline(facts, line);)
    if (line.starts_with("MemAvailable:")) bytes = std::min(bytes, 1024 * std::stod(line.substr(13)));
  // Containers are often given less than the machine has; "max" is no number.
  double limit = 0, used = 0;
  if (std::ifstream("/sys/fs/cgroup/memory.max") >> limit &&
      std::ifstream("/sys/fs/cgroup/memory.current") >> used)
    bytes = std::min(bytes, std::max(0.0, limit - used));
  rlimit own{};
  long pages = 0;
  if (::getrlimit(RLIMIT_AS, &own) == 0 && own.rlim_cur != RLIM_INFINITY &&
      std::ifstream("/proc/self/statm") >> pages)
    bytes = std::min(
        bytes, std::max(0.0, static_cast<double>(own.rlim_cur) -
                                 static_cast<double>(pages) * static_cast<double>(sysconf(_SC_PAGESIZE))));
  return bytes;
}

void require_memory(double rows, double columns, std::string_view asked_by, std::string_view remedy) {
  const double bytes = rows * columns * sizeof(double);
  if (bytes < 1e8) return;  // always to be had; the look costs some time
  const double most = 0.25 * available_memory();
  if (bytes <= most) return;
  throw InputError(fmt::format(
      "{} asks for {:.3g} rows of {:.0f} numbers, {:.3g} GB; a quarter of the memory that is free "
      "here is {:.3g} GB, {:.3g} rows. {}",
      asked_by, rows, columns, bytes / 1e9, most / 1e9, most / (columns * sizeof(double)), remedy));
}

}  // namespace wiggers
