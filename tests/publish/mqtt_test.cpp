#include <cstdlib>
#include <filesystem>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "clampd/archive/json.hpp"
#include "publish/servers.hpp"
#include "publish/station_fixture.hpp"
#include "publish/subscriber.hpp"
#include "sparkplug_b.pb.h"

namespace clampd::publish {
namespace {

using support::eventually;
using support::PublishingStation;
using ::testing::Each;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

constexpr const char* kTopic = "clampd/line 3/checks";

class Mqtt : public ::testing::Test {
 protected:
  void SetUp() override {
    if (const std::string missing = support::Broker::missing(); !missing.empty()) GTEST_SKIP() << missing;
  }

  MqttSettings settings(const support::Broker& broker) const {
    MqttSettings settings;
    settings.host = "127.0.0.1";
    settings.port = broker.port();
    settings.client_id = "clampd-line 3";
    settings.topic = kTopic;
    return settings;
  }

  /// Sequences as a consumer has them that drops what it has seen.
  static std::vector<int> without_repeats(const std::vector<nlohmann::json>& documents) {
    std::vector<int> sequences;
    for (const nlohmann::json& document : documents) {
      const int sequence = document.at("outbox").at("sequence");
      if (sequences.empty() || sequence > sequences.back()) sequences.push_back(sequence);
    }
    return sequences;
  }
  static std::vector<int> up_to(int last) {
    std::vector<int> numbers;
    for (int i = 1; i <= last; ++i) numbers.push_back(i);
    return numbers;
  }

  PublishingStation station{"mqtt"};
};

TEST_F(Mqtt, PublishesEveryCheckOnceAndInOrder) {
  support::Broker broker;
  broker.start();
  support::Subscriber line(broker.port());
  station.save_up_to(3);
  station.start(make_mqtt_channel(settings(broker)));
  station.save_up_to(30);
  ASSERT_TRUE(eventually([&] { return station.pending() == 0; })) << station.status().error;
  ASSERT_TRUE(eventually([&] { return line.messages(kTopic).size() >= 30; }));
  station.stop();
  const auto documents = line.documents(kTopic);
  ASSERT_EQ(documents.size(), 30u) << "nothing twice where nothing fails";
  EXPECT_EQ(without_repeats(documents), up_to(30));
  for (int i = 0; i < 30; ++i)
    EXPECT_EQ(documents[static_cast<std::size_t>(i)].at("record"), PublishingStation::id(i + 1));

  nlohmann::json whole = check_json(PublishingStation::check(1));
  for (const char* promised :
       {"schema", "serial", "verdict", "parameters", "reason", "tracking_rms_N", "cause"})
    EXPECT_EQ(documents[0].at(promised), whole.at(promised)) << promised;
  EXPECT_EQ(documents[0].at("runs").size(), 2u);
  EXPECT_EQ(documents[0].at("runs")[0].at("sha256"), whole.at("runs")[0].at("sha256"));
}

TEST_F(Mqtt, WaitsForABrokerThatIsAwayAndComesBack) {
  support::Broker broker;
  station.start(make_mqtt_channel(settings(broker)));
  station.save_up_to(5);
  ASSERT_TRUE(eventually([&] { return !station.status().error.empty(); }));
  EXPECT_THAT(station.status().error, HasSubstr("nothing listens at 127.0.0.1"));
  EXPECT_FALSE(station.status().connected);
  EXPECT_EQ(station.pending(), 5u);

  broker.start();
  support::Subscriber line(broker.port());  // before the publisher, or as well: its session is the broker's
  // The mark in the database comes before the word in the status.
  ASSERT_TRUE(eventually([&] { return station.status().last == PublishingStation::id(5); }))
      << station.status().error;
  EXPECT_EQ(station.pending(), 0u);
  EXPECT_EQ(station.status().error, "");

  broker.stop();
  station.save_up_to(9);
  ASSERT_TRUE(eventually([&] { return !station.status().error.empty(); }));
  broker.start();
  ASSERT_TRUE(eventually([&] { return station.pending() == 0; })) << station.status().error;
  broker.kill();
  station.save_up_to(12);
  ASSERT_TRUE(eventually([&] { return !station.status().error.empty(); }));
  EXPECT_EQ(station.pending(), 3u);
  broker.start();
  ASSERT_TRUE(eventually([&] { return station.pending() == 0; })) << station.status().error;
}

TEST_F(Mqtt, NothingIsLostWhileTheBrokerComesAndGoes) {
  support::Broker broker;
  broker.start();
  support::Subscriber line(broker.port());
  station.start(make_mqtt_channel(settings(broker)));
  for (int round = 1; round <= 4; ++round) {
    station.save_up_to(20 * round - 5);  // the broker goes while some of these are on their way
    broker.stop();
    station.save_up_to(20 * round);
    broker.start();
  }
  ASSERT_TRUE(eventually([&] { return station.pending() == 0; })) << station.status().error;
  ASSERT_TRUE(eventually([&] { return without_repeats(line.documents(kTopic)) == up_to(80); }))
      << line.messages(kTopic).size();
}

TEST_F(Mqtt, SaysWhatTheBrokerRefuses) {
  support::Broker broker("password_file /dev/null\n");
  broker.start();
  MqttSettings wrong = settings(broker);
  wrong.user = "nobody";
  support::TemporaryDirectory folder;
  wrong.password_file = folder.write("password", "secret\n");
  namespace fs = std::filesystem;
  fs::permissions(wrong.password_file, fs::perms(0644));
  station.save_up_to(1);
  station.start(make_mqtt_channel(wrong));
  ASSERT_TRUE(eventually([&] { return !station.status().error.empty(); }));
  EXPECT_THAT(station.status().error, HasSubstr("everybody on this machine may read the password"));
  fs::permissions(wrong.password_file, fs::perms(0600));
  station.start(make_mqtt_channel(wrong));
  ASSERT_TRUE(eventually([&] { return !station.status().error.empty(); }));
  EXPECT_THAT(station.status().error, HasSubstr("refuses the station"));
  EXPECT_THAT(station.status().error, HasSubstr("[mqtt] user, password_file"));
  EXPECT_EQ(station.status().error.find("secret"), std::string::npos);
  EXPECT_EQ(station.pending(), 1u);
  wrong.password_file += ".none";
  station.start(make_mqtt_channel(wrong));
  ASSERT_TRUE(eventually([&] { return station.status().error.find("password_file") != std::string::npos; }));
}

TEST_F(Mqtt, EncryptsAndChecksTheBrokersCertificate) {
  support::TemporaryDirectory folder;
  const auto certificate = [&](const std::string& name) {
    return "openssl req -x509 -newkey rsa:2048 -nodes -days 2 -subj /CN=localhost -addext "
           "subjectAltName=DNS:localhost "
           "-keyout " +
           folder.path(name + ".key") + " -out " + folder.path(name + ".pem") + " 2>/dev/null";
  };
  if (std::system((certificate("broker") + " && " + certificate("other")).c_str()) != 0)
    GTEST_SKIP() << "no openssl here: `tools/dev setup` installs it";
  for (const char* file : {".", "broker.key", "broker.pem"}) support::give_to_server(folder.path(file));
  support::Broker broker("certfile " + folder.path("broker.pem") + "\nkeyfile " + folder.path("broker.key") +
                         "\n");
  broker.start();
  MqttSettings tls = settings(broker);
  tls.host = "localhost";
  tls.tls_ca_file = folder.path("other.pem");
  station.save_up_to(2);
  station.start(make_mqtt_channel(tls));
  ASSERT_TRUE(eventually([&] { return !station.status().error.empty(); }));
  EXPECT_THAT(station.status().error, HasSubstr("tls_ca_file"));
  EXPECT_EQ(station.pending(), 2u);
  tls.tls_ca_file = folder.path("broker.pem");
  station.start(make_mqtt_channel(tls));
  ASSERT_TRUE(eventually([&] { return station.pending() == 0; })) << station.status().error;
}

TEST_F(Mqtt, BearsFeedsAndBuriesASparkplugNode) {
  support::Broker broker;
  broker.start();
  support::Subscriber line(broker.port());
  MqttSettings sparkplug = settings(broker);
  sparkplug.sparkplug_group = "plant";
  sparkplug.sparkplug_node = "line 3";
  const auto of = [&](const char* kind) {
    std::vector<sparkplug::Payload> payloads;
    for (const auto& message : line.messages(std::string("spBv1.0/plant/") + kind + "/line 3"))
      payloads.emplace_back().ParseFromString(message.payload);
    return payloads;
  };
  const auto session = [](const sparkplug::Payload& payload) {
    for (const sparkplug::Metric& metric : payload.metrics())
      if (metric.name() == "bdSeq") return static_cast<int>(metric.long_value());
    return -1;
  };
  station.save_up_to(2);
  station.start(make_mqtt_channel(sparkplug));
  ASSERT_TRUE(eventually([&] { return station.pending() == 0; })) << station.status().error;
  station.save_up_to(3);
  ASSERT_TRUE(eventually([&] { return of("NDATA").size() == 3 && line.messages(kTopic).size() == 3; }));
  ASSERT_EQ(of("NBIRTH").size(), 1u);
  EXPECT_EQ(of("NBIRTH")[0].seq(), 0u);
  EXPECT_EQ(of("NDATA")[0].seq(), 1u);
  EXPECT_EQ(of("NDATA")[2].seq(), 3u);
  EXPECT_TRUE(of("NDATA")[0].metrics(0).is_historical()) << "it was saved before the connection";
  EXPECT_FALSE(of("NDATA")[2].metrics(0).is_historical());
  const auto topics = line.topics();
  EXPECT_EQ(topics[0], "spBv1.0/plant/NBIRTH/line 3");
  EXPECT_EQ(topics[1], "spBv1.0/plant/NDATA/line 3")
      << "before the document, whose acknowledgement covers it";
  EXPECT_EQ(topics[2], kTopic);

  sparkplug::Payload command;
  command.add_metrics()->set_name("Node Control/Rebirth");
  command.mutable_metrics(0)->set_boolean_value(true);
  line.publish("spBv1.0/plant/NCMD/line 3", "garbage");
  line.publish("spBv1.0/plant/NCMD/line 3", command.SerializeAsString());
  ASSERT_TRUE(eventually([&] { return of("NBIRTH").size() == 2; }));
  EXPECT_EQ(of("NBIRTH")[1].seq(), 0u);
  EXPECT_EQ(session(of("NBIRTH")[1]), 0) << "still the same connection";
  bool newest = false;
  const sparkplug::Payload reborn = of("NBIRTH")[1];
  for (const sparkplug::Metric& metric : reborn.metrics())
    newest = newest || (metric.name() == "Check/Serial" && metric.string_value() == "EMB-0003");
  EXPECT_TRUE(newest);

  station.stop();
  ASSERT_TRUE(eventually([&] { return of("NDEATH").size() == 1; }));
  EXPECT_EQ(session(of("NDEATH")[0]), 0);
  EXPECT_FALSE(of("NDEATH")[0].has_seq());
  station.start(make_mqtt_channel(sparkplug));
  ASSERT_TRUE(eventually([&] { return of("NBIRTH").size() == 3; }));
  EXPECT_EQ(session(of("NBIRTH")[2]), 1) << "counted over restarts";
}

}  // namespace
}  // namespace clampd::publish
