#include <utility>

#include "clampd/base/json.hpp"
#include "clampd/reanalysis/jobs.hpp"

namespace clampd::reanalysis {

nlohmann::ordered_json job_json(const JobStatus& status) {
  using nlohmann::ordered_json;
  ordered_json failures = ordered_json::array();
  for (const auto& [reason, count] : status.failures)
    failures.push_back({{"reason", reason}, {"tasks", count}});
  return {{"job", status.id},
          {"name", status.name},
          {"submitted", status.submitted},
          {"submitted_by", status.submitted_by},
          {"task_sha256", status.task_sha256},
          {"tasks", status.all()},
          {"waiting", status.waiting},
          {"claimed", status.claimed},
          {"done", status.done},
          {"failed", status.failed},
          {"cancelled", status.cancelled},
          {"workers", status.workers},
          {"done_per_s", number_or_null(status.done_per_s)},
          {"left_s", status.left_s ? number_or_null(*status.left_s) : ordered_json(nullptr)},
          {"end", status.end.empty() ? ordered_json(nullptr) : ordered_json(status.end)},
          {"failures", std::move(failures)}};
}

}  // namespace clampd::reanalysis
