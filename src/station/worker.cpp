#include "clampd/station/worker.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "clampd/base/assert.hpp"
#include "clampd/record/checksum.hpp"

namespace clampd {
namespace {

double median(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

/// The runs' estimates are the best start there is: their median is not misled by a run that went astray.
EstimatorOptions joint_options(EstimatorOptions options, const std::vector<RunRecord>& records) {
  for (std::size_t i = 0; i < kParameterCount; ++i) {
    std::vector<double> values;
    for (const RunRecord& record : records)
      if (record.converged) values.push_back(record.estimate[i]);
    if (!values.empty()) options.start.theta[static_cast<Eigen::Index>(i)] = median(std::move(values));
  }
  return options;
}

}  // namespace

IdentificationWorker::IdentificationWorker(Estimator estimator, EstimatorOptions options,
                                           std::size_t capacity, WorkerMode mode, Looks looks)
    : estimator_(std::move(estimator)),
      options_(std::move(options)),
      capacity_(capacity),
      mode_(mode),
      looks_(std::move(looks)) {
  CLAMPD_ASSERT(estimator_ && capacity_ > 0);
  if (mode_ == WorkerMode::Background) thread_ = std::thread([this] { work(); });
}

IdentificationWorker::~IdentificationWorker() {
  {
    const std::lock_guard lock(mutex_);
    closed_ = true;
    queue_.clear();
  }
  arrived_.notify_one();
  if (thread_.joinable()) thread_.join();
}

RunRecord IdentificationWorker::identify(CollectedRun collected) const {
  const Estimate summary = estimator_(std::span<const Run>(&collected.run, 1), options_);
  RunRecord record;
  record.trajectory = collected.trajectory;
  record.tracking_rms_N = collected.tracking_rms_N;
  record.tracking_max_N = collected.tracking_max_N;
  record.fit_force_rms_N = summary.force_rms_N;
  record.fit_velocity_rms_rad_s = summary.velocity_rms_rad_s;
  record.converged = summary.converged() && summary.parameters.theta.allFinite();
  record.estimate.assign(summary.parameters.theta.begin(), summary.parameters.theta.end());
  record.checksum_sha256 = sha256_hex(format_run(collected.run));
  record.run = std::move(collected.run);
  return record;
}

Estimate IdentificationWorker::fit_jointly() const {
  std::vector<Run> runs;
  runs.reserve(records_.size());
  for (const RunRecord& record : records_) runs.push_back(record.run);
  return estimator_(runs, joint_options(options_, records_));
}

void IdentificationWorker::look() {
  if (!looks_.look || records_.size() < looks_.first) return;
  joint_ = fit_jointly();
  joint_runs_ = records_.size();
  const Look look = looks_.look(records_, joint_);
  next_trajectory_.store(look.next_trajectory, std::memory_order_relaxed);
  if (look.is_enough) has_enough_.store(true, std::memory_order_release);
}

bool IdentificationWorker::submit(CollectedRun run) {
  if (has_enough()) return false;
  if (mode_ == WorkerMode::Synchronous) {
    records_.push_back(identify(std::move(run)));
    identified_.fetch_add(1, std::memory_order_relaxed);
    look();
    return true;
  }
  {
    const std::lock_guard lock(mutex_);
    if (closed_ || queue_.size() >= capacity_) return false;
    queue_.push_back(std::move(run));
  }
  arrived_.notify_one();
  return true;
}

void IdentificationWorker::work() {
  while (true) {
    std::unique_lock lock(mutex_);
    arrived_.wait(lock, [this] { return closed_ || !queue_.empty(); });
    if (queue_.empty()) return;
    CollectedRun run = std::move(queue_.front());
    queue_.pop_front();
    lock.unlock();
    records_.push_back(identify(std::move(run)));
    identified_.fetch_add(1, std::memory_order_relaxed);
    // A look must not hold up the runs after it: whatever waits is identified first.
    lock.lock();
    const bool is_behind = !queue_.empty();
    lock.unlock();
    if (!is_behind) look();
    if (has_enough()) return;
  }
}

IdentificationWorker::Outcome IdentificationWorker::finish() {
  {
    const std::lock_guard lock(mutex_);
    closed_ = true;
  }
  arrived_.notify_one();
  if (thread_.joinable()) thread_.join();
  Outcome outcome;
  if (!records_.empty()) outcome.joint = joint_runs_ == records_.size() ? std::move(joint_) : fit_jointly();
  outcome.runs = std::move(records_);
  return outcome;
}

}  // namespace clampd
