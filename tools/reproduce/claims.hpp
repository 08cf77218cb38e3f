#pragma once

#include <string>
#include <vector>

#include "clampd/views/page.hpp"
#include "tools/reproduce/findings.hpp"

namespace clampd::reproduce {

/// One statement of the paper and what came of it.
struct Claim {
  std::string where;
  std::string paper;
  std::string here;
  std::string verdict;
  report::Tone tone = report::Tone::Plain;
};

/// All of them, in the paper's order.
std::vector<Claim> claims_of(const Study& study, const Findings& findings);

}  // namespace clampd::reproduce
