#include "src/identify/joint_normal.hpp"

#include <Eigen/Cholesky>
#include <Eigen/LU>

namespace clampd::identify {

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
