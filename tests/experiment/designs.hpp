#pragma once

#include <vector>

namespace clampd::testing {

/// 0.2 s, 20-sample blocks, -log det M = -68.33: as good as known, and at ease.
inline const std::vector<double> kGoodBlocks_Nm = {0.430, 3.0,   1.330, 0.307, 0.431,
                                                   0.589, 0.766, -3.0,  1.184, 1.796};

/// 0.3 s: creeps under load towards a lock-up at the end. Its torques' third decimals decide about its M.
inline const std::vector<double> kCreepingBlocks_Nm = {0.436, 2.924,  1.381,  0.302, 0.427,
                                                       0.605, -0.296, -2.046, 1.242, 1.448,
                                                       1.579, 1.166,  1.841,  1.551, 1.810};

}  // namespace clampd::testing
