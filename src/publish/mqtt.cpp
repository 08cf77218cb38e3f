#include <mosquitto.h>
#include <poll.h>

#include <cerrno>
#include <cstring>
#include <utility>

#include <fmt/format.h>

#include "clampd/publish/channel.hpp"
#include "clampd/publish/document.hpp"
#include "clampd/publish/sparkplug.hpp"
#include "clampd/record/utc.hpp"
#include "src/publish/password.hpp"
#include "src/publish/reachable.hpp"

namespace clampd::publish {
namespace {

using namespace std::chrono_literals;
using Clock = std::chrono::steady_clock;

constexpr int kKeepAlive_s = 15;
constexpr auto kPatience = 15s;  // for one answer of the broker
constexpr int kAtMostOnce = 0;
constexpr int kAtLeastOnce = 1;

struct Library {
  Library() { mosquitto_lib_init(); }
  ~Library() { mosquitto_lib_cleanup(); }
};

struct Destroy {
  void operator()(mosquitto* client) const { mosquitto_destroy(client); }
};

/// One client object a connection: nothing of an earlier connection is ever sent again behind our back, so
/// that what the broker gets keeps the outbox's order, repeats included.
class MqttChannel final : public Channel {
 public:
  explicit MqttChannel(MqttSettings settings) : settings_(std::move(settings)) {}
  ~MqttChannel() override { close(); }

  Result<void> connect(const ConnectionContext& context, const WakeEvent& wake) override {
    close();
    if (Result<void> there = reachable(settings_.host, settings_.port, wake); !there)
      return failure("MQTT: " + there.error().message + " ([mqtt] host, port)");
    client_.reset(mosquitto_new(settings_.client_id.c_str(), true, this));
    if (client_ == nullptr) return failure(fmt::format("MQTT: no client: {}", std::strerror(errno)));
    answered_ = false;
    refusal_ = 0;
    acknowledged_ = 0;
    rebirth_ = false;
    mosquitto_connect_callback_set(client_.get(), [](mosquitto*, void* self, int refusal) {
      static_cast<MqttChannel*>(self)->answered_ = true;
      static_cast<MqttChannel*>(self)->refusal_ = refusal;
    });
    mosquitto_publish_callback_set(client_.get(), [](mosquitto*, void* self, int message) {
      static_cast<MqttChannel*>(self)->acknowledged_ = message;
    });
    mosquitto_message_callback_set(
        client_.get(), [](mosquitto*, void* self, const mosquitto_message* message) {
          const std::string_view command(static_cast<const char*>(message->payload),
                                         static_cast<std::size_t>(message->payloadlen));
          if (asks_for_rebirth(command)) static_cast<MqttChannel*>(self)->rebirth_ = true;
        });
    if (Result<void> prepared = prepare(context); !prepared) return prepared;
    const int called = mosquitto_connect(client_.get(), settings_.host.c_str(), settings_.port, kKeepAlive_s);
    if (called != MOSQ_ERR_SUCCESS) return broken(called);
    if (Result<void> answer = wait_for([this] { return answered_; }, wake); !answer) return answer;
    if (refusal_ != 0)
      return failure(
          fmt::format("MQTT: the broker at {}:{} refuses the station: {} ([mqtt] user, password_file, "
                      "client_id)",
                      settings_.host, settings_.port, mosquitto_connack_string(refusal_)));
    if (!node_) return {};
    const std::string commands = topic("NCMD");
    const int subscribed = mosquitto_subscribe(client_.get(), nullptr, commands.c_str(), kAtLeastOnce);
    if (subscribed != MOSQ_ERR_SUCCESS) return broken(subscribed);
    return be_born();
  }

  Result<void> send(const Publication& publication, const WakeEvent& wake) override {
    if (node_) {
      if (!node_->born(publication.record)) {
        node_->admit(publication.record);
        if (Result<void> born = be_born(); !born) return born;
      }
      const std::string data = node_->data(publication.record, publication.late, utc_now_ns());
      if (!publication.late) node_->show(publication.record);
      // The document follows on the same connection: its acknowledgement says that this arrived too.
      if (Result<int> sent = publish(topic("NDATA"), data, kAtMostOnce); !sent)
        return tl::unexpected(sent.error());
    }
    const Result<int> message = publish(
        settings_.topic, publication_document(publication.record, publication.sequence), kAtLeastOnce);
    if (!message) return tl::unexpected(message.error());
    return wait_for([&] { return acknowledged_ == *message; }, wake);
  }

  Result<void> attend(const WakeEvent& wake, std::chrono::milliseconds longest) override {
    if (Result<void> served = serve(longest, wake.descriptor()); !served) return served;
    if (!std::exchange(rebirth_, false) || !node_) return {};
    return be_born();
  }

  void close() noexcept override {
    if (client_ == nullptr) return;
    // A disconnect takes the will along: the node says itself that it dies.
    if (node_) {
      const std::string death = node_->death(utc_now_ns());
      mosquitto_publish(client_.get(), nullptr, topic("NDEATH").c_str(), static_cast<int>(death.size()),
                        death.data(), kAtMostOnce, false);
    }
    mosquitto_disconnect(client_.get());
    client_.reset();
    node_.reset();
  }

 private:
  std::string topic(const char* kind) const {
    return fmt::format("spBv1.0/{}/{}/{}", settings_.sparkplug_group, kind, settings_.sparkplug_node);
  }

  /// What must be said before connecting: who we are, and the will.
  Result<void> prepare(const ConnectionContext& context) {
    if (!settings_.user.empty()) {
      const Result<std::string> password = read_password(settings_.password_file);
      if (!password) return failure("MQTT: " + password.error().message + " ([mqtt] password_file)");
      mosquitto_username_pw_set(client_.get(), settings_.user.c_str(),
                                password->empty() ? nullptr : password->c_str());
    }
    if (!settings_.tls_ca_file.empty() &&
        mosquitto_tls_set(client_.get(), settings_.tls_ca_file.c_str(), nullptr, nullptr, nullptr, nullptr) !=
            MOSQ_ERR_SUCCESS)
      return failure(fmt::format("MQTT: {} cannot be read ([mqtt] tls_ca_file)", settings_.tls_ca_file));
    if (settings_.sparkplug_group.empty()) return {};
    node_.emplace(context.connection);
    if (context.latest) node_->show(*context.latest);
    const std::string death = node_->death(utc_now_ns());
    const int willed = mosquitto_will_set(client_.get(), topic("NDEATH").c_str(),
                                          static_cast<int>(death.size()), death.data(), kAtLeastOnce, false);
    return willed == MOSQ_ERR_SUCCESS ? Result<void>() : broken(willed);
  }

  Result<void> be_born() {
    return publish(topic("NBIRTH"), node_->birth(utc_now_ns()), kAtMostOnce).map([](int) {});
  }

  Result<int> publish(const std::string& where, const std::string& payload, int quality) {
    int message = 0;
    const int published = mosquitto_publish(client_.get(), &message, where.c_str(),
                                            static_cast<int>(payload.size()), payload.data(), quality, false);
    if (published != MOSQ_ERR_SUCCESS) return broken(published);
    return message;
  }

  /// Serves the connection once, after waiting for it or for `other`.
  Result<void> serve(std::chrono::milliseconds longest, int other) {
    const int descriptor = mosquitto_socket(client_.get());
    if (descriptor < 0) return broken(MOSQ_ERR_CONN_LOST);
    const auto wanted = static_cast<short>(POLLIN | (mosquitto_want_write(client_.get()) ? POLLOUT : 0));
    pollfd descriptors[]{{descriptor, wanted, 0}, {other, POLLIN, 0}};
    ::poll(descriptors, 2, static_cast<int>(longest.count()));
    int result = MOSQ_ERR_SUCCESS;
    if ((descriptors[0].revents & POLLOUT) != 0) result = mosquitto_loop_write(client_.get(), 1);
    if (result == MOSQ_ERR_SUCCESS && (descriptors[0].revents & ~POLLOUT) != 0)
      result = mosquitto_loop_read(client_.get(), 1);
    if (result == MOSQ_ERR_SUCCESS) result = mosquitto_loop_misc(client_.get());
    return result == MOSQ_ERR_SUCCESS ? Result<void>() : broken(result);
  }

  template <class Condition>
  Result<void> wait_for(Condition condition, const WakeEvent& wake) {
    const auto until = Clock::now() + kPatience;
    while (!condition()) {
      if (wake.stopped()) return failure("MQTT: the station ends");
      if (Clock::now() > until)
        return failure(fmt::format("MQTT: the broker at {}:{} did not acknowledge within {} s",
                                   settings_.host, settings_.port, kPatience.count()));
      // A broker that refuses says so and hangs up at once: what it said counts.
      if (Result<void> served = serve(100ms, -1); !served && !condition()) return served;
    }
    return {};
  }

  tl::unexpected<Error> broken(int code) const {
    const int system = errno;
    std::string why = code == MOSQ_ERR_ERRNO ? std::strerror(system) : mosquitto_strerror(code);
    if (!why.empty() && why.back() == '.') why.pop_back();
    const char* advice = code == MOSQ_ERR_TLS || code == MOSQ_ERR_EAI
                             ? ": is its certificate signed by [mqtt] tls_ca_file and made out to this host?"
                             : ": look at the broker and its log";
    return failure(fmt::format("MQTT: the connection to {}:{} broke ({}){}", settings_.host, settings_.port,
                               why, advice));
  }

  Library library_;
  MqttSettings settings_;
  std::unique_ptr<mosquitto, Destroy> client_;
  std::optional<SparkplugNode> node_;
  bool answered_ = false;
  int refusal_ = 0;
  int acknowledged_ = 0;  ///< the last message's number
  bool rebirth_ = false;
};

}  // namespace

std::unique_ptr<Channel> make_mqtt_channel(MqttSettings settings) {
  return std::make_unique<MqttChannel>(std::move(settings));
}

}  // namespace clampd::publish
