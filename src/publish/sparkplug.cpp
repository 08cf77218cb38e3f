#include "clampd/publish/sparkplug.hpp"

#include <cmath>
#include <utility>

#include "clampd/base/assert.hpp"
#include "clampd/base/clock.hpp"
#include "clampd/base/version.hpp"
#include "clampd/record/utc.hpp"
#include "sparkplug_b.pb.h"

namespace clampd::publish {
namespace {

// Data types of the specification.
constexpr std::uint32_t kInt64 = 4;
constexpr std::uint32_t kDouble = 10;
constexpr std::uint32_t kBoolean = 11;
constexpr std::uint32_t kString = 12;

constexpr const char* kRebirth = "Node Control/Rebirth";

std::uint64_t milliseconds(std::int64_t utc_ns) {
  return static_cast<std::uint64_t>(utc_ns / kNanosecondsPerMillisecond);
}

sparkplug::Payload payload_at(std::int64_t now_ns) {
  sparkplug::Payload payload;
  payload.set_timestamp(milliseconds(now_ns));
  return payload;
}

template <class Value>
void set_value(sparkplug::Metric& metric, const Value& value) {
  if (const auto* text = std::get_if<std::string>(&value))
    metric.set_string_value(*text);
  else if (const auto* truth = std::get_if<bool>(&value))
    metric.set_boolean_value(*truth);
  else if (const auto* number = std::get_if<double>(&value))
    metric.set_double_value(*number);
  else if (const auto* integer = std::get_if<std::int64_t>(&value))
    metric.set_long_value(static_cast<std::uint64_t>(*integer));
  else
    metric.set_is_null(true);
}

void add_connection(sparkplug::Payload& payload, std::uint64_t connection) {
  sparkplug::Metric& metric = *payload.add_metrics();
  metric.set_name("bdSeq");
  metric.set_timestamp(payload.timestamp());
  metric.set_datatype(kInt64);
  metric.set_long_value(connection);
}

}  // namespace

std::vector<SparkplugNode::Metric> SparkplugNode::metrics_of(const CheckRecord& check) {
  std::vector<Metric> metrics;
  const auto text = [&](std::string name, std::string value) {
    metrics.push_back({std::move(name), "", kString, Value(std::move(value))});
  };
  const auto number = [&](std::string name, double value, const std::string& unit) {
    metrics.push_back({std::move(name), unit, kDouble, std::isfinite(value) ? Value(value) : Value()});
  };
  text("Check/Record", check.id);
  text("Check/Serial", check.serial);
  text("Check/Part number", check.part_number);
  text("Check/Recipe version", check.recipe ? check.recipe->version : "");
  text("Check/Recipe SHA-256", check.recipe ? check.recipe->sha256 : "");
  text("Check/Batch", check.batch);
  text("Check/Operator", check.operator_name);
  text("Check/Verdict", std::string(to_string(check.verdict)));
  metrics.push_back({"Check/Marginal", "", kBoolean, check.marginal});
  metrics.push_back({"Check/Simulated", "", kBoolean, check.simulated});
  text("Check/Reason", check.reason);
  text("Check/Fault", std::string(to_string(check.fault)));
  text("Check/Cause", check.cause ? check.cause->summary : "");
  text("Check/Started", check.started);
  text("Check/Stopped", check.stopped);
  metrics.push_back({"Check/Repeats", "", kInt64, std::int64_t{check.repeats}});
  number("Check/Duration", check.duration_s, "s");
  number("Check/Tracking rms", check.tracking_rms_N, "N");
  text("Limits/Revision", check.limits_revision);
  for (const ParameterRecord& parameter : check.parameters) {
    const std::string folder = "Parameters/" + parameter.name + "/";
    number(folder + "Value", parameter.value, parameter.unit);
    number(folder + "Standard deviation", parameter.sd, parameter.unit);
    number(folder + "Lower limit", parameter.lower, parameter.unit);
    number(folder + "Upper limit", parameter.upper, parameter.unit);
    text(folder + "Verdict", std::string(to_string(parameter.verdict)));
  }
  return metrics;
}

std::size_t SparkplugNode::alias_of(const Metric& metric) const {
  const auto found = aliases_.find(metric.name);
  return found == aliases_.end() ? metrics_.size() : found->second;
}

void SparkplugNode::admit(const CheckRecord& check) {
  for (Metric& metric : metrics_of(check)) {
    if (!aliases_.emplace(metric.name, metrics_.size()).second) continue;
    metric.value = Value();
    metrics_.push_back(std::move(metric));
  }
}

void SparkplugNode::show(const CheckRecord& check) {
  admit(check);
  for (Metric& metric : metrics_) metric.value = Value();
  for (Metric& metric : metrics_of(check)) metrics_[alias_of(metric)].value = std::move(metric.value);
}

bool SparkplugNode::born(const CheckRecord& check) const {
  for (const Metric& metric : metrics_of(check)) {
    const std::size_t alias = alias_of(metric);
    if (alias >= metrics_.size() || !metrics_[alias].born) return false;
  }
  return true;
}

std::string SparkplugNode::death(std::int64_t now_ns) const {
  sparkplug::Payload payload = payload_at(now_ns);
  add_connection(payload, connection_);
  return payload.SerializeAsString();
}

std::string SparkplugNode::birth(std::int64_t now_ns) {
  sparkplug::Payload payload = payload_at(now_ns);
  sequence_ = 0;
  payload.set_seq(sequence_);
  add_connection(payload, connection_);
  const auto add = [&](const char* name, std::uint32_t datatype) -> sparkplug::Metric& {
    sparkplug::Metric& metric = *payload.add_metrics();
    metric.set_name(name);
    metric.set_timestamp(payload.timestamp());
    metric.set_datatype(datatype);
    return metric;
  };
  add(kRebirth, kBoolean).set_boolean_value(false);  // by name, never by alias
  add("Properties/Software version", kString).set_string_value(std::string(kVersion));
  for (std::size_t alias = 0; alias < metrics_.size(); ++alias) {
    Metric& own = metrics_[alias];
    sparkplug::Metric& metric = add(own.name.c_str(), own.datatype);
    metric.set_alias(alias);
    set_value(metric, own.value);
    if (!own.unit.empty()) {
      sparkplug::PropertySet& properties = *metric.mutable_properties();
      properties.add_keys("engUnit");
      sparkplug::PropertyValue& unit = *properties.add_values();
      unit.set_type(kString);
      unit.set_string_value(own.unit);
    }
    own.born = true;
  }
  return payload.SerializeAsString();
}

std::string SparkplugNode::data(const CheckRecord& check, bool historical, std::int64_t now_ns) {
  sparkplug::Payload payload = payload_at(now_ns);
  sequence_ = (sequence_ + 1) % 256;
  payload.set_seq(sequence_);
  const std::uint64_t acquired_ms = milliseconds(parse_utc(check.stopped).value_or(now_ns));
  for (const Metric& own : metrics_of(check)) {
    const std::size_t alias = alias_of(own);
    CLAMPD_ASSERT(alias < metrics_.size() && metrics_[alias].born);
    sparkplug::Metric& metric = *payload.add_metrics();
    metric.set_alias(alias);
    metric.set_timestamp(acquired_ms);
    if (historical) metric.set_is_historical(true);
    set_value(metric, own.value);
  }
  return payload.SerializeAsString();
}

bool asks_for_rebirth(std::string_view command) {
  sparkplug::Payload payload;
  if (!payload.ParseFromArray(command.data(), static_cast<int>(command.size()))) return false;
  for (const sparkplug::Metric& metric : payload.metrics())
    if (metric.name() == kRebirth && metric.boolean_value()) return true;
  return false;
}

}  // namespace clampd::publish
