#include <fcntl.h>
#include <fmt/format.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <fstream>
#include <sstream>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/files.hpp>

namespace wiggers {

namespace fs = std::filesystem;

namespace {
fs::path folder_of(const fs::path& path) {
  return path.has_parent_path() ? path.parent_path() : fs::path(".");
}

// The neighbour that a file is written to before it is renamed into place.
std::string partial_name(const fs::path& path) {
  return fmt::format("{}.{}.partial", path.string(), getpid());
}
}  // namespace

bool is_special(const fs::path& path) {
  std::error_code ignored;
  const auto status = fs::status(path, ignored);
  if (!fs::exists(status) || fs::is_directory(status)) return false;
  // Links there lead to what the shell has opened, a file perhaps; the link itself must not be replaced.
  const std::string folder = path.parent_path().string();
  return !fs::is_regular_file(status) || folder == "/dev" || folder == "/dev/fd" || folder == "/proc/self/fd";
}

void write_file_atomically(const fs::path& path, std::string_view bytes) {
  const bool special = is_special(path);
  const fs::path target = special ? path : fs::path(partial_name(path));
  const auto fail = [&](std::string_view what) {
    const int code = errno;
    if (!special) ::unlink(target.c_str());
    std::error_code ignored;
    throw ResourceError(
        fmt::format("cannot {} '{}': {}.{}{}", what, path.string(), std::strerror(code),
                    code == ENOSPC || code == EFBIG || code == EDQUOT ? " Free some space." : "",
                    fs::exists(path, ignored) ? " The earlier file was kept." : ""));
  };
  const int file =
      special ? ::open(target.c_str(), O_WRONLY) : ::open(target.c_str(), O_WRONLY | O_CREAT | O_TRUNC, 0644);
  if (file < 0) fail("create");
  std::size_t written = 0;
  while (written < bytes.size()) {
    const ssize_t n = ::write(file, bytes.data() + written, bytes.size() - written);
    if (n < 0 && errno == EINTR) continue;
    if (n < 0) {
      const int code = errno;
      ::close(file);
      errno = code;
      fail("write");
    }
    written += static_cast<std::size_t>(n);
  }
  if (!special && ::fsync(file) != 0) {
    const int code = errno;
    ::close(file);
    errno = code;
    fail("flush");
  }
  if (::close(file) != 0) fail("close");
  if (!special && ::rename(target.c_str(), path.c_str()) != 0) fail("replace");
}

void require_writable(const fs::path& path, std::string_view option) {
  if (is_special(path)) return;
  const fs::path folder = folder_of(path);
  std::error_code ignored;
  if (fs::is_directory(path, ignored))
    throw InputError(fmt::format("{}: '{}' is a folder; name a file", option, path.string()));
  if (!fs::is_directory(folder, ignored))
    throw InputError(fmt::format("{}: there is no folder '{}'", option, folder.string()));
  // Try it: names too long, read-only or virtual file systems show here and not after the work.
  const std::string trial = partial_name(path);
  const int file = ::open(trial.c_str(), O_WRONLY | O_CREAT | O_TRUNC, 0644);
  if (file >= 0) {
    ::close(file);
    ::unlink(trial.c_str());
  } else {
    throw InputError(
        fmt::format("{}: '{}' cannot be written: {}", option, path.string(), std::strerror(errno)));
  }
}

void refuse_overwriting(const fs::path& output, std::string_view option, const fs::path& input) {
  std::error_code ignored;
  if (!output.empty() && !input.empty() && !is_special(output) &&
      (output == input || fs::equivalent(output, input, ignored)))
    throw InputError(
        fmt::format("{}: '{}' is an input of this command; name another file", option, output.string()));
}

std::string read_file(const fs::path& path) {
  std::error_code ignored;
  if (fs::is_directory(path, ignored))
    throw InputError(fmt::format("'{}' is a folder; name a file", path.string()));
  std::ifstream file(path, std::ios::binary);
  if (!file) throw InputError(fmt::format("cannot read '{}': {}", path.string(), std::strerror(errno)));
  std::ostringstream text;
  text << file.rdbuf();
  return text.str();
}

}  // namespace wiggers
