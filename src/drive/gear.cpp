#include "src/drive/gear.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <string>

#include <fmt/format.h>

#include "clampd/base/nan.hpp"
#include "clampd/statistics/symmetric.hpp"

namespace clampd::drive {
namespace {

/// What the difference of motor and load may consist of, beside a constant of each run. `Torque` and `Side`
/// are of what the gear transmits by some share of the motor's; what that share should be, `Inertia` and
/// `Friction` tell beside them.
enum Column : std::size_t { Position, Velocity, Side, Torque, Inertia, Friction, kColumns };
using Columns = std::array<bool, kColumns>;
constexpr Columns kPlain{true, true, true, true, false, false};
constexpr Columns kFree{true, true, true, true, true, true};

constexpr Columns without(Columns columns, Column one) {
  columns[one] = false;
  return columns;
}

/// Below this share of the transmitted torque's root mean square it is uncertain on which side the teeth are.
constexpr double kUncertainSide = 0.15;
/// What has a name takes so much of the difference's square, by itself and beside all others, and is so many
/// of its standard deviations.
constexpr double kLeastShare = 0.05, kLeast_sds = 6.0;
constexpr double kLeastOfStep = 0.25;  ///< of the coarser position reading, root mean square
constexpr double kLeastRows = 0.5;     ///< of a delay
constexpr double kFollows = 0.2;       ///< a ratio that is off by more than this is of another drive
constexpr double kKnown = 0.3;         ///< a stiffness that is less certain than this has no number
/// A variance inflation of ten: from here on side and size of the torque are not told apart.
constexpr double kAlike = 0.9;

/// Products of the columns and of the difference, block of rows by block.
struct Products {
  std::vector<Eigen::MatrixXd> gram;
  std::vector<Eigen::VectorXd> right;
  std::vector<double> square;
};

struct Fitted {
  Eigen::VectorXd coefficients = Eigen::VectorXd::Zero(kColumns);
  double square = std::numeric_limits<double>::infinity();
  std::size_t share = 0;  ///< index of the motor's share among those that were tried
};

/// All rows with the mean of each run taken out.
class Difference {
 public:
  Difference(const Design& design, const FittedDrive& fitted, const Actuation& actuation)
      : design_(design),
        column_(fitted.model.regressors.size()),
        position_(design.rows()),
        velocity_(design.rows()),
        torque_(design.rows()) {
    Eigen::Index first = 0;
    for (const DriveRows& run : design.data().runs) {
      const auto size = static_cast<Eigen::Index>(run.size());
      position_.segment(first, size) = run.position;
      velocity_.segment(first, size) = run.velocity;
      acceleration_square_ += run.acceleration.squaredNorm();
      torque_.segment(first, size) = run.torque_at(actuation);
      first += size;
    }
    inertia_ = friction_ = Eigen::VectorXd::Zero(design.rows());
    for (const FittedTerm& term : fitted.terms) {
      const bool friction = term.term == DriveTerm::Viscous || term.term == DriveTerm::Coulomb;
      if (!friction && !accelerates(term)) continue;
      for (std::size_t i = 0; i < term.functions.size(); ++i)
        (friction ? friction_ : inertia_) += term.coefficients[i] * design.rows_of(term.functions[i]);
    }
    for (const double of_inertia : {0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9})
      for (const double of_friction : {0.0, 0.25, 0.5, 0.75, 1.0})
        shares_.push_back({of_inertia, of_friction});
    remove_delay();
  }

  /// By which the load is read late; the difference is that without it.
  double delay_s() const { return delay_s_; }
  /// With the best of the motor's shares.
  Fitted fit(const Columns& columns) const {
    Fitted best;
    for (std::size_t s = 0; s < shares_.size(); ++s)
      if (const Fitted here = fit(products_[s], columns, s); here.square < best.square) best = here;
    return best;
  }
  /// Of the coefficients: by leaving out one block after the other, and over all shares that do as well.
  struct Deviations {
    Eigen::VectorXd of_blocks, with_shares;
  };
  Deviations deviations(const Fitted& best, const Columns& columns) const;
  double count() const { return static_cast<double>(torque_.size()); }
  /// Square of the correlation of side and torque, position and velocity aside.
  double likeness(std::size_t share) const;
  /// Of what the torque does beyond all other columns, the part that is no noise of torque and acceleration.
  double reliability(std::size_t share) const;

 private:
  struct Share {
    double of_inertia, of_friction;
  };

  Eigen::VectorXd transmitted(const Share& share) const {
    return torque_ - share.of_inertia * inertia_ - share.of_friction * friction_;
  }
  Eigen::VectorXd centred(Eigen::VectorXd values) const {
    Eigen::Index first = 0;
    for (const DriveRows& run : design_.data().runs) {
      auto part = values.segment(first, static_cast<Eigen::Index>(run.size()));
      part.array() -= part.mean();
      first += part.size();
    }
    return values;
  }
  Eigen::MatrixXd columns_of(const Share& share) const {
    const Eigen::VectorXd torque = transmitted(share);
    const double width = kUncertainSide * std::sqrt(torque.squaredNorm() / count());
    Eigen::MatrixXd columns(torque_.size(), kColumns);
    columns.col(Position) = centred(position_);
    columns.col(Velocity) = centred(velocity_);
    columns.col(Side) = centred((torque / width).cwiseMax(-1.0).cwiseMin(1.0));
    columns.col(Torque) = centred(torque);
    columns.col(Inertia) = centred(inertia_);
    columns.col(Friction) = centred(friction_);
    return columns;
  }
  void multiply(const Eigen::VectorXd& difference) {
    products_.clear();
    for (const Share& share : shares_) {
      const Eigen::MatrixXd columns = columns_of(share);
      Products products;
      for (int b = 0; b < design_.blocks(); ++b) {
        const auto [first, size] = design_.block(b);
        const auto rows = columns.middleRows(first, size);
        const auto target = difference.segment(first, size);
        products.gram.emplace_back(rows.transpose() * rows);
        products.right.emplace_back(rows.transpose() * target);
        products.square.push_back(target.squaredNorm());
      }
      products_.push_back(std::move(products));
    }
  }
  /// The motor's position less the load's `late_s` later.
  Eigen::VectorXd difference(double late_s) const {
    Eigen::VectorXd result(torque_.size());
    Eigen::Index first = 0;
    for (const DriveRows& run : design_.data().runs) {
      const std::vector<double>& position = run.motion.position;
      result.segment(first, static_cast<Eigen::Index>(run.size())) =
          run.filtered(run.motion.columns[column_], -late_s) - run.filtered(position, -late_s) +
          run.filtered(position);
      first += static_cast<Eigen::Index>(run.size());
    }
    return result;
  }
  void remove_delay() {
    constexpr int kRounds = 3;
    for (int round = 0; round <= kRounds; ++round) {
      multiply(centred(difference(delay_s_)));
      if (round < kRounds) delay_s_ += fit(kPlain).coefficients[Velocity];
    }
  }
  /// Of the square of one column, what the others leave.
  double left_of(Column column, const std::vector<Eigen::Index>& others, std::size_t share) const;
  static Fitted fit(const Products& products, const Columns& columns, std::size_t share, int left_out = -1);

  const Design& design_;
  std::size_t column_;  ///< of the motion: the motor's position less the load's
  Eigen::VectorXd position_, velocity_, torque_, inertia_, friction_;
  std::vector<Share> shares_;
  std::vector<Products> products_;  ///< of each share
  double delay_s_ = 0.0, acceleration_square_ = 0.0;
};

Fitted Difference::fit(const Products& products, const Columns& columns, std::size_t share, int left_out) {
  std::vector<Eigen::Index> chosen;
  for (std::size_t c = 0; c < kColumns; ++c)
    if (columns[c]) chosen.push_back(static_cast<Eigen::Index>(c));
  Eigen::MatrixXd gram = Eigen::MatrixXd::Zero(kColumns, kColumns);
  Eigen::VectorXd right = Eigen::VectorXd::Zero(kColumns);
  Fitted fitted{.square = 0.0, .share = share};
  for (std::size_t b = 0; b < products.gram.size(); ++b) {
    if (static_cast<int>(b) == left_out) continue;
    gram += products.gram[b];
    right += products.right[b];
    fitted.square += products.square[b];
  }
  const Eigen::VectorXd solution = statistics::ScaledFactor(gram(chosen, chosen), 1e-10).solve(right(chosen));
  for (std::size_t i = 0; i < chosen.size(); ++i)
    fitted.coefficients[chosen[i]] = solution[static_cast<Eigen::Index>(i)];
  fitted.square += fitted.coefficients.dot(gram * fitted.coefficients - 2.0 * right);
  return fitted;
}

Difference::Deviations Difference::deviations(const Fitted& best, const Columns& columns) const {
  const auto blocks = static_cast<double>(design_.blocks());
  Deviations result{Eigen::VectorXd::Zero(kColumns), Eigen::VectorXd::Zero(kColumns)};
  const Products& here = products_[best.share];
  for (int b = 0; b < design_.blocks(); ++b) {
    const Fitted others = fit(here, columns, best.share, b);
    result.of_blocks += (others.coefficients - best.coefficients).cwiseAbs2() * (blocks - 1.0) / blocks;
  }
  const auto left_in = [](const Products& products, const Fitted& fitted, std::size_t b) {
    return products.square[b] +
           fitted.coefficients.dot(products.gram[b] * fitted.coefficients - 2.0 * products.right[b]);
  };
  Eigen::VectorXd lowest = best.coefficients, highest = best.coefficients;
  for (std::size_t s = 0; s < shares_.size(); ++s) {
    const Fitted other = fit(products_[s], columns, s);
    double sum = 0.0, square = 0.0;
    for (std::size_t b = 0; b < here.square.size(); ++b) {
      const double more = left_in(products_[s], other, b) - left_in(here, best, b);
      sum += more;
      square += more * more;
    }
    if (sum > 2.0 * std::sqrt(std::max(0.0, square - sum * sum / blocks))) continue;
    lowest = lowest.cwiseMin(other.coefficients);
    highest = highest.cwiseMax(other.coefficients);
  }
  result.with_shares = (result.of_blocks + (0.5 * (highest - lowest)).cwiseAbs2()).cwiseSqrt();
  result.of_blocks = result.of_blocks.cwiseSqrt();
  return result;
}

double Difference::left_of(Column column, const std::vector<Eigen::Index>& others, std::size_t share) const {
  Eigen::MatrixXd gram = Eigen::MatrixXd::Zero(kColumns, kColumns);
  for (const Eigen::MatrixXd& block : products_[share].gram) gram += block;
  const auto one = static_cast<Eigen::Index>(column);
  const Eigen::VectorXd right = gram.col(one)(others);
  return gram(one, one) - right.dot(statistics::ScaledFactor(gram(others, others), 1e-10).solve(right));
}

double Difference::likeness(std::size_t share) const {
  return 1.0 -
         left_of(Side, {Position, Velocity, Torque}, share) / left_of(Side, {Position, Velocity}, share);
}

double Difference::reliability(std::size_t share) const {
  const ReadingNoise& noise = design_.data().noise;
  const double inertia = std::sqrt(inertia_.squaredNorm() / acceleration_square_);
  const double square = std::pow(noise.torque, 2) + std::pow(inertia * noise.acceleration, 2);
  return 1.0 - count() * square / left_of(Torque, {Position, Velocity, Side, Inertia, Friction}, share);
}

/// A model of the difference, and what is certain in it.
struct Judged {
  Judged(const Difference& difference, const Columns& columns)
      : fitted(difference.fit(columns)), sd(difference.deviations(fitted, columns)) {
    for (std::size_t c = 0; c < kColumns; ++c) {
      if (!columns[c]) continue;
      const auto column = static_cast<Column>(c);
      const double left = difference.fit(without(columns, column)).square;
      taken_rms[c] = std::sqrt(std::max(0.0, left - fitted.square) / difference.count());
      certain[c] = std::abs(value(column)) > kLeast_sds * sd.of_blocks[static_cast<Eigen::Index>(c)] &&
                   fitted.square < (1.0 - kLeastShare) * left;
    }
  }
  double value(Column column) const { return fitted.coefficients[static_cast<Eigen::Index>(column)]; }
  double sd_of(Column column) const { return sd.with_shares[static_cast<Eigen::Index>(column)]; }
  /// That more of the torque reaches the load, or that it pushes the motor from its place, no gear does.
  bool is_positive(Column column, double step) const {
    return certain[column] && value(column) > 0.0 && taken_rms[column] > kLeastOfStep * step;
  }

  Fitted fitted;
  Difference::Deviations sd;
  Columns certain{};
  std::array<double, kColumns> taken_rms{};
};

std::string with_sd(double value, double sd, const std::string& unit) {
  return fmt::format("{:.3g} ± {:.1g} {}", value, sd, unit);
}

class Findings {
 public:
  Findings(const Difference& difference, const DriveData& data, const DriveModel& model)
      : difference_(difference),
        data_(data),
        column_(model.columns.others.back().second.column),
        position_(model.position_unit()),
        torque_(model.torque_unit),
        effort_(model.effort()) {}

  std::vector<DataFinding> all() {
    const Judged plain(difference_, kPlain);
    if (std::abs(plain.value(Position)) > kFollows) {
      add_ratio(plain, ", so that nothing can be told of the gear");
      return found_;
    }
    if (plain.certain[Position]) add_ratio(plain, "");
    if (std::abs(difference_.delay_s()) > kLeastRows * data_.sample_s && is_late(plain)) add_delay(plain);
    const double step = data_.position_step;
    const bool alike = difference_.likeness(plain.fitted.share) > kAlike;
    const bool backlash = !alike && plain.is_positive(Side, step);
    const bool compliance = !alike && plain.is_positive(Torque, step);
    if (backlash) add_backlash(plain);
    if (compliance) add_compliance(Judged(difference_, kFree));
    if (backlash || compliance) return found_;
    const Judged side(difference_, without(kPlain, Torque));
    if (side.is_positive(Side, step)) add_either(side);
    return found_;
  }

 private:
  void add(const char* name, double size, double sd, const std::string& unit, std::string words) {
    found_.push_back({name, column_, "", size, unit, DataFinding::Severity::Note, std::move(words), sd});
  }
  void add_ratio(const Judged& judged, const char* what) {
    const double ratio = 1.0 - judged.value(Position);
    add("gear-ratio", ratio, judged.sd_of(Position), "1",
        fmt::format("the load's position, column {}, goes {:.5g} times as far as the motor's{}: the scale of "
                    "load_position must be that of its own unit times the gear ratio",
                    column_, ratio, what));
  }
  /// Of a delay that has been taken out.
  bool is_late(const Judged& judged) const {
    return std::abs(difference_.delay_s()) > kLeast_sds * judged.sd.of_blocks[Velocity];
  }
  void add_delay(const Judged& judged) {
    const double delay_s = difference_.delay_s();
    add("load-delay", delay_s, judged.sd_of(Velocity), "s",
        fmt::format(
            "the load's position, column {}, is read {} {} than the motor's, {:.2g} rows; that is no play "
            "of the gear. Record both at the same instant",
            column_, with_sd(1e3 * std::abs(delay_s), 1e3 * judged.sd_of(Velocity), "ms"),
            delay_s > 0.0 ? "later" : "earlier", std::abs(delay_s) / data_.sample_s));
  }
  void add_backlash(const Judged& judged) {
    const double size = 2.0 * judged.value(Side), sd = 2.0 * judged.sd_of(Side);
    add("gear-backlash", size, sd, position_,
        fmt::format(
            "the gear has a backlash of {}, on the motor's side: the difference of motor and load, column "
            "{}, switches by that with the sign of the {} that the gear transmits",
            with_sd(size, sd, position_), column_, effort_));
  }
  /// What share of the torque the gear transmits is known only from what reaches the load, or the motor,
  /// alone.
  void add_compliance(const Judged& free) {
    // Noise in the torque makes the gear appear stiffer than it is; half of what that is taken for is
    // uncertain.
    const double reliability = difference_.reliability(free.fitted.share);
    const double stiffness = reliability / free.value(Torque);
    const double sd =
        stiffness * std::hypot(free.sd_of(Torque) / free.value(Torque), 0.5 * (1.0 / reliability - 1.0));
    const bool known = reliability > 0.5 && free.value(Torque) > 0.0 && sd < kKnown * stiffness;
    const std::string unit = torque_ + "/" + position_;
    add("gear-compliance", known ? stiffness : kNaN, known ? sd : kNaN, unit,
        fmt::format(
            "the gear yields: the difference of motor and load, column {}, goes with the {} that the gear "
            "transmits. {}",
            column_, effort_,
            known ? fmt::format("Its stiffness is {}, on the motor's side", with_sd(stiffness, sd, unit))
                  : "How stiff it is these runs do not tell, since the motor's share of the inertia is not "
                    "known: record accelerations that are faster, or with a load that pulls"));
  }
  /// Where the torque has about one size, both are the same.
  void add_either(const Judged& side) {
    const double size = 2.0 * side.value(Side), sd = 2.0 * side.sd_of(Side);
    add("gear-play", size, sd, position_,
        fmt::format("the difference of motor and load, column {}, changes by {} with the sign of the {}. "
                    "Whether that "
                    "is backlash or compliance these runs do not tell: record accelerations or loads of "
                    "several sizes",
                    column_, with_sd(size, sd, position_), effort_));
  }

  const Difference& difference_;
  const DriveData& data_;
  std::string column_, position_, torque_, effort_;
  std::vector<DataFinding> found_;
};

}  // namespace

std::vector<DataFinding> gear_findings(const Design& design, const FittedDrive& fitted,
                                       const Actuation& actuation) {
  if (!fitted.model.load_position || fitted.model.steady) return {};
  const Difference difference(design, fitted, actuation);
  return Findings(difference, design.data(), fitted.model).all();
}

}  // namespace clampd::drive
