#include "clampd/archive/dfq.hpp"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <set>
#include <tuple>
#include <utility>

#include <fmt/format.h>

namespace clampd {
namespace {

constexpr std::size_t kMaxText = 255;

/// One line's text: ISO 8859-1, no line breaks or control characters (some separate values in this format).
std::string field_text(const std::string& utf8) {
  std::string text;
  for (std::size_t i = 0; i < utf8.size() && text.size() < kMaxText; ++i) {
    const auto byte = static_cast<unsigned char>(utf8[i]);
    if (byte < 0x80) {
      text += byte < 0x20 || byte == 0x7f ? ' ' : utf8[i];
      continue;
    }
    const auto next = i + 1 < utf8.size() ? static_cast<unsigned char>(utf8[i + 1]) : 0U;
    text += (byte == 0xc2 || byte == 0xc3) && (next & 0xc0) == 0x80
                ? static_cast<char>((byte & 0x03) << 6 | (next & 0x3f))
                : '?';
    while (i + 1 < utf8.size() && (static_cast<unsigned char>(utf8[i + 1]) & 0xc0) == 0x80) ++i;
  }
  return text;
}

class Lines {
 public:
  /// Nothing for an empty text.
  void field(const std::string& key, const std::string& text) {
    if (!text.empty()) fmt::format_to(std::back_inserter(text_), "{} {}\r\n", key, field_text(text));
  }
  void number(const std::string& key, double value) {
    fmt::format_to(std::back_inserter(text_), "{} {:.9g}\r\n", key, value);
  }
  void integer(const std::string& key, std::size_t value) {
    fmt::format_to(std::back_inserter(text_), "{} {}\r\n", key, value);
  }
  std::string take() { return std::move(text_); }

 private:
  std::string text_;
};

/// Whether a line takes it whole.
bool fits(const std::string& text) {
  return field_text(text).size() < kMaxText;
}

/// 2026-11-20T23:41:07.123Z as 20.11.2026/23:41:07
std::string time_stamp(const std::string& started) {
  if (started.size() < 19) return "";
  return fmt::format("{}.{}.{}/{}", started.substr(8, 2), started.substr(5, 2), started.substr(0, 4),
                     started.substr(11, 8));
}

/// Numbers for texts, from 1 in the order of first use: K0008 and K0010 hold numbers.
class Catalogue {
 public:
  std::size_t number_of(const std::string& text) {
    const auto found = std::find(entries_.begin(), entries_.end(), text);
    if (found != entries_.end()) return static_cast<std::size_t>(found - entries_.begin()) + 1;
    entries_.push_back(text);
    return entries_.size();
  }
  std::string description(const char* title) const {
    std::string text;
    for (std::size_t i = 0; i < entries_.size(); ++i)
      fmt::format_to(std::back_inserter(text), "{}{} = {}", i == 0 ? "" : ", ", i + 1,
                     entries_[i].empty() ? "(not stated)" : entries_[i]);
    return fmt::format("{} {}", title, text);
  }

 private:
  std::vector<std::string> entries_;
};

/// Parameters, then what the sheet asks for, where one of its limits may be missing.
std::vector<ParameterRecord> characteristics(const CheckRecord& check) {
  std::vector<ParameterRecord> all = check.parameters;
  if (check.sheet)
    for (const CharacteristicRecord& c : check.sheet->characteristics)
      all.push_back(
          {c.name, c.unit, c.value, c.sd, c.lower, c.upper, c.verdict.value_or(ParameterVerdict::Marginal)});
  return all;
}

/// Places after the point that resolve a thousandth of the tolerance; where there is none, a tenth of the
/// standard deviation.
std::size_t decimals(const ParameterRecord& p) {
  const double tolerance = p.upper - p.lower;
  const double step = std::isfinite(tolerance) ? tolerance / 1000.0 : p.sd / 10.0;
  return step > 0.0 ? static_cast<std::size_t>(std::clamp(std::ceil(-std::log10(step)), 0.0, 15.0)) : 6;
}

bool same_characteristic(const ParameterRecord& a, const ParameterRecord& b) {
  const auto same = [](double x, double y) { return x == y || (std::isnan(x) && std::isnan(y)); };
  return a.name == b.name && a.unit == b.unit && same(a.lower, b.lower) && same(a.upper, b.upper);
}

std::string value_set_remark(const CheckRecord& check, bool with_names) {
  std::string text = fmt::format("{}{}{} {}", to_string(check.verdict), check.marginal ? " (marginal)" : "",
                                 check.voided ? " VOID" : "", check.id);
  if (with_names) text += fmt::format("; operator {}; station {}", check.operator_name, check.station);
  return text;
}

tl::unexpected<Error> differs(const CheckRecord& first, const CheckRecord& other, std::string_view what) {
  return failure(fmt::format(
      "checks {} and {} {}: a .dfq file describes one set of characteristics; choose checks of one "
      "kind with --part-number, --batch, --since and --until",
      first.id, other.id, what));
}

}  // namespace

Result<std::string> format_dfq(const std::vector<CheckRecord>& checks,
                               const std::map<std::string, double>& nominal) {
  std::vector<const CheckRecord*> sorted;
  for (const CheckRecord& check : checks) sorted.push_back(&check);
  std::sort(sorted.begin(), sorted.end(), [](const CheckRecord* a, const CheckRecord* b) {
    return std::tie(a->started, a->id) < std::tie(b->started, b->id);
  });
  const auto described = std::find_if(sorted.begin(), sorted.end(),
                                      [](const CheckRecord* check) { return !check->parameters.empty(); });
  if (described == sorted.end())
    return failure("no check with parameters to export: a .dfq file needs at least one that was identified");
  const CheckRecord& first = **described;
  const std::vector<ParameterRecord> described_by = characteristics(first);
  for (const CheckRecord* check : sorted) {
    if (check->part_number != first.part_number)
      return differs(
          first, *check,
          fmt::format("are of different parts ('{}' and '{}')", first.part_number, check->part_number));
    const std::vector<ParameterRecord> values = characteristics(*check);
    if (!check->parameters.empty() && !std::equal(described_by.begin(), described_by.end(), values.begin(),
                                                  values.end(), same_characteristic))
      return differs(
          first, *check,
          fmt::format(
              "have different parameters or limits, those of the sheet included (limits revision {} and {})",
              first.limits_revision, check->limits_revision));
  }

  Catalogue operators, stations;
  std::set<std::string> fixtures;
  std::size_t simulated = 0;
  for (const CheckRecord* check : sorted) {
    operators.number_of(check->operator_name);
    stations.number_of(check->station);
    fixtures.insert(check->fixture);
    if (check->simulated) ++simulated;
  }

  Lines lines;
  lines.integer("K0100", described_by.size());
  lines.field("K1001", first.part_number.empty() ? "brake" : first.part_number);
  lines.field("K1002", "Electromechanical brake, identified parameters");
  lines.field("K1081", first.station);
  if (fixtures.size() == 1) lines.field("K1086", *fixtures.begin());
  const char* brakes = simulated == 0               ? ""
                       : simulated == sorted.size() ? "; all brakes simulated"
                                                    : "; some brakes simulated";
  std::string remark = fmt::format("K0004 is UTC; {}; {}{}", operators.description("K0008 operator:"),
                                   stations.description("K0010 station:"), brakes);
  const bool listed = fits(remark);
  if (!listed)
    remark = fmt::format("K0004 is UTC; K0009 names what K0008 (operator) and K0010 (station) stand for{}",
                         brakes);
  lines.field("K1900", remark);
  for (std::size_t i = 0; i < described_by.size(); ++i) {
    const ParameterRecord& p = described_by[i];
    const auto key = [&](const char* name) { return fmt::format("{}/{}", name, i + 1); };
    lines.integer(key("K2001"), i + 1);
    lines.field(key("K2002"), p.name);
    lines.integer(key("K2004"), 0);
    lines.integer(key("K2022"), decimals(p));
    if (const auto found = nominal.find(p.name); found != nominal.end())
      lines.number(key("K2101"), found->second);
    if (std::isfinite(p.lower)) lines.number(key("K2110"), p.lower);
    if (std::isfinite(p.upper)) lines.number(key("K2111"), p.upper);
    lines.field(key("K2142"), p.unit);
  }
  for (const CheckRecord* check : sorted) {
    const std::vector<ParameterRecord> values = characteristics(*check);
    for (std::size_t i = 0; i < described_by.size(); ++i) {
      const double value = i < values.size() ? values[i].value : NAN;
      const bool valid = is_about_the_brake(check->verdict) && !check->voided && std::isfinite(value);
      lines.number(fmt::format("K0001/{}", i + 1), valid ? value : 0.0);
      lines.integer(fmt::format("K0002/{}", i + 1), valid ? 0 : 255);
    }
    lines.field("K0004/0", time_stamp(check->started));
    lines.field("K0006/0", check->batch);
    lines.integer("K0008/0", operators.number_of(check->operator_name));
    lines.field("K0009/0", value_set_remark(*check, !listed));
    lines.integer("K0010/0", stations.number_of(check->station));
    lines.field("K0014/0", check->serial);
  }
  return lines.take();
}

}  // namespace clampd
