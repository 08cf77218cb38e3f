#include <cstdlib>
#include <fstream>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "clampd/parameters/brake_parameters.hpp"

namespace clampd {
namespace {

using ::testing::HasSubstr;

class ParametersFile : public ::testing::Test {
 protected:
  std::string write(const std::string& text) {
    path_ = ::testing::TempDir() + "clampd_parameters_" +
            ::testing::UnitTest::GetInstance()->current_test_info()->name() + ".toml";
    std::ofstream(path_) << text;
    return path_;
  }
  void TearDown() override {
    if (!path_.empty()) std::remove(path_.c_str());
  }

  std::string error_of(const std::string& text) {
    const auto result = read_brake_parameters(write(text));
    return result ? "no error" : result.error().message;
  }

 private:
  std::string path_;
};

TEST_F(ParametersFile, KeepsNominalWhatItDoesNotName) {
  const auto read = read_brake_parameters(
      write("[parameters]\nk2 = 24.64\n[fixed]\ninertia_kg_m2 = 3.0e-4\n[noise]\nx=1\n"));
  ASSERT_TRUE(read) << read.error().message;
  EXPECT_DOUBLE_EQ(read->theta[k2], 24.64);
  EXPECT_DOUBLE_EQ(read->theta[TC], 7.67e-2);
  EXPECT_DOUBLE_EQ(read->fixed.inertia_kg_m2, 3.0e-4);
  EXPECT_DOUBLE_EQ(read->fixed.ratio_m_rad, 2.63e-5);
}

TEST_F(ParametersFile, ReadsNormalisedValuesAndIntegers) {
  const auto read =
      read_brake_parameters(write("[parameters_normalised]\nk2 = 0.7\nk1 = 1\n[parameters]\nws = 12\n"));
  ASSERT_TRUE(read) << read.error().message;
  EXPECT_DOUBLE_EQ(read->theta[k2], 0.7 * 3.52e1);
  EXPECT_DOUBLE_EQ(read->theta[k1], -3.54e-1);
  EXPECT_DOUBLE_EQ(read->theta[ws], 12.0);
}

TEST_F(ParametersFile, NamesFileLineAndKeyOfAnError) {
  EXPECT_THAT(error_of("[parameters]\n\nkk = 1.0\n"),
              ::testing::AllOf(HasSubstr(".toml:3"), HasSubstr("\"kk\""), HasSubstr("Ts0")));
  EXPECT_THAT(error_of("[parameters]\nk2 = \"hard\"\n"), HasSubstr(":2: k2 must be a finite number"));
  EXPECT_THAT(error_of("[parameters]\nk2 = nan\n"), HasSubstr("k2 must be a finite number"));
  EXPECT_THAT(error_of("[parameters]\nTC = -0.1\n"), HasSubstr("outside of"));
  EXPECT_THAT(error_of("[parameters_normalised]\nk2 = 0.0\n"), HasSubstr("outside of"));
  EXPECT_THAT(error_of("[fixed]\nmass = 1\n"), HasSubstr("\"mass\""));
  EXPECT_THAT(error_of("[fixed]\nratio_m_rad = 0\n"), HasSubstr("must be positive"));
  EXPECT_THAT(error_of("parameters = 3\n"), HasSubstr("must be a table"));
  EXPECT_THAT(error_of("[parameters\n"), HasSubstr("not valid TOML"));
  EXPECT_THAT(error_of("[parameters]\nk2 = 30.0\n[parameters_normalised]\nk2 = 0.9\n"),
              HasSubstr("keep one"));
}

TEST(Parameters, MissingFileIsAnErrorWithItsName) {
  const auto read = read_brake_parameters("/nowhere/brake.toml");
  ASSERT_FALSE(read);
  EXPECT_THAT(read.error().message, HasSubstr("/nowhere/brake.toml"));
}

TEST(Parameters, TableIsConsistent) {
  for (std::size_t i = 0; i < kParameterCount; ++i) {
    const ParameterInfo& info = kParameterTable[i];
    EXPECT_LT(info.lower, info.nominal);
    EXPECT_GT(info.upper, info.nominal);
    EXPECT_EQ(find_parameter(info.name), i);
  }
  EXPECT_EQ(find_parameter("Fcl"), std::nullopt);
}

}  // namespace
}  // namespace clampd
