#pragma once

#include "clampd/base/result.hpp"
#include "clampd/publish/channel.hpp"
#include "clampd/station/configuration.hpp"

namespace clampd::reanalysis {

/// The archive that a configuration names under [postgresql]. Error: it names none.
Result<publish::PostgresqlSettings> archive_of(const StationConfiguration& configuration);

}  // namespace clampd::reanalysis
