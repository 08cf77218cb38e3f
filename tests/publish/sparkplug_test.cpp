#include "clampd/publish/sparkplug.hpp"

#include <cmath>
#include <map>

#include <gtest/gtest.h>

#include "sparkplug_b.pb.h"
#include "support/check_records.hpp"

namespace clampd::publish {
namespace {

constexpr std::int64_t kNow_ns = 1'795'219'200'123'000'000;

sparkplug::Payload read(const std::string& bytes) {
  sparkplug::Payload payload;
  EXPECT_TRUE(payload.ParseFromString(bytes));
  return payload;
}

std::map<std::string, sparkplug::Metric> by_name(const sparkplug::Payload& payload) {
  std::map<std::string, sparkplug::Metric> metrics;
  for (const sparkplug::Metric& metric : payload.metrics()) metrics[metric.name()] = metric;
  return metrics;
}

TEST(Sparkplug, TheBirthNamesEverythingAndTheDataFollowsByAlias) {
  const CheckRecord check = support::make_check_record();
  SparkplugNode node(258);
  node.show(check);
  EXPECT_FALSE(node.born(check));
  const sparkplug::Payload birth = read(node.birth(kNow_ns));
  EXPECT_TRUE(node.born(check));
  EXPECT_EQ(birth.timestamp(), 1'795'219'200'123u);
  ASSERT_TRUE(birth.has_seq());
  EXPECT_EQ(birth.seq(), 0u);
  auto metrics = by_name(birth);
  EXPECT_EQ(metrics.at("bdSeq").long_value(), 2u) << "eight bits";
  EXPECT_EQ(by_name(read(node.death(kNow_ns))).at("bdSeq").long_value(), 2u);
  EXPECT_FALSE(metrics.at("Node Control/Rebirth").has_alias());
  EXPECT_FALSE(metrics.at("Node Control/Rebirth").boolean_value());
  EXPECT_EQ(metrics.at("Check/Verdict").string_value(), "FAIL");
  EXPECT_EQ(metrics.at("Parameters/k2/Value").double_value(), 24.64);
  EXPECT_EQ(metrics.at("Parameters/k2/Value").properties().keys(0), "engUnit");
  EXPECT_EQ(metrics.at("Parameters/k2/Value").properties().values(0).string_value(), "N/rad^2");
  for (const auto& [name, metric] : metrics) EXPECT_TRUE(metric.has_datatype()) << name;

  std::map<std::uint64_t, std::string> names;
  for (const auto& [name, metric] : metrics)
    if (metric.has_alias()) {
      EXPECT_TRUE(names.emplace(metric.alias(), name).second) << "an alias is one metric's";
    }
  CheckRecord next = check;
  next.verdict = Verdict::Pass;
  next.parameters[1].value = 35.5;
  next.tracking_rms_N = std::nan("");
  const sparkplug::Payload data = read(node.data(next, false, kNow_ns));
  EXPECT_EQ(data.seq(), 1u);
  std::map<std::string, sparkplug::Metric> values;
  for (const sparkplug::Metric& metric : data.metrics()) {
    EXPECT_FALSE(metric.has_name());
    EXPECT_EQ(metric.timestamp(), 1'795'218'085'000u) << "when the check stopped";
    values[names.at(metric.alias())] = metric;
  }
  EXPECT_EQ(values.at("Check/Verdict").string_value(), "PASS");
  EXPECT_EQ(values.at("Parameters/k2/Value").double_value(), 35.5);
  EXPECT_TRUE(values.at("Check/Tracking rms").is_null());
}

TEST(Sparkplug, TheSequenceWrapsAndABirthBeginsItAnew) {
  const CheckRecord check = support::make_check_record();
  SparkplugNode node(0);
  node.show(check);
  node.birth(kNow_ns);
  for (std::uint64_t i = 1; i <= 300; ++i) EXPECT_EQ(read(node.data(check, false, kNow_ns)).seq(), i % 256);
  EXPECT_EQ(read(node.birth(kNow_ns)).seq(), 0u);
  EXPECT_EQ(read(node.data(check, true, kNow_ns)).seq(), 1u);
}

TEST(Sparkplug, AParameterNobodyHeardOfNeedsAnotherBirth) {
  CheckRecord check = support::make_check_record();
  SparkplugNode node(0);
  const auto first = by_name(read(node.birth(kNow_ns)));
  EXPECT_EQ(first.size(), 3u) << "a station without checks has nothing to show";
  EXPECT_FALSE(node.born(check));
  node.admit(check);
  const auto second = by_name(read(node.birth(kNow_ns)));
  EXPECT_TRUE(node.born(check));
  EXPECT_TRUE(second.at("Check/Serial").is_null()) << "its data come later";
  const std::uint64_t alias = second.at("Parameters/k1/Value").alias();
  check.parameters.push_back({"cogging.amplitude", "N m", 0.02, 0.001, 0.0, 0.05, ParameterVerdict::Pass});
  EXPECT_FALSE(node.born(check));
  node.admit(check);
  const auto third = by_name(read(node.birth(kNow_ns)));
  EXPECT_EQ(third.count("Parameters/cogging.amplitude/Value"), 1u);
  EXPECT_EQ(third.at("Parameters/k1/Value").alias(), alias);
}

TEST(Sparkplug, UnderstandsTheRebirthCommandOnly) {
  sparkplug::Payload command;
  sparkplug::Metric& metric = *command.add_metrics();
  metric.set_name("Node Control/Rebirth");
  EXPECT_FALSE(asks_for_rebirth(command.SerializeAsString()));
  metric.set_boolean_value(false);
  EXPECT_FALSE(asks_for_rebirth(command.SerializeAsString()));
  metric.set_boolean_value(true);
  EXPECT_TRUE(asks_for_rebirth(command.SerializeAsString()));
  metric.set_name("Node Control/Reboot");
  EXPECT_FALSE(asks_for_rebirth(command.SerializeAsString()));
  EXPECT_FALSE(asks_for_rebirth(""));
  EXPECT_FALSE(asks_for_rebirth("no protobuf"));
}

/// Bytes as the specification's field numbers and wire types have them, so that a wrong definition shows.
TEST(Sparkplug, SpeaksTheWireFormat) {
  const std::string death = SparkplugNode(5).death(1'000'000);
  EXPECT_EQ(death, std::string("\x08\x01"  // 1: timestamp, 1 ms
                               "\x12\x0d"  // 2: a metric of 13 bytes
                               "\x0a\x05"
                               "bdSeq"      // 1: name
                               "\x18\x01"   // 3: timestamp
                               "\x20\x04"   // 4: datatype Int64
                               "\x58\x05",  // 11: long_value
                               17));
}

}  // namespace
}  // namespace clampd::publish
