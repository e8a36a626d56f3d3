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

// Makes Ctrl-C and SIGTERM request a stop instead of ending the process at once. Only commands do so; nothing
// below stops a host that the library is part of.
void catch_interrupts();
bool interrupt_requested();
// Throws Interrupted if a stop was requested. Cheap: long work calls it at every step.
void check_interrupt();
// A host with signals of its own: check_interrupt() calls it now and then, on the thread that set it alone.
// What it throws ends the work.
void set_interrupt_poll(void (*poll)());

}  // namespace wiggers
