#pragma once

#include "clampd/sheet/sheet.hpp"

namespace clampd::support {

/// The two lines that the encoder tells: the contact point without limits, and a clearance of 4 to 8 rad.
inline Sheet encoder_sheet() {
  return *parse_sheet(R"(revision = "1"
[[characteristic]]
kind = "contact-point"
unit = "rad"
[[characteristic]]
kind = "clearance"
unit = "rad"
lower = 4
upper = 8
)",
                      "sheet.toml");
}

}  // namespace clampd::support
