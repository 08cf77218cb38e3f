#include <algorithm>
#include <cmath>
#include <limits>
#include <regex>
#include <string>
#include <variant>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "clampd/views/diagnosis_json.hpp"
#include "clampd/views/diagnosis_pictures.hpp"
#include "clampd/views/diagnosis_report.hpp"
#include "clampd/views/diagnosis_text.hpp"
#include "clampd/views/diagnosis_words.hpp"
#include "views/diagnosis_example.hpp"

namespace clampd {
namespace {

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::Not;
using ::testing::SizeIs;
using ::testing::StartsWith;

constexpr DiagnosisSubject kBrake{.runs = 15};

DiagnosisSubject linear_drive() {
  return {.runs = 1, .drive = true, .position_unit = "m", .torque_unit = "N", .torque = "force"};
}

Diagnosis faultless_brake() {
  Diagnosis diagnosis;
  diagnosis.summary = "The model explains the runs.";
  diagnosis.parameters_before = diagnosis.parameters_after = {{"TC", "N m", 0.0767, 0.0007}};
  diagnosis.views = {rippling_view("optimal-001.csv", 0.0, 1)};
  return diagnosis;
}

/// A drive's diagnosis knows the disturbance and the motion, and no reading's prediction.
Diagnosis rippling_drive() {
  Diagnosis diagnosis = rippling_brake();
  diagnosis.gain->before = {.rms_torque_Nm = 1.31, .torque_error_relative = 0.0408};
  diagnosis.gain->after = {.rms_torque_Nm = 0.98, .torque_error_relative = 0.0311};
  for (RunView& view : diagnosis.views) view.force = view.velocity = {};
  return diagnosis;
}

// ---------------------------------------------------------------------------------------------------- words

TEST(DiagnosisWords, NumbersShowWhatTheirUncertaintyAllows) {
  EXPECT_EQ(words::with_sd(0.05021, 0.0004), "0.05021 ± 0.00040");
  EXPECT_EQ(words::with_sd(-1234.5, 12.0), "-1234 ± 12");
  EXPECT_EQ(words::with_sd(3.55e-5, 2e-7), "3.550e-05 ± 2.0e-07");
  EXPECT_EQ(words::with_sd(6.0, NAN), "6");
  EXPECT_EQ(words::with_sd(NAN, 1.0), "-");
  EXPECT_EQ(words::quantity({"", "s", 0.00302, 0.00005}), "3.020 ± 0.050 ms");
  EXPECT_EQ(words::quantity({"", "N m", 0.05, NAN}), "50 mN m");
  EXPECT_EQ(words::quantity({"", "N/rad^3", -0.35, NAN}), "-0.35 N/rad³");
  EXPECT_EQ(words::quantity({"", "1", 6.0, NAN}), "6");
  EXPECT_EQ(words::quantity({"", "1/rev", 6.0, NAN}), "6 per revolution");
  EXPECT_EQ(words::quantity({"", "s", 0.0, 0.001}), "0.0000 ± 0.0010 s");
}

TEST(DiagnosisWords, AChoiceIsToldByItsName) {
  Diagnosis diagnosis = rippling_brake();
  diagnosis.effects.at(0).parameters.push_back({"law", "", 3.0, NAN, "LuGre's"});
  EXPECT_EQ(words::quantity(diagnosis.effects[0].parameters.back()), "LuGre's");
  EXPECT_THAT(diagnosis_text(diagnosis, kBrake, false), ::testing::ContainsRegex("law +LuGre's"));
  const auto document = diagnosis_json(diagnosis, kBrake);
  const auto& parameters = document["effects"][0]["parameters"];
  EXPECT_EQ(parameters.back()["value"], 3.0);
  EXPECT_EQ(parameters.back()["choice"], "LuGre's");
  EXPECT_FALSE(parameters[0].contains("choice"));
}

TEST(DiagnosisWords, ChancesAreToldAsOdds) {
  EXPECT_EQ(words::chance(0.31), "31 %");
  EXPECT_EQ(words::chance(1.0 / 2345.0), "1 in 2,300");
  EXPECT_EQ(words::chance(1e-6), "1 in 1,000,000");
  EXPECT_EQ(words::chance(0.0), "less than 1 in a million");
  EXPECT_EQ(words::chance(NAN), "-");
}

TEST(DiagnosisWords, ListsReadAsSentences) {
  const std::vector<std::string> names{"a", "b", "c"};
  EXPECT_EQ(words::enumeration(names, "or"), "a, b or c");
  EXPECT_EQ(words::enumeration({names.data(), 1}, "or"), "a");
  EXPECT_EQ(words::enumeration({}, "or"), "");
  EXPECT_EQ(words::headline(torn_brake()), "the cause is force-lag or pad-relaxation");
}

TEST(DiagnosisWords, ACertainCauseStandsBesideRivals) {
  Diagnosis diagnosis = torn_brake();
  diagnosis.effects.insert(diagnosis.effects.begin(), rippling_brake().effects.front());
  EXPECT_EQ(words::headline(diagnosis), "the cause is cogging and force-lag or pad-relaxation");
  const std::string text = diagnosis_text(diagnosis, kBrake, false);
  EXPECT_LT(text.find("Cause\n  cogging"), text.find("Best of the rivals\n  force-lag"));
  EXPECT_NE(text.find("Best of the rivals\n  force-lag"), std::string::npos);

  // Of a name that is given in spite of a near rival there is no doubt left to tell.
  diagnosis.verdict = DiagnosisVerdict::Explained;
  EXPECT_EQ(words::headline(diagnosis), "the cause is cogging and force-lag");
  EXPECT_EQ(diagnosis_text(diagnosis, kBrake, false).find("Best of the rivals"), std::string::npos);
}

TEST(DiagnosisWords, AParameterMovesInStandardDeviations) {
  const std::vector<words::ParameterRow> rows = words::parameter_rows(rippling_brake());
  ASSERT_THAT(rows, SizeIs(4));
  EXPECT_NEAR(rows[1].moved_sd, (0.0766 - 0.0921) / 0.0008, 1e-9);
  EXPECT_TRUE(std::isnan(rows[3].before.value)) << "a parameter of the effect";
  EXPECT_TRUE(std::isnan(rows[3].moved_sd));
}

// ----------------------------------------------------------------------------------------------------- json

TEST(DiagnosisJson, HasEveryKeyThatIsPromised) {
  for (const Diagnosis& diagnosis : {rippling_brake(), torn_brake(), faultless_brake()}) {
    const auto document = diagnosis_json(diagnosis, kBrake);
    for (const char* key : {"schema", "verdict", "effects", "rivals", "unseen", "misfit", "next_experiment",
                            "gain", "parameters_before", "parameters_after"})
      EXPECT_TRUE(document.contains(key)) << key;
    for (const char* key :
         {"heldout_rms_force_N", "heldout_rms_velocity_rad_s", "heldout_log_likelihood_per_sample"}) {
      ASSERT_TRUE(document["gain"].contains(key)) << key;
      EXPECT_TRUE(document["gain"][key].contains("before") && document["gain"][key].contains("after")) << key;
    }
    EXPECT_EQ(document["schema"], "clampd.diagnosis/1");
  }
}

TEST(DiagnosisJson, SaysWhatWasFound) {
  const auto document = diagnosis_json(rippling_brake(), kBrake);
  EXPECT_EQ(document["verdict"], "explained");
  const auto& effect = document["effects"][0];
  EXPECT_EQ(effect["name"], "cogging");
  EXPECT_EQ(effect["location"], "torque-balance");
  EXPECT_EQ(effect["parameters"][0]["value"], 0.05021);
  EXPECT_EQ(effect["evidence"]["log_likelihood_gain"], 532.4);
  EXPECT_EQ(document["unseen"], nlohmann::json({"backlash", "stiffness-hysteresis", "force-saturation"}));
  EXPECT_EQ(document["unseen_reasons"][2]["reason"], "the force stays below 25 kN");
  EXPECT_EQ(document["misfit"]["depends_on"], nlohmann::json({"position", "velocity"}))
      << "significantly, strongest first";
  EXPECT_EQ(document["gain"]["heldout_runs"], 2);
  EXPECT_EQ(document["gain"]["heldout_rms_force_N"]["after"], 30.1);
  EXPECT_TRUE(document["next_experiment"].is_null());
  EXPECT_EQ(document["noise"]["after"]["force_N"], 30.0);
  EXPECT_THAT(document["ladder"], SizeIs(7));
}

TEST(DiagnosisJson, WhatIsNotKnownIsNull) {
  const auto document = diagnosis_json(rippling_brake(), kBrake);
  EXPECT_TRUE(document["effects"][0]["parameters"][1]["sd"].is_null());
  EXPECT_TRUE(document["ladder"][6]["gain"].is_null());
  EXPECT_TRUE(document["gain"]["heldout_rms_torque_Nm"]["after"].is_null());
  EXPECT_THAT(document.dump(), Not(HasSubstr("nan")));

  const auto faultless = diagnosis_json(faultless_brake(), kBrake);
  EXPECT_TRUE(faultless["gain"]["heldout_rms_force_N"]["before"].is_null()) << "no run was held out";
  EXPECT_EQ(faultless["gain"]["heldout_runs"], 0);
  EXPECT_TRUE(faultless["misfit"]["location"].is_null());
  EXPECT_TRUE(faultless["effects"].is_array() && faultless["effects"].empty());
  EXPECT_TRUE(faultless["rivals"].is_array() && faultless["rivals"].empty());
  EXPECT_TRUE(diagnosis_json(rippling_drive(), linear_drive())["noise"].is_null());
}

TEST(DiagnosisJson, ADriveIsJudgedByPartsOfItsRuns) {
  Diagnosis diagnosis = rippling_drive();
  diagnosis.gain->runs.clear();
  const auto gain = diagnosis_json(diagnosis, linear_drive())["gain"];
  EXPECT_EQ(gain["heldout_torque_error_relative"]["after"], 0.0311);
  EXPECT_EQ(gain["heldout_runs"], 0);
  EXPECT_THAT(diagnosis_text(diagnosis, linear_drive(), false), HasSubstr("On parts of the runs"));
}

TEST(DiagnosisJson, HoldsTheNextExperimentWhole) {
  const auto document = diagnosis_json(torn_brake(), kBrake);
  EXPECT_EQ(document["rivals"].dump(), R"([["force-lag","pad-relaxation"]])");
  const auto& next = document["next_experiment"];
  EXPECT_EQ(next["repeats"], 2);
  EXPECT_EQ(next["rows"], 400);
  EXPECT_NEAR(next["duration_s"], 0.399, 1e-12);
  for (const char* column : {"time_s", "torque_Nm", "velocity_rad_s", "force_N"})
    EXPECT_THAT(next[column], SizeIs(400)) << column;
}

// ----------------------------------------------------------------------------------------------------- text

TEST(DiagnosisText, StartsWithTheVerdict) {
  EXPECT_THAT(diagnosis_text(rippling_brake(), kBrake, false),
              StartsWith("EXPLAINED  The motor's torque ripples by 50 mN m, six times a revolution.\n"));
  EXPECT_THAT(diagnosis_text(faultless_brake(), kBrake, false),
              AllOf(StartsWith("ADEQUATE  The model explains the runs.\n"), Not(HasSubstr("Cause")),
                    Not(HasSubstr("extended"))));
}

TEST(DiagnosisText, NamesCauseGainAndWhatWasNotSeen) {
  const std::string text = diagnosis_text(rippling_brake(), kBrake, false);
  EXPECT_THAT(text, HasSubstr("50.21 ± 0.40 mN m"));
  EXPECT_THAT(text, HasSubstr("less than 1 in a million"));
  EXPECT_THAT(text, HasSubstr("On 2 runs that the model was not fitted to"));
  EXPECT_THAT(text, ::testing::ContainsRegex("with the torque errors \\(N rms\\) +212\\.0 +33\\.0\n"));
  EXPECT_THAT(text, HasSubstr("depends on the motor's position"));
  EXPECT_THAT(text, Not(HasSubstr("depends on the clamp force"))) << "not significant";
  EXPECT_THAT(text, HasSubstr("backlash or stiffness-hysteresis: no reversal under load\n"));
  EXPECT_THAT(text, HasSubstr("one run was left out"));
  EXPECT_THAT(text, Not(HasSubstr("nan")));
}

TEST(DiagnosisText, NamesRivalsAndWhatWouldSettleThem) {
  EXPECT_THAT(diagnosis_text(torn_brake(), kBrake, false),
              AllOf(StartsWith("AMBIGUOUS"), HasSubstr("force-lag or pad-relaxation\n"),
                    HasSubstr("to settle it: a hold of 0.4 s at 20 kN tells creep from lag"),
                    Not(HasSubstr("Cause"))));
}

TEST(DiagnosisText, AnUnexplainedResultNamesNoCause) {
  Diagnosis diagnosis = rippling_brake();
  diagnosis.verdict = DiagnosisVerdict::Unexplained;
  const std::string text = diagnosis_text(diagnosis, kBrake, false);
  EXPECT_EQ(text.find("Cause"), std::string::npos) << text;
  EXPECT_EQ(text.find(words::cause("cogging")), std::string::npos) << text;
  EXPECT_THAT(text, HasSubstr("Tried, and not enough\n  cogging\n"));
  EXPECT_TRUE(diagnosis_json(diagnosis, kBrake)["effects"][0]["cause"].is_null());
}

TEST(DiagnosisText, AParameterThatTheRunsDoNotShowHasNoValue) {
  Diagnosis diagnosis = rippling_brake();
  for (std::vector<EstimatedParameter>* list : {&diagnosis.parameters_before, &diagnosis.parameters_after})
    list->front().value = list->front().sd = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THAT(diagnosis_text(diagnosis, kBrake, false), HasSubstr("not identifiable"));
  EXPECT_TRUE(diagnosis_json(diagnosis, kBrake)["parameters_after"][0]["value"].is_null());
}

TEST(DiagnosisText, HasColoursOnlyWhereTheyAreWanted) {
  EXPECT_THAT(diagnosis_text(rippling_brake(), kBrake, false), Not(HasSubstr("\033")));
  EXPECT_THAT(diagnosis_text(rippling_brake(), kBrake, true), StartsWith("\033["));
}

TEST(DiagnosisText, SpeaksTheUnitsOfADrive) {
  EXPECT_THAT(diagnosis_text(rippling_drive(), linear_drive(), false),
              AllOf(HasSubstr("force that the motion needs (N rms)"), HasSubstr("0.0311"),
                    Not(HasSubstr("rad/s rms"))));
}

// ------------------------------------------------------------------------------------------------- pictures

TEST(DiagnosisPictures, OneRunOfEachManoeuvreIsShown) {
  std::vector<RunView> views{rippling_view("a/optimal-001.csv", 0.05, 1),
                             rippling_view("a/optimal-002.csv", 0.05, 2),
                             rippling_view("a/step-001.csv", 0.05, 3), rippling_view("repeat 3", 0.05, 4)};
  for (double& residual : views[1].force.residual_before) residual *= 4.0;
  for (double& residual : views[2].force.residual_before) residual *= 2.0;
  const auto shown = pictures::representative(views, 2);
  EXPECT_THAT(shown, ElementsAre(&views[1], &views[2]));
  EXPECT_THAT(pictures::representative(views, 9), SizeIs(3));
}

TEST(DiagnosisPictures, ARippleStandsAtItsOrder) {
  const std::vector<RunView> views{rippling_view("a", 0.05, 1), rippling_view("b", 0.05, 2)};
  const pictures::Spectrum before = pictures::angle_spectrum(views, &RunView::disturbance_before_Nm);
  const auto peak = std::max_element(before.amplitude.begin(), before.amplitude.end());
  EXPECT_NEAR(before.frequency[static_cast<std::size_t>(peak - before.amplitude.begin())], 6.0, 0.05);
  EXPECT_NEAR(*peak, 0.05, 0.005);
  const pictures::Spectrum after = pictures::angle_spectrum(views, &RunView::disturbance_after_Nm);
  EXPECT_LT(*std::max_element(after.amplitude.begin(), after.amplitude.end()), 0.001);
  std::vector<RunView> still = views;
  for (RunView& view : still)
    for (double& position : view.position_rad) position *= 0.01;
  EXPECT_TRUE(pictures::angle_spectrum(still, &RunView::disturbance_before_Nm).amplitude.empty());
}

double mean_of_curve(const report::Panel& panel, report::Colour colour) {
  double sum = 0.0, count = 0.0;
  for (const auto& layer : panel.layers)
    if (const auto* curve = std::get_if<report::Curve>(&layer); curve != nullptr && curve->colour == colour)
      for (const double y : curve->y) {
        sum += y;
        count += 1.0;
      }
  return sum / count;
}

TEST(DiagnosisPictures, WhiteResidualsHaveUnitPower) {
  const std::vector<RunView> views{rippling_view("a", 0.05, 1), rippling_view("b", 0.05, 2)};
  const auto figure = pictures::residual_spectra_picture(views, true);
  ASSERT_TRUE(figure);
  ASSERT_THAT(figure->panels, SizeIs(2));
  EXPECT_NEAR(mean_of_curve(figure->panels[1], report::Colour::Blue), 1.0, 0.1);
  // Variance of the ripple's share in the velocity: 2^2 / 2.
  EXPECT_NEAR(mean_of_curve(figure->panels[1], report::Colour::Vermilion), 3.0, 0.4);
}

TEST(DiagnosisPictures, MeansOfBins) {
  const std::vector<double> x{3, 1, 2, 4, NAN, 5}, y{30, 10, 20, 40, 50, NAN};
  const pictures::BinnedMeans means = pictures::binned(x, y, 2);
  EXPECT_THAT(means.x, ElementsAre(1.5, 3.5));
  EXPECT_THAT(means.mean, ElementsAre(15, 35));
  EXPECT_DOUBLE_EQ(means.two_sd[0], std::sqrt(2.0));
}

TEST(DiagnosisPictures, LongRunsAreThinnedWithoutLosingPeaks) {
  constexpr std::size_t kRows = 25000, kPeak = 12347;
  RunView view;
  view.name = "long";
  for (std::size_t k = 0; k < kRows; ++k) {
    view.time_s.push_back(1e-3 * static_cast<double>(k));
    view.force.measured.push_back(k == kPeak ? 5000.0 : 0.0);
    view.force.simulated_before.push_back(0.0);
  }
  const auto figure = pictures::run_picture(view, false);
  ASSERT_TRUE(figure);
  const auto& measured = std::get<report::Curve>(figure->panels[0].layers[0]);
  EXPECT_LT(measured.x.size(), 2000U);
  EXPECT_EQ(*std::max_element(measured.y.begin(), measured.y.end()), 5.0) << "kN";
}

// --------------------------------------------------------------------------------------------------- report

std::string html_of(const Diagnosis& diagnosis, const DiagnosisSubject& subject) {
  const Result<std::string> html = diagnosis_html(diagnosis, subject);
  EXPECT_TRUE(html) << html.error().message;
  return html.value_or("");
}

bool has_section(const std::string& html, const std::string& heading) {
  return std::regex_search(html, std::regex("<h2 id=\"section-\\d+\">" + heading));
}

std::size_t figures_in(const std::string& html) {
  std::size_t count = 0;
  for (std::size_t at = 0; (at = html.find("<svg", at)) != std::string::npos; ++at) ++count;
  return count;
}

TEST(DiagnosisReport, NeedsNothingFromElsewhere) {
  for (const Diagnosis& diagnosis : {rippling_brake(), torn_brake(), faultless_brake()}) {
    const std::string html = html_of(diagnosis, kBrake);
    EXPECT_THAT(html,
                AllOf(Not(HasSubstr("<script")), Not(HasSubstr("@import")), Not(HasSubstr("url(http"))));
    const std::regex reference("(?:href|src)=['\"]([^'\"]*)['\"]");
    for (std::sregex_iterator match(html.begin(), html.end(), reference), end; match != end; ++match)
      EXPECT_EQ((*match)[1].str().substr(0, 1), "#");
    for (const char* slip : {">nan", " nan", "{:", ">-nan"}) EXPECT_THAT(html, Not(HasSubstr(slip)));
  }
}

TEST(DiagnosisReport, TellsTheWholeStoryOfAnExplainedSet) {
  const std::string html = html_of(rippling_brake(), kBrake);
  for (const char* heading :
       {"Result", "The effect", "Measured and simulated", "What the misfit depends on",
        "The torque that the model lacks", "The candidates", "The gain", "The parameters",
        "What these runs could not show", "Tests of the residuals", "How it was done"})
    EXPECT_TRUE(has_section(html, heading)) << heading;
  EXPECT_THAT(html, HasSubstr("ripples by 50 mN m"));
  EXPECT_THAT(html, HasSubstr("strongest at 6.0 periods in a revolution"));
  EXPECT_THAT(html, HasSubstr("alarm level"));
  EXPECT_THAT(html, HasSubstr("from 34 to 30.1 N rms"));
  // Two manoeuvres, dependences, spectra, the torque, two stages of the ladder.
  EXPECT_EQ(figures_in(html), 7U);
}

TEST(DiagnosisReport, ShowsTheRunThatWouldSettleTheRivals) {
  const std::string html = html_of(torn_brake(), kBrake);
  EXPECT_TRUE(has_section(html, "What would settle it"));
  EXPECT_THAT(html, AllOf(HasSubstr("Possible: force-lag"), HasSubstr("Possible: pad-relaxation"),
                          HasSubstr("A hold of 0.4 s at 20 kN tells creep from lag"),
                          HasSubstr("to be run 2 times")));
}

TEST(DiagnosisReport, OfAFaultlessBrakeMakesNothingUp) {
  const std::string html = html_of(faultless_brake(), kBrake);
  EXPECT_THAT(html, HasSubstr("the model explains the runs"));
  EXPECT_FALSE(has_section(html, "The effect"));
  EXPECT_FALSE(has_section(html, "The gain"));
  EXPECT_THAT(html, AllOf(Not(HasSubstr(">extended<")), Not(HasSubstr("Extended model"))));
}

TEST(DiagnosisReport, EscapesWhatComesFromOutside) {
  const std::string nasty = "<script>alert('&\"')</script>";
  Diagnosis diagnosis = torn_brake();
  diagnosis.summary = nasty;
  diagnosis.notices = {nasty};
  diagnosis.effects[0].name = diagnosis.effects[0].parameters[0].name = nasty;
  diagnosis.effects[0].parameters[0].unit = nasty;
  diagnosis.unseen[0] = {nasty, nasty};
  diagnosis.rivals = {{nasty, nasty}};
  diagnosis.gain->runs[0] = nasty;
  diagnosis.views[0].name = nasty;
  diagnosis.candidates[0].name = nasty;
  diagnosis.next_experiment->manoeuvre = diagnosis.next_experiment->why = nasty;
  diagnosis.misfit.tests_before[0].name = diagnosis.misfit.tests_before[0].words = nasty;
  diagnosis.misfit.dependences[0].variable = nasty;
  diagnosis.parameters_after[0].name = diagnosis.parameters_after[0].unit = nasty;
  const std::string html = html_of(diagnosis, kBrake);
  EXPECT_THAT(html, AllOf(Not(HasSubstr("<script")), HasSubstr("&lt;script&gt;")));
}

TEST(NextExperiment, WithTheDriveOffIsNoManoeuvreAndSaysWhatToRecord) {
  Diagnosis diagnosis = torn_brake();
  EXPECT_EQ(diagnosis_json(diagnosis, kBrake)["next_experiment"]["drive_off"], false);
  EXPECT_THAT(diagnosis_text(diagnosis, kBrake, false), Not(HasSubstr("drive_enabled")));
  clampd::Run& trajectory = diagnosis.next_experiment->trajectory;
  trajectory.drive_enabled.assign(trajectory.size(), 0.0);
  diagnosis.torque_while_off = TorqueWhileOff{0.003, 0.0002, 3000};
  const auto document = diagnosis_json(diagnosis, kBrake);
  EXPECT_EQ(document["next_experiment"]["drive_off"], true);
  EXPECT_EQ(document["torque_while_off"]["rows"], 3000);
  EXPECT_THAT(diagnosis_text(diagnosis, kBrake, false), HasSubstr("drive_enabled, 0 in every row"));
  EXPECT_THAT(html_of(diagnosis, kBrake),
              AllOf(HasSubstr("drive_enabled, 0 in every row"), Not(HasSubstr("The designed manoeuvre"))));
}

TEST(DiagnosisReport, OfADriveSpeaksItsUnits) {
  const std::string html = html_of(rippling_drive(), linear_drive());
  EXPECT_TRUE(has_section(html, "The force that the model lacks"));
  EXPECT_FALSE(has_section(html, "Measured and simulated")) << "nothing was simulated";
  EXPECT_THAT(html, AllOf(HasSubstr("position (m)"), HasSubstr("left (mN)"), Not(HasSubstr("Kalman")),
                          Not(HasSubstr("in a revolution"))));
}

TEST(DiagnosisReport, TellsMinusSignsFromHyphens) {
  Diagnosis diagnosis = rippling_brake();
  diagnosis.effects[0].parameters = {{"sine-1", "N m", -0.5, NAN}, {"tiny", "N", -3e-5, 1e-6}};
  EXPECT_THAT(html_of(diagnosis, kBrake),
              AllOf(HasSubstr("Sine-1 −0.5 N m"), HasSubstr("−3.00e−05 ± 1.0e−06 N")));
}

TEST(DiagnosisReport, DoesWithoutPicturesOfRuns) {
  Diagnosis diagnosis = rippling_brake();
  diagnosis.views.clear();
  EXPECT_EQ(figures_in(html_of(diagnosis, kBrake)), 2U) << "the ladder's";
  EXPECT_EQ(figures_in(html_of(Diagnosis{}, kBrake)), 0U);
}

}  // namespace
}  // namespace clampd
