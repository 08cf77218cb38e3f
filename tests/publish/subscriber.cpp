#include "publish/subscriber.hpp"

#include <mosquitto.h>

#include <stdexcept>

#include "publish/servers.hpp"

namespace clampd::support {

Subscriber::Subscriber(int port) {
  mosquitto_lib_init();
  client_ = mosquitto_new("line", false, this);
  mosquitto_connect_callback_set(
      client_, [](mosquitto* client, void*, int) { mosquitto_subscribe(client, nullptr, "#", 2); });
  mosquitto_subscribe_callback_set(client_, subscribed);
  mosquitto_message_callback_set(client_, [](mosquitto*, void* object, const mosquitto_message* message) {
    auto& self = *static_cast<Subscriber*>(object);
    const std::lock_guard lock(self.mutex_);
    self.messages_.push_back({message->topic, std::string(static_cast<const char*>(message->payload),
                                                          static_cast<std::size_t>(message->payloadlen))});
  });
  mosquitto_reconnect_delay_set(client_, 1, 1, false);
  mosquitto_connect_async(client_, "127.0.0.1", port, 30);
  mosquitto_loop_start(client_);
  if (!eventually([this] {
        const std::lock_guard lock(mutex_);
        return subscribed_;
      }))
    throw std::runtime_error("the subscriber does not get through");
}

Subscriber::~Subscriber() {
  mosquitto_disconnect(client_);
  mosquitto_loop_stop(client_, false);
  mosquitto_destroy(client_);
  mosquitto_lib_cleanup();
}

void Subscriber::subscribed(mosquitto*, void* object, int, int, const int*) {
  auto& self = *static_cast<Subscriber*>(object);
  const std::lock_guard lock(self.mutex_);
  self.subscribed_ = true;
}

std::vector<Subscriber::Message> Subscriber::messages(const std::string& topic) const {
  const std::lock_guard lock(mutex_);
  std::vector<Message> found;
  for (const Message& message : messages_)
    if (message.topic == topic) found.push_back(message);
  return found;
}

std::vector<nlohmann::json> Subscriber::documents(const std::string& topic) const {
  std::vector<nlohmann::json> found;
  for (const Message& message : messages(topic)) found.push_back(nlohmann::json::parse(message.payload));
  return found;
}

std::vector<std::string> Subscriber::topics() const {
  const std::lock_guard lock(mutex_);
  std::vector<std::string> found;
  for (const Message& message : messages_) found.push_back(message.topic);
  return found;
}

void Subscriber::publish(const std::string& topic, const std::string& payload) {
  mosquitto_publish(client_, nullptr, topic.c_str(), static_cast<int>(payload.size()), payload.data(), 1,
                    false);
}

}  // namespace clampd::support
