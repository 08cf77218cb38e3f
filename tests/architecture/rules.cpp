#include "architecture/rules.hpp"

#include <algorithm>
#include <optional>
#include <regex>

#include <fmt/format.h>

namespace clampd::architecture {
namespace {

const Rooms* arrows_of(std::string_view room) {
  for (const auto& [from, to] : arrows())
    if (from == room) return &to;
  return nullptr;
}

struct LibraryRule {
  std::string_view prefix;
  Rooms rooms;
  bool also_in_public_headers;
};

const std::vector<LibraryRule>& library_rules() {
  static const std::vector<LibraryRule> kRules{
      {"ceres/jet.h", {"identify", "brake"}, false},  // numbers with derivatives, no solver
      {"ceres/gradient_problem", {"attribution"}, false},
      {"ceres/first_order_function.h", {"attribution"}, false},
      {"ceres/", {"identify"}, false},
      {"nlopt", {"experiment"}, false},
      {"coin/", {"experiment"}, false},
      {"coin-or/", {"experiment"}, false},
      {"Ip", {"experiment"}, false},
      {"SQLiteCpp/", {"archive"}, false},
      {"sqlite3", {"archive"}, false},
      {"linux/can", {"drivers/can"}, true},
      {"gpiod", {"drivers/gpio"}, false},
      {"mosquitto", {"publish"}, false},
      {"pqxx", {"publish", "reanalysis"}, false},
      {"sparkplug_b.pb", {"publish"}, false},
      {"boost/math/distributions", {"statistics"}, false},
      {"boost/asio", {"http"}, false},
      {"boost/beast", {"http"}, false},
      {"systemd/", {"daemon"}, false},
      {"CLI/", {"tools/clampd", "tools/clampctl", "tools/clampd-plant", "tools/clampd-worker", "tools/factory"}, true},
  };
  return kRules;
}

bool starts_with(std::string_view text, std::string_view prefix) {
  return text.substr(0, prefix.size()) == prefix;
}

std::optional<std::string_view> component(std::string_view path, std::string_view prefix) {
  if (!starts_with(path, prefix)) return std::nullopt;
  const std::string_view rest = path.substr(prefix.size());
  const std::size_t slash = rest.find('/');
  if (slash == std::string_view::npos) return std::nullopt;
  return rest.substr(0, slash);
}

/// Room of a path in the tree or in an #include; nothing for the standard library and other packages.
std::optional<std::string_view> room_of(std::string_view path) {
  if (const auto room = component(path, "include/clampd/")) return room;
  if (const auto room = component(path, "clampd/")) return room;
  if (const auto room = component(path, "src/")) return room;
  if (starts_with(path, "rt/")) return "rt";
  for (const std::string_view folder : {"drivers/", "tools/"})
    if (const auto room = component(path, folder)) return path.substr(0, folder.size() + room->size());
  if (starts_with(path, "tests/")) return "tests";
  return std::nullopt;
}

/// The text with comments and the insides of literals blanked, line breaks kept.
/// `keep_strings`: for #include lines, whose names look like literals.
std::string code_only(std::string_view text, bool keep_strings) {
  std::string code(text);
  enum class In { Code, LineComment, BlockComment, String, Character } in = In::Code;
  for (std::size_t i = 0; i < code.size(); ++i) {
    const char c = code[i];
    const char next = i + 1 < code.size() ? code[i + 1] : '\0';
    switch (in) {
      case In::Code:
        if (c == '/' && next == '/') in = In::LineComment;
        if (c == '/' && next == '*') in = In::BlockComment;
        if (c == '"') in = In::String;
        // a digit before it makes it a separator as in 1'000
        if (c == '\'' && (i == 0 || !std::isalnum(static_cast<unsigned char>(code[i - 1]))))
          in = In::Character;
        if (in == In::LineComment || in == In::BlockComment) code[i] = ' ';
        break;
      case In::LineComment:
        if (c == '\n')
          in = In::Code;
        else
          code[i] = ' ';
        break;
      case In::BlockComment:
        if (c != '\n') code[i] = ' ';
        if (c == '*' && next == '/') {
          code[++i] = ' ';
          in = In::Code;
        }
        break;
      case In::String:
      case In::Character:
        if (c == (in == In::String ? '"' : '\'') || c == '\n')
          in = In::Code;
        else if (!keep_strings)
          code[i] = ' ';
        if (c == '\\' && next != '\0' && next != '\n') ++i;
        break;
    }
  }
  return code;
}

std::size_t line_of(std::string_view text, std::size_t position) {
  return 1 + static_cast<std::size_t>(
                 std::count(text.begin(), text.begin() + static_cast<std::ptrdiff_t>(position), '\n'));
}

struct RealtimeBan {
  const char* pattern;
  const char* what;
};

/// All of control and rt, but for the set-up code that lives in rt/ and may do what the tick may not.
bool is_realtime_path(std::string_view path, std::string_view room) {
  const bool is_setup_code = starts_with(path, "rt/cyclic_thread") || starts_with(path, "rt/readiness") ||
                             starts_with(path, "rt/supervisor_settings");
  return room == "control" || (room == "rt" && !is_setup_code);
}

struct Include {
  std::string path;
  std::size_t line;
};

std::vector<Include> includes_of(std::string_view content) {
  static const std::regex kInclude(R"re((?:^|\n)[ \t]*#[ \t]*include[ \t]*[<"]([^>"\n]+)[>"])re");
  const std::string code = code_only(content, true);
  std::vector<Include> includes;
  for (std::sregex_iterator match(code.begin(), code.end(), kInclude), end; match != end; ++match)
    includes.push_back({(*match)[1], line_of(code, static_cast<std::size_t>(match->position(1)))});
  return includes;
}

void check_includes(const std::string& path, std::string_view room, std::string_view content, std::vector<std::string>& found) {
  const bool is_public_header = starts_with(path, "include/");
  for (const auto& [include, line] : includes_of(content)) {
    if (include.find("..") != std::string::npos)
      found.push_back(fmt::format("{}:{}: includes {} by a path that leaves its folder", path, line, include));
    const auto target = room_of(include);
    if (target && *target != room) {
      const Rooms* allowed = arrows_of(room);
      if (allowed == nullptr)
        found.push_back(fmt::format("{}:{}: room {} has no arrows yet: decide them", path, line, room));
      else if (std::find(allowed->begin(), allowed->end(), *target) == allowed->end())
        found.push_back(fmt::format("{}:{}: {} must not include {} (room {})", path, line, room, include, *target));
    }
    for (const LibraryRule& rule : library_rules()) {  // the first that fits
      if (target || !starts_with(include, rule.prefix)) continue;
      const bool right_room = std::find(rule.rooms.begin(), rule.rooms.end(), room) != rule.rooms.end();
      if (!right_room || (is_public_header && !rule.also_in_public_headers))
        found.push_back(fmt::format("{}:{}: {} must not include <{}>", path, line, room, include));
      break;
    }
  }
}

void check_realtime_path(const std::string& path, const std::string& code, std::vector<std::string>& found) {
  static const std::vector<RealtimeBan> kBans{
      {R"(std::function\b)", "std::function"},
      {R"(\bthrow\b)", "throw"},
      {R"(\bnew\b)", "new"},
      {R"(\bmalloc\s*\()", "malloc"},
      {R"(\bstd::\w*mutex\b)", "a mutex"},
      {R"(\b(lock_guard|unique_lock|scoped_lock|condition_variable)\b)", "a lock"},
      {R"(\bspdlog\b)", "logging"},
      {R"(#\s*include\s*<(iostream|fstream|sstream|cstdio|mutex|shared_mutex|functional|regex)>)",
       "that header"},
      {R"(\bstd::(string|ostringstream|stringstream|to_string|format)\b(?!_view))", "a string"},
      {R"(\bsleep_(for|until)\b)", "sleep"},
  };
  for (const RealtimeBan& ban : kBans) {
    const std::regex pattern(ban.pattern);
    for (std::sregex_iterator match(code.begin(), code.end(), pattern), end; match != end; ++match)
      found.push_back(fmt::format("{}:{}: the real-time path must not use {}", path,
                                  line_of(code, static_cast<std::size_t>(match->position())), ban.what));
  }
}

void check_marks(const std::string& path, const std::string& code, std::vector<std::string>& found) {
  static const std::regex kMark(R"((?:^|\n)(?!\s*#)[^\n]*\bCLAMPD_REALTIME\b)");
  for (std::sregex_iterator match(code.begin(), code.end(), kMark), end; match != end; ++match) {
    const auto start = static_cast<std::size_t>(match->position() + match->length());
    const std::string declaration = code.substr(start, code.find_first_of(";{", start) - start);
    if (declaration.find("noexcept") == std::string::npos)
      found.push_back(
          fmt::format("{}:{}: marked CLAMPD_REALTIME and not noexcept", path, line_of(code, start)));
  }
}

}  // namespace

std::vector<std::string> effects_named_in(std::string_view content) {
  // An effect's name stands before its location; its parameters have neither location nor cause.
  static const std::regex kName(R"re(\.name = "([a-z-]+)",\s*\.location)re");
  const std::string text(content);
  std::vector<std::string> names;
  for (std::sregex_iterator match(text.begin(), text.end(), kName), end; match != end; ++match) names.push_back((*match)[1]);
  return names;
}

std::vector<std::string> effects_named_elsewhere(const std::string& path, std::string_view content,
                                                 const std::vector<std::string>& effects) {
  std::vector<std::string> found;
  if (starts_with(path, "src/brake/effects/") || starts_with(path, "drivers/sim/")) return found;
  const std::string code = code_only(content, true);
  const auto is_part_of_name = [&](std::size_t at) {
    return at < code.size() && (std::isalnum(static_cast<unsigned char>(code[at])) || code[at] == '_' || code[at] == '-');
  };
  for (const std::string& effect : effects)
    for (std::size_t at = code.find(effect); at != std::string::npos; at = code.find(effect, at + 1))
      if (!is_part_of_name(at - 1) && !is_part_of_name(at + effect.size()))
        found.push_back(fmt::format("{}:{}: names the effect {}: let it say so by a hook", path, line_of(code, at), effect));
  return found;
}

const std::vector<std::pair<std::string_view, Rooms>>& arrows() {
  static const std::vector<std::pair<std::string_view, Rooms>> kArrows{
      {"base", {}},
      {"statistics", {"base"}},
      {"record", {"base"}},
      {"ports", {"record", "base"}},
      {"parameters", {"record", "base"}},
      {"control", {"record", "base"}},
      {"brake", {"parameters", "record", "base"}},
      {"identify", {"brake", "parameters", "record", "statistics", "base"}},
      {"experiment", {"control", "identify", "brake", "parameters", "record", "statistics", "base"}},
      {"sheet", {"experiment", "control", "identify", "brake", "parameters", "record", "statistics", "base"}},
      {"diagnose", {"experiment", "identify", "brake", "parameters", "record", "statistics", "base"}},
      {"drive", {"diagnose", "statistics", "record", "base"}},
      {"station", {"diagnose", "sheet", "experiment", "identify", "brake", "parameters", "ports", "record", "statistics", "base"}},
      {"archive", {"record", "base"}},
      {"publish", {"archive", "record", "base"}},
      {"line", {"archive", "station", "record", "statistics", "base"}},
      {"attribution", {"statistics", "base"}},
      {"views", {"line", "attribution", "archive", "station", "drive", "diagnose", "brake", "record", "base"}},
      {"reanalysis",
       {"views", "publish", "attribution", "archive", "station", "sheet", "diagnose", "identify", "brake", "parameters", "record", "base"}},
      {"line_page",
       {"reanalysis", "views", "line", "attribution", "parameters", "record", "base"}},
      {"rt", {"control", "ports", "record", "base"}},
      {"drivers/can", {"ports", "record", "base"}},
      {"drivers/gpio", {"ports", "record", "base"}},
      {"drivers/sim", {"parameters", "ports", "record", "base"}},
      {"simulation", {"rt", "drivers/can", "drivers/sim", "experiment", "brake", "parameters", "record", "base"}},
      {"bench",
       {"simulation", "rt", "drivers/can", "drivers/gpio", "drivers/sim", "publish", "archive", "station", "sheet", "experiment", "identify",
        "brake", "record", "base"}},
      {"http", {"base"}},
      {"api", {"http", "rt", "ports", "archive", "station", "record", "base"}},
      {"daemon", {"api", "bench", "rt", "drivers/can", "drivers/gpio", "views", "line", "archive", "record", "base"}},
      {"tools/cli", {"record", "base"}},
      {"tools/dashboard", {"http"}},
      {"tools/reproduce", {"simulation", "views", "experiment", "identify", "record", "base"}},
      {"tools/clampd-plant", {"tools/cli", "bench", "simulation", "rt", "drivers/can", "base"}},
      {"tools/clampd-worker",
       {"tools/dashboard", "tools/cli", "http", "line_page", "reanalysis", "publish", "station", "base"}},
      {"tools/factory", {"tools/cli", "bench", "drivers/sim", "publish", "archive", "station", "record", "base"}},
      {"tools/clampd", {"tools/dashboard", "tools/cli", "daemon", "api", "bench", "drivers/gpio", "base"}},
      {"tools/clampctl",
       {"tools/reproduce", "tools/cli", "reanalysis", "publish", "api", "bench", "simulation", "rt", "drivers/can", "drivers/gpio", "drivers/sim", "views", "line",
        "attribution",
        "archive", "station", "sheet", "drive", "diagnose", "experiment", "identify", "brake", "parameters", "record", "base"}},
  };
  return kArrows;
}

std::vector<std::string> violations(const std::string& path, std::string_view content) {
  std::vector<std::string> found;
  const auto room = room_of(path);
  if (!room || *room == "tests") return found;
  check_includes(path, *room, content, found);
  const std::string code = code_only(content, false);
  if (is_realtime_path(path, *room)) check_realtime_path(path, code, found);
  check_marks(path, code, found);
  return found;
}

}  // namespace clampd::architecture
