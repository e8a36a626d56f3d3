// An exception may not pass through a C library: callbacks keep it here, and it is thrown again behind the
// call.
#pragma once

#include <exception>
#include <utility>

namespace wiggers {

class CarriedException {
 public:
  // The callback's work, which returns 0, or a positive number for a failure the library may recover from; -1
  // if it threw.
  template <class Work>
  int guard(Work&& work) {
    try {
      return std::forward<Work>(work)();
    } catch (...) {
      thrown_ = std::current_exception();
      return -1;
    }
  }
  void rethrow() {
    if (thrown_) std::rethrow_exception(std::exchange(thrown_, nullptr));
  }

 private:
  std::exception_ptr thrown_;
};

}  // namespace wiggers
