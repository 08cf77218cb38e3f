#pragma once

// Every check and every amendment of one gets an entry in the table `chain`: the SHA-256 of its contents, and
// the SHA-256 of that together with the entry before. A record that is changed, taken out or put in shows.

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "src/archive/database.hpp"

namespace clampd {

/// SHA-256 over all columns of a record in their order, as they are stored. Of raw runs their checksums
/// count, not the data, so that retention may remove those.
class ContentDigest {
 public:
  explicit ContentDigest(SQLite::Database& database);

  /// Nothing if there is no such check or amendment. `format`: of the link that seals it.
  std::optional<std::string> of_check(const std::string& id, int format);
  std::optional<std::string> of_amendment(std::int64_t id);

 private:
  struct Table {
    std::string name;
    SQLite::Statement rows;
  };
  std::vector<SQLite::Statement> checks_;  ///< of format 1, 2, ...
  std::vector<Table> tables_;              ///< the others
  SQLite::Statement amendment_;
};

/// One entry.
struct ChainLink {
  std::int64_t position = 0;  ///< 1, 2, ...
  std::string check_id;
  std::optional<std::int64_t> amendment;  ///< nothing: the check itself
  int format = 0;
  std::string content_sha256;
  std::string chain_sha256;
};

/// What the columns of contents are: another format where a later version stores more.
inline constexpr int kChainFormat = 6;

/// The link's own SHA-256: over all of it and the one before.
std::string link_sha256(const ChainLink& link, const std::string& chain_before);

ChainLink read_link(SQLite::Statement& all_columns);

/// Adds entries at the end, within the caller's transaction.
class Chain {
 public:
  explicit Chain(SQLite::Database& database);

  void append_check(const std::string& id);
  void append_amendment(const std::string& check_id, std::int64_t amendment);

 private:
  void append(ChainLink link, const std::optional<std::string>& content);

  SQLite::Database& database_;
  ContentDigest digest_;
  std::int64_t last_position_ = 0;
  std::string last_sha256_;
};

/// Whether the check is as it was recorded, and its amendments too. Errors say what is not.
Result<void> unchanged(SQLite::Database& database, const std::string& path, const std::string& id);

}  // namespace clampd
