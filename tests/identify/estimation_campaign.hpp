#pragma once

#include <array>
#include <cstdint>
#include <iosfwd>
#include <string>
#include <vector>

#include "clampd/identify/method.hpp"
#include "drivers/sim/plant_configuration.hpp"

namespace clampd::support {

/// Who made the runs: neither shares anything with the estimators' integrator.
enum class Bench {
  Station,    ///< the simulated brake, driven by the station's own controller along the shipped trajectory
  Reference,  ///< the tests' reference brake under a torque that no controller answers for
  Sinusoid,   ///< the simulated brake, moved slowly under load, where simulations without feedback fail
};

struct CampaignOptions {
  Bench bench = Bench::Station;
  int checks = 100;
  std::uint64_t seed = 1;
  int repeats = 1;          ///< runs a check, fitted jointly
  int profiles = 0;         ///< parameters that are profiled in each check, in turn; 7: all
  bool far_starts = false;  ///< from 0.5 to 1.5 times nominal instead of nominal
  std::string effect;       ///< of the simulated brake, as "cogging=0.05"
  std::string trajectory;   ///< what Bench::Station drives along; empty: the one that ships
};

struct Coverage {
  int held = 0;     ///< intervals that held the truth
  int given = 0;    ///< intervals
  int unknown = 0;  ///< where the method said that it does not know
  double rate() const { return given > 0 ? static_cast<double>(held) / given : 0.0; }
  /// Wilson's 95 % interval of the rate.
  std::array<double, 2> wilson() const;
};

struct MethodCampaign {
  std::array<Coverage, kParameterCount> by_sd;       ///< value ± 1.96 sd
  std::array<Coverage, kParameterCount> by_profile;  ///< the 95 % interval of the profile
  int converged = 0;
  int other_method = 0;              ///< output errors got lost, and prediction errors answered
  int no_result = 0;                 ///< Termination::Unexplained
  int lost = 0;                      ///< reported, and further from the truth than kLost
  std::vector<std::string> remarks;  ///< one line for each of these three
};

/// Further from the truth than so many of its standard deviations an estimate is in another place altogether.
/// Gaussian errors never are; those of a single run, whose standard deviations are uncertain too (Student,
/// four degrees), once in a thousand.
inline constexpr double kLost = 8.0;

struct Campaign {
  int checks = 0;
  int undriven = 0;                       ///< brakes that could not be driven through
  std::array<MethodCampaign, 2> methods;  ///< by Method
};

/// Brakes drawn independently, parameter by parameter, from a quarter beyond nominal to a quarter beyond the
/// means of the paper's Table II; sensors from 5 to 75 N, 0.05 to 1.5 rad/s and 0.5 to 14.2 mN m of torque,
/// uniform in their logarithm.
Campaign run_estimation_campaign(const CampaignOptions& options);

void print(std::ostream& out, const Campaign& campaign);

}  // namespace clampd::support
