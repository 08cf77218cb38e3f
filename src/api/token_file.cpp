#include "src/api/token_file.hpp"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <random>
#include <string_view>
#include <system_error>

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include "clampd/api/secret_file.hpp"
#include "clampd/base/entropy.hpp"

namespace clampd::api {

namespace {

constexpr std::size_t kDigits = 64;
constexpr mode_t kPermissions = 0640;  // the operators' group may read it

/// What speaks against a file that is open; empty: nothing.
std::string objection(const struct stat& found) {
  if (!S_ISREG(found.st_mode)) return "it is no regular file";
  if (found.st_uid != geteuid()) return fmt::format("it belongs to user {}", found.st_uid);
  if (found.st_nlink != 1) return "it has a second name";
  if ((found.st_mode & (S_IWGRP | S_IRWXO)) != 0)
    return fmt::format("its permissions are {:04o}, so that others could have read or written it",
                       found.st_mode & 07777U);
  return "";
}

/// The token of an earlier start, or why there is none.
Result<std::string> earlier_token(int file) {
  struct stat found {};
  if (fstat(file, &found) != 0) return failure(std::generic_category().message(errno));
  if (std::string why = objection(found); !why.empty()) return failure(std::move(why));
  std::array<char, kDigits + 2> text{};
  const ssize_t size = read(file, text.data(), text.size());
  const std::string_view token(text.data(), kDigits);
  if (size != kDigits + 1 || text[kDigits] != '\n' ||
      token.find_first_not_of("0123456789abcdef") != std::string_view::npos)
    return failure("it holds something else than a token");
  return std::string(token);
}

std::string random_token() {
  std::random_device random = entropy();
  std::string token;
  for (std::size_t i = 0; i < kDigits / 8; ++i) token += fmt::format("{:08x}", random());
  return token;
}

}  // namespace

Result<std::string> load_or_make_token(const std::string& file) {
  const int opened = open(file.c_str(), O_RDONLY | O_NOFOLLOW | O_NONBLOCK | O_CLOEXEC);
  const int error = errno;
  if (opened >= 0 || error != ENOENT) {
    Result<std::string> earlier =
        failure(error == ELOOP ? "it is a symbolic link" : std::generic_category().message(error));
    if (opened >= 0) {
      earlier = earlier_token(opened);
      close(opened);
    }
    if (earlier) return earlier;
    spdlog::warn("{}: replaced by a new token, since {}; screens need `clampctl screen` again", file,
                 earlier.error().message);
  }
  std::string token = random_token();
  if (const Result<void> written = write_secret_file(file, token + "\n", kPermissions); !written)
    return failure(written.error().message + " (control.token_file)");
  return token;
}

}  // namespace clampd::api
