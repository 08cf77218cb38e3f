#include "clampd/identify/kalman.hpp"

#include <cmath>
#include <cstdio>

#include <gtest/gtest.h>
#include <Eigen/Dense>

#include "support/excitation.hpp"
#include "tests/identify/noisy_brake.hpp"

namespace clampd {
namespace {

const NoiseLevels kNoise{{30.0, 0.3}, 0.0142};

support::NoisyRun strong_run(unsigned seed, const NoiseLevels& noise = kNoise) {
  std::mt19937_64 generator(seed);
  return support::run_reference_brake({}, BrakeState::Zero(), support::strong_torque(), noise, generator);
}

TEST(KalmanViews, MoreReadingsMakeNarrowerBands) {
  const auto strong = strong_run(1);
  const KalmanViews views = kalman_views(strong.run, {}, BrakeState::Zero(), kNoise);
  std::size_t narrower = 0;
  for (std::size_t k = 0; k < strong.run.size(); ++k) {
    for (const auto signal : {&BandedRun::position_rad, &BandedRun::velocity_rad_s}) {
      const double one_step = (views.one_step.*signal).sd[k];
      const double filtered = (views.filtered.*signal).sd[k];
      const double smoothed = (views.smoothed.*signal).sd[k];
      ASSERT_GE(smoothed, 0.0) << k;
      ASSERT_LE(smoothed, filtered * (1.0 + 1e-6) + 1e-12) << k;
      ASSERT_LE(filtered, one_step * (1.0 + 1e-6) + 1e-12) << k;
      narrower += smoothed < 0.9 * one_step;
    }
  }
  EXPECT_GT(narrower, strong.run.size());
  EXPECT_EQ(views.smoothed.force_N.mean.back(), views.filtered.force_N.mean.back());
  EXPECT_EQ(views.smoothed.force_N.sd.back(), views.filtered.force_N.sd.back());
}

/// Mean squared error over the band's variance, rows where the state is known exactly left out.
struct Calibration {
  double sum = 0.0;
  double rows = 0.0;
  double error_square = 0.0;

  void add(const Band& band, const std::vector<double>& truth, double smallest_sd) {
    for (std::size_t k = 0; k < truth.size(); ++k) {
      const double error = band.mean[k] - truth[k];
      error_square += error * error;
      if (band.sd[k] < smallest_sd) continue;
      sum += error * error / (band.sd[k] * band.sd[k]);
      rows += 1.0;
    }
  }
  double per_row() const { return sum / rows; }
};

TEST(KalmanViews, BandsHoldTheTruthAsOftenAsTheySay) {
  // [view][position, velocity, force]
  Calibration calibration[3][3];
  constexpr int kSeeds = 200;
  for (unsigned seed = 0; seed < kSeeds; ++seed) {
    const auto strong = strong_run(100 + seed);
    const KalmanViews views = kalman_views(strong.run, {}, BrakeState::Zero(), kNoise);
    const BandedRun* const each[3] = {&views.one_step, &views.filtered, &views.smoothed};
    for (int i = 0; i < 3; ++i) {
      calibration[i][0].add(each[i]->position_rad, strong.truth.position_rad, 1e-4);
      calibration[i][1].add(each[i]->velocity_rad_s, strong.truth.velocity_rad_s, 1e-3);
      calibration[i][2].add(each[i]->force_N, strong.truth.force_N, 0.1);
    }
  }
  const char* const names[3] = {"one-step", "filtered", "smoothed"};
  for (int i = 0; i < 3; ++i) {
    std::printf("%s: squared error over variance %.3f position, %.3f velocity, %.3f force\n", names[i],
                calibration[i][0].per_row(), calibration[i][1].per_row(), calibration[i][2].per_row());
    for (int j = 0; j < 3; ++j) {
      // Linear bands are a little too narrow around stops, and most so before the readings that follow.
      EXPECT_NEAR(calibration[i][j].per_row(), 1.0, i == 2 ? 0.15 : 0.25) << names[i] << ' ' << j;
      EXPECT_GT(calibration[i][j].rows, 0.5 * kSeeds * 300) << names[i] << ' ' << j;
      if (i > 0) {
        EXPECT_LT(calibration[i][j].error_square, calibration[i - 1][j].error_square);
      }
    }
  }
}

/// Where noise is so small that the model is linear in it, the smoother is generalised least squares over all
/// of the run's torques.
TEST(KalmanViews, SmootherIsBatchLeastSquares) {
  const NoiseLevels tiny{{30e-4, 0.3e-4}, 0.0142e-4};
  constexpr std::size_t kRows = 40;
  const BrakeState initial(18.0, 40.0);
  const std::vector<double> torque(kRows, 0.9);
  std::mt19937_64 generator(5);
  const clampd::Run run = support::run_reference_brake({}, initial, torque, tiny, generator, 2e-6).run;
  const KalmanViews views = kalman_views(run, {}, initial, tiny);

  const auto rows = static_cast<Eigen::Index>(kRows);
  Simulation nominal(kRows);
  simulate({}, initial, {torque}, nominal);
  Eigen::VectorXd residual(2 * rows);
  Eigen::MatrixXd readings = Eigen::MatrixXd::Zero(2 * rows, rows);  // by torque
  Eigen::MatrixXd states = Eigen::MatrixXd::Zero(2 * rows, rows);    // position, velocity
  Eigen::VectorXd variance(2 * rows);
  constexpr double kStep_Nm = 1e-5;
  Simulation high(kRows);
  Simulation low(kRows);
  for (Eigen::Index j = 0; j < rows; ++j) {
    std::vector<double> up = torque;
    std::vector<double> down = torque;
    up[static_cast<std::size_t>(j)] += kStep_Nm;
    down[static_cast<std::size_t>(j)] -= kStep_Nm;
    simulate({}, initial, {up}, high);
    simulate({}, initial, {down}, low);
    for (Eigen::Index k = 0; k < rows; ++k) {
      const auto at = static_cast<std::size_t>(k);
      readings(2 * k, j) = (high.force_N[at] - low.force_N[at]) / (2.0 * kStep_Nm);
      readings(2 * k + 1, j) = (high.velocity_rad_s[at] - low.velocity_rad_s[at]) / (2.0 * kStep_Nm);
      states(2 * k, j) = (high.position_rad[at] - low.position_rad[at]) / (2.0 * kStep_Nm);
      states(2 * k + 1, j) = readings(2 * k + 1, j);
    }
  }
  for (Eigen::Index k = 0; k < rows; ++k) {
    const auto at = static_cast<std::size_t>(k);
    residual.segment<2>(2 * k) << run.force_N[at] - nominal.force_N[at],
        run.velocity_rad_s[at] - nominal.velocity_rad_s[at];
    variance.segment<2>(2 * k) << std::pow(tiny.sensors.force_N, 2), std::pow(tiny.sensors.velocity_rad_s, 2);
  }
  const double q = tiny.torque_Nm * tiny.torque_Nm;
  Eigen::MatrixXd covariance = q * readings * readings.transpose();
  covariance.diagonal() += variance;
  const Eigen::MatrixXd gain = q * states * readings.transpose() * covariance.inverse();
  const Eigen::VectorXd correction = gain * residual;
  const Eigen::MatrixXd left = q * states * states.transpose() - gain * q * readings * states.transpose();
  for (Eigen::Index k = 0; k < rows; ++k) {
    const auto at = static_cast<std::size_t>(k);
    const double position_sd = std::sqrt(std::max(0.0, left(2 * k, 2 * k)));
    const double velocity_sd = std::sqrt(std::max(0.0, left(2 * k + 1, 2 * k + 1)));
    EXPECT_NEAR(views.smoothed.position_rad.mean[at], nominal.position_rad[at] + correction[2 * k],
                0.02 * position_sd + 1e-10)
        << k;
    EXPECT_NEAR(views.smoothed.velocity_rad_s.mean[at], nominal.velocity_rad_s[at] + correction[2 * k + 1],
                0.02 * velocity_sd + 1e-10)
        << k;
    EXPECT_NEAR(views.smoothed.position_rad.sd[at], position_sd, 0.01 * position_sd + 1e-10) << k;
    EXPECT_NEAR(views.smoothed.velocity_rad_s.sd[at], velocity_sd, 0.01 * velocity_sd + 1e-10) << k;
  }
}

TEST(FreeRun, ItsBandIsTheSpreadOfBrakesWithTorqueNoise) {
  constexpr std::size_t kRows = 300;
  constexpr int kBrakes = 400;
  clampd::Run run;
  std::vector<double> velocity(kRows, 0.0);
  std::vector<double> force(kRows, 0.0);
  BandedRun free;
  for (int i = 0; i < kBrakes; ++i) {
    const auto strong = strong_run(1000 + static_cast<unsigned>(i));
    if (i == 0) free = free_run(strong.run, {}, BrakeState::Zero(), kNoise);
    for (std::size_t k = 0; k < kRows; ++k) {
      velocity[k] += std::pow(strong.truth.velocity_rad_s[k] - free.velocity_rad_s.mean[k], 2) / kBrakes;
      force[k] += std::pow(strong.truth.force_N[k] - free.force_N.mean[k], 2) / kBrakes;
    }
  }
  EXPECT_EQ(free.force_N.sd[0], 0.0);
  double sum_velocity = 0.0;
  double sum_force = 0.0;
  double rows = 0.0;
  for (std::size_t k = 1; k < kRows; ++k) {
    // Where the brake stops or starts, linear bands mean little; the most of the run it moves.
    if (std::abs(free.velocity_rad_s.mean[k]) < 5.0 || free.force_N.sd[k] < 0.1) continue;
    sum_velocity += std::log(std::sqrt(velocity[k]) / free.velocity_rad_s.sd[k]);
    sum_force += std::log(std::sqrt(force[k]) / free.force_N.sd[k]);
    rows += 1.0;
  }
  std::printf("spread over band, geometric mean of %.0f rows: %.3f velocity, %.3f force\n", rows,
              std::exp(sum_velocity / rows), std::exp(sum_force / rows));
  EXPECT_GT(rows, 100.0);
  EXPECT_NEAR(std::exp(sum_velocity / rows), 1.0, 0.15);
  EXPECT_NEAR(std::exp(sum_force / rows), 1.0, 0.15);
}

TEST(KalmanViews, WithoutTorqueNoiseTheFilterIsTheSimulation) {
  NoiseLevels exact = kNoise;
  exact.torque_Nm = 0.0;
  const auto strong = strong_run(7);
  Simulation simulation(strong.run.size());
  simulate({}, BrakeState::Zero(), excitation_of(strong.run), simulation);
  const KalmanViews views = kalman_views(strong.run, {}, BrakeState::Zero(), exact);
  const BandedRun free = free_run(strong.run, {}, BrakeState::Zero(), exact);
  for (const BandedRun* view : {&views.one_step, &views.filtered, &views.smoothed, &free}) {
    for (std::size_t k = 0; k < strong.run.size(); ++k) {
      ASSERT_NEAR(view->position_rad.mean[k], simulation.position_rad[k], 1e-9) << k;
      ASSERT_NEAR(view->velocity_rad_s.mean[k], simulation.velocity_rad_s[k], 1e-7) << k;
      ASSERT_NEAR(view->force_N.mean[k], simulation.force_N[k], 1e-5) << k;
      ASSERT_EQ(view->force_N.sd[k], 0.0) << k;
      ASSERT_EQ(view->velocity_rad_s.sd[k], 0.0) << k;
    }
  }
}

TEST(KalmanViews, FollowsALoadedCreepThatTheSimulationCannot) {
  // Self-locking: torque noise lets the brake creep on where the free run has stopped.
  const auto strong = strong_run(9);
  BrakeParameters heavy;
  heavy.theta[TC] *= 1.3;
  const KalmanViews views = kalman_views(strong.run, heavy, BrakeState::Zero(), kNoise);
  const BandedRun free = free_run(strong.run, heavy, BrakeState::Zero(), kNoise);
  double filter = 0.0;
  double open_loop = 0.0;
  for (std::size_t k = 0; k < strong.run.size(); ++k) {
    filter += std::pow(views.one_step.force_N.mean[k] - strong.truth.force_N[k], 2);
    open_loop += std::pow(free.force_N.mean[k] - strong.truth.force_N[k], 2);
  }
  EXPECT_LT(filter, 0.05 * open_loop);
}

TEST(KalmanViews, ADivergingRunIsNotANumberAndDoesNotCrash) {
  clampd::Run run;
  for (std::size_t k = 0; k < 300; ++k) {
    run.time_s.push_back(1e-3 * static_cast<double>(k));
    run.torque_Nm.push_back(3.0);
    run.force_N.push_back(0.0);
    run.velocity_rad_s.push_back(0.0);
  }
  const BrakeState beyond(60.0, 200.0);
  const BandedRun free = free_run(run, {}, beyond, kNoise);
  EXPECT_TRUE(std::isnan(free.force_N.mean.back()));
  EXPECT_TRUE(std::isnan(free.force_N.sd.back()));
  run.force_N[20] = 1e15;
  run.velocity_rad_s[20] = -1e15;
  const KalmanViews views = kalman_views(run, {}, BrakeState::Zero(), kNoise);
  EXPECT_EQ(views.smoothed.force_N.mean.size(), run.size());
  EXPECT_TRUE(std::isnan(views.one_step.force_N.mean.back()));
  EXPECT_TRUE(std::isnan(views.smoothed.velocity_rad_s.sd.back()));
  EXPECT_TRUE(kalman_views(clampd::Run{}, {}, beyond, kNoise).one_step.force_N.mean.empty());
}

}  // namespace
}  // namespace clampd
