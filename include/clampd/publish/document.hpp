#pragma once

#include <cstdint>

#include <nlohmann/json.hpp>

#include "clampd/record/check_record.hpp"

namespace clampd::publish {

/// clampd.check/1 of a record whose raw runs are not loaded, as text that every consumer can read: valid
/// UTF-8 without NUL. "outbox": {"sequence"} is what a consumer of a channel that may repeat itself drops
/// repeats by: a sequence that is not above the last one seen is a repeat, and "record" is the check's id.
std::string publication_document(const CheckRecord& record, std::int64_t sequence);

}  // namespace clampd::publish
