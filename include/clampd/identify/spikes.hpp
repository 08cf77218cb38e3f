#pragma once

#include <cstddef>
#include <span>
#include <vector>

namespace clampd {

/// From which size on an innovation is that of a spike: so many robust standard deviations of `innovations`
/// (NaN: does not count). Zero if none counts.
double spike_limit(std::vector<double> innovations);

/// Rows of a channel whose innovation is beyond the limit and the largest one nearby: the readings after a
/// spike are judged again once it no longer moves the filter.
std::vector<std::size_t> spikes_in(std::span<const double> innovations, double limit);

}  // namespace clampd
