#include "src/identify/joint_normal.hpp"

#include <Eigen/Cholesky>
#include <Eigen/LU>

namespace clampd::identify {

void add_initial_state_prior(const Eigen::Vector2d& distance, Normal& normal) noexcept {
  const double deviation[2] = {kInitialPositionPrior_rad, kInitialVelocityPrior_rad_s};
  for (int i = 0; i < 2; ++i) {
    const double weight = 1.0 / (deviation[i] * deviation[i]);
    normal(kTheta + i, kTheta + i) += weight;
    normal(kTheta + i, kDataColumn) += weight * distance[i];
    normal(kDataColumn, kTheta + i) += weight * distance[i];
    normal(kDataColumn, kDataColumn) += weight * distance[i] * distance[i];
  }
}

Eigen::Matrix<double, kTheta, 2> elimination(const Normal& normal) noexcept {
  return normal.block<kTheta, 2>(0, kTheta) * normal.block<2, 2>(kTheta, kTheta).inverse();
}

ParameterVector step_to_minimum(const JointNormal& joint) noexcept {
  return -joint.information.ldlt().solve(joint.gradient);
}

JointNormal eliminate_initial_states(std::span<const Normal> normals, const Held& held) noexcept {
  JointNormal joint;
  for (const Normal& normal : normals) {
    const Eigen::Matrix<double, kTheta, 2> coefficients = elimination(normal);
    const Eigen::Vector2d initial = normal.block<2, 1>(kTheta, kDataColumn);
    joint.information +=
        normal.topLeftCorner<kTheta, kTheta>() - coefficients * normal.block<2, kTheta>(kTheta, 0);
    joint.gradient += normal.block<kTheta, 1>(0, kDataColumn) - coefficients * initial;
    const Eigen::Matrix2d block = normal.block<2, 2>(kTheta, kTheta);
    joint.sum_of_squares += normal(kDataColumn, kDataColumn) - initial.dot(block.inverse() * initial);
    joint.log_determinant += std::log(block.determinant());
  }
  for (int i = 0; i < kTheta; ++i) {
    if (!held[static_cast<std::size_t>(i)]) continue;
    joint.information.row(i).setZero();
    joint.information.col(i).setZero();
    joint.information(i, i) = 1.0;
    joint.gradient[i] = 0.0;
  }
  return joint;
}

}  // namespace clampd::identify
