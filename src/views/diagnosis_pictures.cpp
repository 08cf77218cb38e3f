#include "clampd/views/diagnosis_pictures.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <complex>
#include <limits>
#include <map>
#include <numbers>
#include <numeric>
#include <string>

#include <fmt/format.h>

#include "src/views/drive_pictures.hpp"

namespace clampd::pictures {
namespace {

using report::Band;
using report::Bars;
using report::Colour;
using report::Curve;
using report::Figure;
using report::Panel;
using report::Stroke;

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
/// The same in all figures.
constexpr Colour kMeasured = Colour::Black;
constexpr Colour kBefore = Colour::Vermilion;
constexpr Colour kAfter = Colour::Blue;
constexpr const char* kBeforeLabel = "base";
constexpr const char* kAfterLabel = "extended";

constexpr double kRevolution_rad = 2.0 * std::numbers::pi;
/// Of one piece of a spectrum over time: about a second at 1 kHz.
constexpr std::size_t kPieceRows = 1024;
/// More points than a figure is wide are not seen, but make the file large.
constexpr std::size_t kMaxPoints = 1600;

/// For a curve of many rows the least and the largest of each stretch, so that no peak gets lost.
Curve curve_through(const std::vector<double>& x, const std::vector<double>& y, double factor) {
  Curve curve;
  const std::size_t rows = std::min(x.size(), y.size());
  const std::size_t stretch = rows > kMaxPoints ? 2 * rows / kMaxPoints : 1;
  for (std::size_t from = 0; from < rows; from += stretch) {
    const std::size_t to = std::min(from + stretch, rows);
    std::size_t least = from, largest = from;
    for (std::size_t k = from; k < to; ++k) {
      if (y[k] < y[least]) least = k;
      if (y[k] > y[largest]) largest = k;
    }
    for (const std::size_t k : {std::min(least, largest), std::max(least, largest)}) {
      curve.x.push_back(x[k]);
      curve.y.push_back(factor * y[k]);
      if (least == largest) break;
    }
  }
  return curve;
}

Curve line(const std::vector<double>& x, const std::vector<double>& y, double factor, const char* label,
           Colour colour, double width_px = 1.4) {
  Curve curve = curve_through(x, y, factor);
  curve.label = label;
  curve.colour = colour;
  curve.width_px = width_px;
  return curve;
}

bool any_finite(const std::vector<double>& values) {
  return std::any_of(values.begin(), values.end(), [](double value) { return std::isfinite(value); });
}

double mean_square(const std::vector<double>& values) {
  double sum = 0.0;
  std::size_t count = 0;
  for (const double value : values)
    if (std::isfinite(value)) {
      sum += value * value;
      ++count;
    }
  return count == 0 ? 0.0 : sum / static_cast<double>(count);
}

/// "optimal" of "set/optimal-003.csv".
std::string manoeuvre_of(const std::string& name) {
  std::string stem = name.substr(name.find_last_of('/') + 1);
  stem = stem.substr(0, stem.find_last_of('.'));
  const std::size_t end = stem.find_last_not_of("0123456789-_ ");
  return end == std::string::npos ? stem : stem.substr(0, end + 1);
}

const std::vector<double>& first_known(const std::vector<double>& better, const std::vector<double>& other) {
  return any_finite(better) ? better : other;
}

/// One reading of a run against the models: the curves, and measured minus simulated.
void add_channel(std::vector<Panel>& panels, const RunView& view, const RunView::Channel& channel,
                 const char* quantity, const char* unit, double factor, const char* difference_unit,
                 bool extended) {
  const std::vector<double>& before = first_known(channel.simulated_before, channel.before);
  if (!any_finite(channel.measured) || !any_finite(before)) return;
  const std::vector<double>& after = first_known(channel.simulated_after, channel.after);
  Panel curves{.x = {.label = "time (s)"}, .y = {.label = fmt::format("{} ({})", quantity, unit)}};
  Panel differences{.title = "measured minus simulated",
                    .x = {.label = "time (s)"},
                    .y = {.label = fmt::format("{} ({})", quantity, difference_unit)}};
  const auto difference = [&](const std::vector<double>& simulated) {
    std::vector<double> values;
    for (std::size_t k = 0; k < std::min(simulated.size(), channel.measured.size()); ++k)
      values.push_back(channel.measured[k] - simulated[k]);
    return values;
  };
  curves.layers.push_back(line(view.time_s, channel.measured, factor, "measured", kMeasured, 2.6));
  curves.layers.push_back(line(view.time_s, before, factor, kBeforeLabel, kBefore));
  differences.layers.push_back(line(view.time_s, difference(before), 1.0, "", kBefore, 1.0));
  if (extended) {
    curves.layers.push_back(line(view.time_s, after, factor, kAfterLabel, kAfter));
    differences.layers.push_back(line(view.time_s, difference(after), 1.0, "", kAfter, 1.0));
  }
  panels.push_back(std::move(curves));
  panels.push_back(std::move(differences));
}

Curve level(double value, double from, double to) {
  return {.x = {from, to},
          .y = {value, value},
          .colour = Colour::Grey,
          .stroke = Stroke::Dotted,
          .width_px = 1.2};
}

/// Ticks of a logarithmic axis.
std::vector<report::Tick> decades(double from, double to) {
  std::vector<report::Tick> ticks;
  for (double at = from; at <= to; at *= 10.0) ticks.push_back({at, fmt::format("{:g}", at)});
  return ticks;
}

/// All runs' rows of two columns, one after the other; rows that one of them lacks are left out.
struct Pooled {
  std::vector<double> x, y;

  void add(const std::vector<double>& more_x, const std::vector<double>& more_y) {
    for (std::size_t k = 0; k < std::min(more_x.size(), more_y.size()); ++k)
      if (std::isfinite(more_x[k]) && std::isfinite(more_y[k])) {
        x.push_back(more_x[k]);
        y.push_back(more_y[k]);
      }
  }
};

std::size_t finite_count(std::span<const double> values) {
  return static_cast<std::size_t>(
      std::count_if(values.begin(), values.end(), [](double value) { return std::isfinite(value); }));
}

/// Of the finite ones; 0 if there are none.
double mean_of(std::span<const double> values) {
  double sum = 0.0;
  for (const double value : values)
    if (std::isfinite(value)) sum += value;
  const std::size_t count = finite_count(values);
  return count > 0 ? sum / static_cast<double>(count) : 0.0;
}

/// What a residual may depend on.
struct Against {
  std::string label;
  double factor;
  const std::vector<double>& (*column)(const RunView&);
};

std::vector<Against> variables_of(const DiagnosisSubject& subject) {
  // Velocity and force are predictions where there are any: the noise of a reading is part of its own
  // residual, and would show as a dependence.
  return {{fmt::format("position ({})", subject.position_unit), 1.0,
           [](const RunView& view) -> const std::vector<double>& { return view.position_rad; }},
          {fmt::format("velocity ({}/s)", subject.position_unit), 1.0,
           [](const RunView& view) -> const std::vector<double>& {
             return first_known(first_known(view.velocity.after, view.velocity.before),
                                view.velocity.measured);
           }},
          {"clamp force (kN)", 1e-3,
           [](const RunView& view) -> const std::vector<double>& {
             return first_known(view.force.after, view.force.before);
           }},
          {"time (s)", 1.0, [](const RunView& view) -> const std::vector<double>& { return view.time_s; }}};
}

/// Of a drive, also over its load: what friction or a torque constant does that depends on it.
std::vector<Against> variables_of(const DiagnosisSubject& subject, const EffortScale& scale) {
  std::vector<Against> variables = variables_of(subject);
  if (!subject.drive) return variables;
  std::erase_if(variables, [](const Against& each) { return each.label.starts_with("clamp force"); });
  variables.push_back({fmt::format("{} ({})", subject.effort(), scale.unit), scale.factor,
                       [](const RunView& view) -> const std::vector<double>& { return view.torque_Nm; }});
  return variables;
}

struct ResidualOf {
  std::string name;
  std::string label;  ///< with its unit
  double factor;
  bool unit_variance;  ///< of the right model's; else nothing is known of it
  const std::vector<double>& (*before)(const RunView&);
  const std::vector<double>& (*after)(const RunView&);
};

std::vector<ResidualOf> reading_residuals() {
  return {
      {"force", "force (sd)", 1.0, true,
       [](const RunView& view) -> const std::vector<double>& { return view.force.residual_before; },
       [](const RunView& view) -> const std::vector<double>& { return view.force.residual_after; }},
      {"velocity", "velocity (sd)", 1.0, true,
       [](const RunView& view) -> const std::vector<double>& { return view.velocity.residual_before; },
       [](const RunView& view) -> const std::vector<double>& { return view.velocity.residual_after; }},
  };
}

/// In which the drive's residuals are easily read.
EffortScale residual_scale(std::span<const RunView> views, const DiagnosisSubject& subject) {
  double square = 0.0, count = 0.0;
  for (const RunView& view : views)
    for (const double value : view.disturbance_before_Nm)
      if (std::isfinite(value)) square += value * value, count += 1.0;
  constexpr double kPeak = 3.0;  // of a root mean square
  return effort_scale(count > 0.0 ? kPeak * std::sqrt(square / count) : 0.0, subject);
}

std::string effort_label(std::string_view quantity, const EffortScale& scale) {
  return fmt::format("{} ({})", quantity, scale.unit);
}

std::vector<ResidualOf> residuals_of(std::span<const RunView> views, const DiagnosisSubject& subject) {
  if (!subject.drive) return reading_residuals();
  const EffortScale scale = residual_scale(views, subject);
  return {{"error", effort_label("left", scale), scale.factor, false,
           [](const RunView& view) -> const std::vector<double>& { return view.disturbance_before_Nm; },
           [](const RunView& view) -> const std::vector<double>& { return view.disturbance_after_Nm; }}};
}

void add_means(Panel& panel, const BinnedMeans& means, double x_factor, double y_factor, const char* label,
               Colour colour) {
  Curve curve{.label = label, .x = means.x, .y = means.mean, .colour = colour, .width_px = 1.8};
  for (double& value : curve.x) value *= x_factor;
  for (double& value : curve.y) value *= y_factor;
  panel.layers.push_back(std::move(curve));
}

/// Where a mean of white noise of unit variance stays 19 times out of 20.
void add_chance(Panel& panel, const BinnedMeans& means, double x_factor, const char* label) {
  Band band{.label = label, .x = means.x, .upper = means.two_sd, .colour = Colour::Grey};
  for (double& value : band.x) value *= x_factor;
  for (const double value : means.two_sd) band.lower.push_back(-value);
  panel.layers.push_back(std::move(band));
}

/// The mean of each run over its number; tells drift.
std::optional<Panel> run_panel(std::span<const RunView> views, const ResidualOf& residual, bool extended) {
  const auto means_of = [&](const std::vector<double>& (*column)(const RunView&)) {
    BinnedMeans means;
    for (std::size_t i = 0; i < views.size(); ++i) {
      const std::vector<double>& values = column(views[i]);
      const auto count = static_cast<double>(finite_count(values));
      if (count == 0.0) continue;
      means.x.push_back(static_cast<double>(i + 1));
      means.mean.push_back(mean_of(values));
      means.two_sd.push_back(2.0 / std::sqrt(count));
    }
    return means;
  };
  const BinnedMeans before = means_of(residual.before);
  if (before.x.size() < 2) return std::nullopt;
  constexpr std::size_t kMaxTicks = 20;
  std::vector<report::Tick> ticks;
  if (before.x.size() <= kMaxTicks)
    for (const double run : before.x) ticks.push_back({run, fmt::format("{:.0f}", run)});
  Panel panel{.x = {.label = "run", .ticks = std::move(ticks)}, .y = {.label = residual.label}};
  if (residual.unit_variance) add_chance(panel, before, 1.0, "");
  add_means(panel, before, 1.0, residual.factor, "", kBefore);
  if (extended)
    if (const BinnedMeans after = means_of(residual.after); !after.x.empty())
      add_means(panel, after, 1.0, residual.factor, "", kAfter);
  return panel;
}

std::optional<Panel> against_panel(std::span<const RunView> views, const ResidualOf& residual,
                                   const Against& against, bool extended, bool labelled) {
  Pooled before, after;
  for (const RunView& view : views) {
    before.add(against.column(view), residual.before(view));
    after.add(against.column(view), residual.after(view));
  }
  constexpr std::size_t kRowsPerBin = 20, kMaxBins = 30;
  const std::size_t bins = std::min(kMaxBins, before.x.size() / kRowsPerBin);
  if (bins < 3) return std::nullopt;
  Panel panel{.x = {.label = against.label}, .y = {.label = residual.label}};
  const BinnedMeans means = binned(before.x, before.y, bins);
  if (residual.unit_variance) add_chance(panel, means, against.factor, labelled ? "chance" : "");
  add_means(panel, means, against.factor, residual.factor, labelled ? kBeforeLabel : "", kBefore);
  if (extended && after.x.size() >= bins)
    add_means(panel, binned(after.x, after.y, bins), against.factor, residual.factor,
              labelled ? kAfterLabel : "", kAfter);
  return panel;
}

/// Means over equally wide bins of x, those with a few rows only.
BinnedMeans evenly_binned(const std::vector<double>& x, const std::vector<double>& y) {
  constexpr std::size_t kBins = 400, kFewestRows = 4;
  BinnedMeans means;
  if (x.empty()) return means;
  const auto [least, largest] = std::minmax_element(x.begin(), x.end());
  const double width = (*largest - *least) / kBins;
  std::vector<double> sum(kBins, 0.0);
  std::vector<std::size_t> count(kBins, 0);
  for (std::size_t k = 0; k < x.size() && width > 0.0; ++k) {
    const auto bin = std::min(static_cast<std::size_t>((x[k] - *least) / width), kBins - 1);
    sum[bin] += y[k];
    ++count[bin];
  }
  for (std::size_t bin = 0; bin < kBins; ++bin)
    if (count[bin] >= kFewestRows) {
      means.x.push_back(*least + (static_cast<double>(bin) + 0.5) * width);
      means.mean.push_back(sum[bin] / static_cast<double>(count[bin]));
    }
  return means;
}

/// How far a run turns the motor; 0 if its position is not known.
double travel_of(const RunView& view) {
  if (!any_finite(view.position_rad)) return 0.0;
  const auto [least, largest] = std::minmax_element(view.position_rad.begin(), view.position_rad.end());
  return *largest - *least;
}

/// Sums |X(f)|^2 of the pieces of a series, and what to divide it by. The columns of a run are taken as
/// evenly sampled: a picture does not suffer from a late sample.
struct TimeSpectrum {
  explicit TimeSpectrum(const std::vector<double>& frequencies_Hz)
      : frequency_Hz(frequencies_Hz), power(frequencies_Hz.size(), 0.0) {}

  void add(std::span<const double> values, double period_s) {
    constexpr std::size_t kFewestRows = 64;
    for (std::size_t from = 0; from + kFewestRows <= values.size(); from += kPieceRows)
      add_piece(values.subspan(from, std::min(kPieceRows, values.size() - from)), period_s);
  }

  /// 1 for white noise of unit variance.
  std::vector<double> over_white() const {
    return scaled([&](double sum) { return sum / window_squares; });
  }
  /// Of a sine, over all pieces.
  std::vector<double> amplitude() const {
    return scaled([&](double sum) { return 2.0 * std::sqrt(sum / squared_window_sums); });
  }

  std::vector<double> frequency_Hz;
  std::vector<double> power;
  double window_squares = 0.0;
  double squared_window_sums = 0.0;

 private:
  void add_piece(std::span<const double> values, double period_s) {
    const double mean = mean_of(values);
    std::vector<double> windowed;
    double window_sum = 0.0;
    for (std::size_t k = 0; k < values.size(); ++k) {
      const double phase = (static_cast<double>(k) + 0.5) / static_cast<double>(values.size());
      const double window = 0.5 - 0.5 * std::cos(2.0 * std::numbers::pi * phase);
      windowed.push_back(std::isfinite(values[k]) ? window * (values[k] - mean) : 0.0);
      window_sum += window;
      window_squares += window * window;
    }
    squared_window_sums += window_sum * window_sum;
    for (std::size_t i = 0; i < frequency_Hz.size(); ++i) {
      const std::complex<double> turn = std::polar(1.0, -2.0 * std::numbers::pi * frequency_Hz[i] * period_s);
      std::complex<double> pointer = 1.0, sum = 0.0;
      for (const double value : windowed) {
        sum += value * pointer;
        pointer *= turn;
      }
      power[i] += std::norm(sum);
    }
  }

  template <class Scale>
  std::vector<double> scaled(const Scale& scale) const {
    std::vector<double> result;
    for (const double sum : power) result.push_back(window_squares > 0.0 ? scale(sum) : kNan);
    return result;
  }
};

double period_of(const RunView& view) {
  if (view.time_s.size() < 2) return kNan;
  return (view.time_s.back() - view.time_s.front()) / static_cast<double>(view.time_s.size() - 1);
}

/// Up to half the sampling rate of the slowest run, as fine as a piece resolves.
std::vector<double> frequencies(std::span<const RunView> views) {
  double longest_s = 0.0;
  for (const RunView& view : views) longest_s = std::fmax(longest_s, period_of(view));
  std::vector<double> result;
  if (longest_s <= 0.0) return result;
  constexpr int kCount = 400;
  for (int i = 1; i <= kCount; ++i) result.push_back(0.5 / longest_s * i / kCount);
  return result;
}

}  // namespace

std::vector<const RunView*> representative(std::span<const RunView> views, std::size_t most) {
  const auto size = [](const RunView& view) {
    return mean_square(view.force.residual_before) + mean_square(view.velocity.residual_before);
  };
  std::map<std::string, const RunView*> worst;
  for (const RunView& view : views) {
    const RunView*& chosen = worst[manoeuvre_of(view.name)];
    if (chosen == nullptr || size(view) > size(*chosen)) chosen = &view;
  }
  std::vector<const RunView*> result;
  for (const auto& [manoeuvre, view] : worst) result.push_back(view);
  std::stable_sort(result.begin(), result.end(),
                   [&](const RunView* a, const RunView* b) { return size(*a) > size(*b); });
  if (result.size() > most) result.resize(most);
  return result;
}

BinnedMeans binned(std::span<const double> x, std::span<const double> y, std::size_t bins) {
  std::vector<std::size_t> order;
  for (std::size_t k = 0; k < std::min(x.size(), y.size()); ++k)
    if (std::isfinite(x[k]) && std::isfinite(y[k])) order.push_back(k);
  std::sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) { return x[a] < x[b]; });
  BinnedMeans means;
  for (std::size_t bin = 0; bin < bins; ++bin) {
    const std::size_t from = bin * order.size() / bins, to = (bin + 1) * order.size() / bins;
    if (from == to) continue;
    const auto count = static_cast<double>(to - from);
    double sum_x = 0.0, sum_y = 0.0;
    for (std::size_t i = from; i < to; ++i) {
      sum_x += x[order[i]];
      sum_y += y[order[i]];
    }
    means.x.push_back(sum_x / count);
    means.mean.push_back(sum_y / count);
    means.two_sd.push_back(2.0 / std::sqrt(count));
  }
  return means;
}

Spectrum angle_spectrum(std::span<const RunView> views, std::vector<double> RunView::*disturbance_Nm) {
  constexpr double kStep = 0.1, kHighest = 32.0;
  // Less is no period but a trend.
  constexpr double kFewestPeriods = 1.5;
  std::vector<const RunView*> turning;
  double longest_rad = 0.0;
  for (const RunView& view : views) {
    const double travel_rad = travel_of(view);
    if ((view.*disturbance_Nm).size() != view.position_rad.size() ||
        !(travel_rad > kFewestPeriods * kRevolution_rad))
      continue;
    turning.push_back(&view);
    longest_rad = std::max(longest_rad, travel_rad);
  }
  Spectrum spectrum;
  if (turning.empty()) return spectrum;
  double rows = 0.0;
  for (const RunView* view : turning) rows += static_cast<double>(view->position_rad.size());
  const int slowest = static_cast<int>(std::ceil(kFewestPeriods * kRevolution_rad / longest_rad / kStep));
  for (int i = slowest; i * kStep <= kHighest; ++i) {
    const double frequency = i * kStep;
    double squares = 0.0;
    for (const RunView* view : turning) {
      const std::vector<double>& torque_Nm = view->*disturbance_Nm;
      const double mean_Nm = mean_of(torque_Nm);
      std::complex<double> sum = 0.0;
      for (std::size_t k = 0; k < torque_Nm.size(); ++k)
        if (std::isfinite(torque_Nm[k]) && std::isfinite(view->position_rad[k]))
          sum += (torque_Nm[k] - mean_Nm) * std::polar(1.0, -frequency * view->position_rad[k]);
      squares += 4.0 * std::norm(sum) / static_cast<double>(torque_Nm.size());
    }
    spectrum.frequency.push_back(frequency);
    spectrum.amplitude.push_back(std::sqrt(squares / rows));
  }
  return spectrum;
}

std::optional<Figure> run_picture(const RunView& view, bool extended) {
  Figure figure{.columns = 2, .width_px = 1000, .panel_height_px = 215};
  add_channel(figure.panels, view, view.force, "clamp force", "kN", 1e-3, "N", extended);
  add_channel(figure.panels, view, view.velocity, "velocity", "rad/s", 1.0, "rad/s", extended);
  if (figure.panels.empty()) return std::nullopt;
  if (any_finite(view.torque_Nm) && any_finite(view.disturbance_before_Nm)) {
    figure.panels.push_back({.x = {.label = "time (s)"},
                             .y = {.label = "torque (N m)"},
                             .layers = {line(view.time_s, view.torque_Nm, 1.0, "", kMeasured)}});
    Panel error{.title = "torque error that the simulation needs",
                .x = {.label = "time (s)"},
                .y = {.label = "torque (mN m)"},
                .layers = {line(view.time_s, view.disturbance_before_Nm, 1e3, "", kBefore)}};
    if (extended && any_finite(view.disturbance_after_Nm))
      error.layers.push_back(line(view.time_s, view.disturbance_after_Nm, 1e3, "", kAfter));
    figure.panels.push_back(std::move(error));
  }
  return figure;
}

std::optional<Figure> dependence_picture(std::span<const RunView> views, bool extended,
                                         const DiagnosisSubject& subject) {
  Figure figure{.columns = 2, .width_px = 1000, .panel_height_px = 205};
  const std::vector<ResidualOf> residuals = residuals_of(views, subject);
  double largest = 0.0;
  for (const RunView& view : views)
    for (const double torque : view.torque_Nm) largest = std::max(largest, std::abs(torque));
  for (const Against& against : variables_of(subject, effort_scale(largest, subject))) {
    const bool labelled = figure.panels.empty();
    for (const ResidualOf& residual : residuals)
      if (std::optional<Panel> panel = against_panel(views, residual, against, extended, labelled))
        figure.panels.push_back(std::move(*panel));
  }
  for (const ResidualOf& residual : residuals)
    if (std::optional<Panel> panel = run_panel(views, residual, extended))
      figure.panels.push_back(std::move(*panel));
  if (figure.panels.empty()) return std::nullopt;
  return figure;
}

std::optional<Figure> residual_spectra_picture(std::span<const RunView> views, bool extended) {
  const std::vector<double> frequency_Hz = frequencies(views);
  Figure figure{.columns = 2, .width_px = 1000, .panel_height_px = 220};
  if (frequency_Hz.empty()) return std::nullopt;
  for (const ResidualOf& residual : reading_residuals()) {
    TimeSpectrum before(frequency_Hz), after(frequency_Hz);
    for (const RunView& view : views) {
      before.add(residual.before(view), period_of(view));
      after.add(residual.after(view), period_of(view));
    }
    if (before.window_squares == 0.0) continue;
    Panel panel{.x = {.label = "frequency (Hz)"},
                .y = {.label = residual.name + ", power", .logarithmic = true, .ticks = decades(1e-4, 1e6)},
                .layers = {level(1.0, 0.0, frequency_Hz.back())}};
    panel.layers.push_back(Curve{.label = figure.panels.empty() ? kBeforeLabel : "",
                                 .x = frequency_Hz,
                                 .y = before.over_white(),
                                 .colour = kBefore});
    if (extended && after.window_squares > 0.0)
      panel.layers.push_back(Curve{.label = figure.panels.empty() ? kAfterLabel : "",
                                   .x = frequency_Hz,
                                   .y = after.over_white(),
                                   .colour = kAfter});
    figure.panels.push_back(std::move(panel));
  }
  if (figure.panels.empty()) return std::nullopt;
  return figure;
}

std::optional<Figure> disturbance_picture(std::span<const RunView> views, bool extended,
                                          const DiagnosisSubject& subject) {
  const EffortScale scale = residual_scale(views, subject);
  const double factor = scale.factor;
  struct Model {
    std::vector<double> RunView::*torque_Nm;
    const char* label;
    Colour colour;
  };
  std::vector<Model> models{{&RunView::disturbance_before_Nm, kBeforeLabel, kBefore}};
  if (extended) models.push_back({&RunView::disturbance_after_Nm, kAfterLabel, kAfter});

  const bool rotary = subject.position_unit == "rad";
  Panel position{.x = {.label = fmt::format("position ({})", subject.position_unit)},
                 .y = {.label = effort_label(subject.effort(), scale)}};
  Panel angle{.x = {.label = "periods in a revolution of the motor"},
              .y = {.label = effort_label("amplitude", scale)}};
  Panel time{.x = {.label = "frequency (Hz)"}, .y = {.label = effort_label("amplitude", scale)}};
  const std::vector<double> frequency_Hz = frequencies(views);
  for (const Model& model : models) {
    Pooled pooled;
    TimeSpectrum over_time(frequency_Hz);
    for (const RunView& view : views) {
      pooled.add(view.position_rad, view.*model.torque_Nm);
      over_time.add(view.*model.torque_Nm, period_of(view));
    }
    const BinnedMeans means = evenly_binned(pooled.x, pooled.y);
    if (means.x.size() > 1) add_means(position, means, 1.0, factor, model.label, model.colour);
    if (rotary) {
      Spectrum over_angle = angle_spectrum(views, model.torque_Nm);
      for (double& amplitude : over_angle.amplitude) amplitude *= factor;
      if (!over_angle.frequency.empty())
        angle.layers.push_back(
            Curve{.x = over_angle.frequency, .y = over_angle.amplitude, .colour = model.colour});
    }
    if (over_time.window_squares > 0.0) {
      std::vector<double> amplitude = over_time.amplitude();
      for (double& value : amplitude) value *= factor;
      time.layers.push_back(Curve{.x = frequency_Hz, .y = std::move(amplitude), .colour = model.colour});
    }
  }
  Figure figure{.width_px = 1000, .panel_height_px = 220};
  for (Panel* panel : {&position, &angle, &time})
    if (!panel->layers.empty()) figure.panels.push_back(std::move(*panel));
  if (figure.panels.empty()) return std::nullopt;
  return figure;
}

Figure ladder_picture(std::span<const CandidateSummary* const> summaries, double alarm_evidence) {
  double largest = std::isfinite(alarm_evidence) ? alarm_evidence : 1.0;
  for (const CandidateSummary* summary : summaries) largest = std::max(largest, summary->significance_nats);
  // A strong effect would hide the alarm level on an even scale.
  constexpr double kEvenUpTo = 60.0, kLeast = 0.1;
  const bool logarithmic = largest > kEvenUpTo;
  const double start = logarithmic ? kLeast : 0.0;
  const double end = logarithmic ? 1.3 * largest : 1.08 * largest;
  Bars named{.label = "named", .colour = Colour::Blue}, rivals{.label = "rival", .colour = Colour::Orange},
      others{.label = "not named", .colour = Colour::Grey};
  Panel panel{.x = {.label = "evidence", .logarithmic = logarithmic, .lower = start, .upper = end}};
  const auto count = static_cast<double>(summaries.size());
  panel.y = {.lower = 0.4, .upper = count + 0.6};
  for (std::size_t i = 0; i < summaries.size(); ++i) {
    const CandidateSummary& summary = *summaries[i];
    const double y = count - static_cast<double>(i);
    Bars& bars = summary.chosen ? named : summary.rival ? rivals : others;
    bars.y.push_back(y);
    bars.from.push_back(start);
    bars.to.push_back(
        std::max(start, std::isfinite(summary.significance_nats) ? summary.significance_nats : start));
    panel.y.ticks.push_back({y, summary.name});
  }
  if (logarithmic) panel.x.ticks = decades(kLeast, end);
  for (Bars* bars : {&named, &rivals, &others})
    if (!bars->y.empty()) panel.layers.push_back(std::move(*bars));
  if (std::isfinite(alarm_evidence))
    panel.layers.push_back(Curve{.label = "alarm level",
                                 .x = {alarm_evidence, alarm_evidence},
                                 .y = {0.4, count + 0.6},
                                 .colour = Colour::Vermilion,
                                 .stroke = Stroke::Dashed});
  constexpr int kFrame_px = 105, kBar_px = 20;
  return {.panels = {std::move(panel)},
          .width_px = 760,
          .panel_height_px = kFrame_px + kBar_px * static_cast<int>(summaries.size())};
}

Figure trajectory_picture(const Run& trajectory, const DiagnosisSubject& subject) {
  Figure figure{.panel_height_px = 170};
  const auto add = [&](const std::string& label, const std::vector<double>& values, double factor) {
    if (!any_finite(values)) return;
    figure.panels.push_back(
        {.y = {.label = label}, .layers = {line(trajectory.time_s, values, factor, "", Colour::Blue)}});
  };
  add("clamp force (kN)", trajectory.force_N, 1e-3);
  add(fmt::format("velocity ({}/s)", subject.position_unit), trajectory.velocity_rad_s, 1.0);
  add(fmt::format("{} ({})", subject.effort(), subject.torque_unit), trajectory.torque_Nm, 1.0);
  if (!figure.panels.empty()) figure.panels.back().x.label = "time (s)";
  return figure;
}

}  // namespace clampd::pictures
