#include "clampd/archive/compression.hpp"

#include <random>
#include <string>

#include <fmt/format.h>
#include <gtest/gtest.h>

namespace clampd {
namespace {

/// Readings with a noise, as a run's file has them.
std::string readings() {
  std::mt19937_64 random(3);
  std::normal_distribution<double> noise;
  std::string text = "time_s,torque_Nm,velocity_rad_s,force_N\n";
  for (int k = 0; k < 300; ++k)
    text += fmt::format("{},{:.4f},{:.3f},{:.1f}\n", 0.001 * k, 0.01 * noise(random),
                        20.0 + 0.3 * noise(random), 60.0 * k + 17.0 * noise(random));
  return text;
}

TEST(Compression, GivesBackWhatWasCompressed) {
  for (const std::string& text : {std::string(), std::string("a"), readings(), std::string(300'000, '7')}) {
    EXPECT_TRUE(decompressed(compressed(text)).value() == text) << text.size();
    EXPECT_TRUE(decompressed(compressed_smaller(text)).value() == text) << text.size();
  }
  EXPECT_LT(compressed_smaller(readings()).size(), 0.95 * static_cast<double>(compressed(readings()).size()));
}

TEST(Compression, RefusesWhatIsDamaged) {
  for (const std::string& stream : {compressed(readings()), compressed_smaller(readings())}) {
    for (std::size_t length = 0; length < stream.size(); length += 7)
      EXPECT_FALSE(decompressed(stream.substr(0, length))) << length;
    EXPECT_FALSE(decompressed(stream + "x"));
    EXPECT_FALSE(decompressed(stream + stream));
  }
  EXPECT_FALSE(decompressed("time_s,torque_Nm"));
}

TEST(Compression, RefusesATextThatIsLargerThanAnyRun) {
  const std::string large(65U << 20U, '0');
  EXPECT_FALSE(decompressed(compressed(large)));
  EXPECT_FALSE(decompressed(compressed_smaller(large)));
}

}  // namespace
}  // namespace clampd
