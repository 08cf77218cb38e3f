// Does the sheet hold what the independent plant does? As many brakes as one likes:
//   sheet_campaign [--brakes 2000] [--seed 1] [--repeats 6] [--method oem|pem] [--effect NAME=VALUE [--known
//   yes]]

#include <cstdlib>
#include <iostream>
#include <string_view>

#include "tests/sheet/sheet_campaign.hpp"

int main(int argc, char** argv) {
  using namespace clampd::support;
  SheetCampaignOptions options{.brakes = 2000, .effect = {}};
  for (int i = 1; i + 1 < argc; i += 2) {
    const std::string_view option = argv[i], value = argv[i + 1];
    if (option == "--brakes")
      options.brakes = std::atoi(argv[i + 1]);
    else if (option == "--seed")
      options.seed = std::strtoull(argv[i + 1], nullptr, 10);
    else if (option == "--repeats")
      options.repeats = std::atoi(argv[i + 1]);
    else if (option == "--method" && clampd::parse_method(argv[i + 1]))
      options.method = *clampd::parse_method(argv[i + 1]);
    else if (option == "--effect")
      options.effect = value;
    else if (option == "--known")
      options.is_known = value == "yes";
    else {
      std::cerr << "sheet_campaign: '" << option << ' ' << argv[i + 1]
                << "' is not known; see the head of its source\n";
      return 2;
    }
  }
  print(std::cout, run_sheet_campaign(options));
}
