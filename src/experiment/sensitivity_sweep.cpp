#include "sensitivity_sweep.hpp"

#include <algorithm>
#include <cmath>

#include "clampd/base/assert.hpp"

namespace clampd {

namespace {

constexpr double kStep_s = kMaxStep_s;

/// Steps of the differences through an event, where no closed form of the second derivatives is kept.
constexpr double kPositionStep_rad = 3e-6;
constexpr double kVelocityStep_rad_s = 1e-4;
constexpr double kTorqueStep_Nm = 1e-5;

}  // namespace

/// Acceleration while sliding, with all first and second derivatives that the sweeps need; columns in SI.
struct SensitivitySweep::Point {
  double acceleration;
  double by_position;
  double by_velocity;
  double by_position_twice;
  double by_position_velocity;
  double by_velocity_twice;
  Curved forcing;              ///< by parameter, by torque
  Curved forcing_by_position;  ///< their derivatives
  Curved forcing_by_velocity;
};

/// Derivatives of the functional by the state and by the curved columns at a sample, and by the torque of the
/// step before it.
struct SensitivitySweep::Adjoint {
  double position = 0.0;
  double velocity = 0.0;
  double torque = 0.0;
  Curved position_columns = Curved::Zero();
  Curved velocity_columns = Curved::Zero();
};

SensitivitySweep::SensitivitySweep(const BrakeParameters& brake, const SensorNoise& noise,
                                   std::size_t samples, std::size_t block_samples)
    : model_(paper_brake(brake)),
      inverse_inertia_(1.0 / brake.fixed.inertia_kg_m2),
      ratio_m_rad_(brake.fixed.ratio_m_rad),
      noise_(noise),
      samples_(samples),
      block_samples_(block_samples),
      steps_(samples),
      block_ends_(samples / block_samples),
      force_N_(samples),
      velocity_rad_s_(samples),
      sensitivity_(static_cast<Eigen::Index>(2 * samples), kTorque) {
  scale_.head<kTorque>() = nominal_parameters().array();
  scale_[kTorque] = 1.0;
  std::copy(brake.theta.begin(), brake.theta.end(), theta_.begin());
}

SensitivitySweep::Point SensitivitySweep::point_at(double position, double velocity, double torque_Nm,
                                                   double sign) const {
  const double x = position > 0.0 ? position : 0.0;
  const double force = x * x * (theta_[k1] * x + theta_[k2]);
  const double slope = x * (3.0 * theta_[k1] * x + 2.0 * theta_[k2]);
  const double curvature = position > 0.0 ? 6.0 * theta_[k1] * x + 2.0 * theta_[k2] : 0.0;
  // Friction (4): Tv v + sign (TC + (Ts - TC) s), s = ws^2 / (ws^2 + v^2).
  const double excess = theta_[Ts0] + theta_[mus] * force - theta_[TC];
  const double squared = theta_[ws] * theta_[ws];
  const double s = squared / (squared + velocity * velocity);
  const double s_v = -2.0 * velocity * s * s / squared;
  const double s_vv = (8.0 * velocity * velocity * s / squared - 2.0) * s * s / squared;
  const double s_w = 2.0 * velocity * velocity * s * s / (squared * theta_[ws]);
  const double s_wv = 4.0 * velocity * s * (s + velocity * s_v) / (squared * theta_[ws]);
  const double gain = inverse_inertia_;
  const double directed = sign * gain;
  const double by_force = -gain * ratio_m_rad_ - directed * theta_[mus] * s;
  const double by_force_velocity = -directed * theta_[mus] * s_v;

  Point point;
  point.acceleration = gain * (torque_Nm - ratio_m_rad_ * force - theta_[Tv] * velocity) -
                       directed * (theta_[TC] + excess * s);
  point.by_position = by_force * slope;
  point.by_velocity = -gain * theta_[Tv] - directed * excess * s_v;
  point.by_position_twice = by_force * curvature;
  point.by_position_velocity = by_force_velocity * slope;
  point.by_velocity_twice = -directed * excess * s_vv;
  point.forcing << by_force * x * x * x, by_force * x * x, -directed * (1.0 - s), -directed * s,
      -gain * velocity, -directed * s * force, -directed * excess * s_w, gain;
  point.forcing_by_position << by_force * 3.0 * x * x, by_force * 2.0 * x, 0.0, 0.0, 0.0,
      -directed * s * slope, -directed * theta_[mus] * slope * s_w, 0.0;
  point.forcing_by_velocity << by_force_velocity * x * x * x, by_force_velocity * x * x, directed * s_v,
      -directed * s_v, -gain, -directed * s_v * force, -directed * excess * s_wv, 0.0;
  point.forcing *= scale_;
  point.forcing_by_position *= scale_;
  point.forcing_by_velocity *= scale_;
  return point;
}

BrakeState SensitivitySweep::slide(const Step& step, Columns& position, Columns& velocity) const {
  constexpr double kHalf = 0.5 * kStep_s;
  const Columns& p = step.position;
  const Columns& v = step.velocity;
  Columns stage_p = p;
  Columns stage_v = v;
  Columns rate{};
  Columns sum_p{};
  Columns sum_v{};
  double forcing[kColumns] = {};
  forcing[kRestarted + 2] = inverse_inertia_;
  const auto stage = [&](double at, double speed, double weight) {
    AccelerationPoint<PaperBrake::kParameters> point = model_.linearise(at, speed, step.torque_Nm, step.sign);
    for (int i = 0; i < kTorque; ++i) forcing[i] = point.by_parameter[i] * scale_[i];
    forcing[kTorque] = point.by_torque;
    for (std::size_t i = 0; i < stage_p.size(); ++i) {
      rate[i] = point.by_position * stage_p[i] + point.by_velocity * stage_v[i] + forcing[i];
      sum_p[i] += weight * stage_v[i];
      sum_v[i] += weight * rate[i];
    }
    return point.value;
  };
  const auto next = [&](double length) {
    for (std::size_t i = 0; i < stage_p.size(); ++i) {
      stage_p[i] = p[i] + length * stage_v[i];
      stage_v[i] = v[i] + length * rate[i];
    }
  };
  const double p0 = step.state[0];
  const double v0 = step.state[1];
  const double a0 = stage(p0, v0, 1.0);
  next(kHalf);
  const double v1 = v0 + kHalf * a0;
  const double a1 = stage(p0 + kHalf * v0, v1, 2.0);
  next(kHalf);
  const double v2 = v0 + kHalf * a1;
  const double a2 = stage(p0 + kHalf * v1, v2, 2.0);
  next(kStep_s);
  const double v3 = v0 + kStep_s * a2;
  const double a3 = stage(p0 + kStep_s * v2, v3, 1.0);
  for (std::size_t i = 0; i < stage_p.size(); ++i) {
    position[i] = p[i] + kStep_s / 6.0 * sum_p[i];
    velocity[i] = v[i] + kStep_s / 6.0 * sum_v[i];
  }
  return {p0 + kStep_s / 6.0 * (v0 + 2.0 * (v1 + v2) + v3), v0 + kStep_s / 6.0 * (a0 + 2.0 * (a1 + a2) + a3)};
}

SensitivitySweep::Linear SensitivitySweep::linearise(const BrakeState& state, double torque_Nm,
                                                     BrakeState* reached) const {
  LinearStep<PaperBrake::kParameters> step;
  const BrakeState end = linearise_step(model_, state, torque_Nm, kStep_s, step);
  if (reached != nullptr) *reached = end;
  Linear linear;
  linear.transition = step.transition;
  linear.input.leftCols<kTorque>() = step.by_parameter * scale_.head<kTorque>().matrix().asDiagonal();
  linear.input.col(kTorque) = step.by_torque;
  return linear;
}

void SensitivitySweep::record(std::size_t row) {
  const Step& step = steps_[row];
  double by_stiffness[PolynomialStiffness::kParameters];
  const ForcePoint force = model_.stiffness().evaluate(step.state[0], by_stiffness);
  force_N_[row] = force.force_N;
  velocity_rad_s_[row] = step.state[1];
  const auto at = static_cast<Eigen::Index>(2 * row);
  for (int i = 0; i < kTorque; ++i) {
    const auto column = static_cast<std::size_t>(i);
    const double direct = i < PolynomialStiffness::kParameters ? by_stiffness[i] * scale_[i] : 0.0;
    sensitivity_(at, i) = (force.slope_N_rad * step.position[column] + direct) / noise_.force_N;
    sensitivity_(at + 1, i) = step.velocity[column] / noise_.velocity_rad_s;
  }
}

bool SensitivitySweep::forward(const BrakeState& initial, std::span<const double> block_torque_Nm) {
  CLAMPD_ASSERT(block_torque_Nm.size() * block_samples_ == samples_);
  Step* step = &steps_[0];
  step->state = initial;
  step->position.fill(0.0);
  step->velocity.fill(0.0);
  record(0);
  for (std::size_t row = 0; row + 1 < samples_; ++row) {
    if (row % block_samples_ == 0) {
      if (row > 0) block_ends_[row / block_samples_ - 1] = {step->position, step->velocity};
      for (auto* columns : {&step->position, &step->velocity})
        std::fill(columns->begin() + kRestarted, columns->end(), 0.0);
      step->position[kRestarted] = 1.0;
      step->velocity[kRestarted + 1] = 1.0;
    }
    step->torque_Nm = block_torque_Nm[row / block_samples_];
    Step& after = steps_[row + 1];
    step->sign = step->state[1] != 0.0 ? std::copysign(1.0, step->state[1])
                                       : model_.breakaway_sign(step->state[0], step->torque_Nm);
    if (step->sign == 0.0) {
      step->motion = Motion::Stuck;
      after.state = step->state;
      after.position = step->position;
      after.velocity.fill(0.0);
    } else {
      step->motion = Motion::Sliding;
      after.state = slide(*step, after.position, after.velocity);
      if (step->sign * after.state[1] < 0.0) {
        step->motion = Motion::Event;
        const Linear linear = linearise(step->state, step->torque_Nm, &after.state);
        for (std::size_t i = 0; i < static_cast<std::size_t>(kColumns); ++i) {
          Eigen::Vector2d column = linear.transition * Eigen::Vector2d(step->position[i], step->velocity[i]);
          if (i < static_cast<std::size_t>(kCurved)) column += linear.input.col(static_cast<Eigen::Index>(i));
          if (i == static_cast<std::size_t>(kRestarted + 2)) column += linear.input.col(kTorque);
          after.position[i] = column[0];
          after.velocity[i] = column[1];
        }
      }
      if (!is_bounded(after.state)) return false;
    }
    step = &after;
    record(row + 1);
  }
  return true;
}

void SensitivitySweep::back_slide(const Step& step, Adjoint& adjoint) const {
  // The stages once more, then the Runge-Kutta step of state and columns in reverse.
  constexpr double kLength[4] = {0.0, 0.5 * kStep_s, 0.5 * kStep_s, kStep_s};
  constexpr double kWeight[4] = {kStep_s / 6.0, kStep_s / 3.0, kStep_s / 3.0, kStep_s / 6.0};
  const Eigen::Map<const Curved> p(step.position.data());
  const Eigen::Map<const Curved> v(step.velocity.data());
  Point point[4];
  double speed[4];
  Curved stage_p[4];
  Curved stage_v[4];
  Curved rate;
  for (int i = 0; i < 4; ++i) {
    const double position = i == 0 ? step.state[0] : step.state[0] + kLength[i] * speed[i - 1];
    speed[i] = i == 0 ? step.state[1] : step.state[1] + kLength[i] * point[i - 1].acceleration;
    point[i] = point_at(position, speed[i], step.torque_Nm, step.sign);
    if (i == 0) {
      stage_p[i] = p;
      stage_v[i] = v;
    } else {
      stage_p[i] = p + kLength[i] * stage_v[i - 1];
      stage_v[i] = v + kLength[i] * rate;
    }
    rate = point[i].by_position * stage_p[i] + point[i].by_velocity * stage_v[i] + point[i].forcing;
  }

  const Adjoint after = adjoint;
  adjoint.torque = 0.0;
  double later_position = 0.0;  // adjoints of the stage that follows: its position, velocity and columns
  double later_velocity = 0.0;
  Curved later_p = Curved::Zero();
  Curved later_v = Curved::Zero();
  for (int i = 3; i >= 0; --i) {
    const double length = i < 3 ? kLength[i + 1] : 0.0;
    const double of_acceleration = kWeight[i] * after.velocity + length * later_velocity;
    const Curved of_rate = kWeight[i] * after.velocity_columns + length * later_v;
    const double of_by_position = (of_rate * stage_p[i]).sum();
    const double of_by_velocity = (of_rate * stage_v[i]).sum();
    const double position =
        of_acceleration * point[i].by_position + of_by_position * point[i].by_position_twice +
        of_by_velocity * point[i].by_position_velocity + (of_rate * point[i].forcing_by_position).sum();
    const double velocity =
        kWeight[i] * after.position + length * later_position + of_acceleration * point[i].by_velocity +
        of_by_position * point[i].by_position_velocity + of_by_velocity * point[i].by_velocity_twice +
        (of_rate * point[i].forcing_by_velocity).sum();
    adjoint.torque += of_acceleration * inverse_inertia_;
    later_v =
        (kWeight[i] * after.position_columns + length * later_p + point[i].by_velocity * of_rate).eval();
    later_p = point[i].by_position * of_rate;
    later_position = position;
    later_velocity = velocity;
    adjoint.position += position;
    adjoint.velocity += velocity;
    adjoint.position_columns += later_p;
    adjoint.velocity_columns += later_v;
  }
}

void SensitivitySweep::back_event(const Step& step, Adjoint& adjoint) const {
  const Adjoint after = adjoint;
  const Linear here = linearise(step.state, step.torque_Nm, nullptr);
  // The functional's part in this step, for fixed columns before it and fixed adjoints behind it.
  const auto weigh = [&](const BrakeState& state, double torque_Nm) {
    const Linear linear = linearise(state, torque_Nm, nullptr);
    double sum = 0.0;
    for (int i = 0; i < kCurved; ++i) {
      const auto column = static_cast<std::size_t>(i);
      const Eigen::Vector2d reached =
          linear.transition * Eigen::Vector2d(step.position[column], step.velocity[column]) +
          linear.input.col(i);
      sum += after.position_columns[i] * reached[0] + after.velocity_columns[i] * reached[1];
    }
    return sum;
  };
  const auto slope = [&](const BrakeState& direction, double torque_Nm, double length) {
    return (weigh(step.state + direction, step.torque_Nm + torque_Nm) -
            weigh(step.state - direction, step.torque_Nm - torque_Nm)) /
           (2.0 * length);
  };
  adjoint.position = here.transition(0, 0) * after.position + here.transition(1, 0) * after.velocity +
                     slope({kPositionStep_rad, 0.0}, 0.0, kPositionStep_rad);
  adjoint.velocity = here.transition(0, 1) * after.position + here.transition(1, 1) * after.velocity;
  // Of a start at rest the velocity is no variable: nothing before moves it.
  if (step.state[1] != 0.0) {
    const double length = std::min(kVelocityStep_rad_s, 0.5 * std::abs(step.state[1]));
    adjoint.velocity += slope({0.0, length}, 0.0, length);
  }
  adjoint.torque = here.input(0, kTorque) * after.position + here.input(1, kTorque) * after.velocity +
                   slope(BrakeState::Zero(), kTorqueStep_Nm, kTorqueStep_Nm);
  for (int i = 0; i < kCurved; ++i) {
    adjoint.position_columns[i] =
        here.transition(0, 0) * after.position_columns[i] + here.transition(1, 0) * after.velocity_columns[i];
    adjoint.velocity_columns[i] =
        here.transition(0, 1) * after.position_columns[i] + here.transition(1, 1) * after.velocity_columns[i];
  }
}

void SensitivitySweep::back_step(const Step& step, Adjoint& adjoint) const {
  switch (step.motion) {
    case Motion::Stuck:
      adjoint.velocity = adjoint.torque = 0.0;
      adjoint.velocity_columns.setZero();
      break;
    case Motion::Sliding:
      back_slide(step, adjoint);
      break;
    case Motion::Event:
      back_event(step, adjoint);
      break;
  }
}

void SensitivitySweep::backward(const Rows& weights, const AmplificationTerm& term,
                                std::span<double> gradient) const {
  Adjoint adjoint;
  for (std::size_t row = samples_; row-- > 1;) {
    const Step& sample = steps_[row];
    const double x = std::max(0.0, sample.state[0]);
    const double slope = x * (3.0 * theta_[k1] * x + 2.0 * theta_[k2]);
    const double curvature = sample.state[0] > 0.0 ? 6.0 * theta_[k1] * x + 2.0 * theta_[k2] : 0.0;
    const auto at = static_cast<Eigen::Index>(2 * row);
    for (int i = 0; i < kTorque; ++i) {
      const double force_weight = weights(at, i) / noise_.force_N;
      adjoint.position_columns[i] += force_weight * slope;
      adjoint.position += force_weight * curvature * sample.position[static_cast<std::size_t>(i)];
      adjoint.velocity_columns[i] += weights(at + 1, i) / noise_.velocity_rad_s;
    }
    adjoint.position +=
        (weights(at, k1) * scale_[k1] * 3.0 * x * x + weights(at, k2) * scale_[k2] * 2.0 * x) /
        noise_.force_N;
    if (row == term.row) adjoint.velocity_columns[kTorque] += term.weight;
    back_step(steps_[row - 1], adjoint);
    gradient[(row - 1) / block_samples_] += adjoint.torque;
  }
}

void SensitivitySweep::backward_amplification(const AmplificationTerm& term,
                                              std::span<double> gradient) const {
  Adjoint adjoint;
  adjoint.velocity_columns[kTorque] = term.weight;
  for (std::size_t row = term.row; row > 0; --row) {
    back_step(steps_[row - 1], adjoint);
    gradient[(row - 1) / block_samples_] += adjoint.torque;
  }
}

void SensitivitySweep::output_gradients(std::size_t row, std::span<double> force,
                                        std::span<double> velocity) const {
  std::fill(force.begin(), force.end(), 0.0);
  std::fill(velocity.begin(), velocity.end(), 0.0);
  if (row == 0) return;
  // Within the row's own block from the columns restarted there, through earlier blocks by their ends.
  Eigen::RowVector2d by_position(1.0, 0.0);
  Eigen::RowVector2d by_velocity(0.0, 1.0);
  const double slope = [&] {
    double unused[PolynomialStiffness::kParameters];
    return model_.stiffness().evaluate(steps_[row].state[0], unused).slope_N_rad;
  }();
  std::size_t end = row;
  while (end > 0) {
    const std::size_t block = (end - 1) / block_samples_;
    const bool restarted = end % block_samples_ == 0;
    const Columns& p = restarted ? block_ends_[block].position : steps_[end].position;
    const Columns& v = restarted ? block_ends_[block].velocity : steps_[end].velocity;
    Eigen::Matrix2d transition;
    transition << p[kRestarted], p[kRestarted + 1], v[kRestarted], v[kRestarted + 1];
    const Eigen::Vector2d torque(p[kRestarted + 2], v[kRestarted + 2]);
    force[block] = slope * by_position.dot(torque);
    velocity[block] = by_velocity.dot(torque);
    by_position = (by_position * transition).eval();
    by_velocity = (by_velocity * transition).eval();
    end = block * block_samples_;
  }
}

}  // namespace clampd
