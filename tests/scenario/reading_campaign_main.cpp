// The campaign of spoiled and healthy checks, as long as one likes:
//   reading_campaign [--checks 10000] [--healthy 10000] [--seed 1] [--told speed] [--period-ms 1]

#include <cstdlib>
#include <iostream>
#include <string_view>

#include "tests/scenario/reading_campaign.hpp"

int main(int argc, char** argv) {
  int checks = 1000, healthy = 0;
  std::uint64_t seed = 1;
  clampd::Told told;
  for (int i = 1; i + 1 < argc; i += 2) {
    const std::string_view option = argv[i];
    if (option == "--checks")
      checks = std::atoi(argv[i + 1]);
    else if (option == "--healthy")
      healthy = std::atoi(argv[i + 1]);
    else if (option == "--seed")
      seed = std::strtoull(argv[i + 1], nullptr, 10);
    else if (option == "--told" && argv[i + 1] == std::string_view("speed"))
      told.commanded = clampd::CommandedQuantity::Velocity;
    else if (option == "--period-ms")
      told.period_s = 1e-3 * std::atof(argv[i + 1]);
    else {
      std::cerr << "reading_campaign: unknown option '" << option
                << "'; there are: --checks N, --healthy N, --seed N, --told speed, --period-ms N\n";
      return 2;
    }
  }
  bool good = true;
  if (checks > 0) {
    const auto campaign = clampd::scenario::run_spoil_campaign(checks, seed, checks, told);
    for (const std::string& remark : campaign.remarks) std::cout << remark << '\n';
    print(std::cout, campaign);
    good = campaign.all.unsafe == 0 && campaign.all.wrong == 0;
  }
  if (healthy > 0) {
    const auto campaign = clampd::scenario::run_healthy_campaign(healthy, seed, told);
    for (const std::string& fault : campaign.faults) std::cout << fault << '\n';
    std::cout << campaign.checks << " healthy checks, " << campaign.faults.size() << " false faults\n";
    good = good && campaign.faults.empty();
  }
  return good ? 0 : 1;
}
