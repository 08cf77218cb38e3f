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
/// From here on evidence of the same rows is believed though the held-out blocks do not all agree.
constexpr double kOverwhelmingNats = 25.0;

struct Paired {
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

double sum(const std::vector<double>& values) {
  double total = 0.0;
  for (const double value : values) total += value;
  return total;
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
  TorqueModel model = fitted(base_);
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
  std::optional<double> buildup;
  if (const Variant* presliding = model.part(DriveTerm::Presliding))
    buildup = presliding->functions.front().first;
  FittedDrive loads = drive;
  std::erase_if(loads.terms, [](const FittedTerm& term) { return !loads_drive(term.term); });
  std::vector<Variant> candidates;
  const auto add = [&](DriveTerm term, const BasisFunction& function, const FittedDrive& of) {
    if (!wanted(term)) return;
    Eigen::VectorXd rows(design_.rows());
    Eigen::Index first = 0;
    for (const DriveRows& run : design_.data().runs) {
      std::vector<double> samples(run.motion.time_s.size()), columns;
      std::vector<double> travel;
      if (buildup) travel = run.motion.travel_over(*buildup);
      for (std::size_t i = 0; i < samples.size(); ++i) {
        DriveState state = run.motion.state(i, run.run, columns);
        if (buildup) state.travel = travel[i];
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
  const auto extra = static_cast<int>(more.fit.columns.size()) - static_cast<int>(less.fit.columns.size());
  const double nats = gain(more, less);
  if (!(nats > 0.0)) return judgement;
  const double by_likelihood = statistics::chi_squared_neg_log_p(2.0 * nats, std::max(1, extra));
  const std::vector<double> left_more = design_.left_out(more.fit), left_less = design_.left_out(less.fit);
  const Paired difference = paired(left_more, left_less);
  const bool nested = extra > 0 && !added.replaces_viscous && !changes_torque(added);
  double by_blocks = 0.0;
  if (nested) {
    by_blocks = design_.significance_of_last(more.fit, extra);
  } else if (difference.error > 0.0 && difference.mean > 0.0) {
    const double t = difference.mean / difference.error;
    by_blocks = -std::log(std::max(1e-300, statistics::fisher_f_p_value(t * t, 1.0, difference.count - 1.0)));
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

Trial Selector::judged(const TorqueModel& model, const TorqueModel& larger, const Variant& variant) {
  Trial trial;
  trial.variant = variant;
  trial.gain = gain(larger, model);
  trial.evidence = larger.evidence - model.evidence;
  const Judgement judgement = judge(larger, model, variant);
  trial.significance_nats = judgement.significance_nats;
  trial.significant = judgement.significance_nats > critical(1.0) && trial.evidence > 0.0;
  trial.material = judgement.material;
  trial.impossible = impossible(terms_of(larger), range_, model_).value_or("");
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
  const bool before = impossible(terms_of(model), range_, model_).has_value();
  for (const Variant& variant : variants) {
    TorqueModel larger = with(model, variant);
    if (!larger.ok() || (by_direction(variant) && larger.evidence < needed)) continue;
    if (at == nullptr || larger.evidence > best.evidence) {
      best = larger;
      at = &variant;
    }
    if ((possible == nullptr || larger.evidence > best_possible.evidence) &&
        (before || !impossible(terms_of(larger), range_, model_))) {
      best_possible = std::move(larger);
      possible = &variant;
    }
  }
  if (at == nullptr) {
    Trial none;
    none.variant = variants.front();
    return none;
  }
  Trial result = possible != nullptr ? judged(model, best_possible, *possible) : judged(model, best, *at);
  if (before && possible != nullptr) result.impossible.clear();  // it was impossible without it too
  return result;
}

std::vector<Trial> Selector::trials(const TorqueModel& model) {
  std::map<std::string, std::vector<Variant>> by_name;
  for (Variant& variant : pool_of(model)) by_name[variant.name].push_back(std::move(variant));
  std::vector<Trial> result;
  for (const auto& [name, variants] : by_name) result.push_back(trial(model, variants));
  std::ranges::sort(result, [](const Trial& a, const Trial& b) { return a.evidence > b.evidence; });
  return result;
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
  const auto moved = [&](double by) {
    const double shape = *free_shape(variant);
    return with(model, with_shape(variant, additive ? shape + by : shape * std::exp(by)));
  };
  double curvature = 0.0;
  const bool before = impossible(terms_of(model), range_, model_).has_value();
  for (int round = 0; round < 6; ++round) {
    const TorqueModel up = moved(step), down = moved(-step);
    if (up.ok() && down.ok())
      curvature = (up.evidence - 2.0 * model.evidence + down.evidence) / (step * step);
    const TorqueModel& better = up.ok() && (!down.ok() || up.evidence > down.evidence) ? up : down;
    if (better.ok() && better.evidence > model.evidence &&
        (before || !impossible(terms_of(better), range_, model_))) {
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
        if (!other.ok() || !(other.evidence > best.evidence + 1.0) ||
            impossible(terms_of(other), range_, model_))
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

/// Dry friction that differs by direction and a constant torque are the same while the drive slides: the
/// constant comes first.
void Selector::prefer_the_constant(TorqueModel& model) {
  for (std::size_t p = 0; p < model.parts.size(); ++p) {
    const Variant& part = model.parts[p];
    const bool dry_only = part.term == DriveTerm::FrictionAsymmetry && part.functions.size() == 1 &&
                          part.functions.front().factor == BasisFunction::Factor::One;
    if (!dry_only || is_base(part)) continue;
    for (const Variant& variant : pool_)
      if (variant.term == DriveTerm::TorqueOffset)
        if (TorqueModel other = with(without(model, p), variant);
            other.ok() && other.evidence > model.evidence - kRivalNats) {
          model = std::move(other);
          return;
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
  if (more > 0 && gain(alternative, best) < 3.0 * more) return false;
  return !difference_is_certain(best, alternative);
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
    if (group.size() > 1) selection.rivals.push_back(std::move(group));
  }
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
  for (int stage = 0;
       stage < 2 * options_.most_effects && effects() < static_cast<std::size_t>(options_.most_effects);
       ++stage) {
    progress(static_cast<double>(stage) / (options_.most_effects + 1.0));
    Selection::Stage step{trials(selection.best), {}};
    for (std::size_t i = 0; i < step.trials.size() && !step.chosen; ++i)
      if (step.trials[i].acceptable()) step.chosen = i;
    const std::optional<std::size_t> chosen = step.chosen;
    selection.stages.push_back(std::move(step));
    if (!chosen) break;
    const Trial& winner = selection.stages.back().trials[*chosen];
    selection.best = refined(with(selection.best, winner.variant), winner.variant.term);
    for (int round = 0; round < 6; ++round) {
      const bool swapped = swap(selection.best);
      if (swapped) selection.best = refined(selection.best, selection.best.parts.back().term);
      if (!drop_what_is_no_longer_needed(selection.best) && !swapped) break;
    }
  }
  prefer_the_constant(selection.best);
  return selection;
}

}  // namespace clampd::drive
