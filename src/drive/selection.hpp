#pragma once

#include <functional>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "src/drive/design.hpp"
#include "src/drive/terms.hpp"

namespace clampd::drive {

/// The parts of a torque balance and their fit.
struct TorqueModel {
  std::vector<Variant> parts;
  Fit fit;
  double evidence = 0.0;  ///< nats, of the marginal likelihood
  bool ok() const { return fit.ok; }
  const Variant* part(DriveTerm term) const;
};

/// One candidate beside one model.
struct Trial {
  Variant variant = {};
  double gain = 0.0;               ///< nats, overdispersion counted
  double significance_nats = 0.0;  ///< -ln p, its alternatives counted
  double evidence = 0.0;           ///< nats above the model's
  bool significant = false;
  bool material = false;        ///< predicts what was left out
  std::string impossible = {};  ///< why no drive can be like that; empty if one can
  bool acceptable() const { return significant && material && impossible.empty(); }
};

struct Selection {
  TorqueModel base, best;
  struct Stage {
    std::vector<Trial> trials;
    std::optional<std::size_t> chosen;
  };
  std::vector<Stage> stages;
  std::vector<std::vector<std::string>> rivals;
  std::map<std::string, Unidentifiable> unseen;
  std::vector<std::string> findings;  ///< impossible values and the like
  int candidates = 0;
  double alarm_nats = 0.0;
};

struct SelectionOptions {
  double false_alarm = 0.005;
  int most_effects = 6;
  double lag_s = 0.0;  ///< by which the torque is always shifted
  double overdispersion = 1.0;
};

/// Forward selection of terms with backward checks and swaps, all on the same rows with the same likelihood.
class Selector {
 public:
  Selector(Design& design, const DriveRange& range, const DriveModel& model, const SelectionOptions& options);

  /// All but the rivals, which are those of the model that is kept in the end.
  Selection run(const std::function<void(double)>& progress);
  void find_rivals(Selection& selection);
  /// An effect that is not tried from now on.
  void exclude(const std::string& name) { excluded_.insert(name); }

  TorqueModel fitted(std::vector<Variant> parts);
  TorqueModel without(const TorqueModel& model, std::size_t part);
  /// The terms of a saved model, with the shapes that they have there, fitted to these rows.
  TorqueModel refitted(const FittedDrive& saved);
  std::vector<FittedTerm> terms_of(const TorqueModel& model) const;
  Actuation actuation_of(const std::vector<Variant>& parts) const;
  /// Nats by which the larger model's likelihood exceeds the other's.
  double gain(const TorqueModel& more, const TorqueModel& less) const;
  /// Base, and what may join with most columns that no shape decides; for the noise.
  TorqueModel rich();

 private:
  struct Judgement {
    double significance_nats = 0.0;
    bool material = false;
  };
  std::vector<Variant> pool_of(const TorqueModel& model);
  std::vector<Variant> ripple_candidates(const TorqueModel& model);
  std::vector<Variant> wave_candidates(const TorqueModel& model);
  std::vector<Variant> load_candidates(const TorqueModel& model);
  Judgement judge(const TorqueModel& more, const TorqueModel& less, const Variant& added) const;
  Trial trial(const TorqueModel& model, const std::vector<Variant>& variants);
  Trial judged(const TorqueModel& model, const TorqueModel& with, const Variant& variant);
  std::vector<Trial> trials(const TorqueModel& model);
  double asymmetry_evidence(const TorqueModel& model, const std::vector<Variant>& variants);
  TorqueModel refined(TorqueModel model, DriveTerm term);
  std::pair<double, double> limits_of_shape(const Variant& variant) const;
  Eigen::VectorXd slope_by_shape(const TorqueModel& model, std::size_t part, double& step);
  TorqueModel sharpened(TorqueModel model);
  TorqueModel with_sharp_orders(TorqueModel model);
  TorqueModel polished(TorqueModel model);
  TorqueModel in_its_best_form(TorqueModel model, Variant part);
  TorqueModel with_one_of(const TorqueModel& model, Selection::Stage& stage);
  std::vector<std::string> effect_names(const TorqueModel& model) const;
  bool drop_what_is_no_longer_needed(TorqueModel& model);
  bool drop_what_better_forms_explain(TorqueModel& model);
  bool swap(TorqueModel& model);
  bool difference_is_certain(const TorqueModel& better, const TorqueModel& other) const;
  bool is_constant_load(const TorqueModel& model, Variant load);
  void prefer_the_constant(TorqueModel& model);
  void count_gravity_to_its_harmonics(TorqueModel& model);
  bool rivals(const TorqueModel& best, const Variant& part, const TorqueModel& smaller,
              const std::vector<Variant>& variants);
  TorqueModel with(const TorqueModel& model, const Variant& variant);
  TorqueModel enriched(TorqueModel model);
  std::string why_impossible(const TorqueModel& model, const TorqueModel& other) const;
  double critical(double alternatives) const;
  bool is_base(const Variant& variant) const;

  Design& design_;
  const DriveRange& range_;
  const DriveModel& model_;
  SelectionOptions options_;
  std::vector<Variant> base_;
  std::vector<Variant> pool_;  ///< all that depends on no other part
  std::set<std::string> excluded_;
  int candidates_ = 1;
  double variation_ = 0.0;     ///< norm of the torque of all rows about its mean
  double least_square_ = 0.0;  ///< that an effect takes of all rows' squared error
};

/// Variants of friction or inertia that goes up and down along the travel, with the periods that the
/// residuals show.
std::vector<Variant> waves_in(const Design& design, const Eigen::VectorXd& residuals, const DriveRange& range,
                              const DriveModel& model, DriveTerm term);

/// Variants of cogging: the orders that the residuals show, beside those already there.
std::vector<Variant> ripples_in(const Design& design, const Eigen::VectorXd& whitened_residuals,
                                const DriveRange& range, const DriveModel& model, const Variant* already,
                                std::string* why_not);

}  // namespace clampd::drive
