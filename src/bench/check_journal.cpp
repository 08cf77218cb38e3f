#include "clampd/bench/check_journal.hpp"

#include <array>
#include <filesystem>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "clampd/record/file.hpp"

namespace clampd::bench {
namespace {

struct JournalText {
  const char* key;
  std::string CheckRecord::*member;
};

constexpr std::array kJournalTexts{
    JournalText{"id", &CheckRecord::id},
    JournalText{"serial", &CheckRecord::serial},
    JournalText{"part_number", &CheckRecord::part_number},
    JournalText{"batch", &CheckRecord::batch},
    JournalText{"station", &CheckRecord::station},
    JournalText{"fixture", &CheckRecord::fixture},
    JournalText{"operator", &CheckRecord::operator_name},
    JournalText{"software_version", &CheckRecord::software_version},
    JournalText{"limits_file", &CheckRecord::limits_file},
    JournalText{"limits_revision", &CheckRecord::limits_revision},
    JournalText{"limits_sha256", &CheckRecord::limits_sha256},
    JournalText{"trajectory_sha256", &CheckRecord::trajectory_sha256},
    JournalText{"instruments", &CheckRecord::instruments},
    JournalText{"started", &CheckRecord::started},
    JournalText{"method", &CheckRecord::method},
};

Result<CheckRecord> parse_journal(const std::string& file, const std::string& text) {
  try {
    const nlohmann::json document = nlohmann::json::parse(text);
    CheckRecord record;
    for (const JournalText& field : kJournalTexts) document.at(field.key).get_to(record.*field.member);
    document.at("simulated").get_to(record.simulated);
    document.at("repeats").get_to(record.repeats);
    if (const auto recipe = document.find("recipe"); recipe != document.end())  // an older one has none
      record.recipe = RecipeRecord{recipe->at("file").get<std::string>(), recipe->at("version").get<std::string>(),
                                   recipe->at("sha256").get<std::string>()};
    return record;
  } catch (const nlohmann::json::exception& exception) {
    return failure(
        fmt::format("{}: is damaged: {}; a check that the station did not finish may be without a "
                    "record. Remove the file",
                    file, exception.what()));
  }
}

}  // namespace

Result<void> CheckJournal::begin(const CheckRecord& head) const {
  nlohmann::ordered_json document;
  for (const JournalText& field : kJournalTexts) document[field.key] = head.*field.member;
  document["simulated"] = head.simulated;
  document["repeats"] = head.repeats;
  if (head.recipe)
    document["recipe"] = {
        {"file", head.recipe->file}, {"version", head.recipe->version}, {"sha256", head.recipe->sha256}};
  return write_file_atomically(
      file_, document.dump(2, ' ', false, nlohmann::ordered_json::error_handler_t::replace) + "\n");
}

Result<void> CheckJournal::end() const {
  std::error_code error;
  std::filesystem::remove(file_, error);
  if (error) return failure(fmt::format("{}: cannot be removed: {}", file_, error.message()));
  return {};
}

Result<std::optional<CheckRecord>> CheckJournal::recover(CheckStore& store) const {
  std::error_code ignored;
  if (!std::filesystem::exists(file_, ignored)) return std::optional<CheckRecord>();
  const Result<std::string> text = read_file(file_);
  if (!text) return tl::unexpected(text.error());
  Result<CheckRecord> record = parse_journal(file_, *text);
  if (!record) return tl::unexpected(record.error());
  const bool on_record = store.load_result(record->id).has_value();
  if (!on_record) {
    record->verdict = Verdict::Error;
    record->reason =
        "The station ended during the check, or before its result was on record. Check this brake again.";
    record->stopped = record->started;  // when it really stopped is not known
    if (const Result<void> saved = store.save(*record); !saved) return tl::unexpected(saved.error());
  }
  if (const Result<void> ended = end(); !ended) return tl::unexpected(ended.error());
  if (on_record) return std::optional<CheckRecord>();
  return std::optional(std::move(*record));
}

}  // namespace clampd::bench
