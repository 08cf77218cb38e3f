#include "clampd/views/diagnosis_text.hpp"

#include <algorithm>
#include <cctype>
#include <cmath>
#include <iterator>
#include <map>

#include <fmt/format.h>

#include "clampd/views/diagnosis_words.hpp"

namespace clampd {
namespace {

constexpr const char* kBoldCode = "1";

const char* colour_of(DiagnosisVerdict verdict) {
  switch (verdict) {
    case DiagnosisVerdict::Adequate:
      return "1;32";
    case DiagnosisVerdict::Explained:
      return "1;36";
    case DiagnosisVerdict::Ambiguous:
      return "1;33";
    case DiagnosisVerdict::Unexplained:
      return "1;31";
  }
  return kBoldCode;
}

class Text {
 public:
  explicit Text(bool colours) : colours_(colours) {}

  template <class... Values>
  void add(fmt::format_string<Values...> format, Values&&... values) {
    fmt::format_to(std::back_inserter(text_), format, std::forward<Values>(values)...);
  }
  void heading(std::string_view heading) { add("\n{}\n", marked(heading, kBoldCode)); }
  std::string marked(std::string_view text, const char* code) const {
    return colours_ ? fmt::format("\033[{}m{}\033[0m", code, text) : std::string(text);
  }
  std::string take() { return std::move(text_); }

 private:
  bool colours_;
  std::string text_;
};

std::string upper_case(std::string_view word) {
  std::string text(word);
  for (char& c : text) c = static_cast<char>(std::toupper(static_cast<unsigned char>(c)));
  return text;
}

void add_effects(Text& text, const Diagnosis& diagnosis, const DiagnosisSubject& subject) {
  for (const bool rivals : {false, true}) {
    bool begun = false;
    for (const NamedEffect& effect : diagnosis.effects) {
      if (words::has_rivals(diagnosis, effect.name) != rivals) continue;
      if (!begun) text.heading(rivals ? "Best of the rivals" : words::role(diagnosis));
      begun = true;
      const std::string cause = words::explains(diagnosis) ? words::cause(effect) : "";
      text.add("  {}{}{}\n", effect.name, cause.empty() ? "" : ": ", cause);
      for (const EstimatedParameter& parameter : effect.parameters) {
        // What is not estimated tells nobody anything by itself.
        const std::string meaning =
            std::isfinite(parameter.sd) ? "" : "  " + words::meaning(effect.name, parameter.name);
        text.add("    {:<14} {}{}\n", parameter.name, words::quantity(parameter), meaning);
      }
      text.add("    in {}; evidence {:.0f} nats; by chance: {}\n",
               words::place(effect.location, subject.torque), effect.log_likelihood_gain,
               words::chance(effect.p_value));
    }
  }
}

void add_rivals(Text& text, const Diagnosis& diagnosis) {
  if (diagnosis.rivals.empty()) return;
  text.heading("Not to be told apart by these runs");
  for (const std::vector<std::string>& group : diagnosis.rivals)
    text.add("  {}\n", words::enumeration(group, "or"));
  if (!diagnosis.next_experiment) return;
  text.add("  to settle it: {}\n", diagnosis.next_experiment->why);
  if (const std::string how = words::how_to_record(*diagnosis.next_experiment); !how.empty())
    text.add("  {}\n", how);
}

void add_misfit(Text& text, const Diagnosis& diagnosis, const DiagnosisSubject& subject) {
  const Misfit& misfit = diagnosis.misfit;
  if (diagnosis.verdict == DiagnosisVerdict::Adequate) return;
  if (words::depends_on(misfit).empty() && !misfit.location) return;
  text.heading(words::depends_on(misfit).empty() ? "Where the misfit is" : "What the misfit depends on");
  if (misfit.location) text.add("  {}\n", words::meaning(*misfit.location, subject.torque));
  for (const Dependence& dependence : misfit.dependences)
    if (dependence.p_value < words::kSignificant)
      text.add("  depends on {}, in {} ({:.0f} nats)\n", words::variable(dependence.variable, subject.torque),
               words::place(dependence.location, subject.torque), dependence.gain);
}

void add_gain(Text& text, const Diagnosis& diagnosis, const DiagnosisSubject& subject) {
  const std::vector<words::GainRow> rows = words::gain_rows(diagnosis, subject);
  if (rows.empty()) return;
  text.heading("On " + words::heldout_runs(*diagnosis.gain));
  const bool extended = !diagnosis.effects.empty();
  text.add("  {:<48} {:>11}", "", extended ? "base model" : "");
  text.add("{}\n", extended ? fmt::format(" {:>11}", "extended") : "");
  for (const words::GainRow& row : rows) {
    text.add("  {:<48} {:>11}", row.what, row.before);
    if (extended) text.add(" {:>11}", row.after);
    text.add("\n");
  }
}

void add_parameters(Text& text, const Diagnosis& diagnosis) {
  if (diagnosis.parameters_after.empty()) return;
  text.heading("Parameters");
  if (diagnosis.effects.empty()) {
    for (const EstimatedParameter& parameter : diagnosis.parameters_after)
      text.add("  {:<22} {:>25}  {}\n", parameter.name, words::estimate(parameter), parameter.unit);
    return;
  }
  text.add("  {:<22} {:>25} {:>25}  {}\n", "", "base model", "extended", "moved");
  for (const words::ParameterRow& row : words::parameter_rows(diagnosis)) {
    const std::string moved =
        std::isfinite(row.moved_sd) ? fmt::format("{:+.1f} sd", row.moved_sd) : std::string();
    text.add("  {:<22} {:>25} {:>25}  {:<9} {}\n", row.after.name,
             row.is_in_base ? words::estimate(row.before) : "", words::estimate(row.after), moved,
             row.after.unit);
  }
}

/// Of bare drives: what the readings themselves show, and the rows that counted.
void add_data(Text& text, const Diagnosis& diagnosis) {
  if (diagnosis.rows.read == 0) return;
  text.heading("Data");
  text.add("  {} of {} rows used", diagnosis.rows.used, diagnosis.rows.read);
  for (const RowCount::LeftOut& left : diagnosis.rows.left_out) text.add("; {}: {}", left.reason, left.rows);
  text.add("\n");
  for (const DataFinding& finding : diagnosis.data)
    text.add("  {}{}: {}\n", finding.severity == DataFinding::Severity::Mended ? "mended, " : "", finding.name, finding.words);
}

/// Effects with the same reason share a line.
void add_unseen(Text& text, const Diagnosis& diagnosis) {
  if (diagnosis.unseen.empty()) return;
  text.heading("These runs could not have shown");
  std::map<std::string, std::vector<std::string>> by_reason;
  for (const UnseenEffect& effect : diagnosis.unseen) by_reason[effect.reason].push_back(effect.name);
  for (const auto& [reason, names] : by_reason)
    text.add("  {}: {}\n", words::enumeration(names, "or"), reason);
}

}  // namespace

std::string diagnosis_text(const Diagnosis& diagnosis, const DiagnosisSubject& subject, bool colours) {
  Text text(colours);
  text.add("{}  {}\n", text.marked(upper_case(to_string(diagnosis.verdict)), colour_of(diagnosis.verdict)),
           text.marked(diagnosis.summary, kBoldCode));
  add_effects(text, diagnosis, subject);
  add_rivals(text, diagnosis);
  add_misfit(text, diagnosis, subject);
  add_gain(text, diagnosis, subject);
  add_parameters(text, diagnosis);
  add_data(text, diagnosis);
  add_unseen(text, diagnosis);
  if (!diagnosis.notices.empty()) text.heading("To be noted");
  for (const std::string& notice : diagnosis.notices) text.add("  {}\n", notice);
  return text.take();
}

}  // namespace clampd
