// A pool of threads for loops over blocks: started once, woken for each loop, no allocation in between.
#pragma once

#include <functional>
#include <memory>

namespace wiggers {

class ThreadPool {
 public:
  // n_threads counts the caller; 1 starts none.
  explicit ThreadPool(int n_threads);
  ~ThreadPool();
  ThreadPool(const ThreadPool&) = delete;
  ThreadPool& operator=(const ThreadPool&) = delete;

  int size() const;

  // Calls work(first, last) on contiguous shares of [0, n), one a thread, and waits. `work` must not throw.
  void split(std::size_t n, const std::function<void(std::size_t, std::size_t)>& work);

 private:
  struct Implementation;
  std::unique_ptr<Implementation> implementation_;
};

}  // namespace wiggers
