#pragma once

#include <algorithm>
#include <atomic>
#include <cstddef>
#include <memory>
#include <thread>
#include <type_traits>
#include <vector>

namespace clampd {

/// `asked`, or as many threads as there are processors if that is not positive; at most 64, since each may
/// bring its own working memory.
inline int threads_or_all(int asked) {
  const int processors = static_cast<int>(std::max(1u, std::thread::hardware_concurrency()));
  return std::min(asked > 0 ? asked : processors, 64);
}

/// Threads that may still be started, one account for all copies: loops within loops share it, and an inner
/// one gets what an outer one leaves over. By itself, none.
class ThreadBudget {
 public:
  ThreadBudget() = default;
  /// For work on `threads` threads, the caller's one among them.
  explicit ThreadBudget(int threads) : spare_(std::make_shared<std::atomic<int>>(threads - 1)) {}

  bool take() const {
    if (!spare_) return false;
    int spare = spare_->load();
    while (spare > 0)
      if (spare_->compare_exchange_weak(spare, spare - 1)) return true;
    return false;
  }
  void give_back() const {
    ++*spare_;
    spare_->notify_one();
  }
  /// Waits for one that others give back.
  void await() const {
    while (!take()) spare_->wait(0);
  }

 private:
  std::shared_ptr<std::atomic<int>> spare_;
};

/// Calls work(i), or work(thread, i) with the thread's number from 0, for i in [0, count) on the caller's
/// thread and on those that are spare as it begins.
template <class Work>
void for_each_index(std::size_t count, const ThreadBudget& threads, const Work& work) {
  std::atomic<std::size_t> next{0};
  const auto take = [&](std::size_t thread) {
    for (std::size_t i = next++; i < count; i = next++) {
      if constexpr (std::is_invocable_v<const Work&, std::size_t, std::size_t>)
        work(thread, i);
      else
        work(i);
    }
  };
  std::vector<std::jthread> others;
  while (others.size() + 1 < count && next < count && threads.take())
    others.emplace_back([&, thread = others.size() + 1] {
      take(thread);
      threads.give_back();
    });
  take(0);
  if (others.empty()) return;
  // A loop within what the others still do may use this thread's place.
  threads.give_back();
  others.clear();
  threads.await();
}

/// The same until work(i) returns false; whether none did.
template <class Work>
bool for_each_index_while(std::size_t count, const ThreadBudget& threads, const Work& work) {
  std::atomic<bool> all{true};
  for_each_index(count, threads, [&](std::size_t i) {
    if (all && !work(i)) all = false;
  });
  return all;
}

/// for_each_index() on up to `threads` threads, the caller's one among them.
template <class Work>
void for_each_index(std::size_t count, int threads, const Work& work) {
  for_each_index(count, ThreadBudget(threads), work);
}

}  // namespace clampd
