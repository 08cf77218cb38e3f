#pragma once

#include <initializer_list>
#include <span>
#include <string>
#include <string_view>
#include <utility>

namespace clampd::http {

/// A scrape in Prometheus's text format, version 0.0.4. A family is begun once; its samples follow it.
class Metrics {
 public:
  static constexpr std::string_view kType = "text/plain; version=0.0.4; charset=utf-8";
  using Labels = std::initializer_list<std::pair<std::string_view, std::string_view>>;

  /// `type`: counter, gauge or histogram. `help` is one line.
  void family(std::string_view name, std::string_view type, std::string_view help);
  /// Of the family that was begun last. Whatever stands in a label's value, the line is valid.
  void sample(double value, Labels labels = {});
  /// Of a histogram: how many values are no more than each bound, the sum of all values and their number.
  void buckets(std::span<const std::pair<double, double>> at_most, double sum, double count);

  const std::string& text() const { return text_; }

 private:
  void line(std::string_view suffix, double value, Labels labels);

  std::string name_;
  std::string text_;
};

}  // namespace clampd::http
