#include "tools/reproduce/findings.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "clampd/base/nan.hpp"

namespace clampd::reproduce {
namespace {

constexpr std::size_t kKnee_samples = 180;
/// The sinusoid between its approach and its release.
constexpr std::size_t kSinusoidBegin = 150;
constexpr std::size_t kSinusoidEnd = 2150;

double geometric_mean_ratio(const ParameterVector& numerator, const ParameterVector& denominator) {
  return std::exp((numerator.array() / denominator.array()).log().mean());
}

ParameterVector truth_normalised() {
  return true_brake().theta.cwiseQuotient(nominal_parameters());
}

ColumnFigures figures_of(const Column& column) {
  ColumnFigures figures;
  const ParameterVector variance = column.covariance.diagonal();
  figures.sum_of_variances = variance.sum();
  figures.sum_of_bounds = column.bound.trace();
  figures.efficiency = geometric_mean_ratio(column.bound.diagonal(), variance);
  const ParameterVector standard_error =
      (variance / static_cast<double>(column.estimates.size())).cwiseSqrt();
  Eigen::Index index = 0;
  figures.largest_bias_sd =
      ((column.mean - truth_normalised()).array() / standard_error.array()).abs().maxCoeff(&index);
  figures.most_biased = static_cast<std::size_t>(index);
  const ParameterVector deviation = column.bound.diagonal().cwiseSqrt();
  figures.far_off = static_cast<std::size_t>(
      std::count_if(column.estimates.begin(), column.estimates.end(), [&](const Estimate& estimate) {
        const ParameterVector error =
            estimate.parameters.theta.cwiseQuotient(nominal_parameters()) - truth_normalised();
        return (error.array().abs() > 6.0 * deviation.array()).any();
      }));
  return figures;
}

/// Median over the estimates of the distance of theta / theta_nom from the truth: some fits end anywhere.
ParameterVector median_error(const Column& column) {
  ParameterVector medians = ParameterVector::Constant(kNaN);
  if (column.estimates.empty()) return medians;
  for (Eigen::Index i = 0; i < medians.size(); ++i) {
    std::vector<double> errors;
    for (const Estimate& estimate : column.estimates)
      errors.push_back(std::abs(estimate.parameters.theta[i] - true_brake().theta[i]));
    const auto middle = errors.begin() + static_cast<std::ptrdiff_t>(errors.size() / 2);
    std::nth_element(errors.begin(), middle, errors.end());
    medians[i] = *middle;
  }
  return medians;
}

/// Area of the confidence regions of a over those of b.
double area_ratio(const Column& a, const Column& b) {
  const auto area = [](const ParameterMatrix& c, Parameter first, Parameter second) {
    const auto i = static_cast<Eigen::Index>(first), j = static_cast<Eigen::Index>(second);
    return std::sqrt(c(i, i) * c(j, j) - c(i, j) * c(i, j));
  };
  double product = 1.0;
  for (const auto& [first, second] : kFigure5_pairs)
    product *= area(a.covariance, first, second) / area(b.covariance, first, second);
  return std::pow(product, 1.0 / static_cast<double>(kFigure5_pairs.size()));
}

Rest rest_of(const std::vector<double>& velocity_rad_s) {
  Rest rest;
  std::size_t begin = kSinusoidBegin;
  for (std::size_t k = kSinusoidBegin; k < std::min(kSinusoidEnd, velocity_rad_s.size()); ++k) {
    if (velocity_rad_s[k] != 0.0) begin = k + 1;
    const double length_s = static_cast<double>(k + 1 - begin) * kMaxStep_s;
    if (length_s > rest.longest_s) rest = {static_cast<double>(begin) * kMaxStep_s, length_s};
  }
  return rest;
}

Rest rest_of(const std::vector<sim::Truth>& truth) {
  std::vector<double> velocity_rad_s;
  velocity_rad_s.reserve(truth.size());
  for (const sim::Truth& at : truth) velocity_rad_s.push_back(at.velocity_rad_s);
  return rest_of(velocity_rad_s);
}

ReplayFigures figures_of(const Replay& replay, const std::vector<SimulatedRun>& runs) {
  constexpr double kLockUp_s = 0.010;
  ReplayFigures figures;
  std::vector<double> force_rms_N;
  for (std::size_t i = 0; i < runs.size(); ++i) {
    const double rest_s = rest_of(replay.repeats[i].simulation.velocity_rad_s).longest_s;
    if (rest_s >= rest_of(runs[i].truth).longest_s + kLockUp_s) ++figures.locked;
    figures.longest_s = std::max(figures.longest_s, rest_s);
    force_rms_N.push_back(replay.repeats[i].force_rms_N);
  }
  std::sort(force_rms_N.begin(), force_rms_N.end());
  figures.median_force_rms_N = force_rms_N[force_rms_N.size() / 2];
  figures.worst_force_rms_N = force_rms_N.back();
  return figures;
}

/// Steps from one length to the next with which the criterion falls.
std::size_t falls(const std::vector<Design>& designs, double Criterion::*criterion) {
  std::size_t count = 0;
  for (std::size_t i = 1; i < designs.size(); ++i)
    if (designs[i].summary.criterion.*criterion < designs[i - 1].summary.criterion.*criterion) ++count;
  return count;
}

/// Fall of -log det M per 20 ms between two lengths.
double steepness(const std::vector<Design>& designs, std::size_t from, std::size_t to) {
  const Design* const first = design_of(designs, from);
  const Design* const last = design_of(designs, to);
  if (first == nullptr || last == nullptr) return kNaN;
  return (first->summary.criterion.logdet - last->summary.criterion.logdet) *
         static_cast<double>(kBlock_samples) / static_cast<double>(to - from);
}

void judge_designs(const Study& study, Findings& findings) {
  findings.steepness_before = steepness(study.d_designs, kKnee_samples - 40, kKnee_samples);
  findings.steepness_after = steepness(study.d_designs, kKnee_samples, kKnee_samples + 40);
  findings.d_falls = falls(study.d_designs, &Criterion::logdet);
  findings.a_falls = falls(study.a_designs, &Criterion::trace_inverse);
  findings.long_force_min_N = std::numeric_limits<double>::infinity();
  for (const Design& design : study.d_designs) {
    const Certification& seen = design.summary.certification;
    findings.speed_max_rad_s = std::max(findings.speed_max_rad_s, seen.velocity_max_rad_s);
    if (design.samples < kKnee_samples) continue;
    findings.long_force_min_N = std::min(findings.long_force_min_N, seen.force_max_N);
    findings.long_force_max_N = std::max(findings.long_force_max_N, seen.force_max_N);
  }
}

void judge_shapes(const Study& study, Findings& findings) {
  findings.lowest_after_rise = 1.0;
  for (const std::size_t samples : kFigure1_samples) {
    const Design* const design = design_of(study.d_designs, samples);
    if (design == nullptr) continue;
    const std::vector<double>& force_N = design->response.force_N;
    const double peak_N = *std::max_element(force_N.begin(), force_N.end());
    const auto risen = std::find_if(force_N.begin(), force_N.end(),
                                    [peak_N](double force) { return force >= 0.9 * peak_N; });
    findings.latest_rise = std::max(findings.latest_rise, static_cast<double>(risen - force_N.begin()) /
                                                              static_cast<double>(force_N.size()));
    findings.lowest_after_rise =
        std::min(findings.lowest_after_rise, *std::min_element(risen, force_N.end()) / peak_N);
    findings.end_speed_max_rad_s =
        std::max(findings.end_speed_max_rad_s, std::abs(design->response.velocity_rad_s.back()));
  }
}

void judge_table(const Study& study, Findings& findings) {
  findings.oem_optimal = figures_of(study.oem_optimal);
  findings.pem_optimal = figures_of(study.pem_optimal);
  findings.oem_step = figures_of(study.oem_step);
  findings.methods_variance_ratio =
      geometric_mean_ratio(study.oem_optimal.covariance.diagonal(), study.pem_optimal.covariance.diagonal());
  findings.methods_mean_distance = (study.oem_optimal.mean - study.pem_optimal.mean).cwiseAbs().maxCoeff();
  findings.design_variance_ratio =
      geometric_mean_ratio(study.oem_step.covariance.diagonal(), study.oem_optimal.covariance.diagonal());
  findings.methods_area_ratio = area_ratio(study.oem_optimal, study.pem_optimal);
  findings.design_area_ratio = area_ratio(study.oem_step, study.oem_optimal);
  findings.design_bound_ratio =
      geometric_mean_ratio(study.oem_step.bound.diagonal(), study.oem_optimal.bound.diagonal());
  findings.torque_noise_loss =
      geometric_mean_ratio(study.oem_optimal.bound.diagonal(), study.oem_optimal.bound_exact.diagonal());
  findings.time_ratio = study.pem_optimal.median_wall_s / study.oem_optimal.median_wall_s;
  for (const Estimate& estimate : study.pem_optimal.estimates)
    findings.mean_torque_noise_Nm +=
        estimate.noise_torque_Nm / static_cast<double>(study.pem_optimal.estimates.size());
  findings.repeat_s = study.optimal.bench_s / static_cast<double>(study.options.repeats);
}

void judge_filter(const Study& study, Findings& findings) {
  const std::vector<sim::Truth>& truth = study.sinusoid.runs[study.shown_repeat].truth;
  const Band& force = study.kalman.filtered.force_N;
  const Band& velocity = study.kalman.filtered.velocity_rad_s;
  double force_squares = 0.0, velocity_squares = 0.0, moving = 0.0;
  int moving_rows = 0;
  for (std::size_t k = kSinusoidBegin; k < kSinusoidEnd; ++k) {
    const double force_error = force.mean[k] - truth[k].force_N;
    const double velocity_error = velocity.mean[k] - truth[k].velocity_rad_s;
    findings.filter_force_sd_N += force.sd[k];
    force_squares += force_error * force_error;
    velocity_squares += velocity_error * velocity_error;
    if (std::abs(force_error) <= 2.0 * force.sd[k]) findings.covered_force += 1.0;
    if (std::abs(velocity_error) <= 2.0 * velocity.sd[k]) findings.covered_velocity += 1.0;
    if (std::abs(truth[k].velocity_rad_s) < 20.0) {
      findings.velocity_sd_crossing_rad_s = std::max(findings.velocity_sd_crossing_rad_s, velocity.sd[k]);
    } else {
      moving += velocity.sd[k];
      ++moving_rows;
    }
  }
  const auto rows = static_cast<double>(kSinusoidEnd - kSinusoidBegin);
  findings.filter_force_sd_N /= rows;
  findings.filter_force_error_N = std::sqrt(force_squares / rows);
  findings.filter_velocity_error_rad_s = std::sqrt(velocity_squares / rows);
  findings.covered_force /= rows;
  findings.covered_velocity /= rows;
  findings.velocity_sd_moving_rad_s = moving / moving_rows;
  // It starts at rest, hence a little later.
  std::size_t crossing = kSinusoidBegin + 50;
  while (crossing < kSinusoidEnd && truth[crossing].velocity_rad_s > 0.0) ++crossing;
  findings.crossing_s = static_cast<double>(crossing) * kMaxStep_s;
}

}  // namespace

const Design* design_of(const std::vector<Design>& designs, std::size_t samples) {
  const auto found = std::find_if(designs.begin(), designs.end(),
                                  [samples](const Design& design) { return design.samples == samples; });
  return found == designs.end() ? nullptr : &*found;
}

double variance_ratio(const PaperColumn& a, const PaperColumn& b) {
  return geometric_mean_ratio(ParameterVector(a.variance.data()), ParameterVector(b.variance.data()));
}

double sum_of_variances(const PaperColumn& column) {
  return ParameterVector(column.variance.data()).sum();
}

double mean_distance(const PaperColumn& a, const PaperColumn& b) {
  return (ParameterVector(a.mean.data()) - ParameterVector(b.mean.data())).cwiseAbs().maxCoeff();
}

Findings findings_of(const Study& study) {
  Findings findings;
  judge_designs(study, findings);
  judge_shapes(study, findings);
  judge_table(study, findings);
  const std::vector<SimulatedRun>& sinusoids = study.sinusoid.runs;
  for (const SimulatedRun& run : sinusoids)
    findings.brake_longest_rest_s = std::max(findings.brake_longest_rest_s, rest_of(run.truth).longest_s);
  for (const Replay& replay : study.sinusoid_replays)
    findings.replays.push_back(figures_of(replay, sinusoids));
  findings.shown_rest =
      rest_of(study.sinusoid_replays.front().repeats[study.shown_repeat].simulation.velocity_rad_s);
  findings.sinusoid_error_ratio =
      geometric_mean_ratio(median_error(study.oem_sinusoid), median_error(study.pem_sinusoid));
  judge_filter(study, findings);
  return findings;
}

}  // namespace clampd::reproduce
