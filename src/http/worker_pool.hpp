#pragma once

#include <condition_variable>
#include <deque>
#include <functional>
#include <mutex>
#include <thread>
#include <vector>

namespace clampd::http {

/// A fixed number of threads, and a fixed number of jobs that may wait for them.
class WorkerPool {
 public:
  /// nice: of its threads.
  WorkerPool(std::size_t threads, std::size_t most_waiting, int nice);
  /// Waits for the jobs that are being done; those that still wait are dropped.
  ~WorkerPool();
  WorkerPool(const WorkerPool&) = delete;
  WorkerPool& operator=(const WorkerPool&) = delete;

  /// False if too many wait already. A job must not throw.
  bool offer(std::function<void()> job);
  /// How many jobs may be in here at once.
  std::size_t capacity() const { return threads_.size() + most_waiting_; }

 private:
  void work();

  const std::size_t most_waiting_;
  const int nice_;
  std::mutex mutex_;
  std::condition_variable changed_;
  std::deque<std::function<void()>> waiting_;
  bool ending_ = false;
  std::vector<std::thread> threads_;
};

}  // namespace clampd::http
