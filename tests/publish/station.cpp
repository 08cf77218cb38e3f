// A station whose checks are made up: saves as many as it is told, publishing all the while. It writes a line
// to standard output for every check that is saved, and then, unless it was told to stay, ends once all is
// published.
#include <algorithm>
#include <cstdio>
#include <memory>
#include <string>
#include <vector>

#include <CLI/CLI.hpp>

#include "clampd/publish/publisher.hpp"
#include "support/check_records.hpp"
#include "support/eventually.hpp"

int main(int argc, char** argv) {
  using namespace clampd;
  using namespace std::chrono_literals;
  CLI::App app{"saves checks and publishes them"};
  std::string database, server;
  int port = 0;
  unsigned first = 0, count = 0, seed = 0;
  app.add_option("--database", database)->required();
  app.add_option("--mqtt", port);
  app.add_option("--postgresql", server);
  app.add_option("--first", first);
  app.add_option("--count", count);
  app.add_option("--seed", seed);
  CLI11_PARSE(app, argc, argv);

  Result<CheckStore> store = CheckStore::open(database);
  if (!store) return std::fprintf(stderr, "%s\n", store.error().message.c_str()), 1;
  std::vector<std::unique_ptr<publish::Publisher>> publishers;
  std::vector<std::string> channels;
  const auto publish = [&](const char* channel, std::unique_ptr<publish::Channel> way) {
    channels.emplace_back(channel);
    publishers.push_back(std::make_unique<publish::Publisher>(
        publish::PublisherOptions{
            .channel = channel, .database = database, .backoff = {5ms, 100ms}, .seed = seed},
        std::move(way)));
  };
  if (port != 0) {
    publish::MqttSettings mqtt;
    mqtt.host = "127.0.0.1";
    mqtt.port = port;
    mqtt.client_id = mqtt.topic = "station";
    mqtt.sparkplug_group = "plant";
    mqtt.sparkplug_node = "station";
    publish("mqtt", publish::make_mqtt_channel(mqtt));
  }
  if (!server.empty()) {
    publish::PostgresqlSettings postgresql;
    postgresql.host = server;
    postgresql.database = postgresql.user = "line";
    publish("postgresql", publish::make_postgresql_channel(postgresql));
  }
  store->queue_for(channels);

  for (unsigned number = first; number < first + count; ++number) {
    char id[40];
    std::snprintf(id, sizeof id, "20261121T%09uZ-00000000", number);
    if (const Result<void> saved = store->save(support::make_check_record(id)); !saved)
      return std::fprintf(stderr, "%s\n", saved.error().message.c_str()), 1;
    std::printf("%s\n", id);
    std::fflush(stdout);
    for (const auto& publisher : publishers) publisher->notify();
  }
  const bool published = std::all_of(channels.begin(), channels.end(), [&](const std::string& channel) {
    return support::eventually(
        [&] {
          return store->outbox(channel).value_or(OutboxState{1, ""}).pending == 0;
        },
        600s);
  });
  return published ? 0 : 1;
}
