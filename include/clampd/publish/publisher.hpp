#pragma once

#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>

#include "clampd/archive/store.hpp"
#include "clampd/publish/backoff.hpp"
#include "clampd/publish/channel.hpp"
#include "clampd/publish/wake_event.hpp"

namespace clampd::publish {

struct PublisherOptions {
  std::string channel;   ///< name of its outbox
  std::string database;  ///< the store's file
  BackoffOptions backoff = {};
  std::uint64_t seed = 0;  ///< of the back-off's jitter
  /// Called by the publisher's thread when it connected (empty) or when its error changed. May be empty.
  std::function<void(const std::string& error)> on_change = {};
};

/// What a publisher is doing.
struct PublisherStatus {
  bool connected = false;
  std::string error;  ///< why not, in words; empty: nothing is wrong
  std::string last;   ///< id of the last check that was acknowledged since the start
};

/// Empties one outbox of the store, in its order, from a thread of its own: the oldest check is sent,
/// acknowledged, marked as published, and only then the next one is taken. A process that ends between
/// acknowledgement and mark sends that one check again; a check that was saved is never left out.
class Publisher {
 public:
  Publisher(PublisherOptions options, std::unique_ptr<Channel> channel);
  /// Ends the thread; what was not acknowledged stays in the outbox.
  ~Publisher();
  Publisher(const Publisher&) = delete;
  Publisher& operator=(const Publisher&) = delete;

  const std::string& channel() const { return options_.channel; }
  /// A check was saved. Without it the outbox is looked at every second.
  void notify() noexcept { wake_.ring(); }
  PublisherStatus status() const;

 private:
  void run();
  Result<void> work();
  Result<void> connect();
  Result<void> settle();
  void tell(PublisherStatus status);

  PublisherOptions options_;
  std::unique_ptr<Channel> way_;
  WakeEvent wake_;
  mutable std::mutex mutex_;
  PublisherStatus status_;  ///< under mutex_

  // Of the thread.
  std::optional<CheckStore> store_;
  std::string connected_since_;              ///< RFC 3339; empty: not connected
  std::optional<OutboxEntry> acknowledged_;  ///< and not yet marked
  Backoff backoff_;

  std::thread thread_;
};

}  // namespace clampd::publish
