#pragma once

#include <mutex>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

struct mosquitto;

namespace clampd::support {

/// Another client of the broker, with a persistent session: it comes back by itself and misses nothing.
class Subscriber {
 public:
  struct Message {
    std::string topic;
    std::string payload;
  };

  /// Returns once it is subscribed to all topics.
  explicit Subscriber(int port);
  ~Subscriber();
  Subscriber(const Subscriber&) = delete;
  Subscriber& operator=(const Subscriber&) = delete;

  std::vector<Message> messages(const std::string& topic) const;
  /// Documents of a topic in the order of their arrival, repeats included.
  std::vector<nlohmann::json> documents(const std::string& topic) const;
  /// Topics in the order of their messages' arrival.
  std::vector<std::string> topics() const;
  void publish(const std::string& topic, const std::string& payload);

 private:
  static void subscribed(mosquitto*, void* self, int, int, const int*);
  mosquitto* client_;
  mutable std::mutex mutex_;
  bool subscribed_ = false;
  std::vector<Message> messages_;
};

}  // namespace clampd::support
