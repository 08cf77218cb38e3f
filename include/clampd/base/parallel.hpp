#pragma once

#include <algorithm>
#include <atomic>
#include <cstddef>
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

/// Calls work(i), or work(thread, i) with the thread's number from 0, for i in [0, count) on up to `threads`
/// threads, the caller's one among them.
template <class Work>
void for_each_index(std::size_t count, int threads, const Work& work) {
  std::atomic<std::size_t> next{0};
  const auto take = [&](std::size_t thread) {
    for (std::size_t i = next++; i < count; i = next++) {
      if constexpr (std::is_invocable_v<const Work&, std::size_t, std::size_t>)
        work(thread, i);
      else
        work(i);
    }
  };
  const std::size_t workers = std::min(count, static_cast<std::size_t>(std::max(1, threads)));
  std::vector<std::jthread> others;
  for (std::size_t thread = 1; thread < workers; ++thread) others.emplace_back(take, thread);
  take(0);
}

}  // namespace clampd
