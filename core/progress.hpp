// Progress of long work, and its cancelling, through one object.
//
// On a terminal: a bar with an estimate of what is left. In a log: a line now and then. With quiet: nothing.
// Progress goes to standard error, results to standard output.
#pragma once

#include <chrono>
#include <string>

namespace wiggers {

class Progress {
 public:
  enum class Style { automatic, quiet };
  Progress(std::string task, Style style);
  ~Progress();

  // fraction in [0, 1]; negative: unknown. Throws Interrupted when the user asked to stop.
  void update(double fraction, const std::string& note = "");
  void finish(const std::string& note = "");

 private:
  using Clock = std::chrono::steady_clock;
  double seconds_since_start() const;

  std::string task_;
  bool terminal_ = false;
  bool quiet_ = false;
  bool line_open_ = false;
  Clock::time_point start_;
  Clock::time_point last_shown_;
};

// Makes Ctrl-C and SIGTERM request a stop instead of ending the process at once.
void catch_interrupts();
bool interrupt_requested();
// Throws Interrupted if a stop was requested.
void check_interrupt();

}  // namespace wiggers
