// Many whole checks: are the reported uncertainties true?

#include <cmath>
#include <string>

#include <gtest/gtest.h>

#include "tools/embedded_check.hpp"

namespace clampd::assembly {
namespace {

/// Guard bands rest on the reported standard deviations: over many brakes, the errors in units of them must
/// be of unit size. The noise of each brake is its own; the torque reading is noisy, so that the Cramér-Rao
/// figure alone would fail.
TEST(EmbeddedStation, ReportedUncertaintyIsHonest) {
  constexpr int kChecks = 24;
  const ParameterVector nominal = nominal_parameters();
  ParameterVector squares = ParameterVector::Zero();
  for (int i = 0; i < kChecks; ++i) {
    sim::PlantConfiguration brake = plant(1000 + static_cast<std::uint64_t>(i));
    brake.sensors.torque_noise_Nm = 0.01;
    for (Eigen::Index p = 0; p < nominal.size(); ++p)
      brake.brake.theta[p] *=
          1.0 + 0.1 * std::sin(1.7 * static_cast<double>(i) + 2.3 * static_cast<double>(p));
    const CheckRecord record = check(brake, 20);
    ASSERT_EQ(record.parameters.size(), kParameterCount) << record.reason;
    for (Eigen::Index p = 0; p < nominal.size(); ++p) {
      const ParameterRecord& parameter = record.parameters[static_cast<std::size_t>(p)];
      const double error = (parameter.value - brake.brake.theta[p]) / parameter.sd;
      EXPECT_LT(std::abs(error), 5.0) << parameter.name << " in check " << i;
      squares[p] += error * error;
    }
  }
  for (Eigen::Index p = 0; p < nominal.size(); ++p) {
    const double rms = std::sqrt(squares[p] / kChecks);
    const auto name = kParameterTable[static_cast<std::size_t>(p)].name;
    RecordProperty(std::string("normalised_error_rms_") + std::string(name), std::to_string(rms));
    EXPECT_LT(rms, 1.6) << name;  // 24 draws of a unit normal: below 1.45 in 99.9 % of all cases
    EXPECT_GT(rms, 0.5) << name;
  }
}

}  // namespace
}  // namespace clampd::assembly
