#pragma once

#include <string>
#include <utility>
#include <vector>

#include "clampd/base/result.hpp"
#include "clampd/views/figure.hpp"

namespace clampd::report {

/// How a table cell is marked.
enum class Tone { Plain, Good, Mixed, Bad };

struct Cell {
  std::string text = {};
  Tone tone = Tone::Plain;

  Cell(std::string content) : text(std::move(content)) {}
  Cell(const char* content) : text(content) {}
  Cell(std::string content, Tone marked) : text(std::move(content)), tone(marked) {}
};

struct Column {
  std::string heading = {};
  bool number = false;  ///< right-aligned, digits of equal width: give all cells the same number of decimals
};

struct Table {
  std::string caption = {};
  std::vector<Column> columns = {};
  std::vector<std::vector<Cell>> rows = {};  ///< each as long as `columns`; the first cell names the row
};

/// Minus signs of numbers as such; hyphens stay.
std::string typographic(const std::string& text);

/// A report as one HTML file that needs nothing else: no network, no script, figures inline, light and dark,
/// fit for printing. All text is plain (UTF-8) and gets escaped here.
class Page {
 public:
  Page(std::string title, std::string subtitle);

  /// One word in full size with a line below it, to be read from afar.
  void banner(const std::string& word, Tone tone, const std::string& text);
  /// Starts a section, which the contents list names.
  void section(const std::string& heading);
  void paragraph(const std::string& text);
  /// Terms and what is to be said of each.
  void definitions(const std::vector<std::pair<std::string, std::string>>& entries);
  void table(const Table& table);
  /// Draws the figure. Errors are those of draw().
  Result<void> figure(const Figure& figure, const std::string& caption);

  std::string html() const;

 private:
  std::string title_;
  std::string subtitle_;
  std::vector<std::string> headings_;
  std::string body_;
  int figures_ = 0;
};

/// Text with the five characters replaced that mean something in HTML, control characters by spaces.
std::string escaped(const std::string& text);

}  // namespace clampd::report
