#include "src/drive/selection.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <set>

#include <fmt/format.h>

#include "clampd/statistics/distributions.hpp"

namespace clampd::drive {
namespace {

/// An effect has to take this share of the squared error where it was not fitted.
constexpr double kLeastTaken = 0.01;
/// And this where what is left is good enough without it.
constexpr double kLeastTakenBeyond = 0.05;
/// However certain, an effect whose torque is less than this share of what is good enough has no name: the
/// form of another effect, or of the friction, is hardly ever known to the last per cent.
constexpr double kLeastOfGoodEnough = 0.15;
/// For the same reason it has to take this share of the base model's squared error, unless it makes this much
/// of what is good enough.
constexpr double kLeastOfBase = 0.012, kMuchOfGoodEnough = 0.7;
/// Averages, filters and controllers are late by a few rows. That has a name only if it costs what is good
/// enough.
constexpr double kFewRows = 6.0;
/// Differences of held-out blocks count from two of their standard errors on.
constexpr double kCertain = 2.0;
/// The rivals together have 99 % of the posterior.
const double kRivalNats = std::log(99.0);
/// By which what needs one number more has to be better.
constexpr double kNatsANumber = 3.0;
/// From here on evidence of the same rows is believed though the held-out blocks do not all agree.
constexpr double kOverwhelmingNats = 25.0;

struct Paired {
  double significance_nats() const {
    if (!(error > 0.0) || !(mean > 0.0)) return 0.0;
    const double t = mean / error;
    return -std::log(std::max(1e-300, statistics::fisher_f_p_value(t * t, 1.0, count - 1.0)));
  }
  double mean = 0.0, error = 0.0;
  double second = 0.0;  ///< sum of what the second leaves
  int count = 0;
};

/// Of what the second leaves less what the first leaves, block by block, where both can be judged.
Paired paired(const std::vector<double>& first, const std::vector<double>& second) {
  Paired result;
  std::vector<double> differences;
  for (std::size_t b = 0; b < std::min(first.size(), second.size()); ++b) {
    if (std::isnan(first[b]) || std::isnan(second[b])) continue;
    differences.push_back(second[b] - first[b]);
    result.second += second[b];
  }
  if (differences.size() < 3) return {};
  const auto count = static_cast<double>(differences.size());
  result.count = static_cast<int>(differences.size());
  for (const double each : differences) result.mean += each / count;
  double square = 0.0;
  for (const double each : differences) square += std::pow(each - result.mean, 2);
  result.error = std::sqrt(square / (count - 1.0) / count);
  return result;
}

std::vector<double> logarithms(std::vector<double> values) {
  for (double& value : values) value = std::log(value);
  return values;
}

double sum(const std::vector<double>& values) {
  double total = 0.0;
  for (const double value : values) total += value;
  return total;
}

int numbers(const TorqueModel& model) {
  int count = 0;
  for (const Variant& part : model.parts) count += complexity(part);
  return count;
}

}  // namespace

const Variant* TorqueModel::part(DriveTerm term) const {
  for (const Variant& each : parts)
    if (each.term == term) return &each;
  return nullptr;
}

Selector::Selector(Design& design, const DriveRange& range, const DriveModel& model,
                   const SelectionOptions& options)
    : design_(design), range_(range), model_(model), options_(options) {
  const auto add = [&](DriveTerm term, PartUse use) {
    if (use == PartUse::Off || use == PartUse::Fixed) return;
    std::vector<Variant> variants = variants_of(term, range, design.data(), model);
    if (use == PartUse::Estimate) {
      if (variants.empty()) return;
      // A shape that the file does not give: the widest of the first kind.
      Variant chosen = variants.front();
      if (term == DriveTerm::FrictionAsymmetry || term == DriveTerm::FrictionPosition ||
          term == DriveTerm::LoadPosition)
        chosen = variants[1];
      chosen.alternatives = 1.0;
      base_.push_back(chosen);
      return;
    }
    pool_.insert(pool_.end(), variants.begin(), variants.end());
  };
  for (std::size_t t = 0; t < kDriveTermCount; ++t) {
    const auto term = static_cast<DriveTerm>(t);
    if (term == DriveTerm::Regressor) continue;
    if (model.parts[t].use == PartUse::Candidate && unidentifiable(term, range, design.data(), model))
      continue;
    add(term, model.parts[t].use);
  }
  for (Variant& each : variants_of(DriveTerm::Regressor, range, design.data(), model)) {
    const std::string name = each.name.substr(each.name.find(':') + 1);
    const auto regressor = std::ranges::find(model.regressors, name, &DriveRegressor::name);
    if (regressor->use == PartUse::Candidate)
      pool_.push_back(std::move(each));
    else if (each.functions.size() == 1 && each.functions.front().carrier == BasisFunction::Carrier::One)
      base_.push_back(std::move(each));
  }
  const Eigen::VectorXd torque = design.raw(design.target({options.lag_s}));
  variation_ = (torque.array() - torque.mean()).matrix().norm();
  const double good_enough = model.good_enough * variation_;
  least_square_ = std::pow(kLeastOfGoodEnough * good_enough, 2);
  if (const TorqueModel base = fitted(base_); base.ok())
    least_square_ = std::max(least_square_, std::min(kLeastOfBase * design.residuals(base.fit).squaredNorm(),
                                                     std::pow(kMuchOfGoodEnough * good_enough, 2)));
  std::set<std::string> names{"cogging"};
  for (const Variant& each : pool_) names.insert(each.name);
  candidates_ = static_cast<int>(names.size()) + 2;
}

bool Selector::is_base(const Variant& variant) const {
  return std::ranges::find(base_, variant) != base_.end();
}

double Selector::critical(double alternatives) const {
  return std::log(candidates_ / options_.false_alarm) + std::log(std::max(1.0, alternatives));
}

TorqueModel Selector::fitted(std::vector<Variant> parts) {
  TorqueModel model;
  const bool power_law = std::ranges::any_of(parts, &Variant::replaces_viscous);
  std::vector<int> columns;
  double choices = 0.0;
  for (Variant& part : parts) {
    part.columns.clear();
    choices += std::log(std::max(1.0, part.alternatives));
    if ((power_law && part.term == DriveTerm::Viscous) || part.saturation != 0.0) continue;
    if (part.frozen.empty())
      for (const BasisFunction& function : part.functions) part.columns.push_back(design_.column(function));
    else
      part.columns = part.frozen;
    columns.insert(columns.end(), part.columns.begin(), part.columns.end());
  }
  const int target = design_.target(actuation_of(parts));
  std::vector<int> sorted = columns;
  std::ranges::sort(sorted);
  const bool twice = std::ranges::adjacent_find(sorted) != sorted.end();
  model.parts = std::move(parts);
  if (twice) return model;
  model.fit = design_.fit(columns, target);
  if (!model.fit.ok) return model;
  const double rows = std::max(2.0, design_.fitted_rows() - static_cast<double>(columns.size()));
  const double variance = model.fit.square / rows * options_.overdispersion;
  model.evidence = -0.5 * rows / options_.overdispersion * std::log(model.fit.square) -
                   design_.log_occam(columns, target, variance) - choices;
  return model;
}

Actuation Selector::actuation_of(const std::vector<Variant>& parts) const {
  Actuation actuation{options_.lag_s};
  for (const Variant& part : parts) {
    actuation.lag_s += part.lag_s;
    actuation.settling_s += part.settling_s;
    if (part.saturation > 0.0)
      actuation.saturation = {part.saturation, part.functions.front().first, part.functions.front().second};
  }
  return actuation;
}

double Selector::gain(const TorqueModel& more, const TorqueModel& less) const {
  const double rows = std::max(2.0, design_.fitted_rows() - static_cast<double>(more.fit.columns.size()));
  return 0.5 * rows / options_.overdispersion * std::log(less.fit.square / more.fit.square);
}

std::vector<FittedTerm> Selector::terms_of(const TorqueModel& model) const {
  std::vector<FittedTerm> terms;
  Eigen::Index at = 0;
  for (const Variant& part : model.parts) {
    if (part.saturation > 0.0) {
      terms.push_back({part.term, part.name, part.functions, {part.saturation}});
      continue;
    }
    if (part.columns.empty()) continue;
    FittedTerm term{part.term, part.name, part.functions, {}};
    for (std::size_t i = 0; i < part.columns.size(); ++i)
      term.coefficients.push_back(model.fit.coefficients[at++]);
    terms.push_back(std::move(term));
  }
  for (std::size_t t = 0; t < kDriveTermCount; ++t)
    if (model_.parts[t].use == PartUse::Fixed) {
      const auto term = static_cast<DriveTerm>(t);
      const std::vector<Variant> variants = variants_of(term, range_, design_.data(), model_);
      terms.push_back(
          {term, std::string(name_of(term)), variants.front().functions, {model_.parts[t].value}});
    }
  for (std::size_t c = 0; c < model_.regressors.size(); ++c)
    if (model_.regressors[c].known_torque)
      terms.push_back({DriveTerm::Regressor,
                       fmt::format("{}:{}", name_of(DriveTerm::Regressor), model_.regressors[c].name),
                       {known_torque_function(c)},
                       {1.0}});
  return terms;
}

TorqueModel Selector::rich() {
  TorqueModel model = enriched(fitted(base_));
  const double delay_s = design_.data().delay_s;
  if (delay_s == 0.0 || model_.part(DriveTerm::TorqueLag).use != PartUse::Candidate) return model;
  // Nothing fits a torque that is late, and what it leaves is no noise.
  Variant lag{DriveTerm::TorqueLag, std::string(name_of(DriveTerm::TorqueLag)), {}};
  lag.lag_s = delay_s;
  const TorqueModel shifted = with(fitted(base_), lag);
  if (!shifted.ok()) return model;
  TorqueModel other = enriched(shifted);
  return other.ok() && (!model.ok() || gain(other, model) > critical(1.0)) ? other : model;
}

/// With what may join it with most columns that no shape decides.
TorqueModel Selector::enriched(TorqueModel model) {
  constexpr std::array kLinear{
      DriveTerm::TorqueOffset,  DriveTerm::FrictionAsymmetry, DriveTerm::QuadraticDrag,
      DriveTerm::FrictionShape, DriveTerm::FrictionPosition,  DriveTerm::LoadPosition,
      DriveTerm::Gravity,       DriveTerm::InertiaPosition,   DriveTerm::FrictionDrift,
      DriveTerm::Presliding,    DriveTerm::Regressor};
  for (const DriveTerm term : kLinear) {
    TorqueModel best;
    for (const Variant& variant : pool_) {
      if (variant.term != term || variant.replaces_viscous) continue;
      TorqueModel larger = with(model, variant);
      if (larger.ok() && (!best.ok() || larger.fit.square < best.fit.square)) best = std::move(larger);
    }
    if (best.ok()) model = std::move(best);
    if (static_cast<double>(model.fit.columns.size()) > 0.2 * design_.fitted_rows()) break;
  }
  if (!model.ok()) return model;  // nothing can be added to what the rows do not tell apart
  for (int order = 0; order < 3 && model_.part(DriveTerm::Cogging).use == PartUse::Candidate; ++order) {
    const std::vector<Variant> ripples = ripple_candidates(model);
    if (ripples.empty()) break;
    TorqueModel larger = with(model, ripples.front());
    if (!larger.ok() || gain(larger, model) < critical(ripples.front().alternatives)) break;
    model = std::move(larger);
  }
  // Beside a polynomial, hence under a name of their own.
  for (const DriveTerm term : {DriveTerm::FrictionPosition, DriveTerm::InertiaPosition}) {
    std::vector<Variant> waves = waves_in(design_, design_.residuals(model.fit), range_, model_, term);
    const bool candidate = std::ranges::any_of(pool_, [&](const Variant& each) { return each.term == term; });
    if (!candidate || waves.empty()) continue;
    waves.front().name += " wave";
    TorqueModel larger = with(model, waves.front());
    if (larger.ok() && gain(larger, model) > critical(waves.front().alternatives)) model = std::move(larger);
  }
  return model;
}

TorqueModel Selector::with(const TorqueModel& model, const Variant& variant) {
  std::vector<Variant> parts;
  for (const Variant& part : model.parts)
    if (part.name != variant.name) parts.push_back(part);
  parts.push_back(variant);
  return fitted(std::move(parts));
}

TorqueModel Selector::without(const TorqueModel& model, std::size_t part) {
  std::vector<Variant> parts = model.parts;
  parts.erase(parts.begin() + static_cast<std::ptrdiff_t>(part));
  return fitted(std::move(parts));
}

TorqueModel Selector::refitted(const FittedDrive& saved) {
  const auto is_fitted = [&](DriveTerm term) {
    return std::ranges::find(saved.terms, term, &FittedTerm::term) != saved.terms.end();
  };
  std::vector<Variant> parts;
  const FittedTerm* by_load = nullptr;
  for (const FittedTerm& term : saved.terms) {
    if (model_.part(term.term).use == PartUse::Fixed) continue;
    const BasisFunction::Factor factor = term.functions.front().factor;
    if (factor == BasisFunction::Factor::Load || factor == BasisFunction::Factor::StaticLoad) {
      by_load = &term;
      continue;
    }
    Variant part{term.term, term.name, term.functions};
    if (term.term == DriveTerm::TorqueSaturation) part.saturation = term.coefficients.front();
    part.replaces_viscous = term.term == DriveTerm::FrictionPower && !is_fitted(DriveTerm::Viscous);
    parts.push_back(std::move(part));
  }
  if (saved.lag_s != 0.0 || saved.settling_s != 0.0) {
    Variant lag{DriveTerm::TorqueLag, std::string(name_of(DriveTerm::TorqueLag)), {}};
    lag.lag_s = saved.lag_s;
    lag.settling_s = saved.settling_s;
    parts.push_back(std::move(lag));
  }
  TorqueModel model = fitted(std::move(parts));
  if (!model.ok() || by_load == nullptr) return model;
  for (const Variant& variant : load_candidates(model))
    if (variant.functions == by_load->functions) return refined(with(model, variant), by_load->term);
  return {};
}

std::vector<Variant> Selector::ripple_candidates(const TorqueModel& model) {
  if (model_.part(DriveTerm::Cogging).use != PartUse::Candidate) return {};
  return ripples_in(design_, design_.residuals(model.fit), range_, model_, model.part(DriveTerm::Cogging),
                    nullptr);
}

std::vector<Variant> Selector::wave_candidates(const TorqueModel& model) {
  std::vector<Variant> candidates;
  for (const DriveTerm term : {DriveTerm::FrictionPosition, DriveTerm::InertiaPosition}) {
    const bool candidate = std::ranges::any_of(pool_, [&](const Variant& each) { return each.term == term; });
    if (!candidate || model.part(term) != nullptr) continue;
    for (Variant& each : waves_in(design_, design_.residuals(model.fit), range_, model_, term))
      candidates.push_back(std::move(each));
  }
  return candidates;
}

/// Friction that grows with the load depends on the rest of the model: by its last fit.
std::vector<Variant> Selector::load_candidates(const TorqueModel& model) {
  const auto wanted = [&](DriveTerm term) {
    return model_.part(term).use == PartUse::Candidate &&
           (model.part(term) == nullptr || !model.part(term)->frozen.empty());
  };
  if (!wanted(DriveTerm::LoadFriction)) return {};
  FittedDrive drive{model_, {}, {}};
  for (FittedTerm& term : terms_of(model))
    if (term.term != DriveTerm::LoadFriction && term.term != DriveTerm::TorqueSaturation)
      drive.terms.push_back(std::move(term));
  FittedDrive loads = drive;
  std::erase_if(loads.terms, [](const FittedTerm& term) { return !loads_drive(term.term); });
  std::vector<Variant> candidates;
  const auto add = [&](DriveTerm term, const BasisFunction& function, const FittedDrive& of) {
    if (!wanted(term)) return;
    Eigen::VectorXd rows(design_.rows());
    Eigen::Index first = 0;
    for (const DriveRows& run : design_.data().runs) {
      std::vector<double> samples(run.motion.time_s.size()), columns;
      for (std::size_t i = 0; i < samples.size(); ++i) {
        const DriveState state = run.motion.state(i, run.run, columns);
        const double torque = torque_of(of, state);
        samples[i] = value_of(function, state, {torque, torque, torque});
      }
      rows.segment(first, static_cast<Eigen::Index>(run.size())) = run.filtered(samples);
      first += static_cast<Eigen::Index>(run.size());
    }
    Variant variant{term, std::string(name_of(term)), {function}};
    variant.frozen = {design_.add(rows)};
    variant.alternatives = 2.0;
    candidates.push_back(std::move(variant));
  };
  // Friction in proportion to the inertia's torque alone would be hard to tell from noise of the
  // acceleration.
  FittedDrive static_loads = loads;
  std::erase_if(static_loads.terms, accelerates);
  if (!static_loads.terms.empty()) {
    add(DriveTerm::LoadFriction, {BasisFunction::Carrier::Direction, BasisFunction::Factor::Load}, loads);
    add(DriveTerm::LoadFriction, {BasisFunction::Carrier::Direction, BasisFunction::Factor::StaticLoad},
        static_loads);
  }
  return candidates;
}

std::vector<Variant> Selector::pool_of(const TorqueModel& model) {
  std::vector<Variant> pool;
  for (const Variant& each : pool_) {
    const Variant* already = model.part(each.term);
    if (already == nullptr || (each.term == DriveTerm::Regressor && already->name != each.name))
      pool.push_back(each);
  }
  for (Variant& each : ripple_candidates(model)) pool.push_back(std::move(each));
  for (Variant& each : wave_candidates(model)) pool.push_back(std::move(each));
  for (Variant& each : load_candidates(model)) pool.push_back(std::move(each));
  std::erase_if(pool, [&](const Variant& each) { return excluded_.contains(each.name); });
  return pool;
}

Selector::Judgement Selector::judge(const TorqueModel& more, const TorqueModel& less,
                                    const Variant& added) const {
  Judgement judgement;
  if (!more.ok() || !less.ok()) return judgement;  // the rows do not tell its columns apart
  const auto extra = static_cast<int>(more.fit.columns.size()) - static_cast<int>(less.fit.columns.size());
  const double nats = gain(more, less);
  if (!(nats > 0.0)) return judgement;
  const double by_likelihood = statistics::chi_squared_neg_log_p(2.0 * nats, std::max(1, extra));
  const std::vector<double> left_more = design_.left_out(more.fit), left_less = design_.left_out(less.fit);
  const Paired difference = paired(left_more, left_less);
  const auto is_older = [&](int column) {
    const auto newest = more.fit.columns.end() - extra;
    return std::find(more.fit.columns.begin(), newest, column) != newest;
  };
  const bool nested =
      extra > 0 && more.fit.target == less.fit.target && std::ranges::all_of(less.fit.columns, is_older);
  double by_blocks = 0.0;
  if (nested) {
    by_blocks = design_.significance_of_last(more.fit, extra);
  } else {
    // Blocks differ in what they leave: where all of them get better by a like share, that is the surer sign.
    const double by_share = paired(logarithms(left_more), logarithms(left_less)).significance_nats();
    by_blocks = std::max(difference.significance_nats(), by_share) - std::log(2.0);
  }
  judgement.significance_nats =
      std::min(by_likelihood, by_blocks) - std::log(std::max(1.0, added.alternatives));
  judgement.material = difference.count > 0 && difference.mean > kCertain * difference.error &&
                       difference.mean * difference.count > kLeastTaken * difference.second;
  const double square = design_.residuals(less.fit).squaredNorm(),
               taken = square - design_.residuals(more.fit).squaredNorm();
  const bool enough = square < std::pow(model_.good_enough * variation_, 2);
  judgement.material = judgement.material && taken > (enough ? kLeastTakenBeyond : kLeastTaken) * square &&
                       taken > least_square_;
  if (added.term == DriveTerm::TorqueLag &&
      std::abs(added.lag_s) + added.settling_s < kFewRows * design_.data().sample_s)
    judgement.material = judgement.material && taken > std::pow(model_.good_enough * variation_, 2);
  const std::vector<double> held_more = design_.held_out(more.fit), held_less = design_.held_out(less.fit);
  if (!held_more.empty()) judgement.material = judgement.material && sum(held_more) < sum(held_less);
  return judgement;
}

/// Why no drive can be like the one model, unless the other one is impossible for the same reason; empty: one
/// can.
std::string Selector::why_impossible(const TorqueModel& model, const TorqueModel& other) const {
  const std::vector<Impossibility> before =
      other.ok() ? impossibilities(terms_of(other), range_, model_) : std::vector<Impossibility>{};
  for (Impossibility& each : impossibilities(terms_of(model), range_, model_))
    if (std::ranges::find(before, each.term, &Impossibility::term) == before.end())
      return std::move(each.words);
  return {};
}

Trial Selector::judged(const TorqueModel& model, const TorqueModel& larger, const Variant& variant) {
  Trial trial;
  trial.variant = variant;
  trial.gain = gain(larger, model);
  trial.evidence = larger.evidence - model.evidence;
  const Judgement judgement = judge(larger, model, variant);
  trial.significance_nats = judgement.significance_nats;
  trial.significant = judgement.significance_nats > critical(1.0) && trial.evidence > 0.0;
  trial.material = judgement.material;
  trial.impossible = why_impossible(larger, model);
  return trial;
}

namespace {
bool by_direction(const Variant& variant) {
  return (variant.term == DriveTerm::FrictionPower || variant.term == DriveTerm::FrictionShape) &&
         variant.functions.size() > 1;
}
}  // namespace

/// A law of friction that differs by direction holds an asymmetry within itself: it has to say more than
/// that.
double Selector::asymmetry_evidence(const TorqueModel& model, const std::vector<Variant>& variants) {
  double best = -std::numeric_limits<double>::infinity();
  if (std::ranges::none_of(variants, by_direction) || model.part(DriveTerm::FrictionAsymmetry) != nullptr)
    return best;
  for (const Variant& variant : pool_)
    if (variant.term == DriveTerm::FrictionAsymmetry)
      if (const TorqueModel other = with(model, variant); other.ok())
        best = std::max(best, other.evidence + kRivalNats);
  return best;
}

/// The best variant that a drive can be like; if there is none, the best.
Trial Selector::trial(const TorqueModel& model, const std::vector<Variant>& variants) {
  TorqueModel best, best_possible;
  const Variant* at = nullptr;
  const Variant* possible = nullptr;
  const double needed = asymmetry_evidence(model, variants);
  for (const Variant& variant : variants) {
    TorqueModel larger = with(model, variant);
    if (!larger.ok() || (by_direction(variant) && larger.evidence < needed)) continue;
    if (at == nullptr || larger.evidence > best.evidence) {
      best = larger;
      at = &variant;
    }
    if ((possible == nullptr || larger.evidence > best_possible.evidence) &&
        why_impossible(larger, model).empty()) {
      best_possible = std::move(larger);
      possible = &variant;
    }
  }
  if (at == nullptr) {
    Trial none;
    none.variant = variants.front();
    return none;
  }
  return possible != nullptr ? judged(model, best_possible, *possible) : judged(model, best, *at);
}

std::vector<Trial> Selector::trials(const TorqueModel& model) {
  std::map<std::string, std::vector<Variant>> by_name;
  for (Variant& variant : pool_of(model)) by_name[variant.name].push_back(std::move(variant));
  std::vector<Trial> result;
  for (const auto& [name, variants] : by_name) result.push_back(trial(model, variants));
  std::ranges::sort(result, [](const Trial& a, const Trial& b) { return a.evidence > b.evidence; });
  return result;
}

namespace {

/// Whether two variants are the same but for the free number of their shape.
bool of_one_form(const Variant& a, const Variant& b) {
  if (free_shape(a) == nullptr || free_shape(b) == nullptr) return a == b;
  // A power that passes 1 is first viscous friction, and beside it two laws that only differ.
  if (a.term == DriveTerm::FrictionPower && (*free_shape(a) < 1.0) != (*free_shape(b) < 1.0)) return false;
  return with_shape(a, 1.0) == with_shape(b, 1.0);
}

/// Whether a shape's number adds to others of its kind, rather than multiplies.
bool shape_is_additive(const Variant& variant) {
  return variant.term == DriveTerm::TorqueLag && variant.settling_s == 0.0;
}

bool has_the_order_of_gravity(const Variant& variant) {
  return variant.term == DriveTerm::Cogging &&
         std::ranges::any_of(variant.functions, [](const BasisFunction& each) { return each.first == 1.0; });
}

bool is_periodic(const Variant& variant) {
  return !variant.functions.empty() && variant.functions.front().factor == BasisFunction::Factor::Sine;
}

}  // namespace

/// Within which the form is what its name says.
std::pair<double, double> Selector::limits_of_shape(const Variant& variant) const {
  double lowest = std::numeric_limits<double>::infinity(), highest = -lowest;
  for (const Variant& each : pool_) {
    if (each.name != variant.name || free_shape(each) == nullptr || !of_one_form(each, variant)) continue;
    lowest = std::min(lowest, *free_shape(each));
    highest = std::max(highest, *free_shape(each));
  }
  return lowest > highest ? std::pair(-lowest, -highest) : std::pair(lowest, highest);
}

/// Moves the free number of a shape to where the evidence is largest, by halving steps, and keeps its
/// curvature.
TorqueModel Selector::refined(TorqueModel model, DriveTerm term) {
  const auto at = std::ranges::find(model.parts, term, &Variant::term);
  if (at == model.parts.end()) return model;
  if (!at->frozen.empty()) {
    constexpr int kRounds = 8;
    TorqueModel best = model;
    for (int round = 0; round < kRounds; ++round) {
      TorqueModel refitted;
      for (const Variant& again : load_candidates(model))
        if (again.term == term && again.functions == model.part(term)->functions)
          refitted = with(model, again);
      if (!refitted.ok()) break;
      const double change = refitted.evidence - model.evidence;
      model = std::move(refitted);
      if (model.evidence > best.evidence) best = model;
      if (std::abs(change) < 0.1) break;
    }
    model = std::move(best);
    return model;
  }
  if (free_shape(*at) == nullptr) return model;
  Variant variant = *at;
  const bool additive = variant.lag_s != 0.0;
  const bool periodic =
      variant.functions.size() > 1 && variant.functions.front().factor == BasisFunction::Factor::Sine;
  // Less than half of what the grid goes on by.
  double step = additive ? (std::abs(variant.lag_s) * design_.data().cut_off_Hz > 0.31 ? 0.03 : 0.01) /
                               design_.data().cut_off_Hz
                : term == DriveTerm::Gravity ? 0.1
                : periodic ? std::min(0.1, 0.3 / (variant.functions.front().first * range_.half()))
                           : 0.25;
  const auto [lowest, highest] = limits_of_shape(variant);
  const auto moved = [&, lowest = lowest, highest = highest](double by) {
    const double shape = *free_shape(variant);
    return with(model, with_shape(variant, std::clamp(additive ? shape + by : shape * std::exp(by),
                                                      std::min(shape, lowest), std::max(shape, highest))));
  };
  double curvature = 0.0;
  for (int round = 0; round < 6; ++round) {
    const TorqueModel up = moved(step), down = moved(-step);
    if (up.ok() && down.ok())
      curvature = (up.evidence - 2.0 * model.evidence + down.evidence) / (step * step);
    const TorqueModel& better = up.ok() && (!down.ok() || up.evidence > down.evidence) ? up : down;
    if (better.ok() && better.evidence > model.evidence && why_impossible(better, model).empty()) {
      model = better;
      variant = model.parts.back();
    } else {
      step *= 0.5;
    }
  }
  for (Variant& part : model.parts)
    if (part.term == term)
      part.shape_sd =
          curvature < 0.0 ? 1.0 / std::sqrt(-curvature) : std::numeric_limits<double>::quiet_NaN();
  return model;
}

/// Torque by which the model changes if the shape of one of its parts does, over that change; empty: it has
/// none, or its number decides the scale of the readings.
Eigen::VectorXd Selector::slope_by_shape(const TorqueModel& model, std::size_t part, double& step) {
  const Variant& variant = model.parts[part];
  if (free_shape(variant) == nullptr || !variant.frozen.empty() || variant.saturation > 0.0 ||
      variant.settling_s > 0.0)
    return {};
  const double shape = *free_shape(variant);
  if (shape_is_additive(variant)) {
    step = 0.01 / design_.data().cut_off_Hz;
    Actuation later = actuation_of(model.parts);
    later.lag_s += step;
    return (design_.raw(model.fit.target) - design_.raw(design_.target(later))) / step;
  }
  step = is_periodic(variant) ? std::min(0.02, 0.05 / (shape * range_.half())) : 0.02;
  Eigen::Index first = 0;
  for (std::size_t p = 0; p < part; ++p) first += static_cast<Eigen::Index>(model.parts[p].columns.size());
  const Variant changed = with_shape(variant, shape * std::exp(step));
  Eigen::VectorXd slope = Eigen::VectorXd::Zero(design_.rows());
  for (std::size_t i = 0; i < variant.columns.size(); ++i)
    slope += model.fit.coefficients[first + static_cast<Eigen::Index>(i)] / step *
             (design_.rows_of(changed.functions[i]) - design_.raw(variant.columns[i]));
  return slope;
}

/// The free numbers of all shapes where the likelihood is largest, by Gauss's and Newton's steps.
TorqueModel Selector::sharpened(TorqueModel model) {
  constexpr int kMostSteps = 4;
  constexpr double kFarthest = 0.5, kSmallGain = 0.1;
  for (int round = 0; round < kMostSteps && model.ok(); ++round) {
    std::vector<int> columns = model.fit.columns;
    std::vector<std::size_t> shaped;
    for (std::size_t p = 0; p < model.parts.size(); ++p) {
      double step = 0.0;
      const Eigen::VectorXd slope = slope_by_shape(model, p, step);
      if (slope.size() == 0 || !(slope.squaredNorm() > 0.0)) continue;
      columns.push_back(design_.add(slope));
      shaped.push_back(p);
    }
    if (shaped.empty()) return model;
    const Fit together = design_.fit(columns, model.fit.target);
    if (!together.ok) return model;
    TorqueModel better;
    for (double share = 1.0; share > 0.2 && !better.ok(); share *= 0.5) {
      std::vector<Variant> parts = model.parts;
      for (std::size_t k = 0; k < shaped.size(); ++k) {
        Variant& part = parts[shaped[k]];
        const double by =
            share * together.coefficients[static_cast<Eigen::Index>(model.fit.columns.size() + k)];
        const double shape = *free_shape(part);
        const double farthest = shape_is_additive(part) ? 0.1 / design_.data().cut_off_Hz
                                : is_periodic(part)     ? std::min(kFarthest, 0.5 / (shape * range_.half()))
                                                        : kFarthest;
        const double limited = std::clamp(by, -farthest, farthest);
        const auto [lowest, highest] = limits_of_shape(part);
        part =
            with_shape(part, std::clamp(shape_is_additive(part) ? shape + limited : shape * std::exp(limited),
                                        std::min(shape, lowest), std::max(shape, highest)));
      }
      TorqueModel moved = fitted(std::move(parts));
      if (moved.ok() && moved.evidence > model.evidence && why_impossible(moved, model).empty())
        better = std::move(moved);
    }
    if (!better.ok()) return model;
    const double gained = better.evidence - model.evidence;
    model = std::move(better);
    if (gained < kSmallGain) break;
  }
  return model;
}

/// The orders of a ripple where the likelihood is largest while the other effects are there; whole orders of
/// a rotary drive stay.
TorqueModel Selector::with_sharp_orders(TorqueModel model) {
  constexpr int kRounds = 7;
  const double period = M_PI / range_.half(), lowest = 2.0 * period;  // two periods over the travel
  const Variant* ripple = model.part(DriveTerm::Cogging);
  if (ripple == nullptr || is_base(*ripple)) return model;
  std::set<double> orders;
  for (const BasisFunction& function : ripple->functions)
    if (model_.linear || function.first != std::round(function.first)) orders.insert(function.first);
  for (double order : orders) {
    double step = 0.1 * period;
    for (int round = 0; round < kRounds; ++round) {
      TorqueModel best;
      double best_order = order;
      for (const double other : {order - step, order + step}) {
        Variant moved = *model.part(DriveTerm::Cogging);
        for (BasisFunction& function : moved.functions)
          if (function.first == order) function.first = other;
        TorqueModel tried = other < lowest ? TorqueModel{} : with(model, moved);
        if (!tried.ok() || !(tried.evidence > (best.ok() ? best.evidence : model.evidence))) continue;
        best = std::move(tried);
        best_order = other;
      }
      if (best.ok() && best.evidence > model.evidence) {
        model = std::move(best);
        order = best_order;
      } else {
        step *= 0.5;
      }
    }
  }
  return model;
}

/// Each effect in the form, and all of them with the shapes, that the runs ask for while the others are
/// there: what a poor form leaves would pass for one more effect.
TorqueModel Selector::polished(TorqueModel model) {
  constexpr int kRounds = 2;
  for (int round = 0; round < kRounds; ++round) {
    const double start = model.evidence;
    model = sharpened(with_sharp_orders(std::move(model)));
    for (const std::string& name : effect_names(model)) {
      const Variant part = *std::ranges::find(model.parts, name, &Variant::name);
      const bool frozen = !part.frozen.empty();
      if (frozen || part.saturation > 0.0 || part.settling_s > 0.0) model = refined(model, part.term);
      if (!frozen) model = in_its_best_form(std::move(model), part);
    }
    if (model.evidence < start + 1.0) break;
  }
  return model;
}

/// With one of the other forms of a part in its place, if the runs ask for it.
TorqueModel Selector::in_its_best_form(TorqueModel model, Variant part) {
  std::vector<TorqueModel> forms;
  for (const Variant& variant : pool_) {
    if (variant.name != part.name || of_one_form(variant, part)) continue;
    TorqueModel other = with(model, variant);
    if (!other.ok() || !why_impossible(other, model).empty()) continue;
    const auto same = std::ranges::find_if(
        forms, [&](const TorqueModel& each) { return of_one_form(each.parts.back(), variant); });
    if (same == forms.end())
      forms.push_back(std::move(other));
    else if (other.evidence > same->evidence)
      *same = std::move(other);
  }
  for (TorqueModel& form : forms) {
    if (free_shape(form.parts.back()) != nullptr) form = sharpened(std::move(form));
    if (form.evidence > model.evidence) model = std::move(form);
  }
  return model;
}

bool Selector::drop_what_is_no_longer_needed(TorqueModel& model) {
  for (std::size_t p = 0; p < model.parts.size(); ++p) {
    if (is_base(model.parts[p])) continue;
    const TorqueModel smaller = without(model, p);
    if (!smaller.ok()) continue;
    Variant dropped = model.parts[p];
    const TorqueModel again = with(smaller, dropped);  // its coefficients last
    const Judgement judgement = judge(again, smaller, dropped);
    if (judgement.significance_nats > critical(1.0) && judgement.material &&
        again.evidence > smaller.evidence)
      continue;
    model = smaller;
    return true;
  }
  return false;
}

/// Takes out what the other effects explain as well, once they have the forms that they would have had
/// without it.
bool Selector::drop_what_better_forms_explain(TorqueModel& model) {
  if (effect_names(model).size() < 2) return false;
  for (std::size_t p = 0; p < model.parts.size(); ++p) {
    if (is_base(model.parts[p])) continue;
    TorqueModel smaller = without(model, p);
    if (!smaller.ok()) continue;
    smaller = polished(std::move(smaller));
    if (judge(model, smaller, model.parts[p]).material &&
        model.evidence > smaller.evidence + critical(model.parts[p].alternatives))
      continue;
    model = std::move(smaller);
    return true;
  }
  return false;
}

/// One candidate in the place of one or two effects.
bool Selector::swap(TorqueModel& model) {
  TorqueModel best = model;
  const auto effect = [&](std::size_t p) { return !is_base(model.parts[p]); };
  for (std::size_t p = 0; p < model.parts.size(); ++p) {
    if (!effect(p)) continue;
    const TorqueModel smaller = without(model, p);
    std::vector<TorqueModel> starts{smaller};
    for (std::size_t q = 0; q < smaller.parts.size(); ++q)
      if (!is_base(smaller.parts[q])) starts.push_back(without(smaller, q));
    for (const TorqueModel& start : starts) {
      if (!start.ok()) continue;
      for (const Variant& variant : pool_) {
        if (excluded_.contains(variant.name) ||
            (start.part(variant.term) != nullptr && variant.term != DriveTerm::Regressor))
          continue;
        TorqueModel other = with(start, variant);
        if (!other.ok() || !(other.evidence > best.evidence + 1.0) || !why_impossible(other, {}).empty())
          continue;
        const Judgement judgement = judge(other, start, variant);
        if (judgement.significance_nats > critical(1.0) && judgement.material) best = std::move(other);
      }
    }
  }
  if (!(best.evidence > model.evidence + 1.0)) return false;
  model = std::move(best);
  return true;
}

bool Selector::difference_is_certain(const TorqueModel& better, const TorqueModel& other) const {
  const double nats = better.evidence - other.evidence;
  if (nats <= kRivalNats) return false;
  // Where much is left, neither is the whole truth: what both leave has to differ, too.
  constexpr double kAlike = 1.5;
  const double left = design_.residuals(better.fit).squaredNorm();
  if (left > std::pow(model_.good_enough * variation_, 2) &&
      design_.residuals(other.fit).squaredNorm() < kAlike * left)
    return false;
  if (nats > kOverwhelmingNats) return true;
  const Paired difference = paired(design_.left_out(better.fit), design_.left_out(other.fit));
  return difference.count > 0 && difference.mean > kCertain * difference.error;
}

/// Whether the blocks scatter too much for a load's dependence on the place to be more than a constant.
bool Selector::is_constant_load(const TorqueModel& model, Variant load) {
  const auto constant = [](const BasisFunction& each) { return each.factor == BasisFunction::Factor::One; };
  if (load.term != DriveTerm::LoadPosition || !std::ranges::any_of(load.functions, constant)) return false;
  std::stable_partition(load.functions.begin(), load.functions.end(), constant);
  const auto places = static_cast<int>(std::ranges::count_if(load.functions, std::not_fn(constant)));
  const TorqueModel places_last = with(model, load);
  return places_last.ok() && places > 0 &&
         design_.significance_of_last(places_last.fit, places) < critical(load.alternatives);
}

/// Dry friction that differs by direction and a constant torque are the same while the drive slides, and so
/// is a load whose dependence on the place is not certain, or too small to have a name by itself: the
/// constant comes first.
void Selector::prefer_the_constant(TorqueModel& model) {
  const auto square = [&](const TorqueModel& each) { return design_.residuals(each.fit).squaredNorm(); };
  const double unnoticeable = std::pow(kLeastOfGoodEnough * model_.good_enough * variation_, 2);
  for (std::size_t p = 0; p < model.parts.size(); ++p) {
    const Variant& part = model.parts[p];
    if (is_base(part)) continue;
    const bool load = part.term == DriveTerm::LoadPosition;
    const bool dry_only = part.term == DriveTerm::FrictionAsymmetry && part.functions.size() == 1 &&
                          part.functions.front().factor == BasisFunction::Factor::One;
    if (!dry_only && !load) continue;
    for (const Variant& variant : pool_) {
      if (variant.term != DriveTerm::TorqueOffset) continue;
      TorqueModel other = with(without(model, p), variant);
      if (!other.ok()) continue;
      if (load ? is_constant_load(model, part) || square(other) < square(model) + unnoticeable
               : other.evidence > model.evidence - kRivalNats) {
        model = std::move(other);
        return;
      }
    }
  }
}

/// Whether the best of the variants could as well stand in the place of `part`, without which the model is
/// `smaller`.
bool Selector::rivals(const TorqueModel& best, const Variant& part, const TorqueModel& smaller,
                      const std::vector<Variant>& variants) {
  const Trial other = trial(smaller, variants);
  // Between rivals the posterior decides, not whether each of them alone would have raised the alarm.
  if (!other.material || !other.impossible.empty() || other.significance_nats < critical(1.0) - kRivalNats)
    return false;
  TorqueModel alternative = with(smaller, other.variant);
  if (other.evidence > -kOverwhelmingNats && free_shape(other.variant) != nullptr)
    alternative = refined(alternative, other.variant.term);
  // What needs more numbers and does not fit better for them says nothing of its own.
  const int more = complexity(other.variant) - complexity(part);
  if (more > 0 && gain(alternative, best) < kNatsANumber * more) return false;
  return !difference_is_certain(best, alternative);
}

/// A ripple of order 2 with others is most often a series that has an order 1, too, which nothing tells from
/// gravity: both are one effect then, and gravity its rival. Where order 1 is by far the largest, it is
/// gravity.
void Selector::count_gravity_to_its_harmonics(TorqueModel& model) {
  constexpr double kBesideHarmonics = 4.0;
  const auto place = [&](DriveTerm term) { return std::ranges::find(model.parts, term, &Variant::term); };
  const auto gravity = place(DriveTerm::Gravity), ripple = place(DriveTerm::Cogging);
  if (gravity == model.parts.end() || ripple == model.parts.end() ||
      gravity->functions.front().first != 1.0 ||
      !std::ranges::any_of(ripple->functions, [](const BasisFunction& each) { return each.first == 2.0; }))
    return;
  double first = 0.0, others = 0.0;
  for (const FittedTerm& term : terms_of(model))
    for (const double coefficient : term.coefficients) {
      if (term.term == DriveTerm::Gravity) first = std::max(first, std::abs(coefficient));
      if (term.term == DriveTerm::Cogging) others = std::max(others, std::abs(coefficient));
    }
  if (first > kBesideHarmonics * others) return;
  std::vector<Variant> parts = model.parts;
  Variant& series = parts[static_cast<std::size_t>(ripple - model.parts.begin())];
  series.functions.insert(series.functions.begin(), gravity->functions.begin(), gravity->functions.end());
  parts.erase(parts.begin() + (gravity - model.parts.begin()));
  if (TorqueModel together = fitted(std::move(parts)); together.ok()) model = std::move(together);
}

void Selector::find_rivals(Selection& selection) {
  const TorqueModel& best = selection.best;
  for (std::size_t p = 0; p < best.parts.size(); ++p) {
    if (is_base(best.parts[p])) continue;
    const TorqueModel smaller = without(best, p);
    if (!smaller.ok()) continue;
    std::map<std::string, std::vector<Variant>> by_name;
    for (Variant& variant : pool_of(smaller))
      if (variant.name != best.parts[p].name) by_name[variant.name].push_back(std::move(variant));
    std::vector<std::string> group{best.parts[p].name};
    for (const auto& [name, variants] : by_name) {
      std::vector<Variant> simple;
      for (const Variant& variant : variants)
        if (complexity(variant) <= complexity(best.parts[p])) simple.push_back(variant);
      if (rivals(best, best.parts[p], smaller, variants) ||
          (!simple.empty() && simple.size() < variants.size() &&
           rivals(best, best.parts[p], smaller, simple)))
        group.push_back(name);
    }
    if (has_the_order_of_gravity(best.parts[p])) group.emplace_back(name_of(DriveTerm::Gravity));
    if (group.size() > 1) selection.rivals.push_back(std::move(group));
  }
}

std::vector<std::string> Selector::effect_names(const TorqueModel& model) const {
  std::vector<std::string> names;
  for (const Variant& part : model.parts)
    if (!is_base(part)) names.push_back(part.name);
  return names;
}

/// The model with the best of a stage's acceptable candidates: what a candidate says shows once it, and what
/// was there before it, have their best forms beside each other.
TorqueModel Selector::with_one_of(const TorqueModel& model, Selection::Stage& stage) {
  constexpr std::size_t kMost = 4;
  constexpr double kComparable = 0.3;
  const double most = stage.trials[*stage.chosen].gain;
  TorqueModel best;
  std::size_t tried = 0;
  for (std::size_t i = 0; i < stage.trials.size() && tried < kMost; ++i) {
    const Trial& trial = stage.trials[i];
    if (!trial.acceptable() || trial.gain < kComparable * most) continue;
    ++tried;
    TorqueModel larger = polished(with(model, trial.variant));
    if (best.ok() &&
        !(larger.evidence - kNatsANumber * numbers(larger) > best.evidence - kNatsANumber * numbers(best)))
      continue;
    best = std::move(larger);
    stage.chosen = i;
  }
  return best;
}

Selection Selector::run(const std::function<void(double)>& progress) {
  Selection selection;
  selection.base = selection.best = fitted(base_);
  selection.candidates = candidates_;
  selection.alarm_nats = critical(1.0);
  for (std::size_t t = 0; t < kDriveTermCount; ++t) {
    const auto term = static_cast<DriveTerm>(t);
    if (model_.parts[t].use != PartUse::Candidate || term == DriveTerm::Regressor) continue;
    if (const auto reason = unidentifiable(term, range_, design_.data(), model_))
      selection.unseen[std::string(name_of(term))] = *reason;
  }
  for (std::size_t c = 0; c < model_.regressors.size(); ++c)
    if (const DriveRegressor& regressor = model_.regressors[c];
        !regressor.known_torque && regressor.use == PartUse::Candidate && is_constant(design_.data(), c))
      selection.unseen["column:" + regressor.name] = {"it is the same in all runs",
                                                      fmt::format("runs that differ in {}", regressor.name)};
  if (!selection.base.ok()) return selection;
  const auto effects = [&] { return selection.best.parts.size() - base_.size(); };
  constexpr int kMostChecks = 2;
  int checks = 0;
  for (int stage = 0;
       stage < 2 * options_.most_effects && effects() < static_cast<std::size_t>(options_.most_effects);
       ++stage) {
    progress(static_cast<double>(stage) / (options_.most_effects + 1.0));
    Selection::Stage step{trials(selection.best), {}};
    for (std::size_t i = 0; i < step.trials.size() && !step.chosen; ++i)
      if (step.trials[i].acceptable()) step.chosen = i;
    const std::optional<std::size_t> chosen = step.chosen;
    selection.stages.push_back(std::move(step));
    if (!chosen) {
      if (checks++ < kMostChecks && drop_what_better_forms_explain(selection.best)) continue;
      break;
    }
    const TorqueModel before = selection.best;
    selection.best = with_one_of(before, selection.stages.back());
    for (int round = 0; round < 6; ++round) {
      const bool swapped = swap(selection.best);
      if (swapped) selection.best = polished(std::move(selection.best));
      if (!drop_what_is_no_longer_needed(selection.best) && !swapped) break;
    }
    if (effect_names(selection.best) == effect_names(before) &&
        !(selection.best.evidence > before.evidence + 1.0))
      break;
  }
  prefer_the_constant(selection.best);
  count_gravity_to_its_harmonics(selection.best);
  for (const std::string& name : effect_names(selection.best))
    selection.best =
        refined(selection.best, std::ranges::find(selection.best.parts, name, &Variant::name)->term);
  return selection;
}

}  // namespace clampd::drive
