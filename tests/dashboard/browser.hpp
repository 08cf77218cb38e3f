#pragma once

#include <memory>
#include <string>

#include <nlohmann/json.hpp>

#include "dashboard/program.hpp"
#include "support/temporary_directory.hpp"

namespace clampd::screen {

// What the keyboard sends for keys without a character (W3C WebDriver).
inline constexpr const char* kEnter = "\uE007";
inline constexpr const char* kEscape = "\uE00C";
inline constexpr const char* kTab = "\uE004";
inline constexpr const char* kDown = "\uE015";
inline constexpr const char* kF2 = "\uE032";
inline constexpr const char* kF3 = "\uE033";
inline constexpr const char* kF4 = "\uE034";

/// Chromium without a window, driven like by a person: keys go to whatever has the focus. Mistakes of the
/// conversation itself throw std::runtime_error.
class Browser {
 public:
  /// Whether the machine has Chromium and its driver.
  static bool is_installed();

  Browser(int width, int height);
  ~Browser();

  void open(const std::string& address);
  /// One key after the other, down and up, as a keyboard or a barcode scanner does.
  void type(const std::string& text);
  /// What `return EXPRESSION` gives.
  nlohmann::json value(const std::string& expression);
  std::string text(const std::string& selector);
  /// Whether the expression becomes true within the time.
  bool becomes(const std::string& expression, int seconds = 30);
  void prefer_dark(bool dark);
  /// Every answer takes so much longer.
  void delay_network(int latency_ms);
  /// Another screen, as wide and high as this.
  void resize(int width, int height);
  void save_picture(const std::string& file);
  /// What the console has said since the last time: errors, blocked content.
  std::string complaints();

 private:
  nlohmann::json ask(const std::string& method, const std::string& path, const nlohmann::json& body = {});

  support::TemporaryDirectory folder_;
  int port_;
  Program driver_;
  std::string session_;
};

}  // namespace clampd::screen
