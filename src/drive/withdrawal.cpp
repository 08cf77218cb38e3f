#include "src/drive/withdrawal.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>

#include <fmt/format.h>

#include "clampd/base/nan.hpp"
#include "clampd/statistics/distributions.hpp"
#include "src/drive/remainder.hpp"

namespace clampd::drive {
namespace {

/// Of a name that is not to be withdrawn, whatever the others are.
constexpr double kNever = std::numeric_limits<double>::infinity();

bool is_effect(const Selection& selection, const Variant& part) {
  return std::ranges::find(selection.base.parts, part) == selection.base.parts.end();
}

/// What each effect is a function of, if a free function of it could take its place.
std::string_view variable_of_term(DriveTerm term) {
  switch (term) {
    case DriveTerm::Gravity:
    case DriveTerm::LoadPosition:
    case DriveTerm::FrictionPosition:
      return "position";
    case DriveTerm::QuadraticDrag:
    case DriveTerm::FrictionShape:
    case DriveTerm::FrictionPower:
      return "velocity";
    default:
      return "";
  }
}

double inertia_of(const Selector& selector, const TorqueModel& model) {
  for (const FittedTerm& term : selector.terms_of(model))
    if (term.term == DriveTerm::Inertia && !term.coefficients.empty()) return term.coefficients.front();
  return kNaN;
}

/// Takes names from a selection that fit in part only.
class Withdrawal {
 public:
  Withdrawal(Selector& selector, const Design& design, const DriveRange& range, const DriveModel& model,
             Selection& selection, std::vector<std::string>& notices)
      : selector_(selector),
        design_(design),
        range_(range),
        model_(model),
        base_(selection.base),
        selection_(selection),
        best_(selection.best),
        notices_(notices) {}

  void approximations();
  void what_another_shape_would_take();
  void what_wanders();
  void names_beside_two_others();
  void what_leans_on_the_rest();
  std::optional<std::string> what_takes_the_inertia();
  void parts_of_little();
  void guesses_of_one_sinusoid();

 private:
  bool has_effects() const { return best_.parts.size() > base_.parts.size(); }
  double effects() const { return static_cast<double>(best_.parts.size() - base_.parts.size()); }
  Remainder left_by(const TorqueModel& model, double inertia = 0.0) const {
    return remainder_of(design_, model, inertia);
  }
  /// By which the square that is left is smaller than that of the smaller model. They are compared by their
  /// shares of the torque's variation: what takes a saturation out of the reading makes both smaller.
  double taken_from(const TorqueModel& smaller, const Remainder& rest) const {
    return std::pow(left_by(smaller).share * rest.variation, 2) - rest.left * rest.left;
  }
  struct Weakest {
    std::string name;
    TorqueModel without;
  };
  /// The effect for which `measure` of the model without it is least, if that is below `limit`.
  template <typename Measure>
  std::optional<Weakest> weakest_effect(double limit, const Measure& measure) const {
    std::optional<Weakest> weakest;
    for (std::size_t p = 0; p < best_.parts.size(); ++p) {
      if (!is_effect(selection_, best_.parts[p])) continue;
      TorqueModel smaller = selector_.without(best_, p);
      if (!smaller.ok()) continue;
      const double measured = measure(smaller);
      if (!(measured < limit)) continue;
      limit = measured;
      weakest = {best_.parts[p].name, std::move(smaller)};
    }
    return weakest;
  }
  void replace_best(const TorqueModel& model, std::string why) {
    notices_.push_back(std::move(why));
    best_ = model;
  }
  std::string names() const {
    std::vector<std::string> all;
    for (const Variant& part : effects_of(selection_)) all.push_back(part.name);
    return fmt::format("{}", fmt::join(all, ", "));
  }

  Selector& selector_;
  const Design& design_;
  const DriveRange& range_;
  const DriveModel& model_;
  const TorqueModel& base_;
  const Selection& selection_;
  TorqueModel& best_;
  std::vector<std::string>& notices_;
};

/// Names that only approximate what a free function of their variable takes: that torque is on no list.
void Withdrawal::approximations() {
  constexpr double kTooMuch = 0.5, kLeast = 0.05;
  for (const std::string_view variable : {"position", "velocity"}) {
    std::vector<Variant> rest;
    std::vector<std::string> names;
    for (const Variant& part : best_.parts) {
      if (is_effect(selection_, part) && variable_of_term(part.term) == variable)
        names.push_back(part.name);
      else
        rest.push_back(part);
    }
    if (names.empty()) continue;
    TorqueModel smaller = selector_.fitted(rest);
    if (!smaller.ok()) continue;
    const Eigen::VectorXd left = design_.residuals(best_.fit);
    const double share = free_function_share(design_, left, variable_of(design_, variable, model_));
    const double taken = design_.residuals(smaller.fit).squaredNorm() - left.squaredNorm();
    if (share < kLeast || share * left.squaredNorm() < kTooMuch * taken) continue;
    notices_.push_back(fmt::format("{} would explain less than what would still depend on {}",
                                   fmt::join(names, ", "), variable));
    best_ = std::move(smaller);
  }
}

/// A name beside another one, where what is left is no noise, may only mend the other's shape: a stop at the
/// end of the travel looks like a spring and waves over the position. It stays if it leaves next to nothing,
/// or takes more than a free function of the other's variable would in its place.
void Withdrawal::what_another_shape_would_take() {
  constexpr double kAsMuch = 0.8, kNearlyNothing = 0.05;
  while (effects() > 1.0 && !left_by(best_).is_noise()) {
    const double left = design_.residuals(best_.fit).squaredNorm();
    const auto other_of_that_shape = [&](const TorqueModel& smaller) -> const Variant* {
      const Eigen::VectorXd rest = design_.residuals(smaller.fit);
      const double square = rest.squaredNorm();
      if (left < kNearlyNothing * square) return nullptr;
      std::string_view tried;
      for (const Variant& other : smaller.parts) {
        const std::string_view variable = variable_of_term(other.term);
        if (!is_effect(selection_, other) || variable.empty() || variable == tried) continue;
        tried = variable;
        const double free = free_function_share(design_, rest, variable_of(design_, variable, model_));
        if (free * square >= kAsMuch * (square - left)) return &other;
      }
      return nullptr;
    };
    const auto weakest = weakest_effect(kNever, [&](const TorqueModel& smaller) {
      return other_of_that_shape(smaller) ? design_.residuals(smaller.fit).squaredNorm() - left : kNever;
    });
    if (!weakest) return;
    const Variant& other = *other_of_that_shape(weakest->without);
    replace_best(weakest->without,
                 fmt::format("{} would explain no more than {} of another shape over the {}", weakest->name,
                             other.name, variable_of_term(other.term)));
  }
}

/// What is left and smooth in time holds far fewer independent rows than it has, and whatever is as slow
/// takes a part of it by chance: a load that wanders has a mean. Names stay if Fisher's F of what they take
/// is significant for that number of rows, and for the dozen of effects that are tried.
void Withdrawal::what_wanders() {
  constexpr double kSignificant = 0.002;
  while (has_effects() && !left_by(best_).is_noise()) {
    const double left = design_.residuals(best_.fit).squaredNorm();
    const double rows = independent_rows(design_, best_);
    const auto weakest = weakest_effect(-kSignificant, [&](const TorqueModel& smaller) {
      const auto terms = static_cast<double>(best_.fit.coefficients.size() - smaller.fit.coefficients.size());
      if (terms < 1.0) return kNever;
      const double taken = std::max(0.0, design_.residuals(smaller.fit).squaredNorm() - left);
      const double degrees = rows - terms - 1.0;
      return degrees < 1.0 ? -1.0
                           : -statistics::fisher_f_p_value(taken / left * degrees / terms, terms, degrees);
    });
    if (!weakest) return;
    replace_best(weakest->without, fmt::format("{} would explain what may be chance: what is left changes "
                                               "slowly, like {:.0f} independent rows",
                                               weakest->name, rows));
  }
}

/// Two defects at once are rare and three are rarer, but what is on no list is often made up of several that
/// are. While there are more names than two, each has to take more than is left, or be beyond doubt; of those
/// that do not, the one with the least evidence goes first.
void Withdrawal::names_beside_two_others() {
  constexpr double kFew = 2.0, kBeyondDoubt_nats = 100.0;
  while (effects() > kFew) {
    const Remainder rest = left_by(best_);
    const auto weakest = weakest_effect(kBeyondDoubt_nats, [&](const TorqueModel& smaller) {
      const bool takes_more_than_is_left =
          taken_from(smaller, rest) > rest.left * rest.left - rest.noise * rest.noise;
      return takes_more_than_is_left ? kNever : best_.evidence - smaller.evidence;
    });
    if (!weakest) return;
    replace_best(weakest->without,
                 fmt::format("{} beside other effects would explain less than what would still be left",
                             weakest->name));
  }
}

/// A torque that is on no list looks a little like many effects, and more like several together: what fits it
/// in part may only lean on it. A name stays if it takes several times what is left, times the number of
/// names; the weakest goes first. While more is left than is good enough, that is all of it, noise apart;
/// else what a function of the columns would take of it, if that is much: a true effect leaves little for
/// such a function, what stands in for another torque leaves that torque's form. A rest of few independent
/// rows is hardly known itself, so that less will do beside it.
void Withdrawal::what_leans_on_the_rest() {
  constexpr double kSeveral = 3.0;
  constexpr double kHardlyKnown = 24.0, kMore = 1.4;  // so many levels has a free function of one variable
  while (has_effects()) {
    const Remainder rest = left_by(best_);
    const double left = rest.left * rest.left;
    const double share = rest.is_noise() ? 0.0 : explainable_share(design_, best_, model_);
    double what = share > kStructured ? share * left : 0.0;
    if (!rest.is_enough(model_.good_enough)) what = std::max(what, left - rest.noise * rest.noise);
    const double times = independent_rows(design_, best_) < kHardlyKnown ? kMore : kSeveral;
    const auto weakest = weakest_effect(
        times * effects() * what, [&](const TorqueModel& smaller) { return taken_from(smaller, rest); });
    if (!weakest) return;
    replace_best(weakest->without,
                 fmt::format("{} would explain too little beside what would still be left", weakest->name));
  }
}

/// An effect that fits only by taking the inertia's torque for its own has said nothing of the drive. It goes
/// where the inertia would be negative beside it, or, if much is left all the same, a small part of what it
/// is without it. Returns its name.
std::optional<std::string> Withdrawal::what_takes_the_inertia() {
  constexpr double kSmallPart = 0.4;
  if (!has_effects()) return std::nullopt;
  const double inertia = inertia_of(selector_, best_);
  const bool enough = left_by(best_, std::max(0.0, inertia)).is_enough(model_.good_enough);
  const auto thief = weakest_effect(0.0, [&](const TorqueModel& smaller) {
    const double before = inertia_of(selector_, smaller);
    return inertia < (enough ? 0.0 : kSmallPart * before) ? -before : kNever;
  });
  if (!thief) return std::nullopt;
  replace_best(thief->without,
               fmt::format("{} is no explanation: the inertia would be {:.0f} % of what it is without",
                           thief->name, 100.0 * inertia / inertia_of(selector_, thief->without)));
  return thief->name;
}

/// Where the base model is nearly good enough, little is to be explained, and much that is on no list takes a
/// form that some effect has in part. Names stay only if together they take half of it or more, noise apart.
void Withdrawal::parts_of_little() {
  constexpr double kNearlyGoodEnough = 2.0, kHalf = 0.5;
  if (!has_effects()) return;
  const Remainder before = left_by(base_);
  if (!(before.share < kNearlyGoodEnough * model_.good_enough)) return;
  const Remainder after = left_by(best_);
  const double square = before.left * before.left, taken = square - after.left * after.left;
  if (taken > kHalf * (square - after.noise * after.noise)) return;
  notices_.push_back(
      fmt::format("{} would explain {:.0f} % of the square of what the base model leaves, which is little, "
                  "and looks like something else",
                  names(), 100.0 * taken / square));
  best_ = base_;
}

/// One sinusoid shows nothing of an effect but the harmonics of its torque, which others have as well. Names
/// beside which more than a small part is left, for several of them an even smaller one, have not told which
/// they are.
void Withdrawal::guesses_of_one_sinusoid() {
  constexpr double kNearlySinusoidal = 0.9, kSmallPart = 0.02;
  if (range_.sinusoidal < kNearlySinusoidal || !has_effects()) return;
  const Remainder before = left_by(base_), after = left_by(best_);
  const double noise = after.noise * after.noise;
  const double left = (after.left * after.left - noise) / (before.left * before.left - noise);
  if (after.is_noise() || !(effects() * left > kSmallPart)) return;
  notices_.push_back(
      fmt::format("beside {} {:.0f} % of the misfit's square would be left, and in a motion of one sinusoid "
                  "other effects look alike: record another motion as well",
                  names(), 100.0 * left));
  best_ = base_;
}

}  // namespace

std::vector<Variant> effects_of(const Selection& selection) {
  std::vector<Variant> effects;
  for (const Variant& part : selection.best.parts)
    if (is_effect(selection, part)) effects.push_back(part);
  return effects;
}

Selection selected_effects(Selector& selector, const Design& design, const DriveRange& range,
                           const DriveModel& model, std::vector<std::string>& notices,
                           const std::function<void(double)>& progress) {
  constexpr int kMostSearches = 4;
  for (int search = 1;; ++search) {
    Selection selection = selector.run(progress);
    if (!selection.base.ok()) return selection;
    Withdrawal withdraw(selector, design, range, model, selection, notices);
    withdraw.approximations();
    std::optional<std::string> none = withdraw.what_takes_the_inertia();
    if (!none) {
      withdraw.what_another_shape_would_take();
      withdraw.what_wanders();
      withdraw.names_beside_two_others();
      withdraw.what_leans_on_the_rest();
      none = withdraw.what_takes_the_inertia();
    }
    if (!none || search == kMostSearches) {
      withdraw.parts_of_little();
      withdraw.guesses_of_one_sinusoid();
      return selection;
    }
    selector.exclude(*none);
  }
}

}  // namespace clampd::drive
