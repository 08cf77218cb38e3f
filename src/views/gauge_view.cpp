#include "clampd/views/gauge_view.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <iterator>

#include <fmt/format.h>

#include "clampd/base/json.hpp"
#include "clampd/views/page.hpp"

namespace clampd {
namespace {

using nlohmann::ordered_json;
using quality::GaugeComponent;
using quality::GaugeStudy;

struct NamedComponent {
  const char* key;
  const char* name;
  GaugeComponent GaugeStudy::*component;
};

constexpr std::array<NamedComponent, 7> kComponents{{
    {"repeatability", "repeatability (EV)", &GaugeStudy::repeatability},
    {"reproducibility", "reproducibility", &GaugeStudy::reproducibility},
    {"operators", "  operators (AV)", &GaugeStudy::operator_effect},
    {"interaction", "  parts x operators", &GaugeStudy::interaction},
    {"gauge", "gauge R&R (GRR)", &GaugeStudy::gauge},
    {"parts", "parts (PV)", &GaugeStudy::part_variation},
    {"total", "total (TV)", &GaugeStudy::total},
}};

std::string percent(double share) {
  return std::isfinite(share) ? fmt::format("{:.2f} %", 100.0 * share) : "-";
}

/// Judged by the worse of the two shares that there are.
quality::GaugeGrade grade_of(const GaugeStudy& study) {
  const double share = std::isfinite(study.gauge.of_tolerance)
                           ? std::max(study.gauge.of_total, study.gauge.of_tolerance)
                           : study.gauge.of_total;
  return quality::grade(share);
}

std::vector<std::string> names_of(const GaugeQuantity& quantity, std::string quality::GaugeReading::*member) {
  std::vector<std::string> names;
  for (const quality::GaugeReading& reading : quantity.readings)
    if (std::find(names.begin(), names.end(), reading.*member) == names.end())
      names.push_back(reading.*member);
  std::sort(names.begin(), names.end());
  return names;
}

constexpr std::array kColours{report::Colour::Blue,   report::Colour::Vermilion, report::Colour::Green,
                              report::Colour::Orange, report::Colour::Purple,    report::Colour::Sky};

report::Panel by_part(const GaugeQuantity& quantity, bool legend) {
  const auto parts = names_of(quantity, &quality::GaugeReading::part);
  const auto operators = names_of(quantity, &quality::GaugeReading::operator_name);
  report::Panel panel;
  panel.title = quantity.name + (quantity.unit.empty() ? "" : ", " + quantity.unit);
  panel.x.lower = 0.4;
  panel.x.upper = static_cast<double>(parts.size()) + 0.6;
  for (std::size_t i = 0; i < parts.size(); ++i)
    panel.x.ticks.push_back({static_cast<double>(i + 1), std::to_string(i + 1)});
  for (std::size_t o = 0; o < operators.size(); ++o) {
    report::Points points;
    points.label = legend ? operators[o] : "";
    points.colour = kColours[o % kColours.size()];
    points.marker = report::Marker::Dot;
    points.size = 0.5;
    const double shift = 0.22 * (static_cast<double>(o) - 0.5 * static_cast<double>(operators.size() - 1));
    for (const quality::GaugeReading& reading : quantity.readings) {
      if (reading.operator_name != operators[o]) continue;
      const auto part = std::find(parts.begin(), parts.end(), reading.part) - parts.begin();
      points.x.push_back(static_cast<double>(part + 1) + shift);
      points.y.push_back(reading.value);
    }
    panel.layers.emplace_back(std::move(points));
  }
  return panel;
}

report::Panel shares(const std::vector<GaugeQuantity>& quantities) {
  report::Panel panel;
  panel.x.label = "share of the total variation, %";
  panel.x.lower = 0.0;
  panel.x.upper = 100.0;
  panel.y.lower = 0.4;
  panel.y.upper = static_cast<double>(quantities.size()) + 0.6;
  report::Bars gauge{"gauge R&R", {}, {}, {}, report::Colour::Blue, 0.3};
  report::Bars tolerance{"gauge R&R in the tolerance", {}, {}, {}, report::Colour::Sky, 0.3};
  for (std::size_t i = 0; i < quantities.size(); ++i) {
    const double y = static_cast<double>(quantities.size() - i);
    panel.y.ticks.push_back({y, quantities[i].name});
    gauge.y.push_back(y + 0.17);
    gauge.from.push_back(0.0);
    gauge.to.push_back(std::min(100.0, 100.0 * quantities[i].study.gauge.of_total));
    tolerance.y.push_back(y - 0.17);
    tolerance.from.push_back(0.0);
    tolerance.to.push_back(std::min(100.0, 100.0 * quantities[i].study.gauge.of_tolerance));
  }
  panel.layers = {gauge, tolerance};
  for (const auto& [at, label] : {std::pair{10.0, "10 %"}, std::pair{30.0, "30 %"}})
    panel.layers.emplace_back(report::Curve{"",
                                            {at, at},
                                            {panel.y.lower, panel.y.upper},
                                            report::Colour::Grey,
                                            report::Stroke::Dashed,
                                            1.2,
                                            false});
  return panel;
}

}  // namespace

ordered_json gauge_json(const std::vector<GaugeQuantity>& quantities) {
  ordered_json list = ordered_json::array();
  for (const GaugeQuantity& quantity : quantities) {
    const GaugeStudy& study = quantity.study;
    ordered_json anova = ordered_json::array();
    for (const quality::AnovaRow& row : study.anova)
      anova.push_back({{"source", row.source},
                       {"freedom", row.freedom},
                       {"sum_of_squares", number_or_null(row.sum_of_squares)},
                       {"mean_square", number_or_null(row.mean_square)},
                       {"f", number_or_null(row.f)},
                       {"p", number_or_null(row.p)}});
    ordered_json components = ordered_json::object();
    for (const NamedComponent& named : kComponents) {
      const GaugeComponent& component = study.*named.component;
      components[named.key] = {{"sd", number_or_null(component.sd)},
                               {"of_total", number_or_null(component.of_total)},
                               {"of_tolerance", number_or_null(component.of_tolerance)}};
    }
    list.push_back({{"name", quantity.name},
                    {"unit", quantity.unit},
                    {"parts", study.parts},
                    {"operators", study.operators},
                    {"repeats", study.repeats},
                    {"interaction_pooled", study.interaction_pooled},
                    {"components", std::move(components)},
                    {"distinct_categories", number_or_null(study.distinct_categories)},
                    {"grade", quality::to_string(grade_of(study))},
                    {"anova", std::move(anova)}});
  }
  return {{"schema", "clampd.gauge/1"}, {"method", "anova"}, {"quantities", std::move(list)}};
}

std::string format_gauge(const std::vector<GaugeQuantity>& quantities) {
  const GaugeStudy& first = quantities.front().study;
  std::string text =
      fmt::format("Gauge R&R, crossed, analysis of variance: {} parts x {} operators x {} repeats\n\n",
                  first.parts, first.operators, first.repeats);
  text += fmt::format("{:<10}{:>11}{:>11}{:>11}{:>11}{:>12}{:>13}{:>5}  {}\n", "", "sd repeat", "sd reprod",
                      "sd GRR", "sd parts", "GRR of TV", "GRR of tol.", "ndc", "");
  for (const GaugeQuantity& quantity : quantities) {
    const GaugeStudy& s = quantity.study;
    text += fmt::format(
        "{:<10}{:>11.3g}{:>11.3g}{:>11.3g}{:>11.3g}{:>12}{:>13}{:>5.0f}  {}{}\n", quantity.name,
        s.repeatability.sd, s.reproducibility.sd, s.gauge.sd, s.part_variation.sd, percent(s.gauge.of_total),
        percent(s.gauge.of_tolerance), std::floor(s.distinct_categories), quality::to_string(grade_of(s)),
        s.interaction_pooled ? "" : fmt::format("; parts x operators p = {:.3f}", s.anova[2].p));
  }
  return text +
         "\nGood below 10 %, conditional up to 30 %; ndc, the number of distinct categories, should be 5 or "
         "more.\n";
}

Result<std::string> gauge_report(const std::vector<GaugeQuantity>& quantities, const std::string& subtitle) {
  using namespace report;
  const GaugeStudy& first = quantities.front().study;
  Page page("Gauge R&R", subtitle);
  page.paragraph(
      fmt::format("Crossed study: {} parts, {} operators, {} repeats each; analysis of variance after "
                  "AIAG, Measurement Systems Analysis, 4th edition.",
                  first.parts, first.operators, first.repeats));
  page.section("Result");
  Table table{
      "A gauge is good below 10 %, conditional up to 30 %; it should tell 5 categories of parts apart.",
      {{"quantity", false},
       {"sd repeatability", true},
       {"sd reproducibility", true},
       {"sd gauge", true},
       {"sd parts", true},
       {"gauge of total", true},
       {"gauge of tolerance", true},
       {"categories", true},
       {"", false}},
      {}};
  for (const GaugeQuantity& quantity : quantities) {
    const GaugeStudy& s = quantity.study;
    const quality::GaugeGrade grade = grade_of(s);
    table.rows.push_back({quantity.name + (quantity.unit.empty() ? "" : " in " + quantity.unit),
                          fmt::format("{:.3g}", s.repeatability.sd),
                          fmt::format("{:.3g}", s.reproducibility.sd), fmt::format("{:.3g}", s.gauge.sd),
                          fmt::format("{:.3g}", s.part_variation.sd), percent(s.gauge.of_total),
                          percent(s.gauge.of_tolerance),
                          fmt::format("{:.0f}", std::floor(s.distinct_categories)),
                          Cell{std::string(quality::to_string(grade)),
                               grade == quality::GaugeGrade::Good          ? Tone::Good
                               : grade == quality::GaugeGrade::Conditional ? Tone::Mixed
                                                                           : Tone::Bad}});
  }
  page.table(table);
  Figure overview;
  overview.panels.push_back(shares(quantities));
  overview.panel_height_px = 60 + 44 * static_cast<int>(quantities.size());
  if (const auto drawn = page.figure(overview,
                                     "How much of what is seen the gauge itself adds, in all parts and "
                                     "within the tolerance. Dashed: the guideline's 10 and 30 %.");
      !drawn)
    return tl::unexpected(drawn.error());

  page.section("Parts and operators");
  Figure parts;
  parts.columns = 2;
  parts.width_px = 1000;
  parts.panel_height_px = 220;
  for (std::size_t i = 0; i < quantities.size(); ++i) parts.panels.push_back(by_part(quantities[i], i < 2));
  if (const auto drawn = page.figure(
          parts, "Every measurement, by part in the order of their names; operators side by side.");
      !drawn)
    return tl::unexpected(drawn.error());

  page.section("Analysis of variance");
  for (const GaugeQuantity& quantity : quantities) {
    Table anova{
        quantity.name + (quantity.study.interaction_pooled
                             ? ": the interaction is not significant and counts as repeatability"
                             : ": the interaction may be real (p <= 0.25) and counts as reproducibility"),
        {{"source", false},
         {"freedom", true},
         {"sum of squares", true},
         {"mean square", true},
         {"F", true},
         {"p", true}},
        {}};
    for (const quality::AnovaRow& row : quantity.study.anova)
      anova.rows.push_back({row.source, fmt::format("{:.0f}", row.freedom),
                            fmt::format("{:.4g}", row.sum_of_squares), fmt::format("{:.4g}", row.mean_square),
                            std::isfinite(row.f) ? fmt::format("{:.2f}", row.f) : "",
                            !std::isfinite(row.p) ? ""
                            : row.p < 1e-4        ? "< 0.0001"
                                                  : fmt::format("{:.4f}", row.p)});
    page.table(anova);
  }
  return page.html();
}

}  // namespace clampd
