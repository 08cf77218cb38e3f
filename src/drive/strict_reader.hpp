#pragma once

#include <optional>
#include <string>

#include <fmt/format.h>
#include <toml++/toml.h>

#include "clampd/base/result.hpp"

namespace clampd::drive {

/// Reads a TOML document strictly: goes on after an error, and keeps the first one with its place.
class StrictReader {
 public:
  StrictReader(const toml::table& document, const std::string& path) : document_(document), path_(path) {}

  const std::optional<Error>& error() const { return error_; }

 protected:
  void refuse(const toml::node& where, const std::string& message) {
    const toml::source_position at = where.source().begin;
    if (!error_) error_ = Error{fmt::format("{}:{}:{}: {}", path_, at.line, at.column, message)};
  }

  const toml::table& document_;
  const std::string& path_;
  std::optional<Error> error_;
};

}  // namespace clampd::drive
