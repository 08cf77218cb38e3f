#include "src/diagnose/drive_search.hpp"

#include <algorithm>
#include <cmath>
#include <map>

#include <fmt/format.h>

#include "clampd/statistics/distributions.hpp"
#include "clampd/statistics/symmetric.hpp"

namespace clampd::drive {
namespace {

constexpr double kLeastShareOfItsOwn = 1e-3;
constexpr double kRivalNats = 5.0;
/// An effect must take at least this share off the squared error of what was held out.
constexpr double kLeastHeldOutShare = 0.01;
/// Of what an effect gains where it helps, it may lose this share elsewhere.
constexpr double kMaxLost = 0.2;
/// That folds agree by chance that an effect helps.
constexpr double kChanceOfFolds = 0.05;
constexpr std::size_t kMaxOrders = 6;

std::vector<int> numbered(const std::vector<int>& labels) {
  std::map<int, int> numbers;
  for (const int label : labels) numbers.emplace(label, 0);
  int next = 0;
  for (auto& [label, number] : numbers) number = next++;
  std::vector<int> result;
  for (const int label : labels) result.push_back(numbers.at(label));
  return result;
}

int count_of(const std::vector<int>& blocks) {
  return blocks.empty() ? 0 : 1 + *std::max_element(blocks.begin(), blocks.end());
}

/// Which of `levels` equal shares of the values each one is in.
std::vector<int> levels_of(const std::vector<double>& values, int levels) {
  std::vector<double> sorted = values;
  std::sort(sorted.begin(), sorted.end());
  std::vector<int> result;
  for (const double value : values) {
    int level = 0;
    while (level + 1 < levels &&
           value >
               sorted[sorted.size() * static_cast<std::size_t>(level + 1) / static_cast<std::size_t>(levels)])
      ++level;
    result.push_back(level);
  }
  return result;
}

double gain_nats(const Regression& without, const Regression& with) {
  if (!(with.residual_square > 0.0)) return 0.0;
  return 0.5 * effective_size(with.residuals) *
         std::log(std::max(1.0, without.residual_square / with.residual_square));
}

Eigen::MatrixXd joined(const Eigen::MatrixXd& a, const Eigen::MatrixXd& b) {
  Eigen::MatrixXd result(a.rows(), a.cols() + b.cols());
  result << a, b;
  return result;
}

bool independent(const Eigen::MatrixXd& base, const Eigen::MatrixXd& added) {
  Eigen::MatrixXd others = base;
  for (Eigen::Index j = 0; j < added.cols(); ++j) {
    if (share_of_its_own(others, added.col(j)) < kLeastShareOfItsOwn) return false;
    others = joined(others, added.col(j));
  }
  return true;
}

/// Effects that can only add to friction.
bool one_sided(DriveTerm term) {
  return term == DriveTerm::QuadraticDrag || term == DriveTerm::FrictionShape ||
         term == DriveTerm::Presliding;
}

/// Its first column is a constant then.
bool contains_offset(const DriveComponent& component) {
  return (component.term == DriveTerm::FrictionAsymmetry && component.columns.size() == 2) ||
         (component.term == DriveTerm::LoadPosition && component.columns.size() == 3);
}

class Search {
 public:
  Search(const DriveFit& fit, const DriveModel& model, const DriveData* heldout,
         const DriveSearchOptions& options)
      : fit_(fit), model_(model), heldout_(heldout), options_(options) {}

  DriveSearchResult run() {
    base_model();
    std::vector<DriveTerm> candidates = candidate_terms();
    result_.candidates = static_cast<int>(candidates.size());
    while (static_cast<int>(result_.chosen.size()) < options_.most_effects && !candidates.empty()) {
      DriveSearchResult::Stage stage = try_all(candidates);
      if (!stage.winner) {
        result_.stages.push_back(std::move(stage));
        break;
      }
      const DriveComponent winner = stage.trials[*stage.winner].component;
      result_.chosen.push_back(winner);
      std::erase(candidates, winner.term);
      if (winner.term == DriveTerm::FrictionAsymmetry || winner.term == DriveTerm::LoadPosition)
        std::erase(candidates, DriveTerm::TorqueOffset);  // its constant is theirs
      find_rivals(stage);
      result_.stages.push_back(std::move(stage));
      for (const DriveTerm dropped : drop_what_is_not_needed()) candidates.push_back(dropped);
      if (result_.stages.size() > 2 * kDriveTermCount) break;
    }
    return std::move(result_);
  }

 private:
  std::vector<DriveComponent> model() const {
    std::vector<DriveComponent> components = result_.base;
    components.insert(components.end(), result_.chosen.begin(), result_.chosen.end());
    return components;
  }

  bool has(DriveTerm term) const {
    for (const DriveComponent& component : model())
      if (component.term == term) return true;
    return false;
  }

  bool has_constant() const {
    return has(DriveTerm::TorqueOffset) || has(DriveTerm::FrictionAsymmetry) || has(DriveTerm::LoadPosition);
  }

  void unseen(DriveTerm term, std::string reason) { result_.unseen.emplace_back(term, std::move(reason)); }

  void base_model() {
    Eigen::MatrixXd columns(fit_.target().size(), 0);
    for (std::size_t i = 0; i < kDriveTermCount; ++i) {
      const auto term = static_cast<DriveTerm>(i);
      if (model_.parts[i].use != PartUse::Estimate) continue;
      if (term == DriveTerm::Cogging) {
        unseen(term,
               "it can be a candidate, not part of the base model: its orders are not known beforehand");
        continue;
      }
      const auto shapes = shapes_of(term, fit_.range(), has_constant());
      const DriveComponent* best = nullptr;
      double least = std::numeric_limits<double>::infinity();
      for (const DriveComponent& shape : shapes) {
        const Eigen::MatrixXd added = DriveFit::columns({shape}, fit_.data());
        if (!independent(columns, added)) continue;
        const double square = regress(joined(columns, added), fit_.target(), fit_.blocks()).residual_square;
        if (square < least) {
          least = square;
          best = &shape;
        }
      }
      if (best == nullptr) {
        result_.notices.push_back(
            fmt::format("{} cannot be told from the other parts by the motion in these runs and was left out",
                        kDriveTermNames[i]));
        continue;
      }
      result_.base.push_back(*best);
      result_.base.back().certain = true;
      columns = fit_.columns(result_.base);
    }
  }

  std::vector<DriveTerm> candidate_terms() {
    std::vector<DriveTerm> terms;
    for (std::size_t i = 0; i < kDriveTermCount; ++i) {
      const auto term = static_cast<DriveTerm>(i);
      if (model_.parts[i].use != PartUse::Candidate) continue;
      const bool by_place = term == DriveTerm::FrictionPosition || term == DriveTerm::LoadPosition;
      if (!fit_.both_directions() &&
          (term == DriveTerm::TorqueOffset || term == DriveTerm::FrictionAsymmetry)) {
        unseen(term, "the drive moves in one direction only");
      } else if (model_.steady && term == DriveTerm::Cogging) {
        continue;  // within the runs: steady_ripple()
      } else if (model_.steady && (by_place || term == DriveTerm::Presliding)) {
        unseen(term, "a median over a steady run says nothing about position");
      } else if (by_place && !fit_.data().position_absolute) {
        unseen(term, "position is integrated from velocity, so that its zero is not known");
      } else if (term == DriveTerm::FrictionDrift && model_.steady) {
        unseen(term, "each speed was measured once: its time cannot be told from its speed");
      } else {
        terms.push_back(term);
      }
    }
    return terms;
  }

  DriveTrial judge(const DriveComponent& component, const Eigen::MatrixXd& base, const Regression& without) {
    DriveTrial trial{component};
    const Eigen::MatrixXd added = DriveFit::columns({component}, fit_.data());
    const Regression with = regress(joined(base, added), fit_.target(), fit_.blocks());
    const double alternatives = std::log(component.alternatives);
    trial.gain = gain_nats(without, with);
    trial.significance_nats = with.significance_of_last(static_cast<int>(added.cols())) - alternatives;
    trial.score = trial.gain - alternatives -
                  0.5 * static_cast<double>(added.cols()) * std::log(effective_size(with.residuals));
    trial.significant = trial.significance_nats > alarm() && trial.score > 0.0 &&
                        (!one_sided(component.term) || with.coefficients[base.cols()] > 0.0);
    // What an offset does as well is no evidence for a larger model that contains it.
    const int own = static_cast<int>(added.cols()) - 1;
    if (contains_offset(component) && own > 0)
      trial.significant = trial.significant && with.significance_of_last(own) > alarm();
    trial.holds = trial.significant && holds(base, joined(base, added), component);
    return trial;
  }

  double alarm() const { return -std::log(options_.false_alarm / std::max(1, result_.candidates)); }

  /// Whether what the fit did not see is predicted better with the added columns.
  bool holds(const Eigen::MatrixXd& base, const Eigen::MatrixXd& extended,
             const DriveComponent& component) const {
    const bool per_run_phase = component.term == DriveTerm::Cogging && !fit_.data().position_absolute;
    if (heldout_ != nullptr && !per_run_phase) {
      std::vector<DriveComponent> components = model();
      const Eigen::VectorXd target = fit_.target(*heldout_);
      const auto error = [&](const Eigen::MatrixXd& columns) {
        const Regression fitted = regress(columns, fit_.target(), fit_.blocks());
        return (target - DriveFit::columns(components, *heldout_) * fitted.coefficients).squaredNorm();
      };
      const double before = error(base);
      components.push_back(component);
      if (error(extended) > (1.0 - kLeastHeldOutShare) * before) return false;
    }
    return predicts(base, extended);
  }

  /// Whether each part left out in turn is predicted better with the added columns.
  bool predicts(const Eigen::MatrixXd& base, const Eigen::MatrixXd& extended) const {
    return holds_over(base, extended, fit_.conditions()) ||
           (!fit_.by_conditions() && holds_over(base, extended, fit_.blocks()));
  }

  bool holds_over(const Eigen::MatrixXd& base, const Eigen::MatrixXd& extended,
                  const std::vector<int>& folds) const {
    const Regression without = regress(base, fit_.target(), folds);
    const Regression with = regress(extended, fit_.target(), folds);
    double before = 0.0;
    double sum = 0.0;
    double square = 0.0;
    double lost = 0.0;
    int judged = 0;
    for (std::size_t f = 0; f < with.heldout_square.size(); ++f) {
      if (!with.judged[f] || !without.judged[f]) continue;
      const double less = without.heldout_square[f] - with.heldout_square[f];
      before += without.heldout_square[f];
      sum += less;
      square += less * less;
      lost += std::max(0.0, -less);
      ++judged;
    }
    if (judged < 3) return &folds != &fit_.blocks() && holds_over(base, extended, fit_.blocks());
    if (!(sum > kLeastHeldOutShare * before)) return false;
    // Either hardly any part is predicted worse, or the parts agree: an effect may act in few of them.
    if (lost < kMaxLost * (sum + lost)) return true;
    const double variance = std::max(0.0, square - sum * sum / judged) * judged / (judged - 1.0);
    return sum > statistics::student_t_upper_quantile(kChanceOfFolds, judged - 1.0) * std::sqrt(variance);
  }

  DriveSearchResult::Stage try_all(const std::vector<DriveTerm>& candidates) {
    DriveSearchResult::Stage stage;
    const Eigen::MatrixXd base = fit_.columns(model());
    const Regression without = regress(base, fit_.target(), fit_.blocks());
    for (const DriveTerm term : candidates) {
      if (term == DriveTerm::Cogging) {
        if (auto trial = scan_orders(base, without)) stage.trials.push_back(*trial);
        continue;
      }
      std::vector<DriveComponent> shapes = shapes_of(term, fit_.range(), has_constant());
      std::optional<DriveTrial> best;
      for (DriveComponent& shape : shapes) {
        shape.alternatives = static_cast<double>(shapes.size());
        if (!independent(base, DriveFit::columns({shape}, fit_.data()))) continue;
        DriveTrial trial = judge(shape, base, without);
        if (!best || trial.gain > best->gain) best = std::move(trial);
      }
      if (best) {
        stage.trials.push_back(std::move(*best));
      } else if (result_.chosen.empty()) {
        unseen(term, "the motion in these runs does not tell it from the other parts of the torque balance");
      }
    }
    for (std::size_t i = 0; i < stage.trials.size(); ++i) {
      const DriveTrial& trial = stage.trials[i];
      if (trial.holds && (!stage.winner || trial.score > stage.trials[*stage.winner].score)) stage.winner = i;
    }
    return stage;
  }

  /// Who would have done nearly as well, and has nothing left to say beside the winner.
  void find_rivals(DriveSearchResult::Stage& stage) {
    const DriveTrial& winner = stage.trials[*stage.winner];
    const Eigen::MatrixXd base = fit_.columns(model());
    const Regression without = regress(base, fit_.target(), fit_.blocks());
    for (std::size_t i = 0; i < stage.trials.size(); ++i) {
      const DriveTrial& trial = stage.trials[i];
      if (winner.component.term == DriveTerm::TorqueOffset &&
          trial.component.term == DriveTerm::FrictionAsymmetry) {
        stage.rivals.push_back(i);  // while sliding, an asymmetric dry friction is an offset
        continue;
      }
      if (i == *stage.winner || !trial.holds || trial.score < winner.score - kRivalNats) continue;
      const Eigen::MatrixXd added = DriveFit::columns({trial.component}, fit_.data());
      if (independent(base, added) && judge(trial.component, base, without).holds) continue;
      stage.rivals.push_back(i);
    }
  }

  std::vector<DriveTerm> drop_what_is_not_needed() {
    std::vector<DriveTerm> dropped;
    for (std::size_t i = 0; i + 1 < result_.chosen.size();) {
      const DriveComponent component = result_.chosen[i];
      std::vector<DriveComponent> others = result_.base;
      for (std::size_t k = 0; k < result_.chosen.size(); ++k)
        if (k != i) others.push_back(result_.chosen[k]);
      const Eigen::MatrixXd base = fit_.columns(others);
      if (judge(component, base, regress(base, fit_.target(), fit_.blocks())).significant) {
        ++i;
        continue;
      }
      dropped.push_back(component.term);
      result_.chosen.erase(result_.chosen.begin() + static_cast<std::ptrdiff_t>(i));
    }
    return dropped;
  }

  /// Orders join one after the other, the strongest first, while chance does not explain them.
  std::optional<DriveTrial> scan_orders(const Eigen::MatrixXd& base, const Regression& without) {
    const std::vector<double> orders = orders_to_scan(fit_.data(), fit_.range(), model_.linear);
    if (orders.size() < 3) {
      if (result_.chosen.empty())
        unseen(DriveTerm::Cogging,
               "the runs are too short, or the motion too fast for the sampling, for periods");
      return std::nullopt;
    }
    const bool absolute = fit_.data().position_absolute;
    const int runs = static_cast<int>(fit_.data().runs.size());
    if (scanned_.empty())
      for (const double order : orders) scanned_.push_back(columns_at(order));
    DriveComponent component{DriveTerm::Cogging, {}, {}};
    component.alternatives = static_cast<double>(orders.size());
    Eigen::MatrixXd current = base;
    Eigen::VectorXd residual = without.residuals;
    std::vector<double> used;
    while (component.shape.size() < kMaxOrders) {
      const Eigen::MatrixXd basis = statistics::orthonormal_basis(current);
      const auto explained = [&](const Eigen::MatrixXd& columns) {
        const Eigen::MatrixXd rest = columns - basis * (basis.transpose() * columns);
        const Eigen::VectorXd right = rest.transpose() * residual;
        const Eigen::MatrixXd gram = rest.transpose() * rest;
        for (Eigen::Index j = 0; j < gram.rows(); ++j)
          if (gram(j, j) < kLeastShareOfItsOwn * columns.col(j).squaredNorm()) return 0.0;
        return right.dot(statistics::SymmetricFactor(gram).solve(right));
      };
      double best = 0.0;
      std::size_t at = 0;
      for (std::size_t i = 0; i < orders.size(); ++i) {
        if (std::find(used.begin(), used.end(), orders[i]) != used.end()) continue;
        const double here = explained(scanned_[i]);
        if (here > best) {
          best = here;
          at = i;
        }
      }
      if (!(best > 0.0)) break;
      double order = orders[at];
      Eigen::MatrixXd columns = scanned_[at];
      if (model_.linear) {
        // The peak is about as wide as the grid's steps; nearer than this says nothing more.
        const double step = orders[1] - orders[0];
        for (int k = -4; k <= 4; ++k) {
          const double near = orders[at] + 0.2 * k * step;
          const Eigen::MatrixXd trial = columns_at(near);
          const double here = explained(trial);
          if (here > best) {
            best = here;
            order = near;
            columns = trial;
          }
        }
      }
      used.push_back(orders[at]);
      const Eigen::MatrixXd extended = joined(current, columns);
      const Regression with = regress(extended, fit_.target(), fit_.blocks());
      const double significance_nats =
          with.significance_of_last(static_cast<int>(columns.cols())) - std::log(component.alternatives);
      const bool counts = significance_nats > alarm();
      if (!component.shape.empty() && (!counts || !holds_over(current, extended, fit_.blocks()))) break;
      current = extended;
      residual = with.residuals;
      component.shape.push_back(order);
      for (DriveColumn& column : periodic_columns(order, model_.linear, absolute, runs))
        component.columns.push_back(std::move(column));
      if (!counts) break;
    }
    if (component.shape.empty()) return std::nullopt;
    return judge(component, base, without);
  }

  Eigen::MatrixXd columns_at(double order) const {
    const DriveComponent component{DriveTerm::Cogging,
                                   periodic_columns(order, model_.linear, fit_.data().position_absolute,
                                                    static_cast<int>(fit_.data().runs.size())),
                                   {order}};
    return DriveFit::columns({component}, fit_.data());
  }

  const DriveFit& fit_;
  const DriveModel& model_;
  const DriveData* heldout_;
  DriveSearchOptions options_;
  DriveSearchResult result_;
  std::vector<Eigen::MatrixXd> scanned_;
};

}  // namespace

DriveFit::DriveFit(const DriveData& data, const DriveModel& model)
    : data_(data), model_(model), range_(range_of(data)), target_(target(data)) {
  std::vector<double> speeds, places;
  std::vector<int> runs, directions;
  for (std::size_t r = 0; r < data.runs.size(); ++r) {
    const DriveRows& run = data.runs[r];
    for (Eigen::Index i = 0; i < run.velocity.size(); ++i) {
      speeds.push_back(std::abs(run.velocity[i]));
      places.push_back(data.position_absolute ? run.position[i] : run.time_s[i]);
      runs.push_back(static_cast<int>(r));
      directions.push_back(run.velocity[i] > 0.0 ? 1 : 0);
    }
  }
  const std::size_t n = speeds.size();
  const auto forward = static_cast<std::size_t>(std::count(directions.begin(), directions.end(), 1));
  both_directions_ = std::min(forward, n - forward) * 20 > n;
  if (model.steady) {
    for (std::size_t i = 0; i < n; ++i) blocks_.push_back(static_cast<int>(i));
    conditions_ = cells_ = blocks_;
    return;
  }

  // Blocks longer than the residuals of the base model remember, but enough of them for a test.
  std::vector<DriveComponent> base;
  Eigen::MatrixXd so_far(static_cast<Eigen::Index>(n), 0);
  for (const DriveTerm term : {DriveTerm::Inertia, DriveTerm::Viscous, DriveTerm::Coulomb}) {
    if (model.part(term).use != PartUse::Estimate) continue;
    const DriveComponent component = shapes_of(term, range_, false).front();
    if (!independent(so_far, columns({component}, data))) continue;
    base.push_back(component);
    so_far = columns(base, data);
  }
  const std::vector<int> whole(n, 0);
  const Regression first = regress(so_far, target_, whole);
  const double memory = static_cast<double>(n) / effective_size(first.residuals);
  constexpr double kMaxBlocks = 60.0;
  constexpr double kLeastBlocks = 24.0;
  const double blocks = std::clamp(static_cast<double>(n) / (4.0 * memory), kLeastBlocks, kMaxBlocks);
  const auto length = std::max<std::size_t>(2, static_cast<std::size_t>(static_cast<double>(n) / blocks));
  int block = -1;
  std::size_t in_block = 0;
  for (std::size_t i = 0; i < n; ++i) {
    if (i == 0 || in_block >= length || runs[i] != runs[i - 1]) {
      ++block;
      in_block = 0;
    }
    blocks_.push_back(block);
    ++in_block;
  }

  std::vector<double> sorted = speeds;
  std::sort(sorted.begin(), sorted.end());
  const bool speeds_differ = sorted[n * 9 / 10] > 1.5 * sorted[n / 10];
  const std::vector<int> levels = levels_of(speeds, speeds_differ ? 3 : 1);
  const std::vector<int> thirds = levels_of(places, 3);
  std::vector<int> conditions, cells;
  for (std::size_t i = 0; i < n; ++i) {
    conditions.push_back(2 * levels[i] + (both_directions_ ? directions[i] : 0));
    cells.push_back(6 * thirds[i] + conditions.back());
  }
  conditions_ = numbered(conditions);
  cells_ = numbered(cells);
  by_conditions_ = count_of(conditions_) >= 4;
  if (!by_conditions_) conditions_ = data.runs.size() >= 3 ? numbered(runs) : blocks_;
}

Eigen::MatrixXd DriveFit::columns(const std::vector<DriveComponent>& components, const DriveData& data) {
  Eigen::Index rows = 0;
  Eigen::Index count = 0;
  for (const DriveRows& run : data.runs) rows += static_cast<Eigen::Index>(run.size());
  for (const DriveComponent& component : components)
    count += static_cast<Eigen::Index>(component.columns.size());
  Eigen::MatrixXd result(rows, count);
  Eigen::Index column = 0;
  for (const DriveComponent& component : components)
    for (const DriveColumn& each : component.columns) {
      Eigen::Index row = 0;
      for (std::size_t r = 0; r < data.runs.size(); ++r) {
        const auto size = static_cast<Eigen::Index>(data.runs[r].size());
        result.col(column).segment(row, size) = each(data.runs[r], static_cast<int>(r));
        row += size;
      }
      ++column;
    }
  return result;
}

Eigen::VectorXd DriveFit::target(const DriveData& data) const {
  std::vector<double> values;
  for (const DriveRows& run : data.runs) {
    const Eigen::VectorXd rest = run.torque - model_.part(DriveTerm::Inertia).value * run.acceleration -
                                 model_.part(DriveTerm::Viscous).value * run.velocity -
                                 model_.part(DriveTerm::Coulomb).value * run.sign;
    values.insert(values.end(), rest.data(), rest.data() + rest.size());
  }
  return Eigen::Map<Eigen::VectorXd>(values.data(), static_cast<Eigen::Index>(values.size()));
}

DriveSearchResult search(const DriveFit& fit, const DriveModel& model, const DriveData* heldout,
                         const DriveSearchOptions& options) {
  return Search(fit, model, heldout, options).run();
}

}  // namespace clampd::drive
