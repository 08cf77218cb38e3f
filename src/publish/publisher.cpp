#include "clampd/publish/publisher.hpp"

#include <utility>

#include "clampd/record/utc.hpp"

namespace clampd::publish {

using namespace std::chrono_literals;

Publisher::Publisher(PublisherOptions options, std::unique_ptr<Channel> channel)
    : options_(std::move(options)),
      way_(std::move(channel)),
      backoff_(options_.backoff, options_.seed),
      thread_([this] { run(); }) {}

Publisher::~Publisher() {
  wake_.stop();
  thread_.join();
}

PublisherStatus Publisher::status() const {
  const std::lock_guard lock(mutex_);
  return status_;
}

void Publisher::tell(PublisherStatus status) {
  bool changed = false;
  {
    const std::lock_guard lock(mutex_);
    if (status.last.empty()) status.last = status_.last;
    changed = status.error != status_.error || (status.connected && !status_.connected);
    status_ = status;
  }
  if (changed && options_.on_change) options_.on_change(status.error);
}

void Publisher::run() {
  while (!wake_.stopped()) {
    const Result<void> done = work();
    if (done || wake_.stopped()) continue;
    way_->close();
    connected_since_.clear();
    tell({false, done.error().message, ""});
    const auto until = std::chrono::steady_clock::now() + backoff_.next();
    for (auto now = std::chrono::steady_clock::now(); now < until && !wake_.stopped();
         now = std::chrono::steady_clock::now())
      wake_.wait(std::chrono::ceil<std::chrono::milliseconds>(until - now));
  }
  way_->close();
}

/// One step: connects, or publishes one check, or waits for one.
Result<void> Publisher::work() {
  if (!store_) {
    Result<CheckStore> opened = CheckStore::open(options_.database);
    if (!opened) return tl::unexpected(opened.error());
    store_.emplace(std::move(*opened));
  }
  if (acknowledged_) return settle();
  if (connected_since_.empty()) return connect();
  Result<std::optional<OutboxEntry>> next = store_->next_in_outbox(options_.channel);
  if (!next) return tl::unexpected(next.error());
  if (!*next) {
    Result<void> attended = way_->attend(wake_, 1s);
    wake_.silence();
    if (attended) backoff_.reset();
    return attended;
  }
  const OutboxEntry& entry = **next;
  const bool with_rows = way_->wants_raw_runs();
  Result<CheckRecord> record = with_rows ? store_->load(entry.check_id) : store_->load_result(entry.check_id);
  // Damaged runs hold up no verdict: it goes without them, and `records verify` names them.
  if (!record && with_rows) record = store_->load_result(entry.check_id);
  if (!record) return tl::unexpected(record.error());
  const bool late = entry.queued < connected_since_;
  if (Result<void> sent = way_->send({*record, entry.sequence, late}, wake_); !sent) return sent;
  acknowledged_ = std::move(**next);
  return settle();
}

Result<void> Publisher::connect() {
  ConnectionContext context;
  const Result<std::uint64_t> connection = store_->count_connection(options_.channel);
  if (!connection) return tl::unexpected(connection.error());
  context.connection = *connection;
  Result<std::vector<CheckRecord>> latest = store_->load_results({.limit = 1});
  if (!latest) return tl::unexpected(latest.error());
  if (!latest->empty()) context.latest = std::move(latest->front());
  std::string now = format_utc(utc_now_ns());
  if (Result<void> connected = way_->connect(context, wake_); !connected) return connected;
  connected_since_ = std::move(now);
  tell({true, "", ""});
  return {};
}

/// Until the mark is on disk the check counts as unpublished, but this process does not send it again.
Result<void> Publisher::settle() {
  Result<void> marked =
      store_->mark_publication(acknowledged_->check_id, options_.channel, PublicationState::Published);
  if (!marked) return marked;
  backoff_.reset();
  tell({!connected_since_.empty(), "", acknowledged_->check_id});
  acknowledged_.reset();
  return {};
}

}  // namespace clampd::publish
