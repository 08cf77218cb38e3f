#include "rt/cyclic_thread.hpp"

#include <cerrno>
#include <csignal>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <string>

#include <fcntl.h>
#include <malloc.h>
#include <sched.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <unistd.h>

namespace clampd::rt {
namespace {

constexpr std::size_t kStackBytes = 2 * 1024 * 1024;
constexpr std::size_t kStackPrefaultBytes = 256 * 1024;
constexpr std::size_t kHeapPrefaultBytes = 16 * 1024 * 1024;

class MonotonicClock {
 public:
  CLAMPD_REALTIME std::int64_t now_ns() noexcept { return monotonic_now_ns(); }
  CLAMPD_REALTIME void wait_until(std::int64_t deadline_ns) noexcept {
    timespec deadline{};
    deadline.tv_sec = static_cast<std::time_t>(deadline_ns / kNanosecondsPerSecond);
    deadline.tv_nsec = static_cast<long>(deadline_ns % kNanosecondsPerSecond);
    // An interrupted sleep returns early; the loop looks at the clock and sleeps again.
    clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &deadline, nullptr);
  }
};

void prefault_stack() noexcept {
  unsigned char pages[kStackPrefaultBytes];
  explicit_bzero(pages, sizeof pages);  // unlike memset, it may not be optimised away
}

// Keeps freed memory in the process, so that what is locked and mapped now never has to be mapped again.
// False if there is no such memory, which with locked memory means that RLIMIT_MEMLOCK is too small.
bool prefault_heap() noexcept {
  mallopt(M_TRIM_THRESHOLD, -1);
  mallopt(M_MMAP_MAX, 0);
  void* heap = std::malloc(kHeapPrefaultBytes);
  if (heap == nullptr) return false;
  explicit_bzero(heap, kHeapPrefaultBytes);
  std::free(heap);
  return true;
}

// Held open at zero, this file keeps the processor out of deep sleep states; cyclictest does the same.
// Best effort: without the right to it the loop runs, only with more jitter, and `clampctl doctor` says so.
int forbid_deep_sleep() noexcept {
  const int file = open("/dev/cpu_dma_latency", O_WRONLY | O_CLOEXEC);
  const std::int32_t latency_us = 0;
  if (file >= 0 && write(file, &latency_us, sizeof latency_us) != sizeof latency_us) {
    close(file);
    return -1;
  }
  return file;
}

Error start_error(int error, const CyclicThreadSettings& settings) {
  const std::string reason = std::string(" (") + std::strerror(error) + ")";
  if (error == EPERM) {
    return Error{"real-time thread: no right to SCHED_FIFO priority " + std::to_string(settings.priority) +
                 reason +
                 "; raise RLIMIT_RTPRIO (LimitRTPRIO=99 in the systemd unit, rtprio in limits.conf) or grant "
                 "CAP_SYS_NICE, or set priority = 0 for development"};
  }
  if (error == EINVAL && settings.cpu >= 0) {
    return Error{"real-time thread: cannot run on core " + std::to_string(settings.cpu) + reason +
                 "; choose a core that is online and allowed to this process, or cpu = -1 for any"};
  }
  return Error{"real-time thread: cannot start" + reason};
}

}  // namespace

Result<void> CyclicThreadSettings::validate() const {
  if (priority < 0 || priority > 99) {
    return failure("real-time thread: priority " + std::to_string(priority) +
                   " is outside of 0..99; use 1 to 99 for SCHED_FIFO or 0 for an ordinary thread");
  }
  if (cpu < -1 || cpu >= CPU_SETSIZE) {
    return failure("real-time thread: there is no core " + std::to_string(cpu) + "; use -1 for any");
  }
  return {};
}

Result<void> CyclicThread::start(const CyclicThreadSettings& settings, const Target& target) {
  if (running_) return failure("real-time thread: it runs already; stop it first");
  if (auto valid = settings.validate(); !valid) return valid;
  if (settings.lock_memory) {
    const bool locked = mlockall(MCL_CURRENT | MCL_FUTURE) == 0;
    const std::string reason = std::strerror(locked ? ENOMEM : errno);
    if (!locked || !prefault_heap()) {
      munlockall();
      return failure(
          "real-time thread: cannot lock memory (" + reason +
          "); raise RLIMIT_MEMLOCK (LimitMEMLOCK=infinity in the systemd unit, memlock in limits.conf) or "
          "grant CAP_IPC_LOCK, or set lock_memory = false for development");
    }
  }

  pthread_attr_t attributes;
  pthread_attr_init(&attributes);
  pthread_attr_setstacksize(&attributes, kStackBytes);
  pthread_attr_setinheritsched(&attributes, PTHREAD_EXPLICIT_SCHED);
  sched_param parameters{};
  parameters.sched_priority = settings.priority;
  pthread_attr_setschedpolicy(&attributes, settings.priority > 0 ? SCHED_FIFO : SCHED_OTHER);
  pthread_attr_setschedparam(&attributes, &parameters);
  if (settings.cpu >= 0) {
    cpu_set_t cores;
    CPU_ZERO(&cores);
    CPU_SET(static_cast<unsigned>(settings.cpu), &cores);
    pthread_attr_setaffinity_np(&attributes, sizeof cores, &cores);
  }

  target_ = target;
  period_ns_ = settings.period_ns;
  stop_.store(false);
  statistics_ = std::make_unique<LoopStatistics>();
  // The process's signals are for its other threads; the loop must not be interrupted by them.
  sigset_t all_signals, before;
  sigfillset(&all_signals);
  pthread_sigmask(SIG_SETMASK, &all_signals, &before);
  const int error = pthread_create(&thread_, &attributes, &CyclicThread::enter, this);
  pthread_sigmask(SIG_SETMASK, &before, nullptr);
  pthread_attr_destroy(&attributes);
  if (error != 0) {
    if (settings.lock_memory) munlockall();
    return tl::unexpected<Error>(start_error(error, settings));
  }
  dma_latency_file_ = settings.priority > 0 ? forbid_deep_sleep() : -1;
  running_ = true;
  return {};
}

void* CyclicThread::enter(void* self) noexcept {
  auto& thread = *static_cast<CyclicThread*>(self);
  prctl(PR_SET_NAME, "clampd-rt");
  prctl(PR_SET_TIMERSLACK, 1UL);
  prefault_stack();
  MonotonicClock clock;
  run_cyclic(clock, thread.target_, thread.stop_, *thread.statistics_, thread.period_ns_);
  return nullptr;
}

void CyclicThread::stop() noexcept {
  if (!running_) return;
  stop_.store(true, std::memory_order_release);
  pthread_join(thread_, nullptr);
  running_ = false;
  if (dma_latency_file_ >= 0) close(dma_latency_file_);
  dma_latency_file_ = -1;
}

}  // namespace clampd::rt
