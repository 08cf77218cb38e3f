#pragma once

#include <string>
#include <variant>
#include <vector>

#include "clampd/base/result.hpp"

namespace clampd::report {

/// Okabe and Ito's palette, which colour-blind readers can tell apart.
enum class Colour { Black, Grey, Blue, Orange, Green, Vermilion, Sky, Purple };
enum class Stroke { Solid, Dashed, Dotted };
enum class Marker { Dot, Ring, Square, Triangle, Cross };

/// A line through points. All series: x and y of equal length, a NaN leaves a gap, and an empty label keeps
/// the series out of the legend.
struct Curve {
  std::string label = {};
  std::vector<double> x = {};
  std::vector<double> y = {};
  Colour colour = Colour::Blue;
  Stroke stroke = Stroke::Solid;
  double width_px = 1.6;
  bool held = false;  ///< each value holds until the next x
};

struct Points {
  std::string label = {};
  std::vector<double> x = {};
  std::vector<double> y = {};
  Colour colour = Colour::Blue;
  Marker marker = Marker::Dot;
  double size = 0.5;  ///< 1 is about 10 px
};

/// The area between two curves.
struct Band {
  std::string label = {};
  std::vector<double> x = {};
  std::vector<double> lower = {};
  std::vector<double> upper = {};
  Colour colour = Colour::Blue;
};

/// Horizontal bars, one at each y.
struct Bars {
  std::string label = {};
  std::vector<double> y = {};
  std::vector<double> from = {};
  std::vector<double> to = {};
  Colour colour = Colour::Blue;
  double thickness = 0.7;  ///< in units of y
};

struct Tick {
  double at = 0.0;
  std::string label = {};
};

struct Axis {
  std::string label = {};  ///< with its unit
  bool logarithmic = false;
  double lower = 0.0;  ///< both equal: as the data need
  double upper = 0.0;
  std::vector<Tick> ticks = {};  ///< empty: numbers where they are convenient
};

/// One pair of axes. The layers are drawn in their order.
struct Panel {
  std::string title = {};
  Axis x = {};
  Axis y = {};
  std::vector<std::variant<Curve, Points, Band, Bars>> layers = {};
};

/// Panels in rows of `columns`.
struct Figure {
  std::vector<Panel> panels = {};
  int columns = 1;
  int width_px = 880;
  int panel_height_px = 240;
};

/// The outline of the region that holds `probability` of a Gaussian of two variables with this mean and
/// covariance ((xx, xy), (xy, yy)).
Curve confidence_ellipse(double mean_x, double mean_y, double xx, double xy, double yy, double probability);

/// Whether figures can be drawn here: found out before minutes of work rather than after. Drawing needs the
/// program gnuplot.
Result<void> can_draw();

/// The figure as an <svg> element for an HTML page, as wide as the page lets it be and at most width_px.
/// Every id in it starts with `id_prefix`, so that several figures can share a page. Errors: gnuplot is
/// missing, or says what it could not draw.
Result<std::string> draw(const Figure& figure, const std::string& id_prefix);

}  // namespace clampd::report
