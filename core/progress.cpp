#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <csignal>
#include <cstdio>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/progress.hpp>

namespace wiggers {

namespace {
volatile std::sig_atomic_t stop_requested = 0;
void request_stop(int) { stop_requested = 1; }
// Other threads never have one.
thread_local void (*host_poll)() = nullptr;

std::string duration(double seconds) {
  if (seconds < 90) return fmt::format("{:.0f} s", seconds);
  if (seconds < 5400) return fmt::format("{:.0f} min", seconds / 60);
  return fmt::format("{:.1f} h", seconds / 3600);
}
}  // namespace

void catch_interrupts() {
  std::signal(SIGINT, request_stop);
  std::signal(SIGTERM, request_stop);
#ifdef SIGXFSZ
  std::signal(SIGXFSZ, SIG_IGN);  // a file-size limit then shows as a write error, which is reported
#endif
}

bool interrupt_requested() { return stop_requested != 0; }

void check_interrupt() {
  if (interrupt_requested()) throw Interrupted("stopped on request");
  if (!host_poll) return;
  using Clock = std::chrono::steady_clock;
  static thread_local Clock::time_point next{};
  const auto now = Clock::now();
  if (now < next) return;
  next = now + std::chrono::milliseconds(100);
  host_poll();
}

void set_interrupt_poll(void (*poll)()) { host_poll = poll; }

Progress::Progress(std::string task, Style style)
    : task_(std::move(task)),
      terminal_(::isatty(STDERR_FILENO) != 0),
      quiet_(style == Style::quiet),
      start_(Clock::now()),
      last_shown_(start_) {}

Progress::~Progress() {
  if (line_open_) std::fputs("\n", stderr);
}

double Progress::seconds_since_start() const {
  return std::chrono::duration<double>(Clock::now() - start_).count();
}

void Progress::update(double fraction, const std::string& note) {
  check_interrupt();
  if (quiet_) return;
  const auto now = Clock::now();
  const double since_last = std::chrono::duration<double>(now - last_shown_).count();
  if (since_last < (terminal_ ? 0.1 : 5.0)) return;
  last_shown_ = now;
  const double elapsed = seconds_since_start();
  std::string left;
  if (fraction > 0.01) left = fmt::format(", about {} left", duration(elapsed * (1 - fraction) / fraction));
  if (terminal_) {
    std::string bar;
    if (fraction >= 0) {
      const int filled = static_cast<int>(std::clamp(fraction, 0.0, 1.0) * 24);
      bar = fmt::format(" [{}{}] {:3.0f} %", std::string(filled, '#'), std::string(24 - filled, '.'),
                        100 * std::clamp(fraction, 0.0, 1.0));
    }
    std::fputs(fmt::format("\r\033[K{}{} {}{}", task_, bar, note, left).c_str(), stderr);
    std::fflush(stderr);
    line_open_ = true;
  } else {
    const std::string percent = fraction >= 0 ? fmt::format(" {:.0f} %", 100 * fraction) : "";
    std::fputs(fmt::format("{}:{} {}{}\n", task_, percent, note, left).c_str(), stderr);
  }
}

void Progress::finish(const std::string& note) {
  if (quiet_) return;
  const double elapsed = seconds_since_start();
  if (line_open_) std::fputs("\r\033[K", stderr);
  line_open_ = false;
  std::fputs(fmt::format("{}: {} ({:.2f} s)\n", task_, note.empty() ? "done" : note, elapsed).c_str(),
             stderr);
}

}  // namespace wiggers
