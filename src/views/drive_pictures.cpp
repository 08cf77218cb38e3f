#include "src/views/drive_pictures.hpp"

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include <fmt/format.h>

namespace clampd::pictures {
namespace {

double largest_of(const std::vector<double>& values) {
  double largest = 0.0;
  for (const double value : values) largest = std::max(largest, std::abs(value));
  return largest;
}

std::vector<double> scaled(std::vector<double> values, double factor) {
  for (double& value : values) value *= factor;
  return values;
}

std::vector<double> difference(const std::vector<double>& a, const std::vector<double>& b) {
  std::vector<double> result;
  for (std::size_t k = 0; k < std::min(a.size(), b.size()); ++k) result.push_back(a[k] - b[k]);
  return result;
}

const std::vector<double>& left_of(const RunView& view, bool extended) {
  return extended && !view.disturbance_after_Nm.empty() ? view.disturbance_after_Nm
                                                        : view.disturbance_before_Nm;
}

/// Speed, measured and modelled torque of a row in which the drive hardly accelerates.
struct SteadyRow {
  double velocity, measured, modelled;
};

/// Rates of change of the velocity between neighbouring rows; zero for a run of one row, which is steady.
std::vector<double> accelerations_of(const RunView& view) {
  const std::vector<double>& v = view.velocity.measured;
  std::vector<double> result(v.size(), 0.0);
  for (std::size_t k = 0; k < v.size() && v.size() > 1; ++k) {
    const std::size_t before = k > 0 ? k - 1 : k, after = std::min(k + 1, v.size() - 1);
    result[k] = (v[after] - v[before]) / (view.time_s[after] - view.time_s[before]);
  }
  return result;
}

std::vector<SteadyRow> steady_rows(std::span<const RunView> views) {
  std::vector<double> sizes;
  for (const RunView& view : views)
    for (const double a : accelerations_of(view)) sizes.push_back(std::abs(a));
  if (sizes.empty()) return {};
  // A tenth of the usual highest acceleration: its torque is then a tenth of the inertia's at most.
  const auto high = sizes.begin() + static_cast<std::ptrdiff_t>(0.95 * static_cast<double>(sizes.size() - 1));
  std::nth_element(sizes.begin(), high, sizes.end());
  const double most = 0.1 * *high;
  std::vector<SteadyRow> rows;
  for (const RunView& view : views) {
    const std::vector<double> accelerations = accelerations_of(view);
    const std::vector<double>& left = left_of(view, true);
    for (std::size_t k = 0; k < std::min(left.size(), accelerations.size()); ++k)
      if (std::abs(accelerations[k]) <= most)
        rows.push_back({view.velocity.measured[k], view.torque_Nm[k], view.torque_Nm[k] - left[k]});
  }
  return rows;
}

/// Means over bins of equally many rows of one direction, added to the panel.
void add_direction(report::Panel& panel, std::vector<SteadyRow> rows, double factor, bool labelled) {
  constexpr std::size_t kMostBins = 25;
  std::ranges::sort(rows, {}, &SteadyRow::velocity);
  const std::size_t bins = std::min(kMostBins, rows.size());
  report::Points measured{
      .label = labelled ? "measured, mean" : "", .colour = report::Colour::Black, .size = 0.7};
  report::Curve modelled{.label = labelled ? "model" : "", .colour = report::Colour::Blue};
  for (std::size_t b = 0; b < bins; ++b) {
    const std::size_t begin = b * rows.size() / bins, end = (b + 1) * rows.size() / bins;
    SteadyRow mean{0.0, 0.0, 0.0};
    for (std::size_t k = begin; k < end; ++k) {
      const double weight = 1.0 / static_cast<double>(end - begin);
      mean.velocity += weight * rows[k].velocity;
      mean.measured += weight * rows[k].measured;
      mean.modelled += weight * rows[k].modelled;
    }
    measured.x.push_back(mean.velocity);
    measured.y.push_back(factor * mean.measured);
    modelled.x.push_back(mean.velocity);
    modelled.y.push_back(factor * mean.modelled);
  }
  panel.layers.emplace_back(std::move(modelled));
  panel.layers.emplace_back(std::move(measured));
}

}  // namespace

EffortScale effort_scale(double largest, const DiagnosisSubject& subject) {
  if (largest >= 0.5 || largest == 0.0 || subject.torque_unit == "%") return {1.0, subject.torque_unit};
  if (largest >= 5e-4) return {1e3, "m" + subject.torque_unit};
  return {1e6, "µ" + subject.torque_unit};
}

std::optional<report::Figure> modelled_torque_picture(const RunView& view, bool extended,
                                                      const DiagnosisSubject& subject) {
  const std::vector<double>& left = left_of(view, extended);
  if (left.size() < 2 || left.size() != view.torque_Nm.size()) return std::nullopt;
  const EffortScale of_torque = effort_scale(largest_of(view.torque_Nm), subject),
                    of_left = effort_scale(largest_of(left), subject);
  report::Panel torque{
      .title = "",
      .x = {.label = "time (s)"},
      .y = {.label = fmt::format("{} ({})", subject.effort(), of_torque.unit)},
      .layers = {report::Curve{.label = "measured",
                               .x = view.time_s,
                               .y = scaled(view.torque_Nm, of_torque.factor),
                               .colour = report::Colour::Grey},
                 report::Curve{.label = "model",
                               .x = view.time_s,
                               .y = scaled(difference(view.torque_Nm, left), of_torque.factor),
                               .colour = report::Colour::Blue,
                               .width_px = 1.2}}};
  report::Panel rest{.title = "",
                     .x = {.label = "time (s)"},
                     .y = {.label = fmt::format("left ({})", of_left.unit)},
                     .layers = {report::Curve{.x = view.time_s,
                                              .y = scaled(left, of_left.factor),
                                              .colour = report::Colour::Vermilion,
                                              .width_px = 1.2}}};
  return report::Figure{.panels = {std::move(torque), std::move(rest)}, .width_px = 1000};
}

std::optional<report::Figure> friction_curve_picture(std::span<const RunView> views,
                                                     const DiagnosisSubject& subject) {
  constexpr std::size_t kFewest = 6;
  const std::vector<SteadyRow> rows = steady_rows(views);
  if (rows.size() < kFewest) return std::nullopt;
  double largest = 0.0;
  for (const SteadyRow& row : rows) largest = std::max(largest, std::abs(row.measured));
  const EffortScale scale = effort_scale(largest, subject);
  report::Panel panel{.title = "",
                      .x = {.label = fmt::format("speed ({}/s)", subject.position_unit)},
                      .y = {.label = fmt::format("{} ({})", subject.effort(), scale.unit)}};
  constexpr std::size_t kMostPoints = 4000;
  report::Points each{.label = "rows", .colour = report::Colour::Grey, .size = 0.2};
  for (std::size_t k = 0; k < rows.size(); k += std::max<std::size_t>(1, rows.size() / kMostPoints)) {
    each.x.push_back(rows[k].velocity);
    each.y.push_back(scale.factor * rows[k].measured);
  }
  panel.layers.emplace_back(std::move(each));
  bool labelled = true;
  for (const bool forward : {true, false}) {
    std::vector<SteadyRow> one_way;
    std::ranges::copy_if(rows, std::back_inserter(one_way),
                         [&](const SteadyRow& row) { return (row.velocity > 0.0) == forward; });
    if (one_way.size() < 2) continue;
    add_direction(panel, std::move(one_way), scale.factor, labelled);
    labelled = false;
  }
  return report::Figure{.panels = {std::move(panel)}, .width_px = 1000, .panel_height_px = 340};
}

}  // namespace clampd::pictures
