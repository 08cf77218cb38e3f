#include "clampd/brake/parameters.hpp"

namespace clampd {

ParameterVector nominal_parameters() {
  ParameterVector theta;
  for (std::size_t i = 0; i < kParameterCount; ++i) theta[static_cast<Eigen::Index>(i)] = kParameterTable[i].nominal;
  return theta;
}

std::optional<std::size_t> find_parameter(std::string_view name) {
  for (std::size_t i = 0; i < kParameterCount; ++i)
    if (kParameterTable[i].name == name) return i;
  return std::nullopt;
}

}  // namespace clampd
