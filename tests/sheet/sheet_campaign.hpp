#pragma once

#include <cstdint>
#include <iosfwd>
#include <string>
#include <vector>

#include "clampd/identify/method.hpp"

namespace clampd::support {

struct SheetCampaignOptions {
  int brakes = 40;
  std::uint64_t seed = 1;
  int repeats = 6;
  Method method = Method::OutputError;
  std::string effect;     ///< "NAME=VALUE"; empty: none
  bool is_known = false;  ///< the model has the effect, and the method is that of prediction errors
};

/// Of one characteristic over all brakes. Its limit is where a tenth of the brakes are beyond.
struct CharacteristicCount {
  std::string name;
  double limit = 0.0;
  int known = 0;
  int unknown = 0;
  std::string why = {};  ///< of one that is not known
  int held = 0;          ///< the 95 % interval holds what the plant does
  double squares = 0.0;  ///< sum of ((estimate - truth) / sd)^2
  double sd_mean = 0.0;
  int decided = 0;  ///< the limit is further away than the guard band
  int decided_wrong = 0;
  int marginal = 0;
  int marginal_wrong = 0;  ///< decided by the value alone, and wrongly
};

struct SheetCampaign {
  int brakes = 0;
  int not_driven = 0;
  int not_identified = 0;
  int marked = 0;              ///< sheets that say that the model does not explain all of the motion
  int wrong_without_mark = 0;  ///< verdicts that are decided and wrong, on sheets that are not marked
  double evaluation_s = 0.0;   ///< the longest evaluation of a sheet
  std::vector<CharacteristicCount> characteristics;
};

/// Simulated brakes as wide as the paper's Table II, with sensors of all kinds, checked, identified, their
/// sheet computed and compared with what the plant does (plant_measurement.hpp).
SheetCampaign run_sheet_campaign(const SheetCampaignOptions& options);

void print(std::ostream& out, const SheetCampaign& campaign);

}  // namespace clampd::support
