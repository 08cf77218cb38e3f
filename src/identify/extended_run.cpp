#include "src/identify/extended_run.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "clampd/base/assert.hpp"
#include "clampd/statistics/symmetric.hpp"
#include "src/identify/initial_state_prior.hpp"

namespace clampd::identify {

namespace {

constexpr int kMaxStates = ExtendedBrake::kMaxStates;

double reading_of(const FitRun& run, std::size_t k, int channel) {
  return channel == 0 ? run.force_N[k] : run.velocity_rad_s[k];
}
bool counts(const FitRun& run, std::size_t k, int channel) {
  return (channel == 0 ? run.use_force[k] : run.use_velocity[k]) != 0;
}

/// Covariance of the states, with the filter's two moves.
class Covariance {
 public:
  explicit Covariance(int states) : n_(states) { std::fill(values_, values_ + kMaxStates * kMaxStates, 0.0); }

  /// A reading: its variance; the gain comes back, and the reading's noise is `noise`.
  double correct(const double* by_state, double noise, double* gain) {
    double cross[kMaxStates];
    double variance = noise;
    for (int i = 0; i < n_; ++i) {
      cross[i] = 0.0;
      for (int j = 0; j < n_; ++j) cross[i] += at(i, j) * by_state[j];
    }
    for (int i = 0; i < n_; ++i) variance += by_state[i] * cross[i];
    for (int i = 0; i < n_; ++i) gain[i] = cross[i] / variance;
    for (int i = 0; i < n_; ++i)
      for (int j = 0; j < n_; ++j) at(i, j) -= gain[i] * cross[j];
    return variance;
  }

  void advance(const double* transition, const double* torque, double torque_variance) {
    double half[kMaxStates * kMaxStates];
    for (int i = 0; i < n_; ++i)
      for (int j = 0; j < n_; ++j) {
        double sum = 0.0;
        for (int l = 0; l < n_; ++l) sum += transition[i * n_ + l] * at(l, j);
        half[i * kMaxStates + j] = sum;
      }
    for (int i = 0; i < n_; ++i)
      for (int j = 0; j <= i; ++j) {
        double sum = torque_variance * torque[i] * torque[j];
        for (int l = 0; l < n_; ++l) sum += half[i * kMaxStates + l] * transition[j * n_ + l];
        at(i, j) = at(j, i) = sum;
      }
  }

 private:
  double& at(int i, int j) { return values_[i * kMaxStates + j]; }
  int n_;
  double values_[kMaxStates * kMaxStates];
};

bool positive_by_nature(const ExtendedBrake::Place& place, const EffectParameter* parameter) {
  if (place.effect < 0) return place.parameter != static_cast<int>(k1);
  return parameter->logarithmic;
}

}  // namespace

Unknowns::Unknowns(const ExtendedParameters& model, std::span<const ExtendedBrake::Place> places,
                   const std::array<bool, kParameterCount>& held, bool hold_effects) {
  for (std::size_t i = 0; i < places.size(); ++i) {
    const ExtendedBrake::Place& place = places[i];
    if (place.effect < 0) {
      const auto parameter = static_cast<std::size_t>(place.parameter);
      if (held[parameter]) continue;
      const ParameterInfo& info = kParameterTable[parameter];
      free_.push_back({static_cast<int>(i), place, positive_by_nature(place, nullptr), info.nominal,
                       info.lower, info.upper});
    } else if (!hold_effects) {
      const EffectParameter& parameter = parameter_at(model, place);
      free_.push_back({static_cast<int>(i), place, positive_by_nature(place, &parameter), parameter.scale,
                       parameter.lower, parameter.upper});
    }
  }
}

double Unknowns::in_units(int i, double value) const {
  const Free& free = free_[static_cast<std::size_t>(i)];
  return free.logarithmic ? std::log(value) : value / free.scale;
}

double Unknowns::from(const ExtendedParameters& model, int i) const {
  return in_units(i, value_at(model, free_[static_cast<std::size_t>(i)].place));
}

double Unknowns::slope(const ExtendedParameters& model, int i) const {
  const Free& free = free_[static_cast<std::size_t>(i)];
  return free.logarithmic ? value_at(model, free.place) : free.scale;
}

void Unknowns::put(double unknown, int i, ExtendedParameters& model) const {
  const Free& free = free_[static_cast<std::size_t>(i)];
  const double value = free.logarithmic ? std::exp(unknown) : free.scale * unknown;
  value_at(model, free.place) = std::clamp(value, free.lower, free.upper);
}

bool within_bounds(const ExtendedParameters& model) {
  for (std::size_t i = 0; i < kParameterCount; ++i) {
    const double value = model.base.theta[static_cast<Eigen::Index>(i)];
    if (!(value >= kParameterTable[i].lower && value <= kParameterTable[i].upper)) return false;
  }
  for (const EffectValues& values : model.effects) {
    const auto& parameters = info_of(*values.effect).parameters;
    for (std::size_t i = 0; i < parameters.size(); ++i)
      if (!(values.values[i] >= parameters[i].lower && values.values[i] <= parameters[i].upper)) return false;
  }
  return true;
}

RowInput row_input(const FitRun& run, std::size_t k) noexcept {
  const std::size_t last = run.size() - 1;
  return {run.torque_Nm[k > 0 ? k - 1 : 0],
          run.torque_Nm[k],
          run.torque_Nm[std::min(k + 1, last)],
          run.torque_Nm[std::min(k + 2, last)],
          run.time_s[k],
          k < last ? run.time_s[k + 1] - run.time_s[k] : kMaxStep_s,
          run.number};
}

void ExtendedRun::resize(std::size_t size, int n, int p, int l) {
  rows = size;
  states = n;
  parameters = p;
  initial_states = l;
  const auto count = [size](int each) { return size * static_cast<std::size_t>(each); };
  transition.resize(count(n * n));
  step.resize(count(n * p));
  torque.resize(count(n));
  by_state.resize(count(2 * n));
  by_parameter.resize(count(2 * p));
  residual.resize(count(2));
  correction.resize(count(n));
  gain.resize(count(2 * n));
  variance.resize(count(2));
  reference.resize(count(n));
  initial.resize(static_cast<std::size_t>(n * (l + p)));
}

namespace {

/// Of the reading while the drive was off: what the model takes for a torque there, over the deviation.
double off_error(const FitRun& run, const ExtendedBrake& brake) {
  return brake.acting_torque(run.torque_while_off->mean_Nm) / run.torque_while_off->sd_Nm;
}
/// The same with its derivatives by all parameters.
double off_error(const FitRun& run, const ExtendedBrake& brake, double* gradient) {
  const double sd_Nm = run.torque_while_off->sd_Nm;
  const double torque_Nm = brake.acting_torque(run.torque_while_off->mean_Nm, gradient);
  for (int i = 0; i < brake.parameters(); ++i) gradient[i] /= sd_Nm;
  return torque_Nm / sd_Nm;
}

}  // namespace

bool linearise(const FitRun& run, const ExtendedBrake& brake, const ExtendedParameters& model,
               const Unknowns& unknowns, const Eigen::VectorXd& initial, const Variances& variances,
               Gains gains, ExtendedRun& out) {
  const int n = out.states;
  const int p = out.parameters;
  const int all = brake.parameters();
  double slopes[ExtendedBrake::kMaxParameters];
  int places[ExtendedBrake::kMaxParameters];
  for (int i = 0; i < p; ++i) {
    slopes[i] = unknowns.slope(model, i);
    places[i] = unknowns.parameter(i);
  }
  double jacobian[kMaxStates * (kMaxStates + ExtendedBrake::kMaxParameters + 2)];

  ExtendedBrake::State state = brake.settled(initial[0], initial[1], row_input(run, 0), jacobian);
  std::fill(out.initial.begin(), out.initial.end(), 0.0);
  for (int i = 0; i < n; ++i) {
    double* row = out.initial.data() + i * (p + out.initial_states);
    for (int c = 0; c < p; ++c) row[c] = jacobian[i * (2 + all) + 2 + places[c]] * slopes[c];
    row[p] = jacobian[i * (2 + all)];
    row[p + 1] = jacobian[i * (2 + all) + 1];
  }
  for (int f = 0; f + 2 < out.initial_states; ++f) {
    const int place = brake.free_states()[static_cast<std::size_t>(f)];
    state[place] += initial[2 + f];
    out.initial[static_cast<std::size_t>(place * (p + out.initial_states) + p + 2 + f)] = 1.0;
  }

  out.off.resize(0);
  if (run.torque_while_off) {
    const double error = off_error(run, brake, jacobian);
    out.off.setZero(out.columns());
    for (int c = 0; c < p; ++c) out.off[c] = jacobian[places[c]] * slopes[c];
    out.off[out.columns() - 1] = error;
  }

  Covariance covariance(n);
  out.log_determinant = 0.0;
  out.readings = 0.0;
  for (std::size_t k = 0; k < out.rows; ++k) {
    if (!ExtendedBrake::is_bounded(state)) return false;
    const RowInput row = row_input(run, k);
    std::copy_n(state.data(), n, out.reference.data() + k * static_cast<std::size_t>(n));
    const Reading reading = brake.read(state, row, jacobian);
    double* residual = out.residual.data() + 2 * k;
    double* correction = out.correction.data() + k * static_cast<std::size_t>(n);
    std::fill(correction, correction + n, 0.0);
    for (int channel = 0; channel < 2; ++channel) {
      const auto at = 2 * k + static_cast<std::size_t>(channel);
      double* by_state = out.by_state.data() + at * static_cast<std::size_t>(n);
      double* by_parameter = out.by_parameter.data() + at * static_cast<std::size_t>(p);
      double* gain = out.gain.data() + at * static_cast<std::size_t>(n);
      const double* source = jacobian + channel * (n + all);
      std::copy_n(source, n, by_state);
      for (int c = 0; c < p; ++c) by_parameter[c] = source[n + places[c]] * slopes[c];
      residual[channel] =
          reading_of(run, k, channel) - (channel == 0 ? reading.force_N : reading.velocity_rad_s);
      if (!counts(run, k, channel)) {
        if (gains == Gains::Renewed) std::fill(gain, gain + n, 0.0);
        continue;
      }
      if (gains == Gains::Renewed)
        out.variance[at] =
            covariance.correct(by_state, channel == 0 ? variances.force : variances.velocity, gain);
      out.log_determinant += std::log(out.variance[at]);
      out.readings += 1.0;
      double innovation = residual[channel];
      for (int i = 0; i < n; ++i) innovation -= by_state[i] * correction[i];
      for (int i = 0; i < n; ++i) correction[i] += gain[i] * innovation;
    }
    if (k + 1 == out.rows) break;
    for (int i = 0; i < n; ++i) state[i] += correction[i];
    if (!ExtendedBrake::is_bounded(state)) return false;
    state = brake.advance(state, row, jacobian);
    double* transition = out.transition.data() + k * static_cast<std::size_t>(n * n);
    double* step = out.step.data() + k * static_cast<std::size_t>(n * p);
    double* torque = out.torque.data() + k * static_cast<std::size_t>(n);
    for (int i = 0; i < n; ++i) {
      const double* source = jacobian + i * (n + all + 1);
      std::copy_n(source, n, transition + i * n);
      for (int c = 0; c < p; ++c) step[i * p + c] = source[n + places[c]] * slopes[c];
      torque[i] = source[n + all];
    }
    if (gains == Gains::Renewed) covariance.advance(transition, torque, variances.torque);
  }
  return true;
}

ExtendedBrake::State first_state(const FitRun& run, const ExtendedBrake& brake,
                                 const Eigen::VectorXd& initial) {
  ExtendedBrake::State state = brake.settled(initial[0], initial[1], row_input(run, 0));
  for (std::size_t f = 0; f < brake.free_states().size(); ++f)
    state[brake.free_states()[f]] += initial[2 + static_cast<Eigen::Index>(f)];
  return state;
}

double sum_of_squares_of(const FitRun& run, const ExtendedBrake& brake, const Eigen::VectorXd& initial,
                         const ExtendedRun& linearised) {
  constexpr double kNever = std::numeric_limits<double>::infinity();
  const int n = linearised.states;
  double jacobian[kMaxStates * (kMaxStates + ExtendedBrake::kMaxParameters + 2)];
  ExtendedBrake::State state = first_state(run, brake, initial);
  double squares = 0.0;
  if (run.torque_while_off) {
    const double error = off_error(run, brake);
    squares += error * error;
  }
  for (std::size_t k = 0; k < linearised.rows; ++k) {
    if (!ExtendedBrake::is_bounded(state)) return kNever;
    const RowInput row = row_input(run, k);
    const Reading reading = brake.read(state, row, jacobian);
    double correction[kMaxStates] = {};
    for (int channel = 0; channel < 2; ++channel) {
      if (!counts(run, k, channel)) continue;
      const auto at = 2 * k + static_cast<std::size_t>(channel);
      const double* by_state = jacobian + channel * (n + brake.parameters());
      const double* gain = linearised.gain.data() + at * static_cast<std::size_t>(n);
      double innovation =
          reading_of(run, k, channel) - (channel == 0 ? reading.force_N : reading.velocity_rad_s);
      for (int i = 0; i < n; ++i) innovation -= by_state[i] * correction[i];
      for (int i = 0; i < n; ++i) correction[i] += gain[i] * innovation;
      squares += innovation * innovation / linearised.variance[at];
    }
    if (k + 1 == linearised.rows) break;
    for (int i = 0; i < n; ++i) state[i] += correction[i];
    if (!ExtendedBrake::is_bounded(state)) return kNever;
    state = brake.advance(state, row);
  }
  return squares;
}

namespace {

/// Distances of the state from the reference along many columns, moved through a run by its filter.
class Distances {
 public:
  Distances(int states, int columns)
      : n_(states), m_(columns), values_(static_cast<std::size_t>(states * columns), 0.0), next_(values_) {}

  double* row(int state) { return values_.data() + state * m_; }

  /// innovation -= by_state * distance.
  void observe(const double* by_state, double* innovation) const {
    for (int i = 0; i < n_; ++i) {
      if (by_state[i] == 0.0) continue;
      const double* from = values_.data() + i * m_;
      for (int c = 0; c < m_; ++c) innovation[c] -= by_state[i] * from[c];
    }
  }
  void correct(const double* gain, const double* innovation) {
    for (int i = 0; i < n_; ++i) {
      if (gain[i] == 0.0) continue;
      double* to = values_.data() + i * m_;
      for (int c = 0; c < m_; ++c) to[c] += gain[i] * innovation[c];
    }
  }
  void advance(const double* transition) {
    for (int i = 0; i < n_; ++i) {
      double* to = next_.data() + i * m_;
      std::fill(to, to + m_, 0.0);
      for (int l = 0; l < n_; ++l) {
        const double factor = transition[i * n_ + l];
        if (factor == 0.0) continue;
        const double* from = values_.data() + l * m_;
        for (int c = 0; c < m_; ++c) to[c] += factor * from[c];
      }
    }
    values_.swap(next_);
  }

 private:
  int n_, m_;
  std::vector<double> values_, next_;
};

}  // namespace

void compute_normal(const FitRun& run, ExtendedRun& out) {
  const int n = out.states;
  const int p = out.parameters;
  const int m = out.columns();
  const int data = m - 1;
  out.innovations.setZero(m, 2 * static_cast<Eigen::Index>(out.rows));
  Distances distances(n, m);
  for (int i = 0; i < n; ++i) std::copy_n(out.initial.data() + i * (m - 1), m - 1, distances.row(i));
  for (std::size_t k = 0; k < out.rows; ++k) {
    for (int channel = 0; channel < 2; ++channel) {
      if (!counts(run, k, channel)) continue;
      const std::size_t at = 2 * k + static_cast<std::size_t>(channel);
      double* innovation = out.innovations.col(static_cast<Eigen::Index>(at)).data();
      const double* by_parameter = out.by_parameter.data() + at * static_cast<std::size_t>(p);
      for (int c = 0; c < p; ++c) innovation[c] = -by_parameter[c];
      innovation[data] = out.residual[at];
      distances.observe(out.by_state.data() + at * static_cast<std::size_t>(n), innovation);
      distances.correct(out.gain.data() + at * static_cast<std::size_t>(n), innovation);
      const double scale = 1.0 / std::sqrt(out.variance[at]);
      for (int c = 0; c < m; ++c) innovation[c] *= scale;
    }
    if (k + 1 == out.rows) break;
    const double* correction = out.correction.data() + k * static_cast<std::size_t>(n);
    for (int i = 0; i < n; ++i) distances.row(i)[data] -= correction[i];
    distances.advance(out.transition.data() + k * static_cast<std::size_t>(n * n));
    const double* step = out.step.data() + k * static_cast<std::size_t>(n * p);
    for (int i = 0; i < n; ++i)
      for (int c = 0; c < p; ++c) distances.row(i)[c] += step[i * p + c];
  }
  out.normal.setZero(m, m);
  out.normal.selfadjointView<Eigen::Lower>().rankUpdate(out.innovations);
  if (out.off.size() > 0) out.normal.selfadjointView<Eigen::Lower>().rankUpdate(out.off);
  out.normal.triangularView<Eigen::StrictlyUpper>() = out.normal.transpose();
}

std::vector<double> prior_deviations(const ExtendedParameters& model) {
  std::vector<double> deviations(kInitialStatePrior.begin(), kInitialStatePrior.end());
  for (const EffectValues& values : model.effects) {
    const EffectInfo& info = info_of(*values.effect);
    deviations.insert(deviations.end(), static_cast<std::size_t>(info.free_states),
                      info.free_state_deviation);
  }
  return deviations;
}

Reduced without_initial_states(const Eigen::MatrixXd& normal, int parameters, int initial_states) {
  const int data = parameters + initial_states;
  const statistics::SymmetricFactor factor(
      normal.block(parameters, parameters, initial_states, initial_states));
  // Side by side: Eigen does not solve for no column at all, which a fit without parameters has.
  Eigen::MatrixXd followed(initial_states, parameters + 1);
  followed << normal.block(parameters, 0, initial_states, parameters),
      normal.block(parameters, data, initial_states, 1);
  const Eigen::MatrixXd taken = followed.transpose() * factor.solve_columns(followed);
  return {normal.topLeftCorner(parameters, parameters) - taken.topLeftCorner(parameters, parameters),
          normal.block(0, data, parameters, 1) - taken.topRightCorner(parameters, 1),
          normal(data, data) - taken(parameters, parameters)};
}

void recompute_gains(const FitRun& run, const Variances& variances, ExtendedRun& out,
                     std::vector<double>& innovation) {
  const int n = out.states;
  innovation.assign(2 * out.rows, 0.0);
  Covariance covariance(n);
  Distances distance(n, 1);
  out.log_determinant = 0.0;
  for (std::size_t k = 0; k < out.rows; ++k) {
    for (int channel = 0; channel < 2; ++channel) {
      const std::size_t at = 2 * k + static_cast<std::size_t>(channel);
      const double* by_state = out.by_state.data() + at * static_cast<std::size_t>(n);
      double* gain = out.gain.data() + at * static_cast<std::size_t>(n);
      if (!counts(run, k, channel)) {
        std::fill(gain, gain + n, 0.0);
        continue;
      }
      out.variance[at] =
          covariance.correct(by_state, channel == 0 ? variances.force : variances.velocity, gain);
      out.log_determinant += std::log(out.variance[at]);
      innovation[at] = out.residual[at];
      distance.observe(by_state, &innovation[at]);
      distance.correct(gain, &innovation[at]);
    }
    if (k + 1 == out.rows) break;
    const double* transition = out.transition.data() + k * static_cast<std::size_t>(n * n);
    const double* correction = out.correction.data() + k * static_cast<std::size_t>(n);
    for (int i = 0; i < n; ++i) distance.row(i)[0] -= correction[i];
    distance.advance(transition);
    covariance.advance(transition, out.torque.data() + k * static_cast<std::size_t>(n), variances.torque);
  }
}

NoiseSquares smooth(const FitRun& run, const ExtendedRun& filtered, const std::vector<double>& innovation,
                    std::vector<double>* disturbance) {
  const int n = filtered.states;
  NoiseSquares squares;
  double adjoint[kMaxStates] = {};
  double expected[kMaxStates * kMaxStates] = {};
  double work[kMaxStates * kMaxStates];
  if (disturbance != nullptr) disturbance->assign(filtered.rows, 0.0);
  for (std::size_t k = filtered.rows; k-- > 0;) {
    if (k + 1 < filtered.rows) {
      const double* torque = filtered.torque.data() + k * static_cast<std::size_t>(n);
      const double* transition = filtered.transition.data() + k * static_cast<std::size_t>(n * n);
      double of_torque = 0.0;
      double torque_square = 0.0;
      for (int i = 0; i < n; ++i) {
        of_torque += torque[i] * adjoint[i];
        for (int j = 0; j < n; ++j) torque_square += torque[i] * expected[i * n + j] * torque[j];
      }
      squares.torque += of_torque * of_torque;
      squares.torque_expected += torque_square;
      if (disturbance != nullptr) (*disturbance)[k] = of_torque;
      double through[kMaxStates];
      for (int i = 0; i < n; ++i) {
        through[i] = 0.0;
        for (int l = 0; l < n; ++l) through[i] += transition[l * n + i] * adjoint[l];
      }
      std::copy_n(through, n, adjoint);
      for (int i = 0; i < n; ++i)
        for (int j = 0; j < n; ++j) {
          work[i * n + j] = 0.0;
          for (int l = 0; l < n; ++l) work[i * n + j] += expected[i * n + l] * transition[l * n + j];
        }
      for (int i = 0; i < n; ++i)
        for (int j = 0; j < n; ++j) {
          expected[i * n + j] = 0.0;
          for (int l = 0; l < n; ++l) expected[i * n + j] += transition[l * n + i] * work[l * n + j];
        }
    }
    for (int channel = 1; channel >= 0; --channel) {
      if (!counts(run, k, channel)) continue;
      const std::size_t at = 2 * k + static_cast<std::size_t>(channel);
      const double* by_state = filtered.by_state.data() + at * static_cast<std::size_t>(n);
      const double* gain = filtered.gain.data() + at * static_cast<std::size_t>(n);
      const double inverse = 1.0 / filtered.variance[at];
      double gained[kMaxStates];  // expected * gain
      double square = inverse;
      double smoothed = inverse * innovation[at];
      for (int i = 0; i < n; ++i) {
        gained[i] = 0.0;
        for (int j = 0; j < n; ++j) gained[i] += expected[i * n + j] * gain[j];
        smoothed -= gain[i] * adjoint[i];
      }
      for (int i = 0; i < n; ++i) square += gain[i] * gained[i];
      (channel == 0 ? squares.force : squares.velocity) += smoothed * smoothed;
      (channel == 0 ? squares.force_expected : squares.velocity_expected) += square;
      // (I - K C)^T N (I - K C) + C^T C / s, and C^T of the smoothed noise.
      for (int i = 0; i < n; ++i) {
        for (int j = 0; j < n; ++j)
          expected[i * n + j] +=
              by_state[i] * square * by_state[j] - gained[i] * by_state[j] - by_state[i] * gained[j];
        adjoint[i] += by_state[i] * smoothed;
      }
    }
  }
  return squares;
}

Eigen::MatrixXd filter_signals(const FitRun& run, const ExtendedRun& filtered, SignalColumns::Kind kind,
                               const Eigen::MatrixXd& signals, const ExtendedParameters& model) {
  const int n = filtered.states;
  const int m = static_cast<int>(signals.cols());
  Eigen::MatrixXd innovations = Eigen::MatrixXd::Zero(m, 2 * static_cast<Eigen::Index>(filtered.rows));
  Distances distances(n, m);
  std::vector<double> signal(static_cast<std::size_t>(m));
  const ParameterVector& theta = model.base.theta;
  for (std::size_t k = 0; k < filtered.rows; ++k) {
    const auto row = static_cast<Eigen::Index>(k);
    for (int c = 0; c < m; ++c) signal[static_cast<std::size_t>(c)] = signals(row, c);
    for (int channel = 0; channel < 2; ++channel) {
      if (!counts(run, k, channel)) continue;
      const std::size_t at = 2 * k + static_cast<std::size_t>(channel);
      double* innovation = innovations.col(static_cast<Eigen::Index>(at)).data();
      const bool reads = channel == 0
                             ? kind == SignalColumns::Kind::ForceReading || kind == SignalColumns::Kind::Force
                             : kind == SignalColumns::Kind::VelocityReading;
      // What the model lacks is what the data have more.
      if (reads)
        std::transform(signal.begin(), signal.end(), innovation, [](double value) { return -value; });
      distances.observe(filtered.by_state.data() + at * static_cast<std::size_t>(n), innovation);
      distances.correct(filtered.gain.data() + at * static_cast<std::size_t>(n), innovation);
      const double scale = 1.0 / std::sqrt(filtered.variance[at]);
      for (int c = 0; c < m; ++c) innovation[c] *= scale;
    }
    if (k + 1 == filtered.rows) break;
    distances.advance(filtered.transition.data() + k * static_cast<std::size_t>(n * n));
    double torque_each = 0.0;
    if (kind == SignalColumns::Kind::Torque) torque_each = 1.0;
    if (kind == SignalColumns::Kind::Force) {
      const double velocity = filtered.reference[k * static_cast<std::size_t>(n) + 1];
      const double speed = velocity / theta[ws];
      torque_each =
          -model.base.fixed.ratio_m_rad - std::copysign(theta[mus], velocity) / (1.0 + speed * speed);
    }
    if (torque_each != 0.0) {
      const double* torque = filtered.torque.data() + k * static_cast<std::size_t>(n);
      for (int i = 0; i < n; ++i)
        for (int c = 0; c < m; ++c)
          distances.row(i)[c] += torque_each * torque[i] * signal[static_cast<std::size_t>(c)];
    }
  }
  return innovations;
}

}  // namespace clampd::identify
