#include "drivers/gpio/relay_guard.hpp"

#include <poll.h>
#include <sched.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <csignal>
#include <cstring>
#include <new>
#include <optional>
#include <string>
#include <utility>

#include <fmt/format.h>

#include "clampd/base/clock.hpp"

namespace clampd::gpio {

namespace {

constexpr int kPeriod_ms = 2;
constexpr std::int64_t kReopenRelayEvery_ns = 500 * kNanosecondsPerMillisecond;

/// The guard's whole life. It ends when the station's end of the lifeline is closed, by whatever death.
void guard(Line line, const RelayGuard::Settings& settings, GuardedMemory& memory, int lifeline) {
  std::optional<Line> relay(std::move(line));
  RelayGate gate(settings.watchdog_ns);
  bool on = false;
  std::int64_t lost_ns = 0;
  const auto lose = [&](std::int64_t now_ns) {
    memory.relay_error.store(errno);
    memory.relay.store(RelayState::Lost);
    relay.reset();
    lost_ns = now_ns;
  };
  while (true) {
    pollfd end{lifeline, POLLIN, 0};
    const bool station_gone = poll(&end, 1, kPeriod_ms) > 0;
    const std::int64_t now_ns = monotonic_now_ns();
    const bool wanted = gate.energised(memory.board.last_beat(), now_ns) && !station_gone;
    if (!relay && now_ns - lost_ns > kReopenRelayEvery_ns) {
      lost_ns = now_ns;
      if (Result<Line> reopened = Line::open_output(settings.line, LineRole::EnableRelay, false)) {
        relay.emplace(std::move(*reopened));
        on = false;
      }
    }
    if (relay && wanted != on) {
      on = wanted;
      if (!relay->set(on)) lose(now_ns);
    }
    if (relay && !relay->level()) lose(now_ns);
    if (relay) memory.relay.store(on ? RelayState::On : RelayState::Off);
    memory.guard_beat_ns.store(now_ns);
    if (station_gone) return;
  }
}

/// Only the lifeline stays open of what the station had.
void leave_the_station(int lifeline) {
  // Ctrl-C and a service manager's signals reach the whole group: the guard outlives the station.
  for (const int number : {SIGINT, SIGTERM, SIGQUIT, SIGABRT, SIGHUP, SIGPIPE}) std::signal(number, SIG_IGN);
  prctl(PR_SET_NAME, "clampd-relay");
  const int kept = dup2(lifeline, STDERR_FILENO + 1);
  close_range(static_cast<unsigned>(kept) + 1, ~0U, 0);
}

std::string take_priority(int priority) {
  // Best effort: a page fault only costs time. On fault: what the guard never touches of the station's memory
  // would only have to be freed, above the loop's priority, when the guard dies.
  mlockall(MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT);
  if (priority == 0) return "";
  sched_param parameters{};
  parameters.sched_priority = priority;
  if (sched_setscheduler(0, SCHED_FIFO, &parameters) == 0) return "";
  return fmt::format(
      "relay guard: no right to SCHED_FIFO priority {} ({}), one above the loop's; raise RLIMIT_RTPRIO "
      "(LimitRTPRIO in the systemd unit) or lower [realtime] priority",
      priority, std::strerror(errno));
}

[[noreturn]] void be_the_guard(const RelayGuard::Settings& settings, GuardedMemory& memory, int lifeline) {
  leave_the_station(lifeline);
  lifeline = STDERR_FILENO + 1;
  Result<Line> line = Line::open_output(settings.line, LineRole::EnableRelay, false);
  std::string answer = line ? take_priority(settings.priority) : line.error().message;
  const bool ready = answer.empty();
  if (ready) memory.guard_beat_ns.store(monotonic_now_ns());
  answer.push_back('\n');
  if (write(lifeline, answer.data(), answer.size()) == static_cast<ssize_t>(answer.size()) && ready)
    guard(std::move(*line), settings, memory, lifeline);
  _exit(0);
}

std::string read_answer(int lifeline) {
  std::string answer;
  char character = 0;
  while (read(lifeline, &character, 1) == 1) {
    if (character == '\n') return answer;
    answer.push_back(character);
  }
  return "relay guard: it ended before it was ready";
}

}  // namespace

void UnmapGuardedMemory::operator()(GuardedMemory* memory) const noexcept {
  memory->~GuardedMemory();
  munmap(memory, sizeof *memory);
}

Result<SharedMemory> share_memory(std::int64_t lost_after_ns) {
  void* pages =
      mmap(nullptr, sizeof(GuardedMemory), PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
  if (pages == MAP_FAILED) return failure(fmt::format("panel: no shared memory: {}", std::strerror(errno)));
  return SharedMemory(new (pages) GuardedMemory(lost_after_ns));
}

Result<std::unique_ptr<RelayGuard>> RelayGuard::start(const Settings& settings, GuardedMemory& memory) {
  int lifeline[2];
  if (socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, lifeline) != 0)
    return failure(fmt::format("relay guard: {}", std::strerror(errno)));
  const pid_t process = fork();
  if (process == 0) {
    close(lifeline[0]);
    be_the_guard(settings, memory, lifeline[1]);
  }
  close(lifeline[1]);
  if (process < 0) {
    const std::string reason = std::strerror(errno);
    close(lifeline[0]);
    return failure("relay guard: cannot start its process: " + reason);
  }
  std::unique_ptr<RelayGuard> guard(new RelayGuard(process, lifeline[0]));
  const std::string refusal = read_answer(lifeline[0]);
  if (!refusal.empty()) return failure(refusal);
  return guard;
}

bool RelayGuard::ended() noexcept {
  if (!ended_) ended_ = waitpid(process_, nullptr, WNOHANG) == process_;
  return ended_;
}

RelayGuard::~RelayGuard() {
  close(lifeline_);
  if (!ended_) waitpid(process_, nullptr, 0);
}

}  // namespace clampd::gpio
