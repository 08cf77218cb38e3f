#pragma once

#include <chrono>
#include <condition_variable>
#include <deque>
#include <functional>
#include <future>
#include <memory>
#include <mutex>
#include <thread>
#include <type_traits>
#include <utility>

namespace clampd::bench {

/// The one thread for what may wait for the disk, in the order in which it was posted: a disk that stands
/// still then keeps nobody waiting who does not want to. The thread begins with the first job.
class DiskThread {
 public:
  DiskThread() = default;
  /// Does what was posted first.
  ~DiskThread();
  DiskThread(const DiskThread&) = delete;
  DiskThread& operator=(const DiskThread&) = delete;

  /// Any thread. The future's destruction waits for nothing.
  template <class Job>
  std::future<std::invoke_result_t<Job>> post(Job job) {
    auto task = std::make_shared<std::packaged_task<std::invoke_result_t<Job>()>>(std::move(job));
    std::future<std::invoke_result_t<Job>> result = task->get_future();
    enqueue([task] { (*task)(); });
    return result;
  }

 private:
  void enqueue(std::function<void()> job);
  void work();

  std::mutex mutex_;
  std::condition_variable more_;
  std::deque<std::function<void()>> jobs_;
  bool ending_ = false;
  std::thread thread_;
};

/// Whether the result is there; false for a future that belongs to nothing.
template <class T>
bool is_ready(const std::future<T>& future) {
  return future.valid() && future.wait_for(std::chrono::seconds(0)) == std::future_status::ready;
}

}  // namespace clampd::bench
