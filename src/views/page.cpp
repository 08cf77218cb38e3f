#include "clampd/views/page.hpp"

#include <iterator>

#include <fmt/format.h>

#include "clampd/base/assert.hpp"

namespace clampd::report {
namespace {

constexpr const char* kStyle = R"(
:root { color-scheme: light dark; --ink: #1d1f21; --soft: #5b6166; --paper: #fbfbf9; --line: #d5d7d3;
  --good: #00694d; --mixed: #8a5a00; --bad: #a83a00; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e4e5e3; --soft: #a3a8ab; --paper: #191b1c; --line: #3c4042;
    --good: #4cc49e; --mixed: #e6b450; --bad: #f08a5a; } }
body { margin: 0 auto; padding: 2rem 1.25rem 4rem; max-width: 58rem; color: var(--ink); background: var(--paper);
  font: 16px/1.5 system-ui, sans-serif; }
h1 { font-size: 1.8rem; line-height: 1.2; margin: 0 0 .3rem; }
h2 { font-size: 1.25rem; margin: 3rem 0 .6rem; padding-top: .8rem; border-top: 1px solid var(--line); }
p { margin: .6rem 0; max-width: 48rem; }
.subtitle { color: var(--soft); margin-bottom: 1.5rem; }
nav { margin: 1.2rem 0; padding: .7rem 1.1rem; border: 1px solid var(--line); border-radius: 6px; }
nav ol { margin: 0; padding-left: 1.3rem; columns: 18rem 2; }
nav li { break-inside: avoid; }
a { color: inherit; }
dl { margin: .8rem 0; max-width: 48rem; }
dt { font-weight: 600; }
dd { margin: 0 0 .6rem 0; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; margin: .9rem 0; font-size: .92rem; line-height: 1.35; }
caption { text-align: left; color: var(--soft); padding-bottom: .35rem; }
th, td { padding: .3rem .75rem .3rem 0; text-align: left; vertical-align: top; border-bottom: 1px solid var(--line);
  font-weight: normal; }
thead th { font-weight: 600; vertical-align: bottom; }
tbody th { white-space: nowrap; }
thead .number { white-space: normal; }
.number { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
.good, .mixed, .bad { font-weight: 600; white-space: nowrap; }
.good { color: var(--good); } .mixed { color: var(--mixed); } .bad { color: var(--bad); }
.banner { margin: 1.5rem 0; padding: 1rem 1.25rem; border-radius: 6px; color: #fff; }
.banner strong { display: block; font-size: clamp(3rem, 14vw, 7rem); line-height: 1.05; letter-spacing: .02em; }
.banner p { font-size: 1.1rem; margin: .5rem 0 0; }
.banner-good { background: #00694d; } .banner-mixed { background: #e6b450; color: #1d1f21; }
.banner-bad { background: #a3260f; } .banner-plain { background: #5b6166; }
figure { margin: 1.2rem 0; padding: .6rem; background: #fff; color: #1d1f21; border: 1px solid var(--line);
  border-radius: 6px; }
figure svg { display: block; width: 100%; height: auto; margin: 0 auto; }
figcaption { padding: .5rem .4rem 0; font-size: .9rem; color: #4a4f53; }
@media print {
  .banner { print-color-adjust: exact; -webkit-print-color-adjust: exact; }
  body { max-width: none; padding: 0; font-size: 10.5pt; }
  figure, tr, dd, nav { break-inside: avoid; }
  h2, caption, dt { break-after: avoid; }
}
)";

const char* tone_class(Tone tone) {
  switch (tone) {
    case Tone::Plain:
      return "";
    case Tone::Good:
      return "good";
    case Tone::Mixed:
      return "mixed";
    case Tone::Bad:
      return "bad";
  }
  return "";
}

std::string attributes(const Column& column, Tone tone) {
  const std::string marked = tone_class(tone);
  if (!column.number) return marked.empty() ? "" : fmt::format(" class=\"{}\"", marked);
  return fmt::format(" class=\"number{}{}\"", marked.empty() ? "" : " ", marked);
}

bool is_digit(char c) {
  return c >= '0' && c <= '9';
}

}  // namespace

std::string escaped(const std::string& text) {
  std::string result;
  for (const char c : text) {
    switch (c) {
      case '&':
        result += "&amp;";
        break;
      case '<':
        result += "&lt;";
        break;
      case '>':
        result += "&gt;";
        break;
      case '"':
        result += "&quot;";
        break;
      case '\'':
        result += "&#39;";
        break;
      default:
        result += static_cast<unsigned char>(c) < 0x20 ? ' ' : c;
    }
  }
  return result;
}

std::string typographic(const std::string& text) {
  std::string result;
  for (std::size_t i = 0; i < text.size(); ++i) {
    const bool exponent = i >= 2 && text[i - 1] == 'e' && is_digit(text[i - 2]);
    const bool sign = text[i] == '-' && i + 1 < text.size() && is_digit(text[i + 1]) &&
                      (i == 0 || text[i - 1] == ' ' || exponent);
    result += sign ? "−" : std::string(1, text[i]);
  }
  return result;
}

Page::Page(std::string title, std::string subtitle)
    : title_(std::move(title)), subtitle_(std::move(subtitle)) {}

void Page::section(const std::string& heading) {
  headings_.push_back(heading);
  body_ += fmt::format("<h2 id=\"section-{}\">{}</h2>\n", headings_.size(), escaped(heading));
}

void Page::banner(const std::string& word, Tone tone, const std::string& text) {
  body_ += fmt::format("<div class=\"banner banner-{}\"><strong>{}</strong><p>{}</p></div>\n",
                       tone == Tone::Plain ? "plain" : tone_class(tone), escaped(word), escaped(text));
}

void Page::paragraph(const std::string& text) {
  body_ += fmt::format("<p>{}</p>\n", escaped(text));
}

void Page::definitions(const std::vector<std::pair<std::string, std::string>>& entries) {
  body_ += "<dl>\n";
  for (const auto& [term, text] : entries)
    body_ += fmt::format("<dt>{}</dt><dd>{}</dd>\n", escaped(term), escaped(text));
  body_ += "</dl>\n";
}

void Page::table(const Table& table) {
  body_ += "<div class=\"wide\"><table>\n";
  if (!table.caption.empty()) body_ += fmt::format("<caption>{}</caption>\n", escaped(table.caption));
  body_ += "<thead><tr>";
  for (const Column& column : table.columns)
    body_ +=
        fmt::format("<th scope=\"col\"{}>{}</th>", attributes(column, Tone::Plain), escaped(column.heading));
  body_ += "</tr></thead>\n<tbody>\n";
  for (const std::vector<Cell>& row : table.rows) {
    CLAMPD_ASSERT(row.size() == table.columns.size());
    body_ += "<tr>";
    for (std::size_t i = 0; i < row.size(); ++i)
      body_ +=
          fmt::format("<{0}{1}>{2}</{3}>", i == 0 ? "th scope=\"row\"" : "td",
                      attributes(table.columns[i], row[i].tone), escaped(row[i].text), i == 0 ? "th" : "td");
    body_ += "</tr>\n";
  }
  body_ += "</tbody></table></div>\n";
}

Result<void> Page::figure(const Figure& figure, const std::string& caption) {
  const Result<std::string> svg = draw(figure, fmt::format("figure-{}-", ++figures_));
  if (!svg) return tl::unexpected(svg.error());
  body_ += fmt::format("<figure>\n{}<figcaption>{}</figcaption>\n</figure>\n", *svg, escaped(caption));
  return {};
}

std::string Page::html() const {
  std::string contents;
  for (std::size_t i = 0; i < headings_.size(); ++i)
    fmt::format_to(std::back_inserter(contents), "<li><a href=\"#section-{}\">{}</a></li>\n", i + 1,
                   escaped(headings_[i]));
  return fmt::format(
      "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n"
      "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n"
      "<title>{0}</title>\n<style>{1}</style>\n</head>\n<body>\n<header>\n<h1>{0}</h1>\n"
      "<p class=\"subtitle\">{2}</p>\n</header>\n<nav "
      "aria-label=\"Contents\"><ol>\n{3}</ol></nav>\n{4}</body>\n"
      "</html>\n",
      escaped(title_), kStyle, escaped(subtitle_), contents, body_);
}

}  // namespace clampd::report
