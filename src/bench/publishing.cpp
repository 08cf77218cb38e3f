#include "clampd/bench/publishing.hpp"

#include <algorithm>
#include <tuple>
#include <utility>

#include <fmt/format.h>

#include "clampd/base/entropy.hpp"
#include "clampd/record/utc.hpp"

namespace clampd::bench {
namespace {

constexpr const char* kMqtt = "mqtt";
constexpr const char* kPostgresql = "postgresql";

/// As one level of a topic.
std::string topic_level(std::string name) {
  for (char& c : name)
    if (c == '+' || c == '#' || c == '/') c = '_';
  return name;
}

publish::MqttSettings mqtt_settings(const StationConfiguration& configuration) {
  const MqttConfiguration& mqtt = configuration.mqtt;
  const std::string station = topic_level(configuration.name);
  publish::MqttSettings settings;
  settings.host = mqtt.host;
  settings.port = mqtt.port;
  settings.tls_ca_file = mqtt.tls_ca_file;
  settings.user = mqtt.user;
  settings.password_file = mqtt.password_file;
  settings.client_id = mqtt.client_id.empty() ? "clampd-" + station : mqtt.client_id;
  settings.topic = fmt::format("{}/{}/checks", mqtt.topic_prefix, station);
  settings.sparkplug_group = mqtt.sparkplug_group;
  settings.sparkplug_node = mqtt.sparkplug_node.empty() ? station : mqtt.sparkplug_node;
  return settings;
}

publish::PostgresqlSettings postgresql_settings(const PostgresqlConfiguration& postgresql) {
  return {postgresql.host,          postgresql.port,        postgresql.database, postgresql.user,
          postgresql.password_file, postgresql.tls_ca_file, postgresql.raw_runs};
}

std::string where(const StationConfiguration& configuration, const std::string& channel) {
  return channel == kMqtt ? fmt::format("{}:{}", configuration.mqtt.host, configuration.mqtt.port)
                          : fmt::format("{}:{}, database {}", configuration.postgresql.host,
                                        configuration.postgresql.port, configuration.postgresql.database);
}

std::unique_ptr<publish::Channel> make_channel(const StationConfiguration& configuration,
                                               const std::string& channel) {
  return channel == kMqtt ? publish::make_mqtt_channel(mqtt_settings(configuration))
                          : publish::make_postgresql_channel(postgresql_settings(configuration.postgresql));
}

void count_waiting(const CheckStore& store, ChannelReport& report) {
  const Result<OutboxState> outbox = store.outbox(report.channel);
  if (!outbox) {
    report.error = outbox.error().message;
    return;
  }
  report.pending = outbox->pending;
  if (const auto queued_ns = parse_utc(outbox->oldest))
    report.oldest_age_s = std::max(0.0, static_cast<double>(utc_now_ns() - *queued_ns) * 1e-9);
}

}  // namespace

std::string waiting_text(std::size_t pending, double oldest_age_s) {
  if (pending == 0) return "nothing waits";
  constexpr double kMinute_s = 60.0, kHour_s = 3'600.0, kDay_s = 86'400.0;
  const std::string age = oldest_age_s < 2.0 * kMinute_s ? fmt::format("{:.0f} s", oldest_age_s)
                          : oldest_age_s < 2.0 * kHour_s ? fmt::format("{:.0f} min", oldest_age_s / kMinute_s)
                          : oldest_age_s < 2.0 * kDay_s  ? fmt::format("{:.0f} h", oldest_age_s / kHour_s)
                                                         : fmt::format("{:.0f} days", oldest_age_s / kDay_s);
  return pending == 1 ? fmt::format("1 check waits, for {}", age)
                      : fmt::format("{} checks wait, the oldest for {}", pending, age);
}

std::string password_warning(const StationConfiguration& configuration, const std::string& channel) {
  const bool mqtt = channel == kMqtt;
  const auto& [host, password_file, ca_file] =
      mqtt ? std::tie(configuration.mqtt.host, configuration.mqtt.password_file,
                      configuration.mqtt.tls_ca_file)
           : std::tie(configuration.postgresql.host, configuration.postgresql.password_file,
                      configuration.postgresql.tls_ca_file);
  const bool stays_here =
      host == "localhost" || host == "::1" || host.rfind("127.", 0) == 0 || host.rfind('/', 0) == 0;
  if (password_file.empty() || !ca_file.empty() || stays_here) return "";
  return fmt::format("the password goes to {} {}: set [{}] tls_ca_file", host,
                     mqtt ? "in clear text" : "without the server's certificate being verified", channel);
}

std::vector<std::string> publication_channels(const StationConfiguration& configuration) {
  std::vector<std::string> channels;
  if (configuration.mqtt.used()) channels.emplace_back(kMqtt);
  if (configuration.postgresql.used()) channels.emplace_back(kPostgresql);
  return channels;
}

Publishing::Publishing(const StationConfiguration& configuration,
                       std::function<void(const std::string&, const std::string&)> on_change)
    : configuration_(configuration) {
  for (const std::string& channel : publication_channels(configuration)) {
    publish::PublisherOptions options;
    options.channel = channel;
    options.database = configuration.database;
    options.seed = entropy()();
    if (const std::string warning = password_warning(configuration, channel); !warning.empty())
      on_change(channel, warning);
    options.on_change = [channel, on_change](const std::string& error) { on_change(channel, error); };
    publishers_.push_back(
        std::make_unique<publish::Publisher>(std::move(options), make_channel(configuration, channel)));
  }
}

void Publishing::notify() noexcept {
  for (const auto& publisher : publishers_) publisher->notify();
}

std::vector<ChannelReport> Publishing::report(const CheckStore& store) const {
  std::vector<ChannelReport> reports;
  for (const auto& publisher : publishers_) {
    const publish::PublisherStatus status = publisher->status();
    ChannelReport& report = reports.emplace_back();
    report.channel = publisher->channel();
    report.where = where(configuration_, report.channel);
    report.connected = status.connected;
    count_waiting(store, report);
    if (!status.error.empty()) report.error = status.error;
  }
  return reports;
}

std::vector<ChannelReport> try_channels(const StationConfiguration& configuration, const CheckStore* store) {
  StationConfiguration tried = configuration;
  // The daemon's own connection stays: a broker ends the older of two clients of one name.
  tried.mqtt.client_id = mqtt_settings(configuration).client_id + "-doctor";
  tried.mqtt.sparkplug_group.clear();
  std::vector<ChannelReport> reports;
  for (const std::string& channel : publication_channels(configuration)) {
    ChannelReport& report = reports.emplace_back();
    report.channel = channel;
    report.where = where(configuration, channel);
    if (store != nullptr) count_waiting(*store, report);
    const publish::WakeEvent wake;
    const std::unique_ptr<publish::Channel> way = make_channel(tried, channel);
    const Result<void> connected = way->connect({}, wake);
    report.connected = connected.has_value();
    if (!connected) report.error = connected.error().message;
  }
  return reports;
}

}  // namespace clampd::bench
