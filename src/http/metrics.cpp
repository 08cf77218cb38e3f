#include "clampd/http/metrics.hpp"

#include <cmath>
#include <iterator>

#include <fmt/format.h>

namespace clampd::http {
namespace {

/// As the format asks for: a backslash before backslashes, line ends and, in labels, quotes.
std::string escaped(std::string_view text, bool label) {
  std::string result;
  for (const char c : text) {
    if (c == '\\')
      result += "\\\\";
    else if (c == '\n')
      result += "\\n";
    else if (c == '"' && label)
      result += "\\\"";
    else
      result += c;
  }
  return result;
}

std::string number(double value) {
  if (std::isnan(value)) return "NaN";
  if (std::isinf(value)) return value > 0.0 ? "+Inf" : "-Inf";
  return fmt::format("{}", value);
}

}  // namespace

void Metrics::family(std::string_view name, std::string_view type, std::string_view help) {
  name_ = name;
  fmt::format_to(std::back_inserter(text_), "# HELP {} {}\n# TYPE {} {}\n", name, escaped(help, false), name,
                 type);
}

void Metrics::sample(double value, Labels labels) {
  line("", value, labels);
}

void Metrics::buckets(std::span<const std::pair<double, double>> at_most, double sum, double count) {
  for (const auto& [bound, number_of] : at_most) line("_bucket", number_of, {{"le", number(bound)}});
  line("_bucket", count, {{"le", "+Inf"}});
  line("_sum", sum, {});
  line("_count", count, {});
}

void Metrics::line(std::string_view suffix, double value, Labels labels) {
  text_ += name_;
  text_ += suffix;
  std::string_view before = "{";
  for (const auto& [label, of] : labels) {
    fmt::format_to(std::back_inserter(text_), "{}{}=\"{}\"", before, label, escaped(of, true));
    before = ",";
  }
  if (labels.size() > 0) text_ += '}';
  fmt::format_to(std::back_inserter(text_), " {}\n", number(value));
}

}  // namespace clampd::http
