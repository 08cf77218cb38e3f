#include <filesystem>
#include <fstream>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "drivers/sim/plant_configuration.hpp"

namespace clampd::sim {
namespace {

using ::testing::HasSubstr;

class PlantFile : public ::testing::Test {
 protected:
  void SetUp() override {
    const auto* info = ::testing::UnitTest::GetInstance()->current_test_info();
    path_ = ::testing::TempDir() + "plant_" + info->name() + ".toml";
  }
  void TearDown() override { std::filesystem::remove(path_); }

  Result<PlantConfiguration> read(const std::string& text) {
    std::ofstream(path_) << text;
    return read_plant_configuration(path_);
  }
  std::string path_;
};

TEST_F(PlantFile, ReadsEveryTable) {
  const auto plant = read(R"([parameters_normalised]
k2 = 0.7
[fixed]
inertia_kg_m2 = 3e-4
[plant]
seed = 42
clearance_rad = 4
[sensors]
force_noise_N = 75.0
[effects]
cogging = 0.02
[[fault]]
kind = "frozen-counter"
at_s = 2
duration_s = 0.5
)");
  ASSERT_TRUE(plant.has_value()) << plant.error().message;
  EXPECT_DOUBLE_EQ(plant->brake.theta[k2], 0.7 * kParameterTable[k2].nominal);
  EXPECT_DOUBLE_EQ(plant->brake.fixed.inertia_kg_m2, 3e-4);
  EXPECT_EQ(plant->seed, 42u);
  EXPECT_DOUBLE_EQ(plant->clearance_rad, 4.0);
  EXPECT_DOUBLE_EQ(plant->sensors.force_noise_N, 75.0);
  EXPECT_DOUBLE_EQ(plant->effects.cogging_Nm, 0.02);
  EXPECT_FALSE(plant->fault_active(FaultKind::FrozenCounter, 1.999));
  EXPECT_TRUE(plant->fault_active(FaultKind::FrozenCounter, 2.0));
  EXPECT_TRUE(plant->fault_active(FaultKind::FrozenCounter, 2.499));
  EXPECT_FALSE(plant->fault_active(FaultKind::FrozenCounter, 2.5));
  EXPECT_FALSE(plant->fault_active(FaultKind::Silent, 2.1));
}

TEST_F(PlantFile, ErrorsNameFileAndLine) {
  const struct {
    const char* text;
    const char* line;
    const char* what;
  } cases[] = {
      {"[plant]\nsede = 1\n", ":2", "sede"},
      {"[plant]\nseed = -1\n", ":2", "seed"},
      {"[plant]\nseed = 1.5\n", ":2", "seed"},
      {"[plant]\n\nclearance_rad = \"six\"\n", ":3", "clearance_rad"},
      {"[sensors]\nforce_nois_N = 1\n", ":2", "force_nois_N"},
      {"[effects]\ncoging = 1\n", ":2", "coging"},
      {"[effects]\ncogging = 100\n", ":2", "cogging"},
      {"[brakes]\nx = 1\n", ":1", "brakes"},
      {"x = 1\n", ":1", "x"},
      {"[[fault]]\nkind = \"fire\"\nat_s = 1\nduration_s = 1\n", ":2", "fire"},
      {"[[fault]]\nkind = \"silent\"\nat_s = 1\n", ":1", "duration_s"},
      {"[[fault]]\nkind = \"silent\"\nwhen = 1\n", ":3", "when"},
      {"[[fault]]\nkind = \"silent\"\nduration_s = 1\nfrom_force_N = \"much\"\n", ":4", "from_force_N"},
      {"[[fault]]\nkind = \"silent\"\nduration_s = 1\nfrom_force_N = -1\n", ":1", "from_force_N"},
      {"[plant\nseed = 1\n", ":1", ""},
  };
  for (const auto& bad : cases) {
    const auto plant = read(bad.text);
    ASSERT_FALSE(plant.has_value()) << bad.text;
    EXPECT_THAT(plant.error().message, HasSubstr(path_ + bad.line)) << bad.text;
    EXPECT_THAT(plant.error().message, HasSubstr(bad.what)) << bad.text;
  }
}

TEST_F(PlantFile, RefusesImpossibleValues) {
  for (const char* text :
       {"[plant]\nstep_s = 1e-3\n", "[plant]\nclearance_rad = 30\n", "[sensors]\nforce_noise_N = -1\n",
        "[sensors]\nforce_noise_N = nan\n", "[plant]\nwatchdog_s = 0\n"})
    EXPECT_FALSE(read(text).has_value()) << text;
}

TEST_F(PlantFile, SpoiledReadings) {
  const auto plant = read(
      "[[spoil]]\nreading = \"force\"\nkind = \"late\"\namount = 20\nat_s = 1.5\n"
      "[[spoil]]\nreading = \"encoder\"\nkind = \"frozen\"\nat_s = 2\nduration_s = 0.5\nfrom_force_N = 12e3\n");
  ASSERT_TRUE(plant.has_value()) << plant.error().message;
  ASSERT_EQ(plant->spoiled.size(), 2u);
  EXPECT_EQ(plant->spoiled[0].reading, Reading::Force);
  EXPECT_EQ(plant->spoiled[0].spoil, Spoil::Late);
  EXPECT_EQ(plant->spoiled[0].amount, 20.0);
  EXPECT_TRUE(plant->spoiled[0].when.active(1e6));
  EXPECT_FALSE(plant->spoiled[0].when.active(1.4));
  EXPECT_EQ(plant->spoiled[1].reading, Reading::Encoder);
  Episode clamped = plant->spoiled[1].when;
  EXPECT_FALSE(clamped.active(2.1)) << "the brake was never clamped";
  clamped.observe(7.0, 12001.0);
  clamped.observe(8.0, 13000.0);
  EXPECT_FALSE(clamped.active(8.9));
  EXPECT_TRUE(clamped.active(9.1));
  EXPECT_FALSE(clamped.active(9.6));
  for (const auto& [text, message] : std::initializer_list<std::pair<const char*, const char*>>{
           {"[[spoil]]\nreading = \"force\"\n", "needs a reading and a kind"},
           {"[[spoil]]\nreading = \"colour\"\nkind = \"frozen\"\n",
            "force, velocity, position, torque, encoder"},
           {"[[spoil]]\nreading = \"force\"\nkind = \"sleepy\"\n", "frozen, scaled, negated"},
           {"[[spoil]]\nreading = \"force\"\nkind = \"late\"\namount = 1e9\n",
            "an amount that its kind can have"},
           {"[[spoil]]\nreading = \"force\"\nkind = \"frozen\"\nsize = 1\n", "unknown key spoil.size"},
           {"[spoil]\n", "[[spoil]]"}}) {
    const auto refused = read(text);
    ASSERT_FALSE(refused.has_value()) << text;
    EXPECT_THAT(refused.error().message, HasSubstr(message));
  }
}

TEST(PlantConfigurationFile, MissingFileIsAnErrorWithItsName) {
  const auto plant = read_plant_configuration("/nonexistent/plant.toml");
  ASSERT_FALSE(plant.has_value());
  EXPECT_THAT(plant.error().message, HasSubstr("/nonexistent/plant.toml"));
}

TEST(PlantConfigurationFile, ShippedOnesAreValid) {
  const std::filesystem::path configs = std::filesystem::path(CLAMPD_SOURCE_DIR) / "configs";
  const auto nominal = read_plant_configuration((configs / "plant.toml").string());
  ASSERT_TRUE(nominal.has_value()) << nominal.error().message;
  EXPECT_TRUE(nominal->brake.theta.isApprox(nominal_parameters()));
  int brakes = 0;
  for (const auto& entry : std::filesystem::directory_iterator(configs / "brakes")) {
    const auto plant = read_plant_configuration(entry.path().string());
    EXPECT_TRUE(plant.has_value()) << plant.error().message;
    ++brakes;
  }
  EXPECT_GE(brakes, 3);
}

}  // namespace
}  // namespace clampd::sim
