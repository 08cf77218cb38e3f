// Causes a fault and says when: "MONOTONIC REALTIME" in seconds on standard output, both read immediately
// before the deed. A shell cannot do that: starting date(1) and the program that acts costs milliseconds of
// virtual time.
//
//   cause kill SIGNAL-NUMBER PID
//   cause link INTERFACE up|down
//   cause write FILE TEXT            e.g. a driver's unbind
//   cause frame INTERFACE ID#DATA    hexadecimal; an id above 7FF is sent with its flags, e.g. 20000040 is
//   bus-off
//
// With "at-enable INTERFACE" before the verb, it acts when the station's next command frame enables the
// drive.

#include <fcntl.h>
#include <sched.h>
#include <signal.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <functional>
#include <string>
#include <system_error>
#include <vector>

#include "command_frame.hpp"

namespace {

[[noreturn]] void give_up(const std::string& what) {
  std::perror(("cause: " + what).c_str());
  std::exit(2);
}

timespec now(clockid_t clock) {
  timespec time{};
  clock_gettime(clock, &time);
  return time;
}

int open_bus(const std::string& interface) {
  const int handle = open_can(interface);
  if (handle < 0) give_up(interface);
  return handle;
}

// A stop is carried out by the thread that gets it: an ordinary one waits for the processor, and the process
// goes on until then. So each thread gets it, the real-time one among them.
std::function<bool()> stop_of(pid_t pid) {
  std::vector<pid_t> threads;
  std::error_code failed;
  for (const auto& thread :
       std::filesystem::directory_iterator("/proc/" + std::to_string(pid) + "/task", failed))
    threads.push_back(std::atoi(thread.path().filename().c_str()));
  if (failed || threads.empty()) give_up("no process " + std::to_string(pid));
  return [=] {
    return std::all_of(threads.begin(), threads.end(),
                       [&](pid_t thread) { return syscall(SYS_tgkill, pid, thread, SIGSTOP) == 0; });
  };
}

// Everything that can be prepared is prepared before the clocks are read: what is returned only acts.
std::function<bool()> prepare(int count, char** words) {
  const std::string verb = count > 1 ? words[1] : "";
  if (count == 4 && verb == "kill") {
    const int signal_number = std::atoi(words[2]);
    const pid_t pid = std::atoi(words[3]);
    if (signal_number == SIGSTOP) return stop_of(pid);
    return [=] { return kill(pid, signal_number) == 0; };
  }
  if (count == 4 && verb == "link") {
    const int handle = socket(AF_INET, SOCK_DGRAM, 0);
    ifreq request = interface_request(words[2]);
    if (ioctl(handle, SIOCGIFFLAGS, &request) < 0) give_up(words[2]);
    if (std::strcmp(words[3], "up") == 0) {
      request.ifr_flags |= IFF_UP;
    } else {
      request.ifr_flags &= ~IFF_UP;
    }
    return [=]() mutable { return ioctl(handle, SIOCSIFFLAGS, &request) == 0; };
  }
  if (count == 4 && verb == "write") {
    const int file = open(words[2], O_WRONLY);
    if (file < 0) give_up(words[2]);
    const std::string text = words[3];
    return [=] { return write(file, text.data(), text.size()) == static_cast<ssize_t>(text.size()); };
  }
  if (count == 4 && verb == "frame") {
    const int handle = open_bus(words[2]);
    can_frame frame{};
    const std::string text = words[3];
    const std::size_t hash = text.find('#');
    if (hash == std::string::npos || (text.size() - hash - 1) / 2 > CAN_MAX_DLEN) give_up(text);
    frame.can_id = static_cast<canid_t>(std::stoul(text.substr(0, hash), nullptr, 16));
    for (std::size_t at = hash + 1; at + 1 < text.size(); at += 2) {
      frame.data[frame.can_dlc++] = static_cast<__u8>(std::stoul(text.substr(at, 2), nullptr, 16));
    }
    return [=] { return write(handle, &frame, sizeof frame) == sizeof frame; };
  }
  std::fputs(
      "usage: cause [at-enable INTERFACE] kill SIGNAL PID | link INTERFACE up|down | write FILE TEXT | frame "
      "INTERFACE ID#DATA\n",
      stderr);
  std::exit(2);
}

}  // namespace

int main(int count, char** words) {
  const bool waits = count > 3 && std::strcmp(words[1], "at-enable") == 0;
  const int bus = waits ? open_bus(words[2]) : -1;
  if (waits) {
    count -= 2;
    words += 2;
  }
  const std::function<bool()> act = prepare(count, words);
  // No ordinary process may come between the clocks and the deed, or between the frame and the deed. The
  // station and the brake go first all the same.
  const sched_param priority{.sched_priority = 10};
  if (sched_setscheduler(0, SCHED_FIFO, &priority) != 0) give_up("real-time priority");
  if (waits && !wait_for_command(bus, Command::Enable)) give_up("at-enable");
  const timespec monotonic = now(CLOCK_MONOTONIC);
  const timespec realtime = now(CLOCK_REALTIME);
  if (!act()) give_up(words[1]);
  std::printf("%ld.%09ld %ld.%09ld\n", monotonic.tv_sec, monotonic.tv_nsec, realtime.tv_sec,
              realtime.tv_nsec);
  return 0;
}
