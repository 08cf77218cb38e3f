#include "clampd/identify/contact_point.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <utility>
#include <vector>

#include <fmt/format.h>

#include "clampd/brake/effect.hpp"
#include "clampd/brake/stiffness.hpp"
#include "clampd/statistics/distributions.hpp"
#include "src/identify/starting_point.hpp"

namespace clampd {
namespace {

constexpr int kMostSteps = 50;
constexpr double kLongestStep_rad = 3.0;
constexpr double kLastStep_rad = 1e-9;

/// What one run says of it, as sums over its rows.
struct RunContact {
  double position_rad = 0.0;
  double information = 0.0;  ///< of dF/dx squared: its inverse variance, were the force's noise 1 N
  double squares_N2 = 0.0;   ///< of what is left of the force readings
  double rows = 0.0;
  double farthest_rad = 0.0;                               ///< the pads were pressed
  Eigen::Vector2d by_stiffness = Eigen::Vector2d::Zero();  ///< d position_rad / d (k1, k2), times information
  double by_offset = 0.0;  ///< by an offset of the force readings, times information
};

/// By Gauss and Newton from where the estimate has the run's first row; nothing where that leads nowhere.
std::optional<RunContact> contact_of(const Run& run, const PolynomialStiffness& stiffness,
                                     double first_row_rad) {
  for (int step = 0; step < kMostSteps; ++step) {
    RunContact contact{.rows = static_cast<double>(run.size())};
    double score = 0.0;
    for (std::size_t k = 0; k < run.size(); ++k) {
      double gradient[PolynomialStiffness::kParameters];
      // Travel from the first row, so that an encoder that stands far from zero loses no digits.
      const double travel_rad = run.position_rad[k] - run.position_rad[0];
      contact.farthest_rad = std::max(contact.farthest_rad, first_row_rad + travel_rad);
      const ForcePoint force = stiffness.evaluate(first_row_rad + travel_rad, gradient);
      const double residual_N = run.force_N[k] - force.force_N;
      contact.information += force.slope_N_rad * force.slope_N_rad;
      contact.by_stiffness += force.slope_N_rad * Eigen::Vector2d(gradient[0], gradient[1]);
      contact.by_offset -= force.slope_N_rad;
      contact.squares_N2 += residual_N * residual_N;
      score += force.slope_N_rad * residual_N;
    }
    if (!(contact.information > 0.0)) return std::nullopt;
    const double move_rad = std::clamp(score / contact.information, -kLongestStep_rad, kLongestStep_rad);
    first_row_rad += move_rad;
    contact.position_rad = run.position_rad[0] - first_row_rad;
    if (std::abs(move_rad) < kLastStep_rad) return contact;
  }
  return std::nullopt;
}

/// Of the weighted mean over the runs, by their scatter; of one run, by what is left of its force readings.
double variance_of_mean_rad2(std::span<const RunContact> contacts, double mean_rad) {
  double information = 0.0, scatter_N2 = 0.0;
  for (const RunContact& of_run : contacts) {
    information += of_run.information;
    scatter_N2 += of_run.information * std::pow(of_run.position_rad - mean_rad, 2);
  }
  if (contacts.size() == 1)
    return contacts[0].squares_N2 / std::max(1.0, contacts[0].rows - 1.0) / information;
  const double degrees = static_cast<double>(contacts.size()) - 1.0;
  const double widened =
      statistics::student_t_upper_quantile(0.025, degrees) / statistics::normal_quantile(0.975);
  return widened * widened * scatter_N2 / degrees / information;
}

/// Of the mean by the rounding of the encoder's steps, which runs of one motion share: their scatter does not
/// show it. The forces weigh about the upper half of the steps that were passed.
double rounding_variance_rad2(double step_rad, double farthest_rad) {
  return step_rad * step_rad / 12.0 / std::max(1.0, 0.5 * farthest_rad / std::max(step_rad, kLastStep_rad));
}

/// The least by which two successive readings differ; 0 where none do.
double smallest_step_rad(std::span<const Run> runs) {
  constexpr double kRounding = 1e-12;  // of the readings as they are stored
  double smallest = std::numeric_limits<double>::infinity();
  for (const Run& run : runs)
    for (std::size_t k = 1; k < run.size(); ++k) {
      const double step = std::abs(run.position_rad[k] - run.position_rad[k - 1]);
      if (step > kRounding * std::abs(run.position_rad[k])) smallest = std::min(smallest, step);
    }
  return std::isfinite(smallest) ? smallest : 0.0;
}

ContactPoint not_known(std::string why) {
  ContactPoint contact;
  contact.why = std::move(why);
  return contact;
}

}  // namespace

ContactPoint contact_point(std::span<const Run> runs, const Estimate& estimate) {
  for (const Run& run : runs)
    if (run.position_rad.size() != run.size() || run.size() == 0)
      return not_known(fmt::format(
          "{} has no position readings: record those of the motor's encoder as column position_rad",
          run.name));
  for (const EffectEstimate& each : estimate.effects)
    if (const Location location = info_of(*find_effect(each.effect)).location;
        location == Location::Stiffness || location == Location::ForceReading || location == Location::Timing)
      return not_known(
          fmt::format("the model has {}, without which the force does not tell by how much the pads give way",
                      each.effect));
  const Eigen::Vector2d stiffness = estimate.parameters.theta.head<2>();
  if (!stiffness.allFinite() || estimate.initial_states.size() != runs.size())
    return not_known("there is no estimate of k1 and k2 to find it by");
  std::vector<RunContact> contacts;
  for (std::size_t r = 0; r < runs.size(); ++r)
    if (const auto of_run =
            contact_of(runs[r], PolynomialStiffness(stiffness.data()), estimate.initial_states[r][0]))
      contacts.push_back(*of_run);
  if (contacts.empty()) return not_known("no run presses the pads");

  RunContact sum;
  for (const RunContact& of_run : contacts) {
    sum.information += of_run.information;
    sum.position_rad += of_run.information * (of_run.position_rad - contacts[0].position_rad);
    sum.by_stiffness += of_run.by_stiffness;
    sum.by_offset += of_run.by_offset;
    sum.farthest_rad = std::max(sum.farthest_rad, of_run.farthest_rad);
  }
  const double step_rad = smallest_step_rad(runs);
  ContactPoint contact;
  contact.position_rad = contacts[0].position_rad + sum.position_rad / sum.information;
  contact.variance_rad2 = variance_of_mean_rad2(contacts, contact.position_rad) +
                          rounding_variance_rad2(step_rad, sum.farthest_rad);
  contact.by_parameters.head<2>() =
      sum.by_stiffness.cwiseProduct(nominal_parameters().head<2>()) / sum.information;
  contact.by_force_offset = sum.by_offset / sum.information;
  contact.reading_sd_rad = std::max(identify::position_noise_without_model(runs), step_rad / std::sqrt(12.0));
  contact.why.clear();
  return contact;
}

}  // namespace clampd
