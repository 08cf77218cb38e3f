#include "tools/reproduce/report.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <string_view>
#include <utility>
#include <vector>

#include <fmt/format.h>

#include "clampd/base/version.hpp"
#include "clampd/views/figure.hpp"
#include "clampd/views/page.hpp"
#include "tools/reproduce/claims.hpp"
#include "tools/reproduce/findings.hpp"

namespace clampd::reproduce {
namespace {

using report::Cell;
using report::Colour;
using report::Curve;
using report::Figure;
using report::Marker;
using report::Page;
using report::Panel;
using report::Points;
using report::Stroke;
using report::Table;

using Steps = std::vector<std::pair<std::string, std::string>>;

constexpr std::array kSymbols = {"k₁", "k₂", "T_C", "T_s0", "T_v", "μ_s", "ω_s"};
constexpr std::array kFigure1Colours = {Colour::Orange, Colour::Green, Colour::Blue, Colour::Purple};
/// Of the methods, the same in all figures.
constexpr Colour kMeasured = Colour::Black;
constexpr Colour kOem = Colour::Vermilion;
constexpr Colour kPem = Colour::Blue;
constexpr Colour kOemStep = Colour::Green;
constexpr Colour kNominal = Colour::Grey;

std::vector<double> scaled(const std::vector<double>& values, double factor) {
  std::vector<double> result(values);
  for (double& value : result) value *= factor;
  return result;
}

std::vector<double> kilo(const std::vector<double>& newtons) {
  return scaled(newtons, 1e-3);
}

/// With a typographic minus.
std::string signed_number(std::string text) {
  if (text.starts_with('-')) text.replace(0, 1, "−");
  return text;
}

/// Of the parameter, with typographic exponents.
std::string unit_of(std::size_t parameter) {
  std::string unit(kParameterTable[parameter].unit);
  for (const auto& [plain, raised] : {std::pair<std::string_view, std::string_view>{"^2", "²"}, {"^3", "³"}})
    if (const std::size_t at = unit.find(plain); at != std::string::npos)
      unit.replace(at, plain.size(), raised);
  return unit;
}

Curve level(double value, double from, double to) {
  return {.x = {from, to},
          .y = {value, value},
          .colour = Colour::Grey,
          .stroke = Stroke::Dotted,
          .width_px = 1.2};
}

/// "3.1 times smaller", or larger where the ratio is below one.
std::string comparison(double ratio, std::string_view above_one, std::string_view below_one) {
  return ratio >= 1.0 ? fmt::format("{:.2g} times {}", ratio, above_one)
                      : fmt::format("{:.2g} times {}", 1.0 / ratio, below_one);
}

// ---------------------------------------------------------------------------------------------------------

void add_summary(Page& page, const Study& study, const std::vector<Claim>& claims) {
  page.section("Summary");
  const auto count = [&claims](report::Tone tone) {
    return std::count_if(claims.begin(), claims.end(),
                         [tone](const Claim& claim) { return claim.tone == tone; });
  };
  page.paragraph(
      fmt::format("Of {} statements of the paper, {} came out here, {} in part, and {} not. All of it was "
                  "computed on a simulated brake, from seed {}, in {:.0f} s. Each section says what the "
                  "paper claims, what came out, and why the two differ.",
                  claims.size(), count(report::Tone::Good), count(report::Tone::Mixed),
                  count(report::Tone::Bad), study.options.seed, study.wall_s));
  Table table{.columns = {{"Where"}, {"The paper"}, {"Here"}, {"Verdict"}}};
  for (const Claim& claim : claims)
    table.rows.push_back({claim.where, claim.paper, claim.here, Cell(claim.verdict, claim.tone)});
  page.table(table);
}

void add_conditions(Page& page) {
  page.section("How it was done");
  page.definitions({
      {"The brake",
       "Simulated, with the means of Table II (PEM, optimal experiment) as its true parameters, so that the "
       "estimates have to leave the nominal start values. It integrates by Moreau's time stepping in steps "
       "of 20 µs with a set-valued friction law; the estimators integrate by another method, in steps of 1 "
       "ms."},
      {"The bench",
       "The station's own controller tracks each trajectory in closed loop, knowing only the nominal brake."},
      {"Noise",
       fmt::format(
           "White. Torque reading: {} N m, the paper's Q. Sensors: the paper states no noise; assumed are {} "
           "N and {} rad/s on the bench, and {} N and {} rad/s in the design of experiments.",
           kBenchNoise.torque_Nm, kBenchNoise.sensors.force_N, kBenchNoise.sensors.velocity_rad_s,
           kDesignNoise.force_N, kDesignNoise.velocity_rad_s)},
      {"The model",
       "Equations (1) to (6) with the lost sign of T_f restored: J v' = T − N F(x) − T_f(F, v). The smooth "
       "sign tanh(εv) is replaced by its limit ε → ∞: at 1 ms forward Euler (8) has no usable ε, since below "
       "about 0.65 s/rad the clamped brake creeps by hundreds of newtons and above it the velocity chatters "
       "by up to several rad/s. A design optimiser exploits that chatter and claims criteria that no brake "
       "shows."},
      {"The noise matrix",
       "B_v = [0, tₛ/J]ᵀ. As printed, [0, 1/J]ᵀ, the paper's Q would mean a velocity noise of 48.8 rad/s in "
       "each sample instead of 0.0488."},
      {"PEM",
       "On innovations: y(k) − h(x̂(k|k−1)) weighted with S(k), plus ½ Σ log det S(k). The printed cost takes "
       "the corrected output ŷ(k|k), which has already seen y(k): it favours too much torque noise and too "
       "little of the sensors'."},
  });
  Table table{
      .caption = "Parameters, normalised by Table I.",
      .columns = {{"Parameter"}, {"Unit"}, {"Nominal (Table I)", true}, {"True here, of nominal", true}}};
  const ParameterVector truth = true_brake().theta.cwiseQuotient(nominal_parameters());
  for (std::size_t i = 0; i < kParameterCount; ++i)
    table.rows.push_back({kSymbols[i], unit_of(i),
                          signed_number(fmt::format("{:.3g}", kParameterTable[i].nominal)),
                          fmt::format("{:.3f}", truth[static_cast<Eigen::Index>(i)])});
  page.table(table);
}

// ---------------------------------------------------------------------------------------------------------

Result<void> add_figure_1(Page& page, const Study& study, const Findings& f) {
  page.section("Fig. 1: optimal trajectories");
  Panel torque{.y = {.label = "torque (N m)"}}, velocity{.y = {.label = "velocity (rad/s)"}},
      force{.x = {.label = "time (s)"}, .y = {.label = "clamp force (kN)"}};
  const DesignLimits limits;
  for (std::size_t i = 0; i < kFigure1_samples.size(); ++i) {
    const Design* const design = design_of(study.d_designs, kFigure1_samples[i]);
    if (design == nullptr) continue;
    const Run& run = design->response;
    torque.layers.push_back(Curve{.label = fmt::format("{:.1f} s", design->duration_s()),
                                  .x = run.time_s,
                                  .y = run.torque_Nm,
                                  .colour = kFigure1Colours[i],
                                  .held = true});
    velocity.layers.push_back(Curve{.x = run.time_s, .y = run.velocity_rad_s, .colour = kFigure1Colours[i]});
    force.layers.push_back(Curve{.x = run.time_s, .y = kilo(run.force_N), .colour = kFigure1Colours[i]});
  }
  const double end_s = 0.4;
  for (const double sign : {-1.0, 1.0}) {
    torque.layers.push_back(level(sign * limits.torque_Nm, 0.0, end_s));
    velocity.layers.push_back(level(sign * limits.velocity_rad_s, 0.0, end_s));
  }
  force.layers.push_back(level(1e-3 * limits.force_N, 0.0, end_s));
  if (auto drawn = page.figure({.panels = {torque, velocity, force}, .panel_height_px = 210},
                               "D-optimal experiments of the nominal brake, 20 samples a block, from contact "
                               "at rest. Dotted: the limits of Table I.");
      !drawn)
    return drawn;

  Table table{.columns = {{"Length"},
                          {"−log det M", true},
                          {"trace M⁻¹", true},
                          {"Peak force (kN)", true},
                          {"Peak speed (rad/s)", true},
                          {"Speed at the end (rad/s)", true}}};
  for (const std::size_t samples : kFigure1_samples)
    if (const Design* const design = design_of(study.d_designs, samples))
      table.rows.push_back(
          {fmt::format("{:.1f} s", design->duration_s()),
           signed_number(fmt::format("{:.2f}", design->summary.criterion.logdet)),
           fmt::format("{:.4f}", design->summary.criterion.trace_inverse),
           fmt::format("{:.1f}", 1e-3 * design->summary.certification.force_max_N),
           fmt::format("{:.0f}", design->summary.certification.velocity_max_rad_s),
           signed_number(fmt::format("{:.0f}", design->summary.certification.end_velocity_rad_s))});
  page.table(table);
  page.definitions({
      {"The paper",
       "Whatever the length, the force resembles a step response; the velocity accelerates, stays at its "
       "maximum and returns to zero. From 0.18 s on the peak force stays at about 23 kN."},
      {"Here",
       fmt::format("90 % of the peak force is reached within {:.0f} % of the length. The designs of 0.18 s "
                   "and more peak between {:.1f} and {:.1f} kN, and move at up to {:.0f} rad/s.",
                   100.0 * f.latest_rise, 1e-3 * f.long_force_min_N, 1e-3 * f.long_force_max_N,
                   f.speed_max_rad_s)},
      {"Why they differ",
       "The optimiser and the integrator. The paper's genetic algorithm stops early in a problem with very "
       "many local optima; gradient searches from many starts use more of what the limits allow. Every "
       "design here is certified by an integrator that shares no code with the search, and the search shuns "
       "experiments that hold for exact torques only."},
  });
  return {};
}

Result<void> add_figure_2(Page& page, const Study& study, const Findings& f) {
  page.section("Fig. 2: criteria over the length");
  Panel d{.title = "D: −log det M", .x = {.label = "length (s)"}, .y = {.label = "−log det M"}};
  Panel a{.title = "A: trace of M⁻¹",
          .x = {.label = "length (s)"},
          .y = {.label = "sum of relative variances", .logarithmic = true}};
  const auto add = [&](const std::vector<Design>& designs, const std::string& label, Colour colour,
                       Marker marker) {
    Curve logdet{.colour = colour}, trace{.colour = colour};
    for (const Design& design : designs) {
      logdet.x.push_back(design.duration_s());
      logdet.y.push_back(design.summary.criterion.logdet);
      trace.y.push_back(design.summary.criterion.trace_inverse);
    }
    trace.x = logdet.x;
    for (auto& [panel, curve] : {std::pair<Panel&, Curve&>{d, logdet}, {a, trace}}) {
      Points points{.x = curve.x, .y = curve.y, .colour = colour, .marker = marker, .size = 0.6};
      points.label = label;
      panel.layers.push_back(curve);
      panel.layers.push_back(points);
    }
  };
  add(study.d_designs, "D-optimal", Colour::Blue, Marker::Dot);
  add(study.a_designs, "A-optimal", Colour::Vermilion, Marker::Square);
  if (auto drawn =
          page.figure({.panels = {d, a}, .columns = 2, .panel_height_px = 330},
                      "Both criteria of the D-optimal and of the A-optimal experiments. Smaller is better.");
      !drawn)
    return drawn;
  page.definitions({
      {"The paper",
       "Both criteria fall with the length; the fall is steeper for experiments shorter than 0.18 s."},
      {"Here",
       fmt::format("With {} of {} steps of 20 ms −log det M falls (D-optimal), with {} of {} the trace of "
                   "M⁻¹ (A-optimal). −log det M falls by {:.1f} per 20 ms just before 0.18 s and by {:.1f} "
                   "just after: {}.",
                   f.d_falls, study.d_designs.size() - 1, f.a_falls, study.a_designs.size() - 1,
                   f.steepness_before, f.steepness_after,
                   f.steepness_after < 0.6 * f.steepness_before ? "a knee" : "a gentle bend, no knee")},
      {"Why they differ",
       "The paper explains its knee by the peak force, which stops growing at 0.18 s. Optimisers that find "
       "better experiments do not stop there but at the limit of 30 kN, and the information goes on growing. "
       "A search that repeats from many starts is also more even from length to length; where a curve still "
       "rises, the search has missed a better experiment, for what an experiment tells does not get less by "
       "going on."},
  });
  return {};
}

// ---------------------------------------------------------------------------------------------------------

Result<void> add_figure_4(Page& page, const Study& study) {
  page.section("Fig. 4: what is measured");
  std::array<Panel, 6> panels;
  const std::array<const Experiment*, 2> experiments = {&study.optimal, &study.step};
  for (std::size_t column = 0; column < 2; ++column) {
    const SimulatedRun& run = experiments[column]->runs.front();
    panels[column] = {
        .title = column == 0 ? "optimal" : "non-optimal: a step",
        .y = {.label = "torque (N m)"},
        .layers = {Curve{.x = run.readings.time_s, .y = run.readings.torque_Nm, .width_px = 1.0}}};
    panels[2 + column] = {.y = {.label = "velocity (rad/s)"},
                          .layers = {Curve{.x = run.readings.time_s, .y = run.readings.velocity_rad_s}}};
    panels[4 + column] = {.x = {.label = "time (s)"},
                          .y = {.label = "clamp force (kN)"},
                          .layers = {Curve{.x = run.readings.time_s, .y = kilo(run.readings.force_N)}}};
  }
  if (auto drawn =
          page.figure({.panels = {panels.begin(), panels.end()}, .columns = 2, .panel_height_px = 235},
                      "The readings of the first repeat of both experiments, 0.3 s each.");
      !drawn)
    return drawn;
  page.definitions({
      {"The paper", "Shows one repeat of the optimal and of a non-optimal experiment of the same length."},
      {"Here",
       fmt::format("The optimal experiment is D-optimal within {:.0f} % of the limits, −log det M = {}. "
                   "Driven by the controller, the true brake reached {:.1f} kN and {:.0f} rad/s in it.",
                   100.0 * kHeadroom,
                   signed_number(fmt::format("{:.2f}", study.tracked.summary.criterion.logdet)),
                   1e-3 * study.optimal.force_max_N, study.optimal.speed_max_rad_s)},
      {"Why not the one of Fig. 1",
       fmt::format(
           "That one uses the limits up. A brake with {:.1f} times the viscous friction cannot follow it, "
           "and the closed loop needs torque to correct with. It may also let a torque error grow more: "
           "under load slow motion is open-loop unstable at about 62 /s. For the bench a torque that is off "
           "by 1 mN m all along may move the velocity by {:.0f} rad/s at most.",
           true_brake().theta[Tv] / nominal_parameters()[Tv], 1e-3 * kBenchAmplification_rad_s_Nm)},
  });
  return {};
}

void add_table_2(Page& page, const Study& study, const Findings& f) {
  page.section("Table II: estimates of the normalised parameters");
  const std::array<std::pair<const Column*, const PaperColumn*>, 3> columns = {
      {{&study.oem_optimal, &kPaperOemOptimal},
       {&study.pem_optimal, &kPaperPemOptimal},
       {&study.oem_step, &kPaperOemStep}}};
  const ParameterVector truth = true_brake().theta.cwiseQuotient(nominal_parameters());
  for (const auto& [column, paper] : columns) {
    Table table{.caption = fmt::format(
                    "{}: {} of {} repeats, each estimated alone. Variances and bounds in 10⁻⁴.", column->name,
                    column->estimates.size(), column->estimates.size() + column->failed),
                .columns = {{"Parameter"},
                            {"True", true},
                            {"Mean", true},
                            {"Variance", true},
                            {"Cramér-Rao", true},
                            {"Same, exact torque", true},
                            {"Paper: mean", true},
                            {"Paper: variance", true}}};
    for (std::size_t i = 0; i < kParameterCount; ++i) {
      const auto k = static_cast<Eigen::Index>(i);
      table.rows.push_back(
          {kSymbols[i], fmt::format("{:.3f}", truth[k]), fmt::format("{:.3f}", column->mean[k]),
           fmt::format("{:.3f}", 1e4 * column->covariance(k, k)),
           fmt::format("{:.3f}", 1e4 * column->bound(k, k)),
           fmt::format("{:.3f}", 1e4 * column->bound_exact(k, k)), fmt::format("{:.3f}", paper->mean[i]),
           fmt::format("{:.1f}", 1e4 * paper->variance[i])});
    }
    page.table(table);
  }
  page.paragraph(fmt::format(
      "Cramér-Rao: the smallest variance that an unbiased estimator can have, the initial state unknown, "
      "with the torque noise counted; beside it the paper's figure (14), which takes the torque reading as "
      "exact. A variance over {} repeats is itself uncertain by about {:.0f} %.",
      study.options.repeats, 100.0 * std::sqrt(2.0 / (study.options.repeats - 1.0))));

  Table figures{.columns = {{"Column"},
                            {"Efficiency", true},
                            {"Far off", true},
                            {"Largest error of a mean", true},
                            {"Sum of variances", true},
                            {"Sum of bounds", true},
                            {"Paper: sum of its table", true},
                            {"Paper: sum in its text", true}}};
  const std::array<const ColumnFigures*, 3> all = {&f.oem_optimal, &f.pem_optimal, &f.oem_step};
  for (std::size_t i = 0; i < columns.size(); ++i)
    figures.rows.push_back(
        {columns[i].first->name, fmt::format("{:.2f}", all[i]->efficiency),
         fmt::format("{}", all[i]->far_off),
         fmt::format("{:.1f} σ ({})", all[i]->largest_bias_sd, kSymbols[all[i]->most_biased]),
         fmt::format("{:.4f}", all[i]->sum_of_variances), fmt::format("{:.4f}", all[i]->sum_of_bounds),
         fmt::format("{:.4f}", sum_of_variances(*columns[i].second)),
         fmt::format("{:.5f}", columns[i].second->sum_of_variances)});
  figures.caption =
      "Efficiency: bound over variance, geometric mean over the parameters. Far off: estimates with a "
      "parameter more than six standard deviations of the bound from the truth. Error of a mean: in its own "
      "standard errors.";
  page.table(figures);
  page.definitions({
      {"The paper",
       "OEM and PEM agree in their means, away from the nominal values; PEM scatters less than OEM, the "
       "optimal experiment less than the non-optimal one."},
      {"Here",
       fmt::format(
           "PEM's variance is {} than OEM's; OEM's is {} with the step than with the optimal experiment, and "
           "what is possible at all is {} with the step (all as geometric means over the parameters).",
           comparison(f.methods_variance_ratio, "smaller", "larger"),
           comparison(f.design_variance_ratio, "larger", "smaller"),
           comparison(f.design_bound_ratio, "larger", "smaller"))},
      {"What torque noise does",
       fmt::format("OEM takes the torque reading as exact. Its noise moves the brake, and the output errors "
                   "that it leaves are neither white nor of constant size; under slow load they grow, and "
                   "where a simulation locks up the fit can end far off: {} of {} estimates here. The bound "
                   "itself is {:.1f} times larger with torque noise than without.",
                   f.oem_optimal.far_off, study.oem_optimal.estimates.size(), f.torque_noise_loss)},
      {"Why the variances differ from the paper's",
       "Its rig has more to it than seven parameters and white noise: an estimate also scatters by what "
       "changes from repeat to repeat, and the sensors' noise is not stated. The variances here are those of "
       "the stated noise alone."},
      {"The sums of variances",
       fmt::format("Those in the paper's text do not follow from its table. The plain sums of the table, "
                   "{:.4f}, {:.4f} and {:.4f}, even rank the non-optimal experiment first; no weighting that "
                   "was tried gives the printed ones. They are not reproduced.",
                   sum_of_variances(kPaperOemOptimal), sum_of_variances(kPaperPemOptimal),
                   sum_of_variances(kPaperOemStep))},
      {"The torque noise",
       fmt::format("PEM over all repeats at once estimates {:.4f} N m; {:.4f} is true. From single repeats, "
                   "by restricted maximum likelihood, {:.4f} on average. Plain maximum likelihood from one "
                   "run often collapses to zero.",
                   study.pooled.noise_torque_Nm, kBenchNoise.torque_Nm, f.mean_torque_noise_Nm)},
  });
}

// ---------------------------------------------------------------------------------------------------------

Result<void> add_figure_5(Page& page, const Study& study, const Findings& f) {
  page.section("Fig. 5: confidence regions");
  struct Shown {
    const Column* column;
    Colour colour;
    Marker marker;
  };
  const std::array<Shown, 3> shown = {{{&study.oem_step, kOemStep, Marker::Triangle},
                                       {&study.oem_optimal, kOem, Marker::Square},
                                       {&study.pem_optimal, kPem, Marker::Dot}}};
  const ParameterVector truth = true_brake().theta.cwiseQuotient(nominal_parameters());
  Figure figure{.columns = 2, .panel_height_px = 340};
  for (const auto& [first, second] : kFigure5_pairs) {
    const auto x = static_cast<Eigen::Index>(first), y = static_cast<Eigen::Index>(second);
    Panel panel{.x = {.label = fmt::format("{} / nominal", kSymbols[first])},
                .y = {.label = fmt::format("{} / nominal", kSymbols[second])}};
    for (const Shown& one : shown) {
      Points points{.label = one.column->name, .colour = one.colour, .marker = one.marker, .size = 0.45};
      for (const Estimate& estimate : one.column->estimates) {
        const ParameterVector normalised = estimate.parameters.theta.cwiseQuotient(nominal_parameters());
        points.x.push_back(normalised[x]);
        points.y.push_back(normalised[y]);
      }
      const ParameterMatrix& c = one.column->covariance;
      Curve outline = report::confidence_ellipse(one.column->mean[x], one.column->mean[y], c(x, x), c(x, y),
                                                 c(y, y), 0.5);
      outline.colour = one.colour;
      panel.layers.push_back(std::move(points));
      panel.layers.push_back(std::move(outline));
    }
    panel.layers.push_back(Points{.label = "true",
                                  .x = {truth[x]},
                                  .y = {truth[y]},
                                  .colour = Colour::Black,
                                  .marker = Marker::Cross,
                                  .size = 1.0});
    figure.panels.push_back(std::move(panel));
  }
  if (auto drawn = page.figure(
          figure, "Single estimates, and the region that holds half of them if they are Gaussian.");
      !drawn)
    return drawn;
  const auto correlation = [](const Column& column, Parameter a, Parameter b) {
    const ParameterMatrix& c = column.covariance;
    const auto i = static_cast<Eigen::Index>(a), j = static_cast<Eigen::Index>(b);
    return signed_number(fmt::format("{:+.2f}", c(i, j) / std::sqrt(c(i, i) * c(j, j))));
  };
  page.definitions({
      {"The paper",
       "PEM's 50 % regions are smaller than OEM's, and OEM's smaller than those of the non-optimal "
       "experiment."},
      {"Here",
       fmt::format(
           "OEM's regions have {:.2g} times the area of PEM's, those of the step {:.2g} times that of OEM's "
           "with the optimal experiment (geometric means over the four pairs). PEM's estimates correlate by "
           "{} (k₁, k₂), {} (T_C, T_v) and {} (T_s0, μ_s): what one parameter gains, the other loses, so "
           "that the brake they describe is known far better than each of them.",
           f.methods_area_ratio, f.design_area_ratio, correlation(study.pem_optimal, k1, k2),
           correlation(study.pem_optimal, TC, Tv), correlation(study.pem_optimal, Ts0, mus))},
      {"Why they differ",
       "The paper's regions also hold what its rig changes by from repeat to repeat; on the simulated bench "
       "nothing but noise does."},
  });
  return {};
}

Table predictions_table(const std::vector<Prediction>& predictions) {
  Table table{
      .columns = {{"Parameters"}, {"Force, rms error (N)", true}, {"Velocity, rms error (rad/s)", true}}};
  for (const Prediction& prediction : predictions)
    table.rows.push_back({prediction.name, fmt::format("{:.0f}", prediction.force_rms_N),
                          fmt::format("{:.2f}", prediction.velocity_rms_rad_s)});
  return table;
}

Result<void> add_figure_6(Page& page, const Study& study) {
  page.section("Fig. 6: validation by a step");
  const Run& run = study.validation.readings;
  Panel force{.y = {.label = "clamp force (kN)"}},
      velocity{.x = {.label = "time (s)"}, .y = {.label = "velocity (rad/s)"}};
  force.layers.push_back(Curve{
      .label = "measured", .x = run.time_s, .y = kilo(run.force_N), .colour = kMeasured, .width_px = 3.0});
  velocity.layers.push_back(
      Curve{.x = run.time_s, .y = run.velocity_rad_s, .colour = kMeasured, .width_px = 3.0});
  constexpr std::array kColours = {kNominal, kOem, kPem, kOemStep};
  constexpr std::array kStrokes = {Stroke::Solid, Stroke::Solid, Stroke::Dashed, Stroke::Dotted};
  for (std::size_t i = 0; i < study.validation_predictions.size(); ++i) {
    const Prediction& prediction = study.validation_predictions[i];
    force.layers.push_back(Curve{.label = prediction.name,
                                 .x = run.time_s,
                                 .y = kilo(prediction.simulation.force_N),
                                 .colour = kColours[i],
                                 .stroke = kStrokes[i]});
    velocity.layers.push_back(Curve{.x = run.time_s,
                                    .y = prediction.simulation.velocity_rad_s,
                                    .colour = kColours[i],
                                    .stroke = kStrokes[i]});
  }
  if (auto drawn = page.figure({.panels = {force, velocity}, .panel_height_px = 270},
                               "To 20 kN, hold, and back: a run that no estimate has seen, and open-loop "
                               "simulations of it under the recorded torque.");
      !drawn)
    return drawn;
  page.table(predictions_table(study.validation_predictions));
  const std::vector<Prediction>& p = study.validation_predictions;
  page.definitions({
      {"The paper",
       "Simulations with OEM's and PEM's estimates overlap the measurement, those with nominal values do "
       "not. Estimates of the non-optimal experiment overshoot in velocity and deviate after 0.2 s."},
      {"Here", fmt::format("The nominal brake errs by {:.1f} kN rms, OEM by {:.0f} N, PEM by {:.0f} N, and "
                           "OEM's estimates from the step by {:.0f} N.",
                           1e-3 * p[0].force_rms_N, p[1].force_rms_N, p[2].force_rms_N, p[3].force_rms_N)},
      {"Why",
       std::string(p[3].force_rms_N > 1.5 * p[1].force_rms_N
                       ? "What the step's estimates are off by shows in open loop."
                       : "The non-optimal experiment here is a step as well, and tells much of what a step "
                         "needs. What the paper sees after 0.2 s, too little friction, needs physics that "
                         "its seven parameters lack, or a poorer experiment: it does not describe its own.") +
           " The rest of the error is the noise of the recorded torque, which no parameters can undo."},
  });
  return {};
}

// ---------------------------------------------------------------------------------------------------------

report::Axis limited(const std::string& label, double lower, double upper) {
  report::Axis axis;
  axis.label = label;
  axis.lower = lower;
  axis.upper = upper;
  return axis;
}

/// Around what OEM's simulation does worst.
report::Axis zoomed(const Findings& f) {
  const double begin_s = f.shown_rest.begin_s;
  return limited("time (s)", begin_s - 0.1, begin_s + 0.1 + std::clamp(f.shown_rest.longest_s, 0.1, 0.4));
}

Result<void> add_figure_7(Page& page, const Study& study, const Findings& f) {
  page.section("Fig. 7: sinusoid under load, open loop");
  const Run& run = study.sinusoid.runs[study.shown_repeat].readings;
  Panel force{.y = {.label = "clamp force (kN)"}}, velocity{.y = {.label = "velocity (rad/s)"}};
  force.layers.push_back(Curve{
      .label = "measured", .x = run.time_s, .y = kilo(run.force_N), .colour = kMeasured, .width_px = 3.0});
  velocity.layers.push_back(
      Curve{.x = run.time_s, .y = run.velocity_rad_s, .colour = kMeasured, .width_px = 3.0});
  constexpr std::array kColours = {kOem, kPem, Colour::Orange};
  constexpr std::array kStrokes = {Stroke::Solid, Stroke::Dashed, Stroke::Dotted};
  for (std::size_t i = 0; i < study.sinusoid_replays.size(); ++i) {
    const Prediction& prediction = study.sinusoid_replays[i].repeats[study.shown_repeat];
    force.layers.push_back(Curve{.label = study.sinusoid_replays[i].name,
                                 .x = run.time_s,
                                 .y = kilo(prediction.simulation.force_N),
                                 .colour = kColours[i],
                                 .stroke = kStrokes[i]});
    velocity.layers.push_back(Curve{.x = run.time_s,
                                    .y = prediction.simulation.velocity_rad_s,
                                    .colour = kColours[i],
                                    .stroke = kStrokes[i]});
  }
  const Panel zoom{.title = "around the longest rest of OEM's simulation",
                   .x = zoomed(f),
                   .y = limited("velocity (rad/s)", -40.0, 40.0),
                   .layers = velocity.layers};
  if (auto drawn = page.figure({.panels = {force, velocity, zoom}, .panel_height_px = 240},
                               "1.5 Hz between 5 and 20 kN: the repeat in which OEM's simulation errs most. "
                               "Simulations under the recorded torque, with the means of the estimates from "
                               "the optimal experiment and with the true parameters.");
      !drawn)
    return drawn;
  Table table{
      .caption = fmt::format("Over all {} repeats. Lock-up: a rest 10 ms longer than the brake's longest.",
                             study.options.repeats),
      .columns = {{"Parameters"},
                  {"Repeats with a lock-up", true},
                  {"Longest rest (ms)", true},
                  {"Force rms error, median (N)", true},
                  {"Force rms error, largest (N)", true}}};
  for (std::size_t i = 0; i < f.replays.size(); ++i)
    table.rows.push_back({study.sinusoid_replays[i].name, fmt::format("{}", f.replays[i].locked),
                          fmt::format("{:.0f}", 1e3 * f.replays[i].longest_s),
                          fmt::format("{:.0f}", f.replays[i].median_force_rms_N),
                          fmt::format("{:.0f}", f.replays[i].worst_force_rms_N)});
  table.rows.push_back({"the brake itself", "", fmt::format("{:.0f}", 1e3 * f.brake_longest_rest_s), "", ""});
  page.table(table);
  page.definitions({
      {"The paper",
       "The simulation locks up where the velocity crosses zero at the peak of the force, the brake does "
       "not, and the force then deviates. Between lock-ups they agree."},
      {"Here", fmt::format("Of {} repeats, {} lock up with OEM's estimates, {} with PEM's, and {} with the "
                           "true parameters. The force is off by up to {:.1f}, {:.1f} and {:.1f} kN rms.",
                           study.options.repeats, f.replays[0].locked, f.replays[1].locked,
                           f.replays[2].locked, 1e-3 * f.replays[0].worst_force_rms_N,
                           1e-3 * f.replays[1].worst_force_rms_N, 1e-3 * f.replays[2].worst_force_rms_N)},
      {"Why",
       "μ_s exceeds N: the clamped brake is self-locking, and at rest any torque within the friction holds "
       "it. Under load friction falls with speed by about 0.018 N m s/rad, so that slow motion is open-loop "
       "unstable at about 62 /s. An error of torque or parameters too small to see elsewhere decides at each "
       "reversal whether and when the simulated brake starts to move again; what follows is another path. "
       "This is a property of the brake, not of the estimates."},
  });
  return {};
}

Result<void> add_figure_8(Page& page, const Study& study, const Findings& f) {
  page.section("Fig. 8: the Kalman filter on the sinusoid");
  const SimulatedRun& run = study.sinusoid.runs[study.shown_repeat];
  const std::vector<double>& time_s = run.readings.time_s;
  const BandedRun& filtered = study.kalman.filtered;
  const auto bound = [](const Band& band, double deviations, double factor) {
    std::vector<double> values;
    for (std::size_t k = 0; k < band.mean.size(); ++k)
      values.push_back(factor * (band.mean[k] + deviations * band.sd[k]));
    return values;
  };
  const auto band_of = [&](const Band& band, double factor) {
    return report::Band{.label = "estimate ± 2 σ",
                        .x = time_s,
                        .lower = bound(band, -2.0, factor),
                        .upper = bound(band, 2.0, factor),
                        .colour = kPem};
  };
  std::vector<double> true_velocity_rad_s, force_error_N, lower_N, upper_N;
  for (std::size_t k = 0; k < time_s.size(); ++k) {
    true_velocity_rad_s.push_back(run.truth[k].velocity_rad_s);
    force_error_N.push_back(filtered.force_N.mean[k] - run.truth[k].force_N);
    lower_N.push_back(-2.0 * filtered.force_N.sd[k]);
    upper_N.push_back(2.0 * filtered.force_N.sd[k]);
  }
  const Panel force{
      .y = {.label = "clamp force (kN)"},
      .layers = {Curve{.label = "measured",
                       .x = time_s,
                       .y = kilo(run.readings.force_N),
                       .colour = kMeasured,
                       .width_px = 3.0},
                 band_of(filtered.force_N, 1e-3),
                 Curve{.label = "estimate", .x = time_s, .y = kilo(filtered.force_N.mean), .colour = kPem}}};
  const Panel error{
      .title = "force: estimate minus truth",
      .y = {.label = "force (N)"},
      .layers = {
          report::Band{.label = "± 2 σ", .x = time_s, .lower = lower_N, .upper = upper_N, .colour = kPem},
          Curve{.label = "error", .x = time_s, .y = force_error_N, .colour = kMeasured, .width_px = 1.0}}};
  const Panel zoom{
      .title = "velocity at a zero crossing under full load",
      .x = limited("time (s)", f.crossing_s - 0.02, f.crossing_s + 0.02),
      .y = limited("velocity (rad/s)", -10.0, 10.0),
      .layers = {band_of(filtered.velocity_rad_s, 1.0),
                 Curve{.label = "estimate", .x = time_s, .y = filtered.velocity_rad_s.mean, .colour = kPem},
                 Curve{.label = "true",
                       .x = time_s,
                       .y = true_velocity_rad_s,
                       .colour = kMeasured,
                       .stroke = Stroke::Dashed}}};
  const Panel deviation{.title = "standard deviation of the velocity",
                        .x = {.label = "time (s)"},
                        .y = {.label = "σ (rad/s)"},
                        .layers = {Curve{.x = time_s, .y = filtered.velocity_rad_s.sd, .colour = kPem}}};
  if (auto drawn = page.figure(
          {.panels = {force, error, zoom, deviation}, .panel_height_px = 220},
          "The extended Kalman filter (15) to (19) with PEM's parameters on the run of Fig. 7. The paper's "
          "band is one variance wide; here it is ± 2 standard deviations of the state.");
      !drawn)
    return drawn;
  page.definitions({
      {"The paper",
       "Estimated force and its band overlap; the variance of the velocity grows at its zero crossings, yet "
       "no lock-up is seen."},
      {"Here",
       fmt::format(
           "The force is off by {:.0f} N rms, its band ±{:.0f} N wide, and {:.0f} % of the true forces and "
           "{:.0f} % of the true velocities lie within their bands. The velocity's band widens to ±{:.2f} "
           "rad/s around the crossings (slower than 20 rad/s); elsewhere it is ±{:.2f} on average.",
           f.filter_force_error_N, 2.0 * f.filter_force_sd_N, 100.0 * f.covered_force,
           100.0 * f.covered_velocity, 2.0 * f.velocity_sd_crossing_rad_s, 2.0 * f.velocity_sd_moving_rad_s)},
      {"Estimation from the sinusoid",
       fmt::format("Estimated from the sinusoid alone, PEM's parameters are {} than OEM's (median error over "
                   "the repeats, geometric mean over the parameters).",
                   comparison(f.sinusoid_error_ratio, "closer to the truth", "further from it"))},
      {"Why they differ",
       "The set-valued model knows rest: at the instant of rest the velocity is zero and its band with it, "
       "while the paper's smooth tanh(εv) never rests. Around it the band widens with the load, since slow "
       "motion is unstable there. How wide it gets depends on the sensors' noise, too, which the paper does "
       "not state."},
  });
  return {};
}

void add_times(Page& page, const Study& study, const Findings& f) {
  page.section("Computing time");
  Table table{.columns = {{"Method"}, {"One repeat (ms, median)", true}}};
  for (const Column* column : {&study.oem_optimal, &study.pem_optimal})
    table.rows.push_back({column->name, fmt::format("{:.2f}", 1e3 * column->median_wall_s)});
  page.table(table);
  page.definitions({
      {"The paper", "PEM requires ten times more computing time than OEM."},
      {"Here", fmt::format("{:.1f} times, starting from OEM's estimate.", f.time_ratio)},
      {"Why they differ",
       "The factor is one of the implementation. The filter adds a two by two covariance to each sample, and "
       "its Jacobians are sensitivities that are needed anyway; most of the rest is the estimation of the "
       "noise."},
  });
}

}  // namespace

Result<std::string> report_html(const Study& study) {
  const Findings findings = findings_of(study);
  Page page(
      "Rapid Parameter Identification for an Electromechanical Brake, reproduced",
      fmt::format("clampd {} · seed {} · {} repeats", kVersion, study.options.seed, study.options.repeats));
  add_summary(page, study, claims_of(study, findings));
  add_conditions(page);
  if (auto drawn = add_figure_1(page, study, findings); !drawn) return tl::unexpected(drawn.error());
  if (auto drawn = add_figure_2(page, study, findings); !drawn) return tl::unexpected(drawn.error());
  if (auto drawn = add_figure_4(page, study); !drawn) return tl::unexpected(drawn.error());
  add_table_2(page, study, findings);
  if (auto drawn = add_figure_5(page, study, findings); !drawn) return tl::unexpected(drawn.error());
  if (auto drawn = add_figure_6(page, study); !drawn) return tl::unexpected(drawn.error());
  if (auto drawn = add_figure_7(page, study, findings); !drawn) return tl::unexpected(drawn.error());
  if (auto drawn = add_figure_8(page, study, findings); !drawn) return tl::unexpected(drawn.error());
  add_times(page, study, findings);
  return page.html();
}

}  // namespace clampd::reproduce
