#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "clampd/record/check_record.hpp"

namespace clampd::publish {

/// The messages of a Sparkplug B edge node that shows its station's newest check: pure, for one connection.
/// Payloads are those of specification 3.0; topics are spBv1.0/GROUP/{NBIRTH,NDATA,NDEATH}/NODE. Times are
/// nanoseconds since 1970, UTC.
class SparkplugNode {
 public:
  /// `connection` counts all connections of this node; birth and death carry its last eight bits (bdSeq).
  explicit SparkplugNode(std::uint64_t connection) : connection_(connection % 256) {}

  /// NDEATH, to be the connection's will.
  std::string death(std::int64_t now_ns) const;
  /// NBIRTH: every metric with its name, alias, type, unit and value. The message sequence begins anew.
  std::string birth(std::int64_t now_ns);
  /// NDATA: the check's metrics by alias. All must be born.
  std::string data(const CheckRecord& check, bool historical, std::int64_t now_ns);

  /// Takes over what a birth then says of the newest check.
  void show(const CheckRecord& check);
  /// Whether the last birth named all metrics of this check; otherwise another birth is due, after admit().
  bool born(const CheckRecord& check) const;
  /// Lets the next birth name this check's metrics too.
  void admit(const CheckRecord& check);

 private:
  /// Nothing: the metric is null.
  using Value = std::variant<std::monostate, std::string, bool, double, std::int64_t>;
  struct Metric {
    std::string name;
    std::string unit;
    std::uint32_t datatype = 0;
    Value value;
    bool born = false;
  };
  static std::vector<Metric> metrics_of(const CheckRecord& check);
  std::size_t alias_of(const Metric& metric) const;

  std::uint64_t connection_;
  std::uint64_t sequence_ = 0;
  std::vector<Metric> metrics_;  ///< by alias
  std::map<std::string, std::size_t, std::less<>> aliases_;
};

/// Whether an NCMD asks for another birth ("Node Control/Rebirth" is true). Anything else is not for us.
bool asks_for_rebirth(std::string_view command);

}  // namespace clampd::publish
