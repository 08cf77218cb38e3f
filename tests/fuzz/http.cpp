// Whatever may be sent to the control API: bytes of a connection, in front of the real server and the real
// daemon, whose loop stands still, so that no check can begin.

#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <string_view>

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include "clampd/api/control_server.hpp"
#include "clampd/archive/store.hpp"
#include "clampd/base/assert.hpp"
#include "clampd/daemon/daemon.hpp"
#include "support/check_records.hpp"
#include "support/network.hpp"
#include "support/temporary_directory.hpp"
#include "tools/dashboard/assets.hpp"

namespace {

using namespace clampd;

/// The token of every input: what needs one is not to be missed.
constexpr std::string_view kToken = "0123456789abcdef0123456789abcdef0123456789abcdef0123456789abcdef";

/// A station with two checks on record.
class Station {
 public:
  Station() {
    spdlog::set_level(spdlog::level::off);
    StationConfiguration configuration;
    configuration.can.interface = "simulated";
    configuration.database = folder_.path("checks.sqlite");
    configuration.control.port = 0;  // any
    configuration.control.token_file = folder_.write("token", std::string(kToken) + "\n");
    ::chmod(configuration.control.token_file.c_str(), 0600);
    auto prepared = bench::prepare_station(configuration);
    auto plant = bench::load_plant("");
    auto store = CheckStore::open(configuration.database);
    CLAMPD_ASSERT(prepared && plant && store);
    station_ = std::make_unique<bench::PreparedStation>(std::move(*prepared));
    store_ = std::make_unique<CheckStore>(std::move(*store));
    for (const char* id : {"20261120T234107123Z-9f3a61c2", "20261121T080000000Z-00000001"})
      CLAMPD_ASSERT(store_->save(support::make_check_record(id)));
    bench_ = std::make_unique<bench::SimulatedBench>(*station_, *plant);
    daemon_ = std::make_unique<daemon::Daemon>(*station_, *bench_, *store_);
    auto server = api::ControlServer::start(*daemon_, configuration.control, dashboard::assets());
    CLAMPD_ASSERT(server);
    server_ = std::move(*server);
  }

  /// What comes back for these bytes, after which the sender has nothing more to say.
  std::string answer(const std::uint8_t* data, std::size_t size) const {
    const int socket = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    const sockaddr_in address = support::loopback(server_->port());
    // The fuzzer's own alarm interrupts calls.
    CLAMPD_ASSERT(TEMP_FAILURE_RETRY(
                      ::connect(socket, reinterpret_cast<const sockaddr*>(&address), sizeof address)) == 0);
    for (std::size_t sent = 0; sent < size;) {
      const ssize_t count = TEMP_FAILURE_RETRY(::send(socket, data + sent, size - sent, MSG_NOSIGNAL));
      if (count <= 0) break;
      sent += static_cast<std::size_t>(count);
    }
    ::shutdown(socket, SHUT_WR);
    std::string received;
    std::array<char, 4096> buffer;
    for (ssize_t count = 0;
         (count = TEMP_FAILURE_RETRY(::recv(socket, buffer.data(), buffer.size(), 0))) > 0;)
      received.append(buffer.data(), static_cast<std::size_t>(count));
    ::close(socket);
    return received;
  }

  std::size_t files() const { return folder_.entries(); }

 private:
  support::TemporaryDirectory folder_;
  std::unique_ptr<bench::PreparedStation> station_;
  std::unique_ptr<CheckStore> store_;
  std::unique_ptr<bench::SimulatedBench> bench_;
  std::unique_ptr<daemon::Daemon> daemon_;
  std::unique_ptr<api::ControlServer> server_;
};

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static const Station station;
  static const std::size_t files = station.files();
  const std::string answer = station.answer(data, size);
  if (!answer.empty()) {
    CLAMPD_ASSERT(answer.starts_with("HTTP/1.1 "));
    CLAMPD_ASSERT(!answer.starts_with("HTTP/1.1 500"));
    CLAMPD_ASSERT(answer.find(kToken) == std::string::npos || size >= kToken.size());
  }
  CLAMPD_ASSERT(station.files() <= files + 2);  // SQLite's journal comes and goes
  constexpr std::string_view kStatus = "GET /v1/status HTTP/1.1\r\nHost: localhost\r\n\r\n";
  static unsigned count = 0;
  if (count++ % 64 != 0) return 0;
  const std::string status =
      station.answer(reinterpret_cast<const std::uint8_t*>(kStatus.data()), kStatus.size());
  if (!status.starts_with("HTTP/1.1 200")) fmt::print(stderr, "the status is: {}\n", status);
  CLAMPD_ASSERT(status.starts_with("HTTP/1.1 200"));
  return 0;
}
