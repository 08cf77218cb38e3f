#pragma once

#include <concepts>

namespace clampd {

/// A clamp force law F(x) with kParameters identified parameters, constructed from a pointer to them.
/// `force_N(x)`; `evaluate(x, gradient)` also gives dF/dx (N/rad) and dF/dparameter into
/// gradient[kParameters].
template <class S>
concept StiffnessLaw = requires(const S law, double x, double* gradient) {
  { S::kParameters } -> std::convertible_to<int>;
  { law.force_N(x) } -> std::same_as<double>;
  { law.evaluate(x, gradient).force_N } -> std::convertible_to<double>;
  { law.evaluate(x, gradient).slope_N_rad } -> std::convertible_to<double>;
}
&&std::constructible_from<S, const double*>;

struct ForcePoint {
  double force_N;
  double slope_N_rad;
};

/// Equation (3): F = k1 x^3 + k2 x^2 in contact (x >= 0), none in the clearance (x < 0). x is the motor angle
/// in rad from the contact point. With k1 < 0 the polynomial turns over at x = -2 k2 / (3 k1), beyond any
/// real brake.
struct PolynomialStiffness {
  static constexpr int kParameters = 2;

  double cubic_N_rad3;
  double quadratic_N_rad2;

  /// parameters: k1, k2.
  explicit PolynomialStiffness(const double* parameters)
      : cubic_N_rad3(parameters[0]), quadratic_N_rad2(parameters[1]) {}

  double force_N(double x) const noexcept {
    if (x < 0.0) return 0.0;
    return x * x * (cubic_N_rad3 * x + quadratic_N_rad2);
  }

  ForcePoint evaluate(double x, double* gradient) const noexcept {
    if (x < 0.0) {
      gradient[0] = gradient[1] = 0.0;
      return {0.0, 0.0};
    }
    const double square = x * x;
    gradient[0] = square * x;
    gradient[1] = square;
    return {square * (cubic_N_rad3 * x + quadratic_N_rad2),
            x * (3.0 * cubic_N_rad3 * x + 2.0 * quadratic_N_rad2)};
  }
};
static_assert(StiffnessLaw<PolynomialStiffness>);

}  // namespace clampd
