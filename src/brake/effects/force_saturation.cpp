#include "src/brake/effects/catalogue.hpp"

namespace clampd {

namespace {

using Role = EffectParameter::Role;

class ForceSaturation final : public EquationsOf<ForceSaturation> {
 public:
  const EffectInfo& info() const override {
    static const EffectInfo kInfo{.name = "force-saturation",
                                  .location = Location::ForceReading,
                                  .cause = "the reading of clamp force clips",
                                  .excitation = "the full range of force",
                                  .parameters = {{.name = "level",
                                                  .unit = "N",
                                                  .description = "where it clips",
                                                  .role = Role::Shape,
                                                  .lower = 500,
                                                  .upper = 100000.0,
                                                  .scale = 0.01,
                                                  .logarithmic = true}}};
    return kInfo;
  }
  template <class T>
  void read(effects_detail::Readout<T>& readout, const effects_detail::Own<T>& own) const {
    if (readout.force_N > own.parameters[0]) readout.force_N = own.parameters[0];
  }
  /// Where the highest readings crowd together.
  std::vector<double> starts(std::size_t, std::span<const Run> runs) const override {
    std::vector<double> readings;
    for (const Run& run : runs) readings.insert(readings.end(), run.force_N.begin(), run.force_N.end());
    if (readings.empty()) return {};
    const auto at = [&](double share) {
      const auto place =
          readings.begin() + static_cast<std::ptrdiff_t>(share * static_cast<double>(readings.size() - 1));
      std::nth_element(readings.begin(), place, readings.end());
      return *place;
    };
    std::vector<double> starts;
    for (const double share : {0.998, 0.985, 0.95})
      if (at(share) > 500.0) starts.push_back(at(share));
    return starts;
  }
};

}  // namespace

const Effect& force_saturation() {
  static const ForceSaturation kEffect;
  return kEffect;
}

}  // namespace clampd
