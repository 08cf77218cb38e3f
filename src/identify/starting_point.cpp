#include "src/identify/starting_point.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include <Eigen/Core>

#include "clampd/statistics/median.hpp"
#include "clampd/statistics/symmetric.hpp"

namespace clampd::identify {

namespace {

/// Samples of the integrated torque balance: long enough to drown the velocity reading's noise, short enough
/// to resolve a reversal.
constexpr std::size_t kWindow = 12;

void append_third_differences(std::span<const double> series, std::vector<double>& magnitudes) {
  for (std::size_t k = 3; k < series.size(); ++k)
    magnitudes.push_back(std::abs(series[k] - 3.0 * series[k - 1] + 3.0 * series[k - 2] - series[k - 3]));
}

/// Standard deviation of white noise from its third differences; the median ignores the steps of the torque.
double noise_from(std::vector<double>& magnitudes) {
  return statistics::median(magnitudes) / (0.6745 * std::sqrt(20.0));  // 20 = 1 + 9 + 9 + 1
}

std::vector<double> travel_of(const Run& run) {
  std::vector<double> travel(run.size(), 0.0);
  for (std::size_t k = 1; k < run.size(); ++k)
    travel[k] = travel[k - 1] + 0.5 * (run.velocity_rad_s[k] + run.velocity_rad_s[k - 1]) *
                                    (run.time_s[k] - run.time_s[k - 1]);
  return travel;
}

double largest(std::span<const double> series) {
  return series.empty() ? 0.0 : *std::max_element(series.begin(), series.end());
}

/// x >= 0 with F(x) = force on the rising branch, sought from `near`; negative if there is none.
double position_of(const PolynomialStiffness& stiffness, double force_N, double near) {
  constexpr double kFarthest_rad = 500.0, kClose = 1e-12;
  double low = 0.0, high = std::numeric_limits<double>::infinity();
  double position = near;
  for (int i = 0; i < 100; ++i) {
    double gradient[2];
    const ForcePoint force = stiffness.evaluate(position, gradient);
    if (force.slope_N_rad <= 0.0 && force.force_N < force_N) return -1.0;  // beyond the highest force
    (force.force_N < force_N ? low : high) = position;
    // Newton's step, or half of what is left where that leads out of it.
    double next = position + (force_N - force.force_N) / force.slope_N_rad;
    if (!(next > low && next < high)) next = std::isinf(high) ? 1.5 * position + 1.0 : 0.5 * (low + high);
    if (next > kFarthest_rad) return -1.0;
    if (std::abs(next - position) < kClose * (1.0 + position)) return next;
    position = next;
  }
  return position;
}

/// Refines k1, k2 and one initial position a run on force over travel by Gauss-Newton; false if the runs do
/// not tell.
bool fit_stiffness(std::span<const Run> runs, std::vector<double>& positions, ParameterVector& theta) {
  constexpr double kClose = 1e-6;  // of nominal, and rad: far less than a start has to be right by
  std::vector<std::vector<double>> travels;
  for (const Run& run : runs) travels.push_back(travel_of(run));
  Eigen::Vector2d coefficients = theta.head<2>();
  const Eigen::Vector2d unit(kParameterTable[k1].nominal, kParameterTable[k2].nominal);
  for (int iteration = 0; iteration < 15; ++iteration) {
    Eigen::Matrix2d normal = Eigen::Matrix2d::Identity() * 1e-3;
    Eigen::Vector2d right = Eigen::Vector2d::Zero();
    std::vector<Eigen::Vector4d> eliminated(runs.size());  // per run: row of the position update
    const PolynomialStiffness stiffness(coefficients.data());
    for (std::size_t r = 0; r < runs.size(); ++r) {
      Eigen::Matrix3d block = Eigen::Matrix3d::Zero();
      Eigen::Vector3d target = Eigen::Vector3d::Zero();
      for (std::size_t k = 0; k < runs[r].size(); ++k) {
        double gradient[2];
        const ForcePoint force = stiffness.evaluate(positions[r] + travels[r][k], gradient);
        const Eigen::Vector3d row(gradient[0] * unit[0], gradient[1] * unit[1], force.slope_N_rad);
        block += row * row.transpose();
        target += row * (runs[r].force_N[k] - force.force_N);
      }
      const double pivot = block(2, 2) + 1e-3;
      const Eigen::Vector2d cross = block.topRightCorner<2, 1>();
      normal += block.topLeftCorner<2, 2>() - cross * cross.transpose() / pivot;
      right += target.head<2>() - cross * target[2] / pivot;
      eliminated[r] << cross / pivot, target[2] / pivot, 0.0;
    }
    const Eigen::Vector2d step = statistics::SymmetricFactor(normal).solve(right);
    if (!step.allFinite()) return false;
    coefficients += unit.cwiseProduct(step);
    double largest = step.cwiseAbs().maxCoeff();
    for (std::size_t r = 0; r < runs.size(); ++r) {
      const double move = eliminated[r][2] - eliminated[r].head<2>().dot(step);
      positions[r] += std::clamp(move, -3.0, 3.0);
      largest = std::max(largest, std::abs(move));
    }
    if (largest < kClose) break;
  }
  for (const std::size_t i : {std::size_t{k1}, std::size_t{k2}}) {
    const double ratio = coefficients[static_cast<Eigen::Index>(i)] / kParameterTable[i].nominal;
    if (!(ratio > 0.1 && ratio < 10.0)) return false;
  }
  theta.head<2>() = coefficients;
  return true;
}

struct Window {
  double sign, velocity_integral, force_integral,
      drive_integral;  ///< drive: torque - N force - inertia torque
  std::array<double, kWindow> velocity, force, duration;
};

std::vector<Window> sliding_windows(std::span<const Run> runs, const FixedParameters& fixed,
                                    double threshold) {
  std::vector<Window> windows;
  for (const Run& run : runs) {
    for (std::size_t from = 0; from + kWindow < run.size(); from += kWindow / 2) {
      Window window{};
      window.sign = run.velocity_rad_s[from] > 0.0 ? 1.0 : -1.0;
      bool slides = true;
      for (std::size_t i = 0; i < kWindow && slides; ++i) {
        const std::size_t k = from + i;
        const double duration = run.time_s[k + 1] - run.time_s[k];
        window.velocity[i] = 0.5 * (run.velocity_rad_s[k] + run.velocity_rad_s[k + 1]);
        window.force[i] = 0.5 * (run.force_N[k] + run.force_N[k + 1]);
        window.duration[i] = duration;
        window.velocity_integral += window.velocity[i] * duration;
        window.drive_integral += (run.torque_Nm[k] - fixed.ratio_m_rad * window.force[i]) * duration;
        slides = window.sign * window.velocity[i] > threshold;
      }
      if (!slides) continue;
      window.drive_integral -=
          fixed.inertia_kg_m2 * (run.velocity_rad_s[from + kWindow] - run.velocity_rad_s[from]);
      windows.push_back(window);
    }
  }
  return windows;
}

/// TC, Ts0, Tv, mus by linear least squares for each ws of a grid; the best grid point wins.
void fit_friction(const std::vector<Window>& windows, ParameterVector& theta) {
  constexpr std::array<double, 10> kGrid{0.15, 0.22, 0.33, 0.5, 0.7, 1.0, 1.4, 2.0, 3.0, 4.5};
  if (windows.size() < 8) return;
  const Eigen::Vector4d unit(kParameterTable[TC].nominal, kParameterTable[Ts0].nominal,
                             kParameterTable[Tv].nominal, kParameterTable[mus].nominal);
  double best = std::numeric_limits<double>::infinity();
  ParameterVector fitted = theta;
  for (const double factor : kGrid) {
    const double speed = factor * kParameterTable[ws].nominal;
    // A faint pull towards the present values stands for what the windows do not show.
    Eigen::Matrix4d normal = Eigen::Matrix4d::Zero();
    Eigen::Vector4d right = Eigen::Vector4d::Zero();
    double square = 0.0;
    for (const Window& window : windows) {
      Eigen::Vector4d row = Eigen::Vector4d::Zero();
      for (std::size_t i = 0; i < kWindow; ++i) {
        const double ratio = window.velocity[i] / speed;
        const double share = 1.0 / (1.0 + ratio * ratio);
        row[0] += window.sign * (1.0 - share) * window.duration[i];
        row[1] += window.sign * share * window.duration[i];
        row[3] += window.sign * share * window.force[i] * window.duration[i];
      }
      row[2] = window.velocity_integral;
      row = row.cwiseProduct(unit);
      normal += row * row.transpose();
      right += row * window.drive_integral;
      square += window.drive_integral * window.drive_integral;
    }
    const double ridge = 1e-3 * normal.trace() / 4.0;
    Eigen::Vector4d present(theta[TC], theta[Ts0], theta[Tv], theta[mus]);
    present = present.cwiseQuotient(unit);
    const Eigen::Matrix4d damped = normal + ridge * Eigen::Matrix4d::Identity();
    const Eigen::Vector4d solution = statistics::SymmetricFactor(damped).solve(right + ridge * present);
    const double misfit = square - 2.0 * right.dot(solution) + solution.dot(normal * solution);
    if (!solution.allFinite() || misfit >= best) continue;
    best = misfit;
    const Eigen::Vector4d bounded = solution.cwiseMax(0.15).cwiseMin(6.0).cwiseProduct(unit);
    fitted[TC] = bounded[0];
    fitted[Ts0] = bounded[1];
    fitted[Tv] = bounded[2];
    fitted[mus] = bounded[3];
    fitted[ws] = speed;
  }
  theta = fitted;
}

}  // namespace

SensorNoise noise_without_model(std::span<const Run> runs) {
  std::vector<double> force;
  std::vector<double> velocity;
  for (const Run& run : runs) {
    append_third_differences(run.force_N, force);
    append_third_differences(run.velocity_rad_s, velocity);
  }
  return {std::max(kSmallestNoise.force_N, noise_from(force)),
          std::max(kSmallestNoise.velocity_rad_s, noise_from(velocity))};
}

double position_noise_without_model(std::span<const Run> runs) {
  std::vector<double> position;
  for (const Run& run : runs) append_third_differences(run.position_rad, position);
  return position.empty() ? 0.0 : noise_from(position);
}

BrakeState initial_state_guess(const Run& run, const ParameterVector& theta) {
  const std::vector<double> travel = travel_of(run);
  const PolynomialStiffness stiffness(theta.data());
  const double threshold = std::max(200.0, 0.1 * largest(run.force_N));
  double weight = 0.0;
  double sum = 0.0;
  double near = 1.0;
  for (std::size_t k = 0; k < run.size(); ++k) {
    if (run.force_N[k] < threshold) continue;
    const double position = position_of(stiffness, run.force_N[k], near);
    if (position < 0.0) continue;
    near = position;
    double gradient[2];
    const double slope = stiffness.evaluate(position, gradient).slope_N_rad;
    weight += slope * slope;
    sum += slope * slope * (position - travel[k]);
  }
  // Never in contact: as near to it as the travel allows.
  const double position = weight > 0.0 ? sum / weight : -std::max(0.0, largest(travel));
  return {
      std::clamp(position, -0.5 * kDivergedPosition_rad, 0.5 * kDivergedPosition_rad),
      std::clamp(run.velocity_rad_s.front(), -0.5 * kDivergedVelocity_rad_s, 0.5 * kDivergedVelocity_rad_s)};
}

ParameterVector equation_error_start(std::span<const Run> runs, const BrakeParameters& fallback,
                                     const SensorNoise& noise) {
  ParameterVector theta = fallback.theta;
  std::vector<double> positions;
  for (const Run& run : runs) positions.push_back(initial_state_guess(run, theta)[0]);
  fit_stiffness(runs, positions, theta);
  fit_friction(sliding_windows(runs, fallback.fixed, 2.0 * noise.velocity_rad_s), theta);
  return theta;
}

}  // namespace clampd::identify
