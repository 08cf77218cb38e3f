#pragma once

#include <optional>
#include <string>
#include <vector>

#include <Eigen/Core>

#include "src/diagnose/drive_regression.hpp"
#include "src/diagnose/drive_terms.hpp"

namespace clampd::drive {

/// Rows of all runs one below the other, and how they are divided.
class DriveFit {
 public:
  DriveFit(const DriveData& data, const DriveModel& model);

  Eigen::MatrixXd columns(const std::vector<DriveComponent>& components) const {
    return columns(components, data_);
  }
  static Eigen::MatrixXd columns(const std::vector<DriveComponent>& components, const DriveData& data);
  /// What is left of the torque beside the parts with known values.
  Eigen::VectorXd target(const DriveData& data) const;

  const DriveData& data() const { return data_; }
  const DriveRange& range() const { return range_; }
  const Eigen::VectorXd& target() const { return target_; }
  const std::vector<int>& blocks() const { return blocks_; }          ///< stretches of time
  const std::vector<int>& conditions() const { return conditions_; }  ///< direction and speed
  const std::vector<int>& cells() const { return cells_; }            ///< direction, speed and position
  bool by_conditions() const { return by_conditions_; }
  bool both_directions() const { return both_directions_; }

 private:
  const DriveData& data_;
  const DriveModel& model_;
  DriveRange range_;
  Eigen::VectorXd target_;
  std::vector<int> blocks_, conditions_, cells_;
  bool by_conditions_ = false;
  bool both_directions_ = false;
};

/// One candidate beside one model.
struct DriveTrial {
  DriveComponent component;
  double gain = 0.0;               ///< nats, counted in independent samples
  double significance_nats = 0.0;  ///< -ln p, its alternatives counted
  double score = 0.0;              ///< gain less what its coefficients and alternatives cost
  bool significant = false;
  bool holds = false;  ///< predicts what was left out
};

struct DriveSearchResult {
  std::vector<DriveComponent> base;
  std::vector<DriveComponent> chosen;
  struct Stage {
    std::vector<DriveTrial> trials;
    std::optional<std::size_t> winner;
    std::vector<std::size_t> rivals;
  };
  std::vector<Stage> stages;
  std::vector<std::pair<DriveTerm, std::string>> unseen;  ///< and the reason
  std::vector<std::string> notices;
  int candidates = 0;
};

struct DriveSearchOptions {
  double false_alarm = 0.01;
  int most_effects = 4;
};

DriveSearchResult search(const DriveFit& fit, const DriveModel& model, const DriveData* heldout,
                         const DriveSearchOptions& options);

}  // namespace clampd::drive
