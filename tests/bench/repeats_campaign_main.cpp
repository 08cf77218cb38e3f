// As many checks with as many repeats as each brake needs as one likes: see --help.

#include <cstdlib>
#include <exception>
#include <iostream>
#include <string_view>

#include "tests/bench/repeats_campaign.hpp"

int main(int argc, char** argv) {
  clampd::support::RepeatsCampaignOptions options;
  for (int i = 1; i < argc; i += 2) {
    const std::string_view name = argv[i];
    const char* value = i + 1 < argc ? argv[i + 1] : nullptr;
    if (value != nullptr && name == "--brakes")
      options.brakes = std::atoi(value);
    else if (value != nullptr && name == "--seed")
      options.seed = std::strtoull(value, nullptr, 10);
    else if (value != nullptr && name == "--near")
      options.near_sd = std::atof(value);
    else if (value != nullptr && name == "--share")
      options.near_share = std::atof(value);
    else if (value != nullptr && name == "--beyond")
      options.beyond_share = std::atof(value);
    else if (value != nullptr && name == "--noise")
      options.noise = std::atof(value);
    else if (value != nullptr && name == "--most")
      options.most = static_cast<std::uint32_t>(std::atoi(value));
    else if (value != nullptr && name == "--choice")
      options.chooses = std::atoi(value) != 0;
    else if (value != nullptr && name == "--threads")
      options.threads = std::atoi(value);
    else if (value != nullptr && name == "--effect")
      options.effect = value;
    else if (value != nullptr && name == "--fixed-every")
      options.fixed_every = std::atoi(value);
    else {
      std::cerr << "usage: repeats_campaign [--brakes 1000] [--seed 1] [--near 8.944 (sd of 20 repeats)] "
                   "[--share 0.1] "
                   "[--beyond 0.05] [--noise 1] [--most 21] [--choice 1] [--threads 1] [--effect NAME=VALUE] "
                   "[--fixed-every 20]\n";
      return 2;
    }
  }
  try {
    print(std::cout, run_repeats_campaign(options));
  } catch (const std::exception& problem) {
    std::cerr << "repeats_campaign: " << problem.what() << '\n';
    return 1;
  }
}
