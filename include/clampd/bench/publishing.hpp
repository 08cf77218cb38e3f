#pragma once

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "clampd/archive/store.hpp"
#include "clampd/publish/publisher.hpp"
#include "clampd/station/configuration.hpp"

namespace clampd::bench {

/// A channel as the technician sees it.
struct ChannelReport {
  std::string channel;  ///< "mqtt" or "postgresql"
  std::string where;    ///< host:port
  bool connected = false;
  std::size_t pending = 0;    ///< checks that wait
  double oldest_age_s = 0.0;  ///< how long the oldest of them waits; 0: none does
  std::string error;          ///< empty: nothing is wrong
};

/// What is to be said of a password that goes over the network in clear text, or to whoever takes the
/// server's name; empty: there is none that does.
std::string password_warning(const StationConfiguration& configuration, const std::string& channel);

/// Every configured channel's publisher, each in a thread of its own. What is saved reaches their outboxes if
/// the store that saves it queues for `publication_channels`.
class Publishing {
 public:
  /// `on_change` is called by the publishers' threads; an empty error: the channel is connected.
  Publishing(const StationConfiguration& configuration,
             std::function<void(const std::string& channel, const std::string& error)> on_change);

  /// A check was saved.
  void notify() noexcept;
  /// `store` counts what waits.
  std::vector<ChannelReport> report(const CheckStore& store) const;

 private:
  StationConfiguration configuration_;
  std::vector<std::unique_ptr<publish::Publisher>> publishers_;
};

/// "nothing waits", or how many checks do and for how long.
std::string waiting_text(std::size_t pending, double oldest_age_s);

/// The configured channels' names.
std::vector<std::string> publication_channels(const StationConfiguration& configuration);

/// The same reports where no publisher runs: every channel is connected once, under a name of its own, and
/// closed again. `store` may be null: nothing was saved yet.
std::vector<ChannelReport> try_channels(const StationConfiguration& configuration, const CheckStore* store);

}  // namespace clampd::bench
