#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "clampd/archive/store.hpp"
#include "clampd/publish/publisher.hpp"
#include "support/check_records.hpp"
#include "support/temporary_directory.hpp"

namespace clampd::support {

/// A store with one outbox, and a publisher that comes and goes.
class PublishingStation {
 public:
  explicit PublishingStation(std::string channel) : channel_(std::move(channel)) {
    auto opened = CheckStore::open(database());
    if (!opened) throw std::runtime_error(opened.error().message);
    store_.emplace(std::move(*opened));
    store_->queue_for({channel_});
  }

  std::string database() const { return folder_.path("checks.sqlite"); }
  CheckStore& store() { return *store_; }

  static std::string id(int number) { return fmt::format("20261121T{:09}Z-00000000", number); }
  static CheckRecord check(int number) {
    CheckRecord record = make_check_record(id(number));
    record.serial = fmt::format("EMB-{:04}", number);
    return record;
  }
  /// Saves checks up to this number.
  void save_up_to(int number) {
    while (saved_ < number) {
      const auto saved = store_->save(check(++saved_));
      ASSERT_TRUE(saved) << saved.error().message;
      if (publisher_) publisher_->notify();
    }
  }

  void start(std::unique_ptr<publish::Channel> channel) {
    using namespace std::chrono_literals;
    publisher_ = std::make_unique<publish::Publisher>(
        publish::PublisherOptions{
            .channel = channel_, .database = database(), .backoff = {5ms, 100ms}, .seed = 1},
        std::move(channel));
  }
  void stop() { publisher_.reset(); }
  publish::PublisherStatus status() const { return publisher_->status(); }
  std::size_t pending() { return store_->outbox(channel_)->pending; }

 private:
  TemporaryDirectory folder_;
  std::string channel_;
  std::optional<CheckStore> store_;
  std::unique_ptr<publish::Publisher> publisher_;
  int saved_ = 0;
};

}  // namespace clampd::support
