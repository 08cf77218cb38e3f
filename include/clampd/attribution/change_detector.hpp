#pragma once

#include <cstddef>
#include <vector>

namespace clampd::attribution {

/// A sum of e-processes, one for each time at which the mean of independent normal readings may have changed
/// (an e-detector of Shiryaev and Roberts' kind; Shin, Ramdas, Rinaldo, arXiv 2309.09111). The mean and the
/// spread before the change are not known: each reading is held against the earlier ones by Student's t, and
/// these residuals are independent as long as nothing changes (Brown, Durbin, Evans 1975), so that the
/// promise needs no reference that is known exactly. As long as nothing changes, the expected evidence()
/// after n readings is at most n; a detector that starts anew whenever it reaches A therefore does so at most
/// n / A times on average in any n readings.
class ChangeDetector {
 public:
  /// A time at which the change may have happened, and what was known before it.
  struct Start {
    double time_s = 0.0;  ///< of the first reading after the change
    double information = 0.0;
    double mean = 0.0;
    double score = 0.0;  ///< sums over the residuals before it
    double weight = 0.0;
  };
  /// All of it, to be stored.
  struct State {
    std::size_t readings = 0;
    double information = 0.0;  ///< sum of 1/variance of all readings
    double mean = 0.0;
    double squares = 0.0;  ///< weighted sum of the squared deviations from the mean
    double score = 0.0;
    double weight = 0.0;
    std::vector<Start> starts;  ///< the latest kMostStarts
  };
  struct Change {
    double time_s = 0.0;
    double size = 0.0;  ///< in the unit of the readings
    double sd = 0.0;
  };

  static constexpr std::size_t kMostStarts = 400;

  ChangeDetector() = default;
  explicit ChangeDetector(State state) : state_(std::move(state)) {}

  /// `variance`: relative to that of a usual reading, about 1; above zero.
  void add(double time_s, double reading, double variance);
  double evidence() const;
  /// Begins to gather evidence anew, with the baseline that there is. The promise stays: what is left out of
  /// the sum only makes it smaller.
  void drop_evidence() { state_.starts.clear(); }
  /// The most likely time of a change and its size. At least three readings.
  Change change() const;
  const State& state() const { return state_; }

 private:
  double evidence_of(const Start& start) const;
  State state_;
};

}  // namespace clampd::attribution
