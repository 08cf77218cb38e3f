#include "clampd/views/diagnosis_report.hpp"

#include <algorithm>
#include <cctype>
#include <cmath>
#include <optional>
#include <utility>
#include <vector>

#include <fmt/format.h>

#include "clampd/base/version.hpp"
#include "clampd/views/diagnosis_pictures.hpp"
#include "clampd/views/diagnosis_words.hpp"
#include "clampd/views/page.hpp"
#include "src/views/drive_pictures.hpp"

namespace clampd {
namespace {

using report::Cell;
using report::Figure;
using report::Page;
using report::Table;
using report::Tone;
using report::typographic;

constexpr std::size_t kMaxManoeuvres = 6;
/// Of a stage after the first, which only adds to what the first one showed.
constexpr std::size_t kMaxLaterRungs = 8;

/// With a capital and a full stop.
std::string sentence(std::string text) {
  if (text.empty()) return text;
  text[0] = static_cast<char>(std::toupper(static_cast<unsigned char>(text[0])));
  return text + ".";
}

std::string fixed(double value, int decimals) {
  return std::isfinite(value) ? typographic(fmt::format("{:.{}f}", value, decimals)) : "";
}

bool is_extended(const Diagnosis& diagnosis) {
  return !diagnosis.effects.empty();
}

Tone tone_of(double p_value) {
  return !std::isfinite(p_value) ? Tone::Plain : p_value < words::kSignificant ? Tone::Bad : Tone::Good;
}

std::string plural(std::size_t count, const char* noun) {
  return fmt::format("{} {}{}", count, noun, count == 1 ? "" : "s");
}

// ---------------------------------------------------------------------------------------------------------

std::string verdict_in_words(const Diagnosis& diagnosis) {
  switch (diagnosis.verdict) {
    case DiagnosisVerdict::Adequate:
      return "Adequate: the simulation with the base model agrees with the runs as well as the "
             "sensors' "
             "noise allows. Nothing has to be added.";
    case DiagnosisVerdict::Explained:
      return "Explained: the simulation with the base model alone does not agree with the runs. With "
             "the "
             "cause named here it does, and no other known cause does nearly as well.";
    case DiagnosisVerdict::Ambiguous:
      return "Ambiguous: the simulation does not agree with the runs, and more than one cause would explain "
             "it "
             "nearly as well. These runs cannot tell which.";
    case DiagnosisVerdict::Unexplained:
      return "Unexplained: the simulation does not agree with the runs, and no known cause mends it.";
  }
  return "";
}

std::string gain_in_words(const Diagnosis& diagnosis, const DiagnosisSubject& subject) {
  const GainFigures& before = diagnosis.gain->before;
  const GainFigures& after = diagnosis.gain->after;
  std::vector<std::string> changes;
  const auto add = [&](const std::string& what, double GainFigures::*figure, const std::string& unit) {
    if (before.*figure > 0.0 && after.*figure > 0.0)
      changes.push_back(fmt::format("{} goes from {:.3g} to {:.3g} {}", what, before.*figure, after.*figure, unit));
  };
  if (subject.drive) {
    add(fmt::format("the error of the {} that the motion needs", subject.effort()),
        &GainFigures::rms_torque_Nm, subject.torque_unit + " rms");
  } else {
    add("the error of the force predicted one sample ahead", &GainFigures::rms_force_N, "N rms");
    add("that of the velocity", &GainFigures::rms_velocity_rad_s, "rad/s rms");
  }
  return fmt::format("On {}, {}.", words::heldout_runs(*diagnosis.gain), words::enumeration(changes, "and"));
}

std::string next_step(const Diagnosis& diagnosis, const DiagnosisSubject& subject) {
  switch (diagnosis.verdict) {
    case DiagnosisVerdict::Adequate:
      return "None. What these runs could not have shown is listed below.";
    case DiagnosisVerdict::Explained:
      return fmt::format(
          "Check the named cause where it is. The parameters of the base model are biased by it: until it is "
          "mended, "
          "use those of the extended model{}.",
          subject.drive ? "" : " (--save writes it)");
    case DiagnosisVerdict::Ambiguous:
      if (!diagnosis.next_experiment) return "Add runs with other manoeuvres and diagnose again.";
      return "Do what is said below (--next writes the motion) and diagnose again with its runs added.";
    case DiagnosisVerdict::Unexplained:
      return "Look where the misfit is and at what it depends on. Do not trust the parameters until the "
             "cause is "
             "known.";
  }
  return "";
}

void add_result(Page& page, const Diagnosis& diagnosis, const DiagnosisSubject& subject) {
  page.section("Result");
  std::vector<std::pair<std::string, std::string>> entries{{"Verdict", verdict_in_words(diagnosis)}};
  for (const NamedEffect& effect : diagnosis.effects)
    if (!words::has_rivals(diagnosis, effect.name))
      entries.emplace_back(
          fmt::format("{}: {}", words::role(diagnosis), effect.name),
          typographic(words::explains(diagnosis) ? fmt::format("{} {}", sentence(words::cause(effect)),
                                                               sentence(words::quantities(effect.parameters)))
                                                 : sentence(words::quantities(effect.parameters))));
  for (const std::vector<std::string>& group : diagnosis.rivals)
    for (const std::string& name : group)
      if (diagnosis.verdict == DiagnosisVerdict::Ambiguous)
        entries.emplace_back("Possible: " + name, sentence(words::cause(name)));
  if (diagnosis.misfit.location && diagnosis.verdict != DiagnosisVerdict::Adequate) {
    std::string where = words::meaning(*diagnosis.misfit.location, subject.torque);
    std::vector<std::string> variables;
    for (const std::string& name : words::depends_on(diagnosis.misfit))
      variables.push_back(words::variable(name, subject.torque));
    if (!variables.empty())
      where += fmt::format(" The misfit depends on {}.", words::enumeration(variables, "and"));
    entries.emplace_back("Where", where);
  }
  if (is_extended(diagnosis) && !words::gain_rows(diagnosis, subject).empty())
    entries.emplace_back("Gain", gain_in_words(diagnosis, subject));
  entries.emplace_back("Next step", next_step(diagnosis, subject));
  page.definitions(entries);
}

// ---------------------------------------------------------------------------------------------------------

void add_effects(Page& page, const Diagnosis& diagnosis, const DiagnosisSubject& subject) {
  if (!is_extended(diagnosis)) return;
  page.section(diagnosis.effects.size() == 1 ? "The effect" : "The effects");
  Table sizes{.caption = "± one standard deviation.",
              .columns = {{"Effect"}, {"Quantity"}, {"Meaning"}, {"Size", true}}};
  for (const NamedEffect& effect : diagnosis.effects)
    for (const EstimatedParameter& parameter : effect.parameters)
      sizes.rows.push_back({effect.name, parameter.name, words::meaning(effect.name, parameter.name),
                            typographic(words::quantity(parameter))});
  page.table(sizes);
  Table significance_nats{
      .caption =
          "Evidence in nats: how much more likely (as a natural logarithm) the model makes the runs with "
          "the effect than without it.",
      .columns = {{"Effect"}, {"Wrong without it"}, {"Evidence (nats)", true}, {"By chance"}}};
  for (const NamedEffect& effect : diagnosis.effects)
    significance_nats.rows.push_back({effect.name, words::place(effect.location, subject.torque),
                                      fixed(effect.log_likelihood_gain, 1), words::chance(effect.p_value)});
  page.table(significance_nats);
}

// ---------------------------------------------------------------------------------------------------------

Result<void> add_runs(Page& page, const Diagnosis& diagnosis) {
  bool begun = false;
  for (const RunView* view : pictures::representative(diagnosis.views, kMaxManoeuvres)) {
    const std::optional<Figure> picture = pictures::run_picture(*view, is_extended(diagnosis));
    if (!picture) continue;
    if (!begun) {
      page.section("Measured and simulated");
      page.paragraph(
          "The simulation gets the recorded torque and, since that is noisy, the torque error that makes it "
          "agree best. "
          "How large that error had to be tells how far a model is off. Of each manoeuvre the run with the "
          "largest "
          "misfit is shown.");
      begun = true;
    }
    if (auto drawn = page.figure(*picture, fmt::format("Run {}.", view->name)); !drawn) return drawn;
  }
  return {};
}

/// Of a drive first of all: the torque, measured and modelled, and the friction curve.
Result<void> add_drive(Page& page, const Diagnosis& diagnosis, const DiagnosisSubject& subject) {
  constexpr std::size_t kMostRuns = 3;
  std::size_t shown = 0;
  for (const RunView& view : diagnosis.views) {
    const std::optional<Figure> picture = pictures::modelled_torque_picture(view, is_extended(diagnosis), subject);
    if (!picture) continue;
    if (++shown > kMostRuns) break;
    if (shown == 1) page.section(fmt::format("Measured and modelled {}", subject.effort()));
    const std::string caption =
        fmt::format("{}: the recorded {} and what the model needs for the recorded motion{}, without the rows near standstill; below, what is left.",
                    view.name, subject.effort(), is_extended(diagnosis) ? " with the named effects" : "");
    if (auto drawn = page.figure(*picture, caption); !drawn) return drawn;
  }
  const std::optional<Figure> friction = pictures::friction_curve_picture(diagnosis.views, subject);
  if (!friction) return {};
  page.section("The friction curve");
  return page.figure(*friction,
                     fmt::format("The {} over speed where the drive hardly accelerates, forward and backward: means of equally many rows, and the "
                                 "model at the same rows. Gravity and other loads are in both; they widen the cloud of rows.",
                                 subject.effort()));
}

Result<void> add_dependence(Page& page, const Diagnosis& diagnosis, const DiagnosisSubject& subject) {
  const Misfit& misfit = diagnosis.misfit;
  const std::optional<Figure> means =
      pictures::dependence_picture(diagnosis.views, is_extended(diagnosis), subject);
  const std::optional<Figure> spectra =
      pictures::residual_spectra_picture(diagnosis.views, is_extended(diagnosis));
  if (misfit.dependences.empty() && !means && !spectra) return {};
  page.section("What the misfit depends on");
  if (!misfit.dependences.empty()) {
    Table table{.caption = "What a free function of the variable in that place would explain of the misfit.",
                .columns = {{"Depends on"}, {"In"}, {"Explains (nats)", true}, {"By chance"}}};
    for (const Dependence& dependence : misfit.dependences)
      table.rows.push_back({words::variable(dependence.variable, subject.torque),
                            words::place(dependence.location, subject.torque), fixed(dependence.gain, 1),
                            Cell(words::chance(dependence.p_value), tone_of(dependence.p_value))});
    page.table(table);
  }
  const char* const caption =
      subject.drive ? "Mean of what is left, over position, velocity, time, load and run."
                    : "Mean error of the prediction one sample ahead, in standard deviations of one reading, "
                      "over position, "
                      "velocity and so on. A model that is right stays in the grey band 19 times out of 20.";
  if (means)
    if (auto drawn = page.figure(*means, caption); !drawn) return drawn;
  if (spectra)
    if (auto drawn =
            page.figure(*spectra,
                        "Power of the same errors over frequency. Noise alone is flat at 1; a peak is a "
                        "vibration or hum, more at the left a slow error.");
        !drawn)
      return drawn;
  return {};
}

bool in_torque_balance(const Diagnosis& diagnosis) {
  const auto is = [](Location location) { return location == Location::TorqueBalance; };
  return (diagnosis.misfit.location && is(*diagnosis.misfit.location)) ||
         std::any_of(diagnosis.effects.begin(), diagnosis.effects.end(),
                     [&](const NamedEffect& effect) { return is(effect.location); });
}

Result<void> add_disturbance(Page& page, const Diagnosis& diagnosis, const DiagnosisSubject& subject) {
  if (!subject.drive && !in_torque_balance(diagnosis)) return {};
  const std::optional<Figure> picture =
      pictures::disturbance_picture(diagnosis.views, is_extended(diagnosis), subject);
  if (!picture) return {};
  page.section(fmt::format("The {} that the model lacks", subject.effort()));
  std::string caption = fmt::format(
      "The {} that would have to act besides the model's to explain the readings: its mean at each position, "
      "and "
      "how strongly it repeats.",
      subject.effort());
  const pictures::Spectrum spectrum =
      pictures::angle_spectrum(diagnosis.views, &RunView::disturbance_before_Nm);
  if (subject.position_unit == "rad" && !spectrum.amplitude.empty()) {
    const auto peak = std::max_element(spectrum.amplitude.begin(), spectrum.amplitude.end());
    caption += fmt::format(" It is strongest at {:.1f} periods in a revolution: {} in the base model.",
                           spectrum.frequency[static_cast<std::size_t>(peak - spectrum.amplitude.begin())],
                           words::quantity({"", subject.torque_unit, *peak}));
  }
  return page.figure(*picture, caption);
}

// ---------------------------------------------------------------------------------------------------------

Result<void> add_ladder(Page& page, const Diagnosis& diagnosis, const DiagnosisSubject& subject) {
  if (diagnosis.candidates.empty()) return {};
  page.section("The candidates");
  page.paragraph(
      "Each known cause was added to the model by itself and fitted to all runs. Its evidence says how "
      "unlikely "
      "the improvement is by chance (−ln p); below the alarm level nothing is made of it.");
  int last_stage = 1;
  for (const CandidateSummary& summary : diagnosis.candidates)
    last_stage = std::max(last_stage, summary.stage);
  for (int stage = 1; stage <= last_stage; ++stage) {
    std::vector<const CandidateSummary*> summaries;
    for (const CandidateSummary& summary : diagnosis.candidates)
      if (summary.stage == stage) summaries.push_back(&summary);
    std::stable_sort(summaries.begin(), summaries.end(),
                     [](const CandidateSummary* a, const CandidateSummary* b) {
                       return a->significance_nats > b->significance_nats;
                     });
    if (stage > 1 && summaries.size() > kMaxLaterRungs) summaries.resize(kMaxLaterRungs);
    if (summaries.empty()) continue;
    const std::string caption = stage == 1 ? "Each candidate alone beside the base model."
                                           : fmt::format("Each candidate beside the {} before.",
                                                         stage == 2 ? "one chosen" : "ones chosen");
    if (auto drawn = page.figure(pictures::ladder_picture(summaries, diagnosis.alarm_evidence), caption);
        !drawn)
      return drawn;
    Table table{
        .columns = {{"Candidate"}, {"Changes"}, {"Gain (nats)", true}, {"Evidence", true}, {"Size"}, {""}}};
    for (const CandidateSummary* summary : summaries) {
      if (!std::isfinite(summary->gain)) continue;
      table.rows.push_back({summary->name, words::place(summary->location, subject.torque),
                            fixed(summary->gain, 1), fixed(summary->significance_nats, 1),
                            typographic(words::quantities(summary->values)),
                            summary->chosen  ? Cell("named", Tone::Good)
                            : summary->rival ? Cell("rival", Tone::Mixed)
                                             : Cell("")});
    }
    if (!table.rows.empty()) page.table(table);
  }
  return {};
}

void add_gain(Page& page, const Diagnosis& diagnosis, const DiagnosisSubject& subject) {
  const std::vector<words::GainRow> rows = words::gain_rows(diagnosis, subject);
  if (rows.empty()) return;
  page.section("The gain");
  const bool extended = is_extended(diagnosis);
  const std::vector<std::string>& runs = diagnosis.gain->runs;
  Table table{.caption = fmt::format("On {}{}{}.", words::heldout_runs(*diagnosis.gain),
                                     runs.empty() ? "" : ": ", words::enumeration(runs, "and")),
              .columns = {{""}, {"Base model", true}}};
  if (extended) table.columns.push_back({"Extended model", true});
  for (const words::GainRow& row : rows) {
    table.rows.push_back({row.what, typographic(row.before)});
    if (extended)
      table.rows.back().push_back(Cell(typographic(row.after), row.better ? Tone::Good : Tone::Mixed));
  }
  page.table(table);
}

std::string with_unit(const std::string& name, const std::string& unit) {
  return unit.empty() ? name : fmt::format("{} ({})", name, unit);
}

void add_parameters(Page& page, const Diagnosis& diagnosis) {
  if (diagnosis.parameters_after.empty()) return;
  page.section("The parameters");
  if (!is_extended(diagnosis)) {
    Table table{.caption = "± one standard deviation.", .columns = {{"Parameter"}, {"Estimate", true}}};
    for (const EstimatedParameter& parameter : diagnosis.parameters_after)
      table.rows.push_back(
          {with_unit(parameter.name, parameter.unit), typographic(words::estimate(parameter))});
    page.table(table);
    return;
  }
  constexpr double kFarMoved_sd = 3.0;
  Table table{
      .caption =
          "± one standard deviation. Moved: by how many of its own standard deviations the base model was "
          "off.",
      .columns = {{"Parameter"}, {"Base model", true}, {"Extended model", true}, {"Moved (sd)", true}}};
  for (const words::ParameterRow& row : words::parameter_rows(diagnosis)) {
    std::string moved =
        std::isfinite(row.moved_sd) ? typographic(fmt::format("{:+.1f}", row.moved_sd)) : std::string();
    table.rows.push_back(
        {with_unit(row.after.name, row.after.unit),
         row.is_in_base ? typographic(words::estimate(row.before)) : "",
         typographic(words::estimate(row.after)),
         Cell(std::move(moved), std::abs(row.moved_sd) > kFarMoved_sd ? Tone::Mixed : Tone::Plain)});
  }
  page.table(table);
}

// ---------------------------------------------------------------------------------------------------------

Result<void> add_next_experiment(Page& page, const Diagnosis& diagnosis, const DiagnosisSubject& subject) {
  if (diagnosis.rivals.empty() && !diagnosis.next_experiment) return {};
  page.section("What would settle it");
  for (const std::vector<std::string>& group : diagnosis.rivals)
    page.paragraph(fmt::format("These runs cannot tell apart: {}.", words::enumeration(group, "and")));
  if (!diagnosis.next_experiment) return {};
  const NextExperiment& next = *diagnosis.next_experiment;
  page.paragraph(sentence(next.why));
  if (const std::string how = words::how_to_record(next); !how.empty()) {
    page.paragraph(sentence(how));
    return {};
  }
  const Figure picture = pictures::trajectory_picture(next.trajectory, subject);
  if (picture.panels.empty()) return {};
  return page.figure(picture,
                     fmt::format("The designed manoeuvre ({}) of the {}, to be run {}.", next.manoeuvre,
                                 subject.drive ? "drive" : "nominal brake",
                                 next.repeats == 1 ? "once" : fmt::format("{} times", next.repeats)));
}

/// Of bare drives: what the readings themselves show.
void add_data(Page& page, const Diagnosis& diagnosis) {
  if (diagnosis.data.empty()) return;
  page.section("The readings");
  Table table{.columns = {{"Found"}, {"Column"}, {"Size", true}, {"What"}}};
  for (const DataFinding& finding : diagnosis.data)
    table.rows.push_back(
        {finding.severity == DataFinding::Severity::Mended ? "mended, " + finding.name : finding.name,
         finding.column, typographic(words::quantity({"", finding.unit, finding.size, finding.sd})),
         typographic(sentence(finding.words))});
  page.table(table);
}

void add_unseen(Page& page, const Diagnosis& diagnosis) {
  if (diagnosis.unseen.empty() && diagnosis.notices.empty()) return;
  page.section("What these runs could not show");
  if (!diagnosis.unseen.empty()) {
    page.paragraph("These causes may be there or not: nothing in the runs would have told.");
    Table table{.columns = {{"Cause"}, {"Why not"}, {"What would show it"}}};
    for (const UnseenEffect& effect : diagnosis.unseen) {
      const Effect* const known = find_effect(effect.name);
      table.rows.push_back(
          {effect.name, effect.reason, known == nullptr ? "" : std::string(info_of(*known).excitation)});
    }
    page.table(table);
  }
  for (const std::string& notice : diagnosis.notices) page.paragraph(notice);
}

void add_tests(Page& page, const Diagnosis& diagnosis) {
  const Misfit& misfit = diagnosis.misfit;
  const auto add = [&](const char* caption, const std::vector<MisfitTest>& tests) {
    if (tests.empty()) return;
    Table table{.caption = caption,
                .columns = {{"Test"}, {"Statistic", true}, {"By chance"}, {"What it means"}}};
    for (const MisfitTest& test : tests)
      table.rows.push_back({test.name, fixed(test.statistic, 2),
                            Cell(words::chance(test.p_value), tone_of(test.p_value)), test.words});
    page.table(table);
  };
  if (misfit.tests_before.empty() && misfit.tests_after.empty()) return;
  page.section("Tests of the residuals");
  add("Base model.", misfit.tests_before);
  if (is_extended(diagnosis)) add("Extended model.", misfit.tests_after);
}

void add_method(Page& page, const Diagnosis& diagnosis, const DiagnosisSubject& subject) {
  page.section("How it was done");
  if (subject.drive) {
    page.definitions({
        {"Misfit",
         fmt::format(
             "The motion, smoothed and differentiated, needs a {0}; what the recorded {0} differs from it "
             "by is the misfit.",
             subject.effort())},
        {"Evidence",
         "How unlikely it is that stretches of the runs agree on the effect by chance. Noise that is alike "
         "from "
         "sample to sample does not count as evidence."},
    });
    return;
  }
  const auto levels = [](const NoiseLevels& noise) {
    return typographic(fmt::format("force {:.3g} N, velocity {:.3g} rad/s, torque {:.2g} N m",
                                   noise.sensors.force_N, noise.sensors.velocity_rad_s, noise.torque_Nm));
  };
  page.definitions({
      {"Misfit",
       "A Kalman filter predicts each reading one sample ahead. If model and noise are right, its errors are "
       "white noise of known size. It knows that the torque reading is noisy, too, so that a simulation may "
       "drift from the run without the model being wrong."},
      {"Noise",
       fmt::format("Estimated from the runs: {}{}.", levels(diagnosis.noise_after),
                   is_extended(diagnosis) ? fmt::format(" (base model: {})", levels(diagnosis.noise_before))
                                          : std::string())},
      {"Evidence",
       "Twice the gain in log likelihood is chi-square with as many degrees of freedom as the candidate has "
       "parameters, if the candidate is not there. The alarm level makes up for the number of candidates."},
      {"Held-out runs", "The gain counts only on runs that the judged model was not fitted to."},
  });
}

}  // namespace

Result<std::string> diagnosis_html(const Diagnosis& diagnosis, const DiagnosisSubject& subject) {
  Page page("Diagnosis: " + words::headline(diagnosis, subject.torque), diagnosis.summary);
  add_result(page, diagnosis, subject);
  if (subject.drive)
    if (auto drawn = add_drive(page, diagnosis, subject); !drawn) return tl::unexpected(drawn.error());
  add_effects(page, diagnosis, subject);
  if (auto drawn = add_runs(page, diagnosis); !drawn) return tl::unexpected(drawn.error());
  if (auto drawn = add_dependence(page, diagnosis, subject); !drawn) return tl::unexpected(drawn.error());
  if (auto drawn = add_disturbance(page, diagnosis, subject); !drawn) return tl::unexpected(drawn.error());
  if (auto drawn = add_ladder(page, diagnosis, subject); !drawn) return tl::unexpected(drawn.error());
  add_gain(page, diagnosis, subject);
  add_parameters(page, diagnosis);
  if (auto drawn = add_next_experiment(page, diagnosis, subject); !drawn)
    return tl::unexpected(drawn.error());
  add_data(page, diagnosis);
  add_unseen(page, diagnosis);
  add_tests(page, diagnosis);
  add_method(page, diagnosis, subject);
  page.paragraph(
      fmt::format("clampd {} · {} · {:.1f} s", kVersion, plural(subject.runs, "run"), diagnosis.wall_s));
  return page.html();
}

}  // namespace clampd
