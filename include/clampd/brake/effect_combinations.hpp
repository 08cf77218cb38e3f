#pragma once

#include <utility>
#include <vector>

#include "clampd/brake/effect.hpp"

namespace clampd {

/// Every combination of the values that an effect's parameters may have: `values_of(i)` gives those of
/// parameter i; of a refinement the first one counts.
template <class ValuesOf>
std::vector<std::vector<double>> combinations(const Effect& effect, const ValuesOf& values_of) {
  std::vector<std::vector<double>> list{{}};
  const auto& parameters = info_of(effect).parameters;
  for (std::size_t i = 0; i < parameters.size(); ++i) {
    std::vector<double> values = values_of(i);
    if (parameters[i].role == EffectParameter::Role::Refinement) values.resize(1);
    std::vector<std::vector<double>> longer;
    for (const auto& begun : list)
      for (const double value : values) {
        longer.push_back(begun);
        longer.back().push_back(value);
      }
    list = std::move(longer);
  }
  return list;
}

}  // namespace clampd
