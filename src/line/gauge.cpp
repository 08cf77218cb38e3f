#include "clampd/line/gauge.hpp"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include "clampd/line/constants.hpp"
#include "clampd/statistics/distributions.hpp"

namespace clampd::quality {
namespace {

constexpr double kToleranceSigmas = 6.0;
constexpr double kCategories = 1.41;  ///< sqrt(2), as the manual prints it

double square(double x) {
  return x * x;
}

/// The study as a box of numbers: parts x operators x repeats.
struct Cells {
  std::vector<std::string> parts;
  std::vector<std::string> operators;
  std::vector<std::vector<double>> values;  ///< [part * operators + operator]

  const std::vector<double>& at(std::size_t part, std::size_t op) const {
    return values[part * operators.size() + op];
  }
  std::size_t repeats() const { return values.front().size(); }
};

std::size_t index_of(std::vector<std::string>& names, const std::string& name) {
  const auto found = std::find(names.begin(), names.end(), name);
  if (found != names.end()) return static_cast<std::size_t>(found - names.begin());
  names.push_back(name);
  return names.size() - 1;
}

Result<Cells> arrange(std::span<const GaugeReading> readings) {
  Cells cells;
  for (const GaugeReading& reading : readings) {
    if (!std::isfinite(reading.value))
      return failure(
          fmt::format("part {}, operator {}: a value is not a number", reading.part, reading.operator_name));
    index_of(cells.parts, reading.part);
    index_of(cells.operators, reading.operator_name);
  }
  if (cells.parts.size() < 2 || cells.operators.size() < 2)
    return failure(fmt::format("a gauge study needs at least two parts and two operators; here are {} and {}",
                               cells.parts.size(), cells.operators.size()));
  cells.values.resize(cells.parts.size() * cells.operators.size());
  for (const GaugeReading& reading : readings)
    cells
        .values[index_of(cells.parts, reading.part) * cells.operators.size() +
                index_of(cells.operators, reading.operator_name)]
        .push_back(reading.value);
  std::size_t most = 0;
  for (const auto& cell : cells.values) most = std::max(most, cell.size());
  for (std::size_t p = 0; p < cells.parts.size(); ++p)
    for (std::size_t o = 0; o < cells.operators.size(); ++o)
      if (cells.at(p, o).size() != most)
        return failure(
            fmt::format("operator {} measured part {} {} times, others up to {} times: every operator must "
                        "measure every part equally often",
                        cells.operators[o], cells.parts[p], cells.at(p, o).size(), most));
  if (most < 2)
    return failure("every operator measured every part once only: without repeats, repeatability is unknown");
  return cells;
}

GaugeStudy study_of(const Cells& cells) {
  GaugeStudy study;
  study.parts = cells.parts.size();
  study.operators = cells.operators.size();
  study.repeats = cells.repeats();
  return study;
}

/// What follows from the variances of repeatability, operators, interaction and parts.
void conclude(GaugeStudy& study, double ev, double av, double interaction, double pv,
              const GaugeOptions& options) {
  const double total = ev + av + interaction + pv;
  const auto component = [&](double variance) {
    GaugeComponent result;
    result.sd = std::sqrt(variance);
    result.of_total = total > 0.0 ? std::sqrt(variance / total) : 0.0;
    result.of_tolerance = kToleranceSigmas * result.sd / options.tolerance;
    return result;
  };
  study.repeatability = component(ev);
  study.operator_effect = component(av);
  study.interaction = component(interaction);
  study.reproducibility = component(av + interaction);
  study.gauge = component(ev + av + interaction);
  study.part_variation = component(pv);
  study.total = component(total);
  study.distinct_categories = kCategories * study.part_variation.sd / study.gauge.sd;
}

double mean_of(const std::vector<double>& values) {
  double sum = 0.0;
  for (const double value : values) sum += value;
  return sum / static_cast<double>(values.size());
}

struct Means {
  double all = 0.0;
  std::vector<double> parts;
  std::vector<double> operators;
};

Means means_of(const Cells& cells) {
  Means means{0.0, std::vector<double>(cells.parts.size()), std::vector<double>(cells.operators.size())};
  const double p = static_cast<double>(cells.parts.size()), o = static_cast<double>(cells.operators.size());
  for (std::size_t i = 0; i < cells.parts.size(); ++i)
    for (std::size_t j = 0; j < cells.operators.size(); ++j) {
      const double mean = mean_of(cells.at(i, j));
      means.parts[i] += mean / o;
      means.operators[j] += mean / p;
      means.all += mean / (p * o);
    }
  return means;
}

AnovaRow row(const char* source, double freedom, double sum_of_squares) {
  AnovaRow result;
  result.source = source;
  result.freedom = freedom;
  result.sum_of_squares = sum_of_squares;
  result.mean_square = sum_of_squares / freedom;
  return result;
}

void test_against(AnovaRow& tested, const AnovaRow& error) {
  if (!(error.mean_square > 0.0)) return;
  tested.f = tested.mean_square / error.mean_square;
  tested.p = statistics::fisher_f_p_value(tested.f, tested.freedom, error.freedom);
}

double range_of(const std::vector<double>& values) {
  const auto [least, most] = std::minmax_element(values.begin(), values.end());
  return *most - *least;
}

}  // namespace

Result<GaugeStudy> gauge_anova(std::span<const GaugeReading> readings, const GaugeOptions& options) {
  const Result<Cells> cells = arrange(readings);
  if (!cells) return tl::unexpected(cells.error());
  GaugeStudy study = study_of(*cells);
  const double p = static_cast<double>(study.parts), o = static_cast<double>(study.operators),
               r = static_cast<double>(study.repeats);
  const Means means = means_of(*cells);
  double ss_parts = 0.0, ss_operators = 0.0, ss_cells = 0.0, ss_within = 0.0;
  for (const double mean : means.parts) ss_parts += o * r * square(mean - means.all);
  for (const double mean : means.operators) ss_operators += p * r * square(mean - means.all);
  for (std::size_t i = 0; i < study.parts; ++i)
    for (std::size_t j = 0; j < study.operators; ++j) {
      const double cell = mean_of(cells->at(i, j));
      ss_cells += r * square(cell - means.parts[i] - means.operators[j] + means.all);
      for (const double value : cells->at(i, j)) ss_within += square(value - cell);
    }
  AnovaRow part = row("parts", p - 1.0, ss_parts);
  AnovaRow op = row("operators", o - 1.0, ss_operators);
  AnovaRow both = row("parts x operators", (p - 1.0) * (o - 1.0), ss_cells);
  AnovaRow error = row("repeatability", p * o * (r - 1.0), ss_within);
  const AnovaRow total = row("total", p * o * r - 1.0, ss_parts + ss_operators + ss_cells + ss_within);
  test_against(both, error);

  // !(p <= limit): also where nothing scatters.
  study.interaction_pooled = !(both.p <= options.pooling_p);
  const AnovaRow pooled =
      row("repeatability", both.freedom + error.freedom, both.sum_of_squares + error.sum_of_squares);
  const AnovaRow& reference = study.interaction_pooled ? pooled : both;
  test_against(part, reference);
  test_against(op, reference);
  const auto positive = [](double variance) { return std::max(variance, 0.0); };
  const double ev = study.interaction_pooled ? pooled.mean_square : error.mean_square;
  const double interaction =
      study.interaction_pooled ? 0.0 : positive((both.mean_square - error.mean_square) / r);
  conclude(study, ev, positive((op.mean_square - reference.mean_square) / (p * r)), interaction,
           positive((part.mean_square - reference.mean_square) / (o * r)), options);
  study.anova = {part, op, both, error, total};
  return study;
}

Result<GaugeStudy> gauge_average_range(std::span<const GaugeReading> readings, const GaugeOptions& options) {
  const Result<Cells> cells = arrange(readings);
  if (!cells) return tl::unexpected(cells.error());
  GaugeStudy study = study_of(*cells);
  const int groups = static_cast<int>(cells->values.size());
  double range = 0.0;
  for (const auto& cell : cells->values) range += range_of(cell) / groups;
  const Means means = means_of(*cells);
  // The manual's K1, K2, K3. With more than 15 groups, d2* is d2.
  const int repeats = static_cast<int>(study.repeats);
  const double ev = range / (groups > 15 ? range_mean(repeats) : average_range_mean(repeats, groups));
  const double av = range_of(means.operators) / average_range_mean(static_cast<int>(study.operators), 1);
  const double pv = range_of(means.parts) / average_range_mean(static_cast<int>(study.parts), 1);
  const double av_square = square(av) - square(ev) / static_cast<double>(study.parts * study.repeats);
  conclude(study, square(ev), std::max(av_square, 0.0), 0.0, square(pv), options);
  return study;
}

std::string_view to_string(GaugeGrade grade) noexcept {
  switch (grade) {
    case GaugeGrade::Good:
      return "good";
    case GaugeGrade::Conditional:
      return "conditional";
    case GaugeGrade::Unacceptable:
      return "unacceptable";
  }
  return "";
}

GaugeGrade grade(double share) noexcept {
  return share < 0.1 ? GaugeGrade::Good : share <= 0.3 ? GaugeGrade::Conditional : GaugeGrade::Unacceptable;
}

}  // namespace clampd::quality
