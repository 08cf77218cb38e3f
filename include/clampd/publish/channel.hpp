#pragma once

#include <chrono>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include "clampd/base/result.hpp"
#include "clampd/publish/wake_event.hpp"
#include "clampd/record/check_record.hpp"

namespace clampd::publish {

/// What a channel may say when it connects.
struct ConnectionContext {
  std::uint64_t connection = 0;  ///< how often this channel connected before, over all of the station's life
  std::optional<CheckRecord> latest;  ///< the newest check, published or not
};

/// A check on its way out.
struct Publication {
  const CheckRecord& record;  ///< its runs without rows, unless the channel wants_raw_runs()
  std::int64_t sequence = 0;  ///< in the channel's outbox
  bool late = false;          ///< it was saved before this connection was made
};

/// A way out of the station. Used by one thread; errors are sentences for a technician. After an error the
/// channel is closed and connected again. Whatever waits gives up when the wake stops.
class Channel {
 public:
  virtual ~Channel() = default;
  /// Whether it sends the runs' rows too.
  virtual bool wants_raw_runs() const { return false; }

  virtual Result<void> connect(const ConnectionContext& context, const WakeEvent& wake) = 0;
  /// Returns once the other side has acknowledged: from then on it answers for the check.
  virtual Result<void> send(const Publication& publication, const WakeEvent& wake) = 0;
  /// Looks after the idle connection until the wake rings, or at most so long.
  virtual Result<void> attend(const WakeEvent& wake, std::chrono::milliseconds longest) = 0;
  virtual void close() noexcept = 0;
};

/// MQTT 3.1.1 with QoS 1. Every check is one JSON document (publication_document) on TOPIC. With a Sparkplug
/// group there are, on the same connection and before each document, Sparkplug B messages of an edge node:
/// the acknowledgement of the document stands for both.
struct MqttSettings {
  std::string host;
  int port = 1883;
  std::string tls_ca_file;    ///< empty: not encrypted
  std::string user;           ///< empty: none
  std::string password_file;  ///< read at every connect; empty: none
  std::string client_id;
  std::string topic;
  std::string sparkplug_group;  ///< empty: no Sparkplug
  std::string sparkplug_node;
};
std::unique_ptr<Channel> make_mqtt_channel(MqttSettings settings);

/// PostgreSQL, schema `clampd`, which is made and brought up to date by the first station that connects. Each
/// check is one transaction; one that is already there stays as it is.
struct PostgresqlSettings {
  std::string host;  ///< name, address, or folder of the server's socket
  int port = 5432;
  std::string database;
  std::string user;           ///< empty: as the operating system calls the station's user
  std::string password_file;  ///< read at every connect; empty: none
  std::string tls_ca_file;    ///< empty: encrypted if the server can, its certificate not verified
  bool raw_runs = false;      ///< the runs themselves too, once each
};
std::unique_ptr<Channel> make_postgresql_channel(PostgresqlSettings settings);

}  // namespace clampd::publish
