#include <fcntl.h>
#include <fmt/format.h>
#include <poll.h>
#include <signal.h>
#include <sys/file.h>
#include <sys/random.h>
#include <sys/stat.h>
#include <sys/vfs.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <ctime>
#include <map>
#include <mutex>
#include <optional>
#include <thread>
#include <utility>
#include <vector>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/files.hpp>
#include <wiggers/core/progress.hpp>

namespace wiggers {

namespace fs = std::filesystem;

namespace {

constexpr std::string_view partial_ending = ".partial";
constexpr std::size_t most_bytes_of_a_pipe = std::size_t{1} << 28;
constexpr auto longest_wait_for_a_writer = std::chrono::seconds(5);
constexpr time_t old_enough_to_be_left_over_s = 60;
constexpr int most_links = 40;

// A file descriptor that closes itself.
struct Descriptor {
  int number = -1;
  explicit Descriptor(int n) : number(n) {}
  Descriptor(const Descriptor&) = delete;
  Descriptor& operator=(const Descriptor&) = delete;
  ~Descriptor() {
    if (number >= 0) ::close(number);
  }
};

fs::path folder_of(const fs::path& path) {
  return path.has_parent_path() ? path.parent_path() : fs::path(".");
}

// The real folder of a path, or nothing where there is none.
std::string real_folder(const fs::path& path) {
  std::error_code failed;
  const fs::path folder = fs::canonical(folder_of(path), failed);
  return failed ? std::string() : folder.string();
}

bool is_in_proc(const std::string& folder) {
  constexpr long proc_magic = 0x9fa0;
  struct statfs facts {};
  return !folder.empty() && ::statfs(folder.c_str(), &facts) == 0 && facts.f_type == proc_magic;
}

// Follows links one by one to the file that is to be written, which need not exist. Stops at what must not be
// replaced: entries of /dev and of the list of open files, themselves links perhaps.
struct Target {
  fs::path path;
  bool special = false;
  std::string trouble;  // why it cannot be a target
};
Target target_of(const fs::path& named) {
  Target target{named, false, {}};
  for (int links = 0; links < most_links; ++links) {
    struct stat facts {};
    if (::lstat(target.path.c_str(), &facts) != 0) return target;
    const std::string folder = real_folder(target.path);
    if (!S_ISDIR(facts.st_mode) && (folder == "/dev" || is_in_proc(folder))) {
      target.special = true;
      return target;
    }
    if (!S_ISLNK(facts.st_mode)) {
      target.special = !S_ISREG(facts.st_mode) && !S_ISDIR(facts.st_mode);
      return target;
    }
    // As the kernel does where its own protection is on: others' links in a folder for all are not followed.
    struct stat around {};
    if (::stat(folder_of(target.path).c_str(), &around) == 0 && (around.st_mode & S_ISVTX) &&
        (around.st_mode & S_IWOTH) && facts.st_uid != ::geteuid() && facts.st_uid != around.st_uid) {
      target.trouble = "it is another user's link in a folder that all may write to";
      return target;
    }
    std::error_code failed;
    const fs::path next = fs::read_symlink(target.path, failed);
    if (failed) {
      target.trouble = failed.message();
      return target;
    }
    target.path = next.is_absolute() ? next : folder_of(target.path) / next;
  }
  target.trouble = "too many links lead to one another";
  return target;
}

std::string random_word() {
  std::uint64_t bits = 0;
  for (std::size_t got = 0; got < sizeof bits;) {
    const ssize_t n = ::getrandom(reinterpret_cast<char*>(&bits) + got, sizeof bits - got, 0);
    if (n > 0) got += static_cast<std::size_t>(n);
    if (n < 0 && errno != EINTR) throw ResourceError("the system gives no random numbers");
  }
  return fmt::format("{:016x}", bits);
}

// The longest name of a file in a folder, in bytes.
std::size_t longest_name(const fs::path& folder) {
  const long most = ::pathconf(folder.c_str(), _PC_NAME_MAX);
  return most > 0 ? static_cast<std::size_t>(most) : 255;
}

// What the partial neighbours of a target begin with: its name, or so much of it (whole characters) as leaves
// room for the rest.
std::string partial_stem(const fs::path& target) {
  constexpr std::size_t rest = 1 + 9 + 1 + 16 + partial_ending.size();  // .PROCESS-RANDOM.partial
  const std::size_t most = std::max(longest_name(folder_of(target)), rest + 1) - rest;
  std::string name = target.filename().string();
  if (name.size() <= most) return name;
  std::size_t end = most;
  while (end > 0 && (static_cast<unsigned char>(name[end]) & 0xC0) == 0x80) --end;
  name.resize(end);
  return name;
}

// NAME.PROCESS-RANDOM.partial
std::string partial_name(const fs::path& target) {
  return (target.parent_path() /
          fmt::format("{}.{}-{}{}", partial_stem(target), ::getpid(), random_word(), partial_ending))
      .string();
}

// Creates the neighbour that is to replace `target`; on failure errno says why.
int create_partial(const std::string& name, mode_t mode) {
  const int file = ::open(name.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_NOFOLLOW | O_CLOEXEC, mode);
  if (file >= 0) (void)::flock(file, LOCK_EX | LOCK_NB);  // as long as it is locked, it is being written
  return file;
}

// The process that wrote a partial neighbour of the target called `name`; nothing for other files.
std::optional<pid_t> writer_of(std::string_view file, std::string_view name) {
  if (!file.starts_with(name) || !file.ends_with(partial_ending)) return {};
  file.remove_prefix(name.size());
  if (file.size() <= partial_ending.size()) return {};
  file.remove_suffix(partial_ending.size());
  const auto all = [](std::string_view text, const char* allowed) {
    return !text.empty() && text.find_first_not_of(allowed) == std::string_view::npos;
  };
  const std::size_t dash = file.find('-');
  if (dash == std::string_view::npos || file.front() != '.') return {};
  const std::string_view process = file.substr(1, dash - 1), word = file.substr(dash + 1);
  if (!all(process, "0123456789") || process.size() > 9 || word.size() != 16 ||
      !all(word, "0123456789abcdef"))
    return {};
  return static_cast<pid_t>(std::stol(std::string(process)));
}

// ---- inputs and outputs of this process ----

struct Output {
  fs::path path;
  std::string option;
  bool folder = false;
  bool gone_on_in = false;
};
struct Registry {
  std::mutex mutex;
  std::vector<fs::path> inputs;
  std::vector<Output> outputs;
  std::map<std::string, std::string> special;  // what came out of pipes and devices
};
Registry& registry() {
  static Registry one;
  return one;
}

fs::path whole_path(const fs::path& path) {
  std::error_code failed;
  const fs::path whole = fs::weakly_canonical(fs::absolute(path, failed), failed);
  return failed ? path : whole;
}

// The same file, by name or through links of any kind.
bool same_file(const fs::path& a, const fs::path& b) {
  std::error_code none;
  return a == b || fs::equivalent(a, b, none);
}

bool is_within(const fs::path& file, const fs::path& folder) {
  const auto end = std::mismatch(folder.begin(), folder.end(), file.begin(), file.end()).first;
  if (end == folder.end()) return true;
  // A second name of the file may stand in the folder.
  std::error_code none;
  if (fs::hard_link_count(file, none) < 2 || none) return false;
  for (const auto& entry : fs::directory_iterator(folder, none))
    if (same_file(entry.path(), file)) return true;
  return false;
}

bool touches(const Output& output, const fs::path& input) {
  return output.folder ? is_within(input, output.path) : same_file(output.path, input);
}

[[noreturn]] void refuse_touching(const Output& output, const fs::path& input) {
  if (output.folder)
    throw InputError(
        fmt::format("{}: files in '{}' will be replaced, and '{}' there is an input of this "
                    "command; name another file",
                    output.option, output.path.string(), input.string()));
  throw InputError(fmt::format("{}: '{}' is an input of this command; name another file", output.option,
                               output.path.string()));
}

void record_output(const fs::path& path, std::string_view option, bool folder) {
  Registry& r = registry();
  const Output now{whole_path(path), std::string(option), folder, false};
  const std::lock_guard lock(r.mutex);
  for (const Output& other : r.outputs) {
    if (other.folder || folder || !same_file(other.path, now.path)) continue;
    if (other.option == now.option || other.gone_on_in) return;
    throw InputError(fmt::format("{}: '{}' is the file of {} already; name another file", option,
                                 path.string(), other.option));
  }
  for (const fs::path& input : r.inputs)
    if (touches(now, input)) refuse_touching(now, input);
  r.outputs.push_back(now);
}

bool is_input(const fs::path& path) {
  Registry& r = registry();
  const std::lock_guard lock(r.mutex);
  return std::any_of(r.inputs.begin(), r.inputs.end(),
                     [&](const fs::path& input) { return same_file(input, path); });
}

// What killed runs left beside the target goes.
void remove_leftovers(const fs::path& target) {
  const std::string name = partial_stem(target);
  std::error_code failed;
  std::vector<fs::path> left;
  for (fs::directory_iterator entry(folder_of(target), failed), end; !failed && entry != end;
       entry.increment(failed)) {
    const auto writer = writer_of(entry->path().filename().string(), name);
    if (!writer) continue;
    const Descriptor file(
        ::open(entry->path().c_str(), O_RDONLY | O_NOFOLLOW | O_NONBLOCK | O_NOCTTY | O_CLOEXEC));
    struct stat facts {};
    if (file.number < 0 || ::fstat(file.number, &facts) != 0 || !S_ISREG(facts.st_mode)) continue;
    if (::flock(file.number, LOCK_EX | LOCK_NB) != 0) continue;
    const bool gone = ::kill(*writer, 0) != 0 && errno == ESRCH;
    if (gone || ::time(nullptr) - facts.st_mtime > old_enough_to_be_left_over_s)
      left.push_back(entry->path());
  }
  for (const fs::path& path : left)
    if (!is_input(path)) ::unlink(path.c_str());
}

// ---- writing ----

[[noreturn]] void fail(std::string_view what, const fs::path& path, int code, bool kept) {
  throw ResourceError(
      fmt::format("cannot {} '{}': {}.{}{}", what, path.string(), std::strerror(code),
                  code == ENOSPC || code == EFBIG || code == EDQUOT ? " Free some space." : "",
                  kept ? " The earlier file was kept." : ""));
}

// Returns errno, 0 for success.
int write_all(int file, std::string_view bytes) {
  while (!bytes.empty()) {
    const ssize_t n = ::write(file, bytes.data(), bytes.size());
    if (n >= 0) {
      bytes.remove_prefix(static_cast<std::size_t>(n));
    } else if (errno == EAGAIN) {
      pollfd wait{file, POLLOUT, 0};
      (void)::poll(&wait, 1, 100);
      check_interrupt();
    } else if (errno != EINTR) {
      return errno;
    }
  }
  return 0;
}

// The number of a file that this process has open, named as /dev/fd/N, /dev/stdout or /proc/self/fd/N.
std::optional<int> own_descriptor(const fs::path& path) {
  fs::path named = path;
  std::error_code failed;
  if (real_folder(path) == "/dev") {
    if (!fs::is_symlink(path, failed)) return {};
    named = fs::path("/dev") / fs::read_symlink(path, failed);
  }
  const std::string folder = real_folder(named), name = named.filename().string();
  if (folder != fmt::format("/proc/{}/fd", ::getpid()) || name.empty() || name.size() > 6 ||
      name.find_first_not_of("0123456789") != std::string::npos)
    return {};
  return std::stoi(name);
}

void write_through(const fs::path& path, std::string_view bytes) {
  // An open file is written where it stands, not from its beginning.
  int number = -1;
  if (const auto own = own_descriptor(path)) {
    std::fflush(nullptr);
    number = ::fcntl(*own, F_DUPFD_CLOEXEC, 0);
  } else {
    struct stat facts {};
    const bool pipe = ::stat(path.c_str(), &facts) == 0 && S_ISFIFO(facts.st_mode);
    const int flags = O_WRONLY | O_NOCTTY | O_CLOEXEC | (pipe ? O_NONBLOCK : 0);
    // Until somebody reads from a pipe.
    while ((number = ::open(path.c_str(), flags)) < 0 && (errno == EINTR || (pipe && errno == ENXIO))) {
      check_interrupt();
      std::this_thread::sleep_for(std::chrono::milliseconds(20));
    }
  }
  const Descriptor file(number);
  if (file.number < 0) fail("open", path, errno, false);
  if (const int code = write_all(file.number, bytes)) fail("write", path, code, false);
}

}  // namespace

void refuse_other_kind(const fs::path& path, std::string_view option, FileKind kind) {
  throw InputError(
      fmt::format("{}: '{}' is there already and is not {}: it would be lost; name another file, "
                  "or move it away",
                  option, path.string(), name_of(kind)));
}

bool is_special(const fs::path& path) { return target_of(path).special; }

void write_file_atomically(const fs::path& path, std::string_view bytes) {
  const Target target = target_of(path);
  if (!target.trouble.empty())
    throw ResourceError(fmt::format("cannot write '{}': {}", path.string(), target.trouble));
  if (target.special) {
    write_through(path, bytes);
    return;
  }
  struct stat earlier {};
  const bool exists = ::stat(target.path.c_str(), &earlier) == 0;
  remove_leftovers(target.path);
  const std::string partial = partial_name(target.path);
  const mode_t mode = exists ? earlier.st_mode & 0777 : 0666;
  Descriptor file(create_partial(partial, mode));
  if (file.number < 0) fail("create", path, errno, exists);
  const auto give_up = [&](std::string_view what, int code) {
    ::unlink(partial.c_str());
    fail(what, path, code, exists);
  };
  if (exists) {
    // An administrator's run leaves a user's file to the user, where the system allows it.
    if (earlier.st_uid != ::geteuid() && ::fchown(file.number, earlier.st_uid, earlier.st_gid) != 0)
      errno = 0;
    if (::fchmod(file.number, mode) != 0) give_up("set the mode of", errno);
  }
  try {
    if (const int code = write_all(file.number, bytes)) give_up("write", code);
  } catch (...) {
    ::unlink(partial.c_str());
    throw;
  }
  if (::fsync(file.number) != 0 && errno != EINVAL) give_up("flush", errno);
  // Some file systems report a failed write only here.
  if (::close(std::exchange(file.number, -1)) != 0) give_up("close", errno);
  if (::rename(partial.c_str(), target.path.c_str()) != 0) give_up("replace", errno);
  // The new name is on the disk, too.
  const Descriptor folder(::open(folder_of(target.path).c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
  if (folder.number >= 0) (void)::fsync(folder.number);
}

void require_writable(const fs::path& path, std::string_view option, FileKind kind) {
  const auto refuse = [&](std::string_view why) {
    throw InputError(fmt::format("{}: '{}' cannot be written: {}", option, path.string(), why));
  };
  const Target target = target_of(path);
  if (!target.trouble.empty()) refuse(target.trouble);
  if (target.special) return;
  std::error_code ignored;
  if (path.filename().empty() || fs::is_directory(target.path, ignored))
    throw InputError(fmt::format("{}: '{}' is a folder; name a file", option, path.string()));
  const fs::path folder = folder_of(target.path);
  if (!fs::is_directory(folder, ignored))
    throw InputError(fmt::format("{}: there is no folder '{}'", option, folder.string()));
  if (target.path.filename().native().size() > longest_name(folder)) refuse(std::strerror(ENAMETOOLONG));
  record_output(target.path, option, false);
  if (fs::exists(target.path, ignored) && ::access(target.path.c_str(), W_OK) != 0)
    refuse(std::strerror(errno));
  if (!is_replaceable(target.path, kind)) refuse_other_kind(path, option, kind);
  // Try it: read-only or virtual file systems show here and not after the work.
  const std::string trial = partial_name(target.path);
  const Descriptor file(create_partial(trial, 0600));
  if (file.number < 0) refuse(std::strerror(errno));
  ::unlink(trial.c_str());
}

void require_writable_folder(const fs::path& folder, std::string_view option) {
  std::error_code failed;
  fs::path named = folder;
  if (!named.has_filename()) named = named.parent_path();  // "name.fields/"
  if (fs::is_symlink(named, failed))
    throw InputError(
        fmt::format("{}: '{}' is a link: files would be replaced where it leads; name another "
                    "result, or remove the link",
                    option, named.string()));
  record_output(named, option, true);
  // Frames are replaced by name: without an index of ours they are somebody else's.
  const fs::path index = named / "index.pvd";
  if (!is_replaceable(index, FileKind::series)) refuse_other_kind(index, option, FileKind::series);
  if (fs::exists(index, failed)) return;
  for (fs::directory_iterator entry(named, failed), end; !failed && entry != end; entry.increment(failed)) {
    const std::string name = entry->path().filename().string();
    if (name.starts_with("frame_") && name.ends_with(".vtu"))
      throw InputError(
          fmt::format("{}: '{}' has frames and no index.pvd: it is no folder of a run, and they "
                      "would be lost; name another result, or move them away",
                      option, named.string()));
  }
}

void note_input(const fs::path& path) {
  std::error_code failed;
  if (!fs::exists(path, failed) || is_special(path)) return;
  const fs::path input = whole_path(path);
  Registry& r = registry();
  const std::lock_guard lock(r.mutex);
  if (std::find(r.inputs.begin(), r.inputs.end(), input) != r.inputs.end()) return;
  for (const Output& output : r.outputs)
    if (!output.gone_on_in && touches(output, input)) refuse_touching(output, path);
  r.inputs.push_back(input);
}

void allow_going_on_in(const fs::path& result) {
  if (is_special(result)) return;
  Registry& r = registry();
  const std::lock_guard lock(r.mutex);
  r.outputs.push_back({whole_path(result), "--resume", false, true});
}

// ---- reading ----

namespace {

[[noreturn]] void refuse_reading(const fs::path& path, int code) {
  std::string nearest;
  if (code == ENOENT) {
    std::error_code failed;
    std::vector<std::string> names;
    for (fs::directory_iterator entry(folder_of(path), failed), end; !failed && entry != end;
         entry.increment(failed))
      if (names.size() < 10000 && !entry->is_directory(failed))
        names.push_back(entry->path().filename().string());
    nearest = nearest_name(path.filename().string(), names);
    if (!nearest.empty() && path.has_parent_path()) nearest = (path.parent_path() / nearest).string();
  }
  throw InputError(fmt::format("cannot read '{}': {}{}", path.string(), std::strerror(code),
                               nearest.empty() ? "" : fmt::format("; did you mean '{}'?", nearest)));
}

std::string read_special(const fs::path& path) {
  const Descriptor file(::open(path.c_str(), O_RDONLY | O_NONBLOCK | O_NOCTTY | O_CLOEXEC));
  if (file.number < 0) refuse_reading(path, errno);
  const auto begin = std::chrono::steady_clock::now();
  std::string text, part(1 << 16, '\0');
  bool seen_writer = false;
  while (true) {
    check_interrupt();
    pollfd wait{file.number, POLLIN, 0};
    if (::poll(&wait, 1, 100) <= 0) {
      struct stat facts {};
      const bool pipe = ::fstat(file.number, &facts) == 0 && S_ISFIFO(facts.st_mode);
      if (pipe && !seen_writer && std::chrono::steady_clock::now() - begin > longest_wait_for_a_writer)
        throw InputError(fmt::format("'{}' is a pipe, and nothing was written to it in {} s", path.string(),
                                     longest_wait_for_a_writer.count()));
      continue;
    }
    const ssize_t n = ::read(file.number, part.data(), part.size());
    if (n < 0 && (errno == EINTR || errno == EAGAIN)) continue;
    if (n < 0) refuse_reading(path, errno);
    if (n == 0) return text;
    seen_writer = true;
    text.append(part, 0, static_cast<std::size_t>(n));
    if (text.size() > most_bytes_of_a_pipe)
      throw InputError(fmt::format("'{}' does not end within {} MB: it is no input", path.string(),
                                   most_bytes_of_a_pipe >> 20));
  }
}

std::string read_regular(const fs::path& path) {
  const Descriptor file(::open(path.c_str(), O_RDONLY | O_CLOEXEC));
  if (file.number < 0) refuse_reading(path, errno);
  std::string text, part(1 << 16, '\0');
  while (true) {
    const ssize_t n = ::read(file.number, part.data(), part.size());
    if (n < 0 && errno == EINTR) continue;
    if (n < 0) refuse_reading(path, errno);
    if (n == 0) return text;
    text.append(part, 0, static_cast<std::size_t>(n));
  }
}

}  // namespace

std::string read_file(const fs::path& path) {
  struct stat facts {};
  if (::stat(path.c_str(), &facts) != 0) refuse_reading(path, errno);
  if (S_ISDIR(facts.st_mode)) throw InputError(fmt::format("'{}' is a folder; name a file", path.string()));
  if (!S_ISREG(facts.st_mode)) {
    Registry& r = registry();
    const std::string name = fmt::format("{} {} {}", fs::absolute(path).string(), facts.st_dev, facts.st_ino);
    {
      const std::lock_guard lock(r.mutex);
      if (const auto known = r.special.find(name); known != r.special.end()) return known->second;
    }
    std::string text = read_special(path);
    const std::lock_guard lock(r.mutex);
    return r.special.emplace(name, std::move(text)).first->second;
  }
  note_input(path);
  return read_regular(path);
}

std::string read_own_file(const fs::path& path) { return read_regular(path); }

bool special_file_was_read() {
  Registry& r = registry();
  const std::lock_guard lock(r.mutex);
  return !r.special.empty();
}

}  // namespace wiggers
