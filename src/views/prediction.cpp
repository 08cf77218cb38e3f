#include "clampd/views/prediction.hpp"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "clampd/base/json.hpp"
#include "clampd/views/page.hpp"

namespace clampd {
namespace {

constexpr std::string_view kOpenLoop =
    "Each run is simulated from the state of its first rows by the recorded torque alone. Nothing corrects "
    "it on the way, so that position "
    "and velocity of an open loop drift with every error of torque or friction; the errors of simulations "
    "that begin anew every 0.1 s and "
    "1 s tell the model's own part.";

std::string percent_of(double share) {
  return std::isfinite(share) ? fmt::format("{:.3g} %", 100.0 * share) : std::string("—");
}

nlohmann::ordered_json errors_json(const std::vector<PredictedQuantity>& quantities) {
  nlohmann::ordered_json errors = nlohmann::ordered_json::array();
  for (const PredictedQuantity& quantity : quantities) {
    const PredictionError error = error_of(quantity);
    errors.push_back({{"quantity", error.quantity},
                      {"unit", error.unit},
                      {"rms", number_or_null(error.rms)},
                      {"of_standard_deviation", number_or_null(error.of_standard_deviation)},
                      {"fit_percent", number_or_null(error.fit_percent)}});
  }
  return errors;
}

/// Every quantity of a run, from its first rows to the end, then with each horizon.
template <class Visit>
void for_each_error(const PredictedRun& run, const Visit& visit) {
  for (const PredictedQuantity& quantity : run.quantities) visit("whole run", error_of(quantity));
  for (const PredictedRun::Limited& limited : run.limited)
    for (const PredictedQuantity& quantity : limited.quantities)
      visit(fmt::format("{:g} s", limited.horizon_s), error_of(quantity));
}

/// At most so many points, so that a page of a long run stays small: the extremes of each stretch.
report::Curve thinned(std::string label, const std::vector<double>& x, const std::vector<double>& y,
                      report::Colour colour) {
  constexpr std::size_t kStretches = 1500;
  report::Curve curve{.label = std::move(label), .colour = colour, .width_px = 1.2};
  const std::size_t length = std::max<std::size_t>(1, x.size() / kStretches);
  for (std::size_t begin = 0; begin < x.size(); begin += length) {
    const std::size_t end = std::min(begin + length, x.size());
    std::size_t low = begin, high = begin;
    for (std::size_t i = begin; i < end; ++i) {
      if (y[i] < y[low]) low = i;
      if (y[i] > y[high]) high = i;
    }
    for (const std::size_t i : {std::min(low, high), std::max(low, high)}) {
      curve.x.push_back(x[i]);
      curve.y.push_back(y[i]);
    }
  }
  return curve;
}

report::Figure figure_of(const PredictedRun& run) {
  report::Figure figure;
  for (const PredictedQuantity& quantity : run.quantities) {
    std::vector<double> residual;
    for (std::size_t k = 0; k < quantity.measured.size(); ++k)
      residual.push_back(quantity.measured[k] - quantity.predicted[k]);
    const report::Axis time{.label = "time (s)"};
    figure.panels.push_back(
        {.title = quantity.quantity,
         .x = time,
         .y = {.label = fmt::format("{} ({})", quantity.quantity, quantity.unit)},
         .layers = {thinned("measured", run.time_s, quantity.measured, report::Colour::Grey),
                    thinned("predicted", run.time_s, quantity.predicted, report::Colour::Blue)}});
    figure.panels.push_back({.title = "measured less predicted",
                             .x = time,
                             .y = {.label = fmt::format("residual ({})", quantity.unit)},
                             .layers = {thinned("", run.time_s, residual, report::Colour::Vermilion)}});
  }
  return figure;
}

}  // namespace

nlohmann::ordered_json prediction_json(std::span<const PredictedRun> runs, const std::string& model) {
  nlohmann::ordered_json document{{"schema", "clampd.prediction/1"}, {"model", model}};
  auto& list = document["runs"] = nlohmann::ordered_json::array();
  for (const PredictedRun& run : runs) {
    nlohmann::ordered_json limited = nlohmann::ordered_json::array();
    for (const PredictedRun::Limited& each : run.limited)
      limited.push_back({{"horizon_s", each.horizon_s}, {"errors", errors_json(each.quantities)}});
    list.push_back({{"name", run.name},
                    {"rows", run.time_s.size()},
                    {"errors", errors_json(run.quantities)},
                    {"limited", std::move(limited)},
                    {"diverged_s", number_or_null(run.diverged_s)}});
  }
  return document;
}

std::string prediction_text(std::span<const PredictedRun> runs) {
  std::string text;
  for (const PredictedRun& run : runs) {
    text += fmt::format("{}, {} rows\n", run.name, run.time_s.size());
    text += fmt::format("  {:<10} {:<10} {:>12} {:<6} {:>22} {:>8}\n", "anew every", "quantity", "rms error",
                        "", "of the std. deviation", "fit");
    for_each_error(run, [&](const std::string& horizon, const PredictionError& error) {
      text += fmt::format("  {:<10} {:<10} {:>12.4g} {:<6} {:>22} {:>6.1f} %\n",
                          horizon == "whole run" ? "never" : horizon, error.quantity, error.rms, error.unit,
                          percent_of(error.of_standard_deviation), error.fit_percent);
    });
    if (std::isfinite(run.diverged_s))
      text += fmt::format("  the simulation left all bounds at {:.4g} s; the errors are those until then\n",
                          run.diverged_s);
  }
  if (std::ranges::any_of(runs, [](const PredictedRun& run) { return !run.limited.empty(); }))
    text += fmt::format("\n{}\n", kOpenLoop);
  return text;
}

Result<std::string> prediction_html(std::span<const PredictedRun> runs, const std::string& model) {
  report::Page page("Prediction",
                    fmt::format("{}, {} run{}", model, runs.size(), runs.size() == 1 ? "" : "s"));
  page.section("Errors");
  report::Table table{.caption = "root mean square of measured less predicted",
                      .columns = {{"run"},
                                  {"begun anew every"},
                                  {"quantity"},
                                  {"rms", true},
                                  {"unit"},
                                  {"of the standard deviation", true},
                                  {"fit, %", true}}};
  for (const PredictedRun& run : runs)
    for_each_error(run, [&](const std::string& horizon, const PredictionError& error) {
      table.rows.push_back({run.name, horizon, error.quantity, fmt::format("{:.4g}", error.rms), error.unit,
                            percent_of(error.of_standard_deviation),
                            fmt::format("{:.1f}", error.fit_percent)});
    });
  page.table(table);
  page.paragraph(std::string(kOpenLoop));
  constexpr std::size_t kMostPictures = 6;
  for (std::size_t r = 0; r < std::min(runs.size(), kMostPictures); ++r) {
    page.section(runs[r].name);
    if (Result<void> drawn =
            page.figure(figure_of(runs[r]), "Measured and predicted, and what is left of the measured.");
        !drawn)
      return tl::unexpected(drawn.error());
  }
  if (runs.size() > kMostPictures)
    page.paragraph(fmt::format("Pictures of the first {} of {} runs.", kMostPictures, runs.size()));
  return page.html();
}

}  // namespace clampd
