#include "clampd/archive/csv.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include <fmt/format.h>

namespace clampd {
namespace {

bool begins_formula(char c) {
  return std::string_view("=+-@\t\r").find(c) != std::string_view::npos;
}

/// An apostrophe before everything that a spreadsheet would run: at the beginning, and after a semicolon,
/// which separates cells where the decimal separator is a comma, whether the text is quoted or not.
std::string without_formulas(const std::string& text) {
  std::string safe;
  for (std::size_t i = 0; i < text.size(); ++i) {
    if (begins_formula(text[i]) && (i == 0 || text[i - 1] == ';')) safe += '\'';
    safe += text[i];
  }
  return safe;
}

std::string cell(const std::string& unsafe) {
  const std::string text = without_formulas(unsafe);
  if (text.find_first_of(",;\"\r\n") == std::string::npos) return text;
  std::string quoted = "\"";
  for (const char c : text) quoted += c == '"' ? "\"\"" : std::string(1, c);
  return quoted + '"';
}

std::string csv_number(double value) {
  return std::isfinite(value) ? fmt::format("{:.10g}", value) : "";
}

using Name = std::pair<std::string, std::string>;  ///< of a parameter, and its unit

struct Judged {
  Name name;
  double value, sd, lower, upper;
  std::string verdict;  ///< empty: none
};

/// Parameters, then what the sheet asks for.
std::vector<Judged> judged(const CheckRecord& check) {
  std::vector<Judged> values;
  for (const ParameterRecord& p : check.parameters)
    values.push_back({{p.name, p.unit}, p.value, p.sd, p.lower, p.upper, std::string(to_string(p.verdict))});
  if (check.sheet)
    for (const CharacteristicRecord& c : check.sheet->characteristics)
      values.push_back({{"sheet " + c.name, c.unit},
                        c.value,
                        c.sd,
                        c.lower,
                        c.upper,
                        c.verdict ? std::string(to_string(*c.verdict)) : ""});
  return values;
}

std::vector<Name> names_of(const std::vector<CheckRecord>& checks) {
  std::vector<Name> names;
  for (const CheckRecord& check : checks)
    for (const Judged& each : judged(check))
      if (std::find(names.begin(), names.end(), each.name) == names.end()) names.push_back(each.name);
  return names;
}

}  // namespace

std::string format_csv(const std::vector<CheckRecord>& checks) {
  const std::vector<Name> names = names_of(checks);
  std::string text =
      "record,serial,part_number,batch,station,fixture,operator,software_version,limits_revision,"
      "limits_sha256,simulated,started,stopped,duration_s,repeats,verdict,marginal,reason,fault,cause,"
      "tracking_rms_N,ticks,skipped,lost_samples,lateness_max_us";
  for (const auto& [name, unit] : names)
    for (const char* column : {"", " sd", " lower", " upper"})
      text += "," + cell(fmt::format("{}{} [{}]", name, column, unit));
  for (const auto& [name, unit] : names) text += "," + cell(name + " verdict");
  text += ",void,misfit_marked,stopped_because,recipe_version,recipe_sha256";
  text += "\r\n";
  for (const CheckRecord& c : checks) {
    std::string cause;
    if (c.cause)
      cause = c.cause->effects.empty() || c.cause->verdict == "unexplained"
                  ? c.cause->verdict
                  : fmt::format("{}", fmt::join(c.cause->effects, " "));
    std::vector<std::string> row{c.id,
                                 c.serial,
                                 c.part_number,
                                 c.batch,
                                 c.station,
                                 c.fixture,
                                 c.operator_name,
                                 c.software_version,
                                 c.limits_revision,
                                 c.limits_sha256,
                                 c.simulated ? "1" : "0",
                                 c.started,
                                 c.stopped,
                                 csv_number(c.duration_s),
                                 std::to_string(c.repeats),
                                 std::string(to_string(c.verdict)),
                                 c.marginal ? "1" : "0",
                                 c.reason,
                                 std::string(to_string(c.fault)),
                                 cause};
    for (std::string& field : row) field = cell(field);
    for (const double value :
         {c.tracking_rms_N, static_cast<double>(c.timing.ticks), static_cast<double>(c.timing.skipped),
          static_cast<double>(c.timing.lost_samples), c.timing.lateness_max_us})
      row.push_back(csv_number(value));
    std::vector<std::string> verdicts;
    const std::vector<Judged> values = judged(c);
    for (const Name& name : names) {
      const auto found =
          std::find_if(values.begin(), values.end(), [&](const Judged& each) { return each.name == name; });
      const bool has = found != values.end();
      for (const double Judged::*member : {&Judged::value, &Judged::sd, &Judged::lower, &Judged::upper})
        row.push_back(has ? csv_number((*found).*member) : "");
      verdicts.push_back(has ? found->verdict : "");
    }
    row.insert(row.end(), verdicts.begin(), verdicts.end());
    row.push_back(c.voided ? cell(c.voided->reason) : "");
    row.push_back(!c.systematic ? "" : c.systematic->marked ? "1" : "0");
    row.push_back(c.stopping ? cell(c.stopping->reason) : "");
    row.push_back(c.recipe ? cell(c.recipe->version) : "");
    row.push_back(c.recipe ? cell(c.recipe->sha256) : "");
    text += fmt::format("{}\r\n", fmt::join(row, ","));
  }
  return text;
}

}  // namespace clampd
