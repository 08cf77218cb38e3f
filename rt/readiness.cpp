#include "rt/readiness.hpp"

#include <algorithm>
#include <cstdio>
#include <ctime>
#include <fstream>
#include <sstream>

#include <sys/resource.h>
#include <sys/utsname.h>
#include <unistd.h>

#include "rt/cyclic_thread.hpp"

namespace clampd::rt {
namespace {

constexpr int kCapabilityIpcLock = 14;
constexpr int kCapabilitySysNice = 23;
constexpr rlim_t kLockedBytesNeeded = rlim_t{256} * 1024 * 1024;
constexpr double kLatenessGood_us = 100.0;
constexpr double kLatenessBearable_us = 500.0;

/// First line of a file without its end, empty if it cannot be read.
std::string first_line(const std::string& path) {
  std::ifstream file(path);
  std::string line;
  std::getline(file, line);
  return line;
}

bool has_capability(const std::string& root, int capability) {
  std::ifstream file(root + "/proc/self/status");
  for (std::string line; std::getline(file, line);) {
    if (line.rfind("CapEff:", 0) != 0) continue;
    unsigned long long mask = 0;
    return std::sscanf(line.c_str() + 7, "%llx", &mask) == 1 && ((mask >> capability) & 1U) != 0;
  }
  return false;
}

std::string limit_text(rlim_t limit) {
  return limit == RLIM_INFINITY ? "unlimited" : std::to_string(limit);
}

ReadinessFact kernel(const std::string& root) {
  utsname name{};
  uname(&name);
  ReadinessFact fact{"kernel preemption", ReadinessStatus::Ok, std::string(name.release) + " " + name.version,
                     ""};
  const bool real_time = first_line(root + "/sys/kernel/realtime") == "1";
  if (real_time) {
    fact.found += ": PREEMPT_RT";
  } else {
    fact.status = ReadinessStatus::Warn;
    fact.found += ": not PREEMPT_RT";
    fact.advice = "install a PREEMPT_RT kernel (Debian: apt install linux-image-rt-amd64)";
  }
  return fact;
}

ReadinessFact priority_right(const ReadinessOptions& options) {
  rlimit limit{};
  getrlimit(RLIMIT_RTPRIO, &limit);
  const bool capable = has_capability(options.root, kCapabilitySysNice);
  ReadinessFact fact{"right to real-time priority", ReadinessStatus::Ok,
                     "RLIMIT_RTPRIO " + limit_text(limit.rlim_cur) + (capable ? ", CAP_SYS_NICE" : ""), ""};
  if (!capable && limit.rlim_cur != RLIM_INFINITY && limit.rlim_cur < static_cast<rlim_t>(options.priority)) {
    fact.status = ReadinessStatus::Fail;
    fact.advice =
        "LimitRTPRIO=99 in the systemd unit, or \"rtprio 99\" in /etc/security/limits.conf, or CAP_SYS_NICE";
  }
  return fact;
}

ReadinessFact memory_right(const std::string& root) {
  rlimit limit{};
  getrlimit(RLIMIT_MEMLOCK, &limit);
  const bool capable = has_capability(root, kCapabilityIpcLock);
  ReadinessFact fact{"right to lock memory", ReadinessStatus::Ok,
                     "RLIMIT_MEMLOCK " + limit_text(limit.rlim_cur) + (capable ? ", CAP_IPC_LOCK" : ""), ""};
  if (!capable && limit.rlim_cur != RLIM_INFINITY && limit.rlim_cur < kLockedBytesNeeded) {
    fact.status = ReadinessStatus::Fail;
    fact.advice =
        "LimitMEMLOCK=infinity in the systemd unit, or \"memlock unlimited\" in /etc/security/limits.conf, "
        "or "
        "CAP_IPC_LOCK";
  }
  return fact;
}

ReadinessFact throttling(const std::string& root) {
  const std::string runtime = first_line(root + "/proc/sys/kernel/sched_rt_runtime_us");
  ReadinessFact fact{"real-time throttling", ReadinessStatus::Ok, "sched_rt_runtime_us " + runtime, ""};
  if (runtime.empty()) {
    fact.status = ReadinessStatus::Warn;
    fact.found = "unknown";
  } else if (runtime == "0") {
    fact.status = ReadinessStatus::Fail;
    fact.advice = "sysctl kernel.sched_rt_runtime_us=-1 (0 forbids real-time threads)";
  } else if (runtime != "-1") {
    fact.found += ": a real-time thread is stopped when all of them use more than that of each second";
    fact.advice =
        "harmless for this loop alone; with other real-time programs: sysctl kernel.sched_rt_runtime_us=-1";
  }
  return fact;
}

ReadinessFact isolation(const ReadinessOptions& options) {
  const std::string isolated = first_line(options.root + "/sys/devices/system/cpu/isolated");
  ReadinessFact fact{"isolated cores", ReadinessStatus::Ok, isolated.empty() ? "none" : isolated, ""};
  if (isolated.empty()) {
    fact.status = ReadinessStatus::Warn;
    fact.advice = "boot with isolcpus=N nohz_full=N rcu_nocbs=N and set the station's cpu to N";
  } else if (options.cpu < 0) {
    fact.status = ReadinessStatus::Warn;
    fact.advice = "cores are isolated, but the station is not told to use one: set its cpu";
  }
  return fact;
}

ReadinessFact governor(const ReadinessOptions& options) {
  const std::string core = std::to_string(std::max(options.cpu, 0));
  const std::string value =
      first_line(options.root + "/sys/devices/system/cpu/cpu" + core + "/cpufreq/scaling_governor");
  ReadinessFact fact{"frequency governor", ReadinessStatus::Ok,
                     value.empty() ? "none (fixed clock or virtual)" : value, ""};
  if (!value.empty() && value != "performance") {
    fact.status = ReadinessStatus::Warn;
    fact.advice = "cpupower frequency-set -g performance";
  }
  return fact;
}

ReadinessFact deep_sleep() {
  ReadinessFact fact{"processor sleep states", ReadinessStatus::Ok, "/dev/cpu_dma_latency can be held", ""};
  if (access("/dev/cpu_dma_latency", W_OK) != 0) {
    fact.status = ReadinessStatus::Warn;
    fact.found = "/dev/cpu_dma_latency is missing or not writable";
    fact.advice = "make it writable for the station's user (udev rule), or boot with processor.max_cstate=1";
  }
  return fact;
}

ReadinessFact clock_source(const std::string& root) {
  const std::string source =
      first_line(root + "/sys/devices/system/clocksource/clocksource0/current_clocksource");
  ReadinessFact fact{"clock source", ReadinessStatus::Ok, source.empty() ? "unknown" : source, ""};
  if (source == "acpi_pm" || source == "hpet" || source == "jiffies") {
    fact.status = ReadinessStatus::Warn;
    fact.advice = "slow to read; see dmesg why the kernel distrusts the TSC, or boot with tsc=reliable";
  }
  return fact;
}

ReadinessFact timer_resolution() {
  timespec resolution{};
  clock_getres(CLOCK_MONOTONIC, &resolution);
  const std::int64_t resolution_ns = resolution.tv_sec * kNanosecondsPerSecond + resolution.tv_nsec;
  ReadinessFact fact{"timer resolution", ReadinessStatus::Ok, std::to_string(resolution_ns) + " ns", ""};
  if (resolution_ns > 1000) {
    fact.status = ReadinessStatus::Fail;
    fact.advice =
        "the kernel has no high-resolution timers: boot without highres=off, CONFIG_HIGH_RES_TIMERS=y";
  }
  return fact;
}

ReadinessFact firmware_interrupts(const std::string& root) {
  ReadinessFact fact{"firmware interrupts (SMI)", ReadinessStatus::Ok, "", ""};
  std::ifstream file(root + "/proc/cpuinfo");
  bool virtual_machine = false;
  for (std::string line; std::getline(file, line) && !virtual_machine;) {
    virtual_machine = line.rfind("flags", 0) == 0 && (line + " ").find(" hypervisor ") != std::string::npos;
  }
  if (virtual_machine) {
    fact.status = ReadinessStatus::Warn;
    fact.found = "this is a virtual machine: its host may take the processor away at any time";
    fact.advice = "use real hardware for a station";
  } else {
    fact.found = "invisible to the kernel";
    fact.advice =
        "measure them once with hwlatdetect (rt-tests); disable power management and USB legacy in the BIOS";
  }
  return fact;
}

struct Idle {
  void tick(std::int64_t, std::int64_t, std::uint64_t) noexcept {}
  void shutdown(std::int64_t) noexcept {}
};

ReadinessFact measured_lateness(const ReadinessOptions& options) {
  CyclicThread thread;
  Idle idle;
  CyclicThreadSettings settings{options.priority, options.cpu, false};
  ReadinessFact fact{"wake-up lateness", ReadinessStatus::Ok, "", ""};
  auto started = thread.start(settings, idle);
  std::string scheduling = "SCHED_FIFO " + std::to_string(options.priority);
  if (!started) {
    fact.status = ReadinessStatus::Warn;
    fact.advice = started.error().message;
    settings.priority = 0;
    scheduling = "SCHED_OTHER";
    started = thread.start(settings, idle);
  }
  if (!started) {
    fact.status = ReadinessStatus::Fail;
    fact.found = "not measured";
    fact.advice = started.error().message;
    return fact;
  }
  const timespec duration{static_cast<std::time_t>(options.jitter_test_ns / kNanosecondsPerSecond),
                          static_cast<long>(options.jitter_test_ns % kNanosecondsPerSecond)};
  clock_nanosleep(CLOCK_MONOTONIC, 0, &duration, nullptr);
  thread.stop();
  const HistogramSnapshot lateness = thread.statistics().lateness.snapshot();
  const std::uint64_t skipped = thread.statistics().skipped.load();
  char text[160];
  std::snprintf(text, sizeof text, "min %.0f, avg %.0f, max %.0f us over %llu ticks, %llu skipped, %s",
                lateness.min_us, lateness.avg_us, lateness.max_us,
                static_cast<unsigned long long>(lateness.count), static_cast<unsigned long long>(skipped),
                scheduling.c_str());
  fact.found = text;
  if (skipped > 0 || lateness.max_us > kLatenessBearable_us) {
    fact.status = ReadinessStatus::Fail;
    if (fact.advice.empty()) fact.advice = "the 1 ms grid is not kept: see the facts above";
  } else if (lateness.max_us > kLatenessGood_us) {
    fact.status = ReadinessStatus::Warn;
    if (fact.advice.empty())
      fact.advice = "usable, but far from what a PREEMPT_RT machine does: see the facts above";
  }
  return fact;
}

}  // namespace

std::string_view to_string(ReadinessStatus status) noexcept {
  switch (status) {
    case ReadinessStatus::Ok:
      return "ok";
    case ReadinessStatus::Warn:
      return "warn";
    case ReadinessStatus::Fail:
      return "fail";
  }
  return "?";
}

std::vector<ReadinessFact> examine_readiness(const ReadinessOptions& options) {
  std::vector<ReadinessFact> facts{kernel(options.root),
                                   priority_right(options),
                                   memory_right(options.root),
                                   throttling(options.root),
                                   isolation(options),
                                   governor(options),
                                   deep_sleep(),
                                   clock_source(options.root),
                                   timer_resolution(),
                                   firmware_interrupts(options.root)};
  if (options.jitter_test_ns > 0) facts.push_back(measured_lateness(options));
  return facts;
}

}  // namespace clampd::rt
