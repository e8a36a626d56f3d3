#include <atomic>
#include <condition_variable>
#include <mutex>
#include <system_error>
#include <thread>
#include <vector>
#include <wiggers/core/threads.hpp>

namespace wiggers {

namespace {
inline void pause() {
#if defined(__x86_64__)
  __builtin_ia32_pause();
#endif
}
}  // namespace

struct ThreadPool::Implementation {
  std::mutex mutex;
  std::condition_variable wake, done;
  const std::function<void(std::size_t, std::size_t)>* work = nullptr;
  std::size_t n = 0;
  std::atomic<long> round{0};  // counts the loops; a thread waits for the next
  std::atomic<int> busy{0};
  bool stopping = false;
  std::vector<std::thread> threads;

  void run_share(int index, std::size_t total, const std::function<void(std::size_t, std::size_t)>& f) const {
    const std::size_t shares = threads.size() + 1;
    const std::size_t first = total * static_cast<std::size_t>(index) / shares;
    const std::size_t last = total * static_cast<std::size_t>(index + 1) / shares;
    if (first < last) f(first, last);
  }

  void serve(int index) {
    long seen = 0;
    for (;;) {
      // Loops follow each other closely: look out for the next for a while before going to sleep, because
      // waking costs some 50 us.
      for (int look = 0; look < 20000 && round.load(std::memory_order_acquire) == seen; ++look) pause();
      std::unique_lock lock(mutex);
      wake.wait(lock, [&] { return stopping || round != seen; });
      if (stopping) return;
      seen = round;
      const auto* f = work;
      const std::size_t total = n;
      lock.unlock();
      run_share(index, total, *f);
      if (busy.fetch_sub(1, std::memory_order_acq_rel) == 1) {
        lock.lock();
        done.notify_one();
      }
    }
  }
};

ThreadPool::ThreadPool(int n_threads) : implementation_(std::make_unique<Implementation>()) {
  // The vector is complete before a thread may look at its size.
  const std::scoped_lock lock(implementation_->mutex);
  implementation_->threads.reserve(static_cast<std::size_t>(n_threads));
  try {
    for (int index = 1; index < n_threads; ++index)
      implementation_->threads.emplace_back([this, index] { implementation_->serve(index); });
  } catch (const std::system_error&) {
    // As many as the system gives: shares follow the number of threads.
  }
}

ThreadPool::~ThreadPool() {
  {
    const std::scoped_lock lock(implementation_->mutex);
    implementation_->stopping = true;
  }
  implementation_->wake.notify_all();
  for (std::thread& thread : implementation_->threads) thread.join();
}

int ThreadPool::size() const { return static_cast<int>(implementation_->threads.size()) + 1; }

void ThreadPool::split(std::size_t n, const std::function<void(std::size_t, std::size_t)>& work) {
  Implementation& pool = *implementation_;
  if (!pool.threads.empty()) {
    const std::scoped_lock lock(pool.mutex);
    pool.work = &work;
    pool.n = n;
    pool.busy = static_cast<int>(pool.threads.size());
    ++pool.round;
  }
  pool.wake.notify_all();
  pool.run_share(0, n, work);
  if (pool.threads.empty()) return;
  for (int look = 0; look < 20000 && pool.busy.load(std::memory_order_acquire) != 0; ++look) pause();
  std::unique_lock lock(pool.mutex);
  pool.done.wait(lock, [&] { return pool.busy == 0; });
}

}  // namespace wiggers
