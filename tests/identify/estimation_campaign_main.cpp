// Do the reported uncertainties hold the truth, and is a fit that got lost noticed? As many checks as one
// likes:
//   estimation_campaign [--checks 1000] [--seed 1] [--repeats 1] [--profiles 1] [--bench
//   station|reference|sinusoid]
//                       [--starts nominal|far] [--effect NAME=VALUE] [--trajectory FILE.csv]
// A percentage is followed by Wilson's 95 % interval, and by -N where N intervals were not given.

#include <cstdlib>
#include <iostream>
#include <string_view>

#include "tests/identify/estimation_campaign.hpp"

int main(int argc, char** argv) {
  using namespace clampd::support;
  CampaignOptions options{.checks = 1000, .profiles = 1, .effect = {}, .trajectory = {}};
  for (int i = 1; i + 1 < argc; i += 2) {
    const std::string_view option = argv[i];
    const std::string_view value = argv[i + 1];
    if (option == "--checks")
      options.checks = std::atoi(argv[i + 1]);
    else if (option == "--seed")
      options.seed = std::strtoull(argv[i + 1], nullptr, 10);
    else if (option == "--repeats")
      options.repeats = std::atoi(argv[i + 1]);
    else if (option == "--profiles")
      options.profiles = std::atoi(argv[i + 1]);
    else if (option == "--starts")
      options.far_starts = value == "far";
    else if (option == "--effect")
      options.effect = value;
    else if (option == "--trajectory")
      options.trajectory = value;
    else if (option == "--bench" && (value == "station" || value == "reference" || value == "sinusoid"))
      options.bench = value == "station"     ? Bench::Station
                      : value == "reference" ? Bench::Reference
                                             : Bench::Sinusoid;
    else {
      std::cerr << "estimation_campaign: '" << option << ' ' << value
                << "' is not known; see the head of its source\n";
      return 2;
    }
  }
  const Campaign campaign = run_estimation_campaign(options);
  for (const MethodCampaign& method : campaign.methods)
    for (const std::string& remark : method.remarks) std::cout << remark << '\n';
  print(std::cout, campaign);
}
