#include "report_program.hpp"

#include <fcntl.h>
#include <fmt/core.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <optional>
#include <utility>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/files.hpp>
#include <wiggers/core/progress.hpp>

namespace wiggers::command {

namespace fs = std::filesystem;

namespace {

// Starts a program; what it writes to a descriptor, whose number is its last word, can be read from `answer`
// if one is asked for.
pid_t start_program(std::vector<std::string> words, int* answer) {
  int ends[2] = {-1, -1};
  if (answer) {
    if (::pipe2(ends, O_CLOEXEC) != 0) throw ResourceError("cannot start another program: no pipe is left");
    words.push_back(std::to_string(ends[1]));
  }
  std::vector<char*> arguments;
  for (std::string& word : words) arguments.push_back(word.data());
  arguments.push_back(nullptr);
  std::fflush(nullptr);
  const pid_t child = fork();
  if (child == 0) {
    if (answer) ::fcntl(ends[1], F_SETFD, 0);
    execvp(arguments[0], arguments.data());
    _exit(127);
  }
  if (answer) {
    ::close(ends[1]);
    *answer = ends[0];
  }
  if (child < 0) {
    if (answer) ::close(ends[0]);
    throw ResourceError(fmt::format("cannot start another program: {}", std::strerror(errno)));
  }
  return child;
}

int status_of(pid_t child) {
  int status = 0;
  while (waitpid(child, &status, 0) < 0)
    if (errno != EINTR) throw ResourceError("lost the report program");
  return WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
}

std::string read_all(int file) {
  std::string text, part(1 << 16, '\0');
  while (true) {
    const ssize_t n = ::read(file, part.data(), part.size());
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0) return text;
    text.append(part, 0, static_cast<std::size_t>(n));
  }
}

struct Part {
  std::string kind, name, bytes;
};

// The parts of an answer; nothing if it breaks off.
std::optional<std::vector<Part>> parts_of(std::string_view answer) {
  std::vector<Part> parts;
  while (true) {
    const std::size_t end = answer.find('\n');
    if (end == std::string_view::npos) return {};
    const std::string_view line = answer.substr(0, end);
    answer.remove_prefix(end + 1);
    const std::size_t first = line.find(' '), last = line.rfind(' ');
    if (first == std::string_view::npos || first == last) return {};
    const std::string digits(line.substr(last + 1));
    if (digits.empty() || digits.size() > 15 || digits.find_first_not_of("0123456789") != std::string::npos)
      return {};
    const std::size_t size = std::stoull(digits);
    if (size > answer.size()) return {};
    Part part{std::string(line.substr(0, first)), std::string(line.substr(first + 1, last - first - 1)),
              std::string(answer.substr(0, size))};
    answer.remove_prefix(size);
    if (part.kind == "end") return parts;
    parts.push_back(std::move(part));
  }
}

}  // namespace

std::string report_python() {
  if (const char* chosen = std::getenv("WIGGERS_PYTHON")) return chosen;
  const std::string configured = WIGGERS_PYTHON_DEFAULT;
  std::error_code ignored;
  if (!configured.empty() && fs::exists(configured, ignored)) return configured;
  return "python3";
}

fs::path report_folder() {
  std::error_code ignored;
  const fs::path executable = fs::read_symlink("/proc/self/exe", ignored);
  const fs::path installed = executable.parent_path() / ".." / "share" / "wiggers" / "report";
  if (fs::is_directory(installed, ignored)) return fs::canonical(installed, ignored);
  return WIGGERS_REPORT_SOURCE;
}

int run_program(const std::vector<std::string>& words) { return status_of(start_program(words, nullptr)); }

void write_report(const std::string& program, const fs::path& subject, const fs::path& folder) {
  const std::string python = report_python();
  int pipe = -1;
  const pid_t child =
      start_program({python, (report_folder() / program).string(), subject.string(), folder.string()}, &pipe);
  const std::string answer = read_all(pipe);
  ::close(pipe);
  const int status = status_of(child);
  check_interrupt();
  if (status == 127)
    throw ResourceError(fmt::format("cannot start Python as '{}'; set WIGGERS_PYTHON", python));
  const auto parts = parts_of(answer);
  if (!parts)
    throw ResourceError(
        status > 128 ? fmt::format("the report program was ended by signal {}", status - 128)
                     : fmt::format("the report program ended with status {} before its answer", status));
  for (const Part& part : *parts) {
    if (part.kind == "refuse") throw InputError(part.bytes);
    if (part.kind == "fail") throw ResourceError(part.bytes);
    if (part.kind == "file" &&
        (part.name.empty() || part.name[0] == '.' || part.name.find('/') != std::string::npos))
      throw InputError(fmt::format("'{}': a wall has a name that is no name of a file", subject.string()));
  }
  std::error_code failed;
  const bool made = fs::create_directories(folder, failed);
  if (failed)
    throw ResourceError(fmt::format("cannot make the folder '{}': {}", folder.string(), failed.message()));
  try {
    for (const Part& part : *parts)
      if (part.kind == "file") require_writable(folder / part.name, "-o", kind_of_report_file(part.name));
    const auto write = [&](bool page) {
      for (const Part& part : *parts)
        if (part.kind == "file" && (part.name == "index.html") == page)
          write_file_atomically(folder / part.name, part.bytes);
    };
    // The page is there only when all that belongs to it is.
    write(false);
    write(true);
  } catch (...) {
    if (made) fs::remove(folder, failed);  // if it is empty
    throw;
  }
  for (const Part& part : *parts)
    if (part.kind == "say") fmt::print("{}", part.bytes);
}

}  // namespace wiggers::command
