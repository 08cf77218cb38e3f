#pragma once

namespace clampd::quality {

// What ranges and standard deviations of n normal values of unit variance are on average: the constants of
// every control chart, here for any n from 2 to 100 rather than from a rounded table.

/// d2: mean of the range.
double range_mean(int n);
/// d3: standard deviation of the range.
double range_sd(int n);
/// c4: mean of the sample standard deviation.
double deviation_mean(int n);
/// d2*: root mean square of the average of `groups` ranges (Duncan); with one group as AIAG's K2 and K3 use
/// it.
double average_range_mean(int n, int groups);

}  // namespace clampd::quality
