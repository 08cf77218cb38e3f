#include <stdlib.h>

#include <cmath>
#include <limits>
#include <regex>
#include <set>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "clampd/views/figure.hpp"
#include "clampd/views/page.hpp"

namespace clampd::report {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

Figure two_panels() {
  Panel curves;
  curves.title = "a <b> & 'c' \"d\" `e` @f %g _h^i {j}";
  curves.x = {.label = "time (s)"};
  curves.y = {.label = "force (kN)"};
  curves.layers = {
      Band{.label = "", .x = {0, 1, 2}, .lower = {0, 0, 0}, .upper = {1, 2, 1}},
      Curve{.label = "torque <µ> id='x'", .x = {0, 1, 2, 3}, .y = {1, kNan, 2, 1}},
      Points{.label = "readings", .x = {0, 1}, .y = {0, 1}, .marker = Marker::Ring},
  };
  Panel logarithmic;
  logarithmic.y = {.label = "trace", .logarithmic = true, .lower = 0.1, .upper = 1000};
  logarithmic.layers = {Curve{.label = "falling", .x = {0, 1}, .y = {100, 1}, .stroke = Stroke::Dashed}};
  return {.panels = {curves, logarithmic}, .columns = 2};
}

std::set<std::string> matches(const std::string& text, const std::string& pattern) {
  std::set<std::string> found;
  const std::regex expression(pattern);
  for (std::sregex_iterator match(text.begin(), text.end(), expression), end; match != end; ++match)
    found.insert((*match)[1]);
  return found;
}

TEST(Figure, LabelsAppearAsTheyAreWritten) {
  const Result<std::string> svg = draw(two_panels(), "p-");
  ASSERT_TRUE(svg) << svg.error().message;
  EXPECT_THAT(*svg, ::testing::StartsWith("<svg"));
  EXPECT_THAT(*svg, HasSubstr("time (s)"));
  EXPECT_THAT(*svg, HasSubstr("a &lt;b> &amp; 'c' \"d\" `e` @f %g _h^i {j}"));
  EXPECT_THAT(*svg, HasSubstr("torque &lt;µ> id='x'"));
  EXPECT_THAT(*svg, HasSubstr("readings"));
  EXPECT_THAT(*svg, HasSubstr("falling"));
  EXPECT_THAT(*svg, Not(HasSubstr("<title>")));
  EXPECT_THAT(*svg, Not(HasSubstr("<script")));
}

TEST(Figure, AMissingValueLeavesAGap) {
  Figure figure;
  figure.panels = {
      Panel{.layers = {Curve{.x = {0, 1, 2, 3, 4}, .y = {1, 2, kNan, 2, 1}, .colour = Colour::Green}}}};
  const auto path_of = [](const std::string& svg) {
    std::smatch match;
    std::regex_search(svg, match, std::regex("stroke='rgb\\( *0, 158, 115\\)' +d='([^']*)'"));
    return match.empty() ? std::string() : match[1].str();
  };
  const auto strokes = [](const std::string& path) { return std::count(path.begin(), path.end(), 'M'); };
  const Result<std::string> broken = draw(figure, "");
  ASSERT_TRUE(broken) << broken.error().message;
  EXPECT_EQ(strokes(path_of(*broken)), 2);
  std::get<Curve>(figure.panels[0].layers[0]).y[2] = 3;
  EXPECT_EQ(strokes(path_of(*draw(figure, ""))), 1);
}

TEST(Figure, TwoOnAPageDoNotShareIds) {
  Page page("Two figures", "");
  ASSERT_TRUE(page.figure(two_panels(), "first"));
  ASSERT_TRUE(page.figure(two_panels(), "second"));
  const std::string html = page.html();
  std::multiset<std::string> ids;
  const std::regex expression("<[^>]*\\sid=['\"]([^'\"]+)['\"]");
  for (std::sregex_iterator match(html.begin(), html.end(), expression), end; match != end; ++match)
    ids.insert((*match)[1]);
  EXPECT_GT(ids.size(), 10U);
  EXPECT_EQ(ids.size(), std::set<std::string>(ids.begin(), ids.end()).size());
  for (const std::string& target : matches(html, "href=['\"]#([^'\"]+)['\"]"))
    EXPECT_EQ(ids.count(target), 1U) << target;
}

TEST(Figure, AnEllipseHoldsItsShareOfTheDistribution) {
  const double xx = 4.0, xy = -1.5, yy = 1.0, probability = 0.5;
  const Curve outline = confidence_ellipse(3.0, -2.0, xx, xy, yy, probability);
  const double determinant = xx * yy - xy * xy;
  for (std::size_t i = 0; i < outline.x.size(); ++i) {
    const double dx = outline.x[i] - 3.0, dy = outline.y[i] + 2.0;
    const double squared = (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / determinant;
    // Chi-square with two degrees of freedom: P = 1 - exp(-squared / 2).
    EXPECT_NEAR(1.0 - std::exp(-0.5 * squared), probability, 1e-12);
  }
  EXPECT_NEAR(outline.x.front(), outline.x.back(), 1e-12);
}

TEST(Figure, BarsStandAtNamedTicks) {
  Figure figure;
  figure.panels = {Panel{
      .x = {.label = "evidence", .logarithmic = true, .lower = 0.1, .upper = 100},
      .y = {.lower = 0.4, .upper = 2.6, .ticks = {{1, "first 'one'"}, {2, "the second, much longer name"}}},
      .layers = {
          Bars{.label = "named", .y = {2, 1}, .from = {0.1, 0.1}, .to = {50, 3}, .colour = Colour::Green}}}};
  const Result<std::string> svg = draw(figure, "");
  ASSERT_TRUE(svg) << svg.error().message;
  EXPECT_THAT(*svg, HasSubstr("first 'one'"));
  EXPECT_THAT(*svg, HasSubstr("the second, much longer name"));
  const std::regex bar(R"(fill = 'rgb\( *0, 158, 115\)'[^>]*points = '([0-9.]+),[0-9.]+ ([0-9.]+),)");
  std::vector<double> lengths;
  for (std::sregex_iterator match(svg->begin(), svg->end(), bar), end; match != end; ++match)
    lengths.push_back(std::stod((*match)[2]) - std::stod((*match)[1]));
  ASSERT_EQ(lengths.size(), 3U) << "the legend's sample, then the bars";
  EXPECT_NEAR(lengths[2] / lengths[1], std::log10(3 / 0.1) / std::log10(50 / 0.1), 1e-3);
}

class WithoutGnuplot : public ::testing::Test {
 protected:
  WithoutGnuplot() : path_(getenv("PATH")) { setenv("PATH", "/nonexistent", 1); }
  ~WithoutGnuplot() override { setenv("PATH", path_.c_str(), 1); }

 private:
  std::string path_;
};

TEST_F(WithoutGnuplot, SaysWhatToInstall) {
  const Result<void> possible = can_draw();
  ASSERT_FALSE(possible);
  EXPECT_THAT(possible.error().message, HasSubstr("gnuplot-nox"));
  Page page("", "");
  EXPECT_FALSE(page.figure(two_panels(), ""));
}

TEST(Page, EscapesAllText) {
  const std::string nasty = "<script>alert('&\"')</script>";
  Page page(nasty, nasty);
  page.section(nasty);
  page.paragraph(nasty);
  page.definitions({{nasty, nasty}});
  page.table({.caption = nasty,
              .columns = {{nasty}, {nasty, true}},
              .rows = {{nasty, Cell(nasty, Tone::Bad)}, {"a\tb\nc", "1.0"}}});
  ASSERT_TRUE(page.figure(two_panels(), nasty));
  const std::string html = page.html();
  EXPECT_THAT(html, Not(HasSubstr("<script")));
  EXPECT_THAT(html, Not(HasSubstr("alert('")));
  EXPECT_THAT(html, HasSubstr("&lt;script&gt;alert(&#39;&amp;&quot;&#39;)&lt;/script&gt;"));
  EXPECT_THAT(html, HasSubstr("a b c"));
}

TEST(Page, NeedsNothingFromElsewhere) {
  Page page("Report", "of nothing");
  page.section("First");
  page.paragraph("See https://example.org/ for more.");
  ASSERT_TRUE(page.figure(two_panels(), "A figure."));
  const std::string html = page.html();
  for (const std::string& target : matches(html, "(?:href|src)=['\"]([^'\"]*)['\"]"))
    EXPECT_EQ(target.substr(0, 1), "#") << target;
  EXPECT_THAT(html, Not(HasSubstr("@import")));
  EXPECT_THAT(html, Not(HasSubstr("url(http")));
}

TEST(Page, ListsItsSections) {
  Page page("Report", "");
  page.section("First & last");
  const std::string html = page.html();
  EXPECT_THAT(html, HasSubstr("<a href=\"#section-1\">First &amp; last</a>"));
  EXPECT_THAT(html, HasSubstr("<h2 id=\"section-1\">First &amp; last</h2>"));
}

TEST(Page, MarksCellsAndAlignsNumbers) {
  Page page("Report", "");
  page.table({.columns = {{"what"}, {"value", true}}, .rows = {{"k1", Cell("0.5", Tone::Good)}}});
  EXPECT_THAT(page.html(), HasSubstr("<th scope=\"row\">k1</th><td class=\"number good\">0.5</td>"));
}

}  // namespace
}  // namespace clampd::report
