#include "clampd/views/figure.hpp"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <numbers>

#include <fmt/format.h>

#include "clampd/base/assert.hpp"
#include "src/views/gnuplot.hpp"

namespace clampd::report {
namespace {

constexpr int kFontSize_px = 13;

const char* rgb(Colour colour) {
  switch (colour) {
    case Colour::Black:
      return "#000000";
    case Colour::Grey:
      return "#8a8a8a";
    case Colour::Blue:
      return "#0072b2";
    case Colour::Orange:
      return "#e69f00";
    case Colour::Green:
      return "#009e73";
    case Colour::Vermilion:
      return "#d55e00";
    case Colour::Sky:
      return "#56b4e9";
    case Colour::Purple:
      return "#cc79a7";
  }
  return "#000000";
}

const char* dashes(Stroke stroke) {
  switch (stroke) {
    case Stroke::Solid:
      return "solid";
    case Stroke::Dashed:
      return "'-'";
    case Stroke::Dotted:
      return "'.'";
  }
  return "solid";
}

int point_type(Marker marker) {
  switch (marker) {
    case Marker::Dot:
      return 7;
    case Marker::Ring:
      return 6;
    case Marker::Square:
      return 5;
    case Marker::Triangle:
      return 9;
    case Marker::Cross:
      return 2;
  }
  return 7;
}

/// A gnuplot string, in which nothing but the quote has a meaning.
std::string quoted(const std::string& text) {
  std::string result = "'";
  for (const char c : text) {
    if (c == '\'') result += '\'';
    result += static_cast<unsigned char>(c) < 0x20 ? ' ' : c;
  }
  return result + "'";
}

std::string title_of(const std::string& label) {
  return label.empty() ? "notitle" : "title " + quoted(label);
}

void write_number(std::string& script, double value) {
  if (std::isfinite(value))
    fmt::format_to(std::back_inserter(script), "{:.7g} ", value);
  else
    script += "NaN ";
}

/// Writes a named block of data and plots it.
class LayerWriter {
 public:
  LayerWriter(std::string& data, std::string& plot, int& blocks)
      : data_(data), plot_(plot), blocks_(blocks) {}

  void operator()(const Curve& curve) {
    block({&curve.x, &curve.y});
    fmt::format_to(std::back_inserter(plot_), "using 1:2 with {} lw {:.2f} dt {} lc rgb '{}' {}",
                   curve.held ? "steps" : "lines", curve.width_px, dashes(curve.stroke), rgb(curve.colour),
                   title_of(curve.label));
  }
  void operator()(const Points& points) {
    block({&points.x, &points.y});
    fmt::format_to(std::back_inserter(plot_), "using 1:2 with points pt {} ps {:.2f} lc rgb '{}' {}",
                   point_type(points.marker), points.size, rgb(points.colour), title_of(points.label));
  }
  void operator()(const Band& band) {
    block({&band.x, &band.lower, &band.upper});
    fmt::format_to(std::back_inserter(plot_),
                   "using 1:2:3 with filledcurves fs transparent solid 0.25 noborder lc rgb '{}' {}",
                   rgb(band.colour), title_of(band.label));
  }
  void operator()(const Bars& bars) {
    std::vector<double> below(bars.y), above(bars.y);
    for (double& y : below) y -= 0.5 * bars.thickness;
    for (double& y : above) y += 0.5 * bars.thickness;
    block({&bars.from, &bars.y, &bars.from, &bars.to, &below, &above});
    fmt::format_to(std::back_inserter(plot_),
                   "using 1:2:3:4:5:6 with boxxyerror fs solid 0.85 noborder lc rgb '{}' {}",
                   rgb(bars.colour), title_of(bars.label));
  }

 private:
  void block(const std::vector<const std::vector<double>*>& columns) {
    const std::size_t rows = columns.front()->size();
    fmt::format_to(std::back_inserter(data_), "$data{} << END\n", blocks_);
    for (const std::vector<double>* column : columns) CLAMPD_ASSERT(column->size() == rows);
    for (std::size_t k = 0; k < rows; ++k) {
      for (const std::vector<double>* column : columns) write_number(data_, (*column)[k]);
      data_ += '\n';
    }
    data_ += "END\n";
    fmt::format_to(std::back_inserter(plot_), "{}$data{} ", plot_.empty() ? "plot " : ", ", blocks_++);
  }

  std::string& data_;
  std::string& plot_;
  int& blocks_;
};

void write_axis(std::string& script, char name, const Axis& axis) {
  fmt::format_to(std::back_inserter(script), "set {}label {}\n", name, quoted(axis.label));
  fmt::format_to(std::back_inserter(script), "{} logscale {}\n", axis.logarithmic ? "set" : "unset", name);
  fmt::format_to(std::back_inserter(script), "set format {} '{}'\n", name, axis.logarithmic ? "%.0e" : "%g");
  if (axis.lower < axis.upper)
    fmt::format_to(std::back_inserter(script), "set {}range [{}:{}]\n", name, axis.lower, axis.upper);
  else
    fmt::format_to(std::back_inserter(script), "set {}range [*:*]\n", name);
  if (axis.ticks.empty()) {
    fmt::format_to(std::back_inserter(script), "set {}tics autofreq\n", name);
    return;
  }
  fmt::format_to(std::back_inserter(script), "set {}tics (", name);
  for (const Tick& tick : axis.ticks)
    fmt::format_to(std::back_inserter(script), "{}{} {:.7g}", &tick == &axis.ticks.front() ? "" : ", ",
                   quoted(tick.label), tick.at);
  script += ")\n";
}

/// Characters to the left of a panel; its y axis' numbers need 10.
int left_margin(const Panel& panel) {
  std::size_t longest = 7;
  for (const Tick& tick : panel.y.ticks) longest = std::max(longest, tick.label.size());
  return static_cast<int>(longest) + 3;
}

int rows_of(const Figure& figure) {
  const int panels = static_cast<int>(figure.panels.size());
  return (panels + figure.columns - 1) / figure.columns;
}

std::string script_of(const Figure& figure) {
  const int rows = rows_of(figure);
  std::string data;
  std::string commands = fmt::format(
      "set encoding utf8\n"
      "set minussign\n"
      "set terminal svg size {},{} dynamic noenhanced rounded font 'sans-serif,{}'\n"
      "set border 3 lc rgb '#555555'\n"
      "set tics nomirror textcolor rgb '#222222'\n"
      "set grid lc rgb '#dddddd' lw 0.7 dt solid\n"
      "set key tmargin center horizontal Left reverse samplen 2.5 noautotitle\n"
      "set rmargin 2\n"
      "set multiplot layout {},{}\n",
      figure.width_px, rows * figure.panel_height_px, kFontSize_px, rows, figure.columns);
  int blocks = 0;
  for (const Panel& panel : figure.panels) {
    CLAMPD_ASSERT(!panel.layers.empty());
    fmt::format_to(std::back_inserter(commands), "set title {}\n", quoted(panel.title));
    write_axis(commands, 'x', panel.x);
    write_axis(commands, 'y', panel.y);
    fmt::format_to(std::back_inserter(commands), "set lmargin {}\n", left_margin(panel));
    std::string plot;
    for (const auto& layer : panel.layers) std::visit(LayerWriter(data, plot, blocks), layer);
    commands += plot + "\n";
  }
  return data + commands + "unset multiplot\n";
}

void replace_all(std::string& text, const std::string& what, const std::string& with) {
  for (std::size_t at = 0; (at = text.find(what, at)) != std::string::npos; at += with.size())
    text.replace(at, what.size(), with);
}

/// Prefixes the ids and the references to them, within tags only: labels may hold the same characters.
std::string with_own_ids(const std::string& svg, const std::string& prefix) {
  std::string result;
  std::size_t at = 0;
  while (at < svg.size()) {
    const std::size_t open = std::min(svg.find('<', at), svg.size());
    const std::size_t close = std::min(svg.find('>', open), svg.size());
    result.append(svg, at, open - at);
    std::string tag = svg.substr(open, close - open);
    for (const char* quote : {"'", "\""}) {
      replace_all(tag, fmt::format(" id={}", quote), fmt::format(" id={}{}", quote, prefix));
      replace_all(tag, fmt::format("href={}#", quote), fmt::format("href={}#{}", quote, prefix));
    }
    replace_all(tag, "url(#", "url(#" + prefix);
    result += tag;
    at = close;
  }
  return result;
}

void remove_elements(std::string& svg, const std::string& name) {
  const std::string opening = fmt::format("<{}>", name), closing = fmt::format("</{}>", name);
  for (std::size_t at = 0; (at = svg.find(opening, at)) != std::string::npos;) {
    const std::size_t end = svg.find(closing, at);
    if (end == std::string::npos) return;
    svg.erase(at, end + closing.size() - at);
  }
}

}  // namespace

Curve confidence_ellipse(double mean_x, double mean_y, double xx, double xy, double yy, double probability) {
  constexpr int kSegments = 72;
  const double scale = std::sqrt(-2.0 * std::log1p(-probability));
  // The Cholesky factor of the covariance takes the unit circle to the outline.
  const double l11 = std::sqrt(xx), l21 = xy / l11, l22 = std::sqrt(std::max(yy - l21 * l21, 0.0));
  Curve outline;
  for (int i = 0; i <= kSegments; ++i) {
    const double angle = 2.0 * std::numbers::pi * i / kSegments;
    outline.x.push_back(mean_x + scale * l11 * std::cos(angle));
    outline.y.push_back(mean_y + scale * (l21 * std::cos(angle) + l22 * std::sin(angle)));
  }
  return outline;
}

Result<void> can_draw() {
  const Result<std::string> answer = run_gnuplot("set terminal svg\n");
  if (!answer) return tl::unexpected(answer.error());
  return {};
}

Result<std::string> draw(const Figure& figure, const std::string& id_prefix) {
  CLAMPD_ASSERT(!figure.panels.empty() && figure.columns > 0);
  Result<std::string> drawn = run_gnuplot(script_of(figure));
  if (!drawn) return drawn;
  const std::size_t start = drawn->find("<svg");
  if (start == std::string::npos) return failure("gnuplot drew nothing; its svg terminal is needed");
  std::string svg = drawn->substr(start);
  // Its titles would show as tooltips.
  remove_elements(svg, "title");
  remove_elements(svg, "desc");
  svg.insert(4, fmt::format(" style=\"max-width:{}px\"", figure.width_px));
  return with_own_ids(svg, id_prefix);
}

}  // namespace clampd::report
