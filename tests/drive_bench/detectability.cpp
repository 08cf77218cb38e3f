#include "tests/drive_bench/detectability.hpp"

#include <algorithm>
#include <cmath>
#include <functional>
#include <numbers>

#include <Eigen/Dense>

namespace clampd::drive_bench {
namespace {

constexpr double kTau = 2.0 * std::numbers::pi;
using Row = Recording::Truth;
using Term = std::function<double(const Row&)>;
using Terms = std::vector<Term>;

double sign(double x) {
  return static_cast<double>((x > 0.0) - (x < 0.0));
}

/// The rows that count, of all runs, with columns that look back in time: made once.
struct Data {
  struct Extended : Row {
    std::size_t run = 0;
    double torque_rate = 0.0;
    std::vector<double> bristles;  ///< one for each of kLengths
  };
  std::vector<Extended> rows;
  std::vector<std::size_t> begins;  ///< first row of each run, and the end
};

const std::vector<double>& lengths() {  // of hystereses, as shares of the way
  static const std::vector<double> kLengths{0.01, 0.02, 0.04, 0.08, 0.15, 0.3, 0.6, 1.2};
  return kLengths;
}

Data gather(const Case& c, const std::vector<Recording>& runs) {
  Data data;
  const double reach = detail::travel(c), row_s = c.rig.row_s();
  for (std::size_t run = 0; run < runs.size(); ++run) {
    data.begins.push_back(data.rows.size());
    std::vector<double> bristles(lengths().size(), 0.0);
    const auto& truth = runs[run].truth;
    for (std::size_t k = 0; k < truth.size(); ++k) {
      const double way = truth[k].velocity * row_s;
      for (std::size_t i = 0; i < bristles.size(); ++i)
        bristles[i] =
            sign(way) + (bristles[i] - sign(way)) * std::exp(-std::abs(way) / (lengths()[i] * reach));
      if (truth[k].stuck) continue;
      Data::Extended row;
      static_cast<Row&>(row) = truth[k];
      row.run = run;
      row.bristles = bristles;
      const std::size_t before = k > 0 ? k - 1 : k, after = std::min(k + 1, truth.size() - 1);
      if (after > before)
        row.torque_rate =
            (truth[after].torque - truth[before].torque) / (static_cast<double>(after - before) * row_s);
      data.rows.push_back(std::move(row));
    }
  }
  data.begins.push_back(data.rows.size());
  return data;
}

/// Running mean over half a period of the band's edge, twice (a triangle): what is slower stays. Thinned to
/// what the band needs.
Eigen::VectorXd within_band(const Case& c, const Data& data, const Eigen::VectorXd& values) {
  const auto half = static_cast<std::ptrdiff_t>(std::floor(0.125 / (c.band_Hz * c.rig.row_s())));
  if (half < 1) return values;
  Eigen::VectorXd result = values;
  for (int pass = 0; pass < 2; ++pass) {
    Eigen::VectorXd sums(result.size() + 1);
    sums[0] = 0.0;
    for (Eigen::Index k = 0; k < result.size(); ++k) sums[k + 1] = sums[k] + result[k];
    for (std::size_t run = 0; run + 1 < data.begins.size(); ++run) {
      const auto begin = static_cast<std::ptrdiff_t>(data.begins[run]),
                 end = static_cast<std::ptrdiff_t>(data.begins[run + 1]);
      for (std::ptrdiff_t k = begin; k < end; ++k) {
        const std::ptrdiff_t reach = std::min({half, k - begin, end - 1 - k});
        result[k] = (sums[k + reach + 1] - sums[k - reach]) / static_cast<double>(2 * reach + 1);
      }
    }
  }
  const auto every = std::max<std::ptrdiff_t>(1, half);  // four times as many as the band's edge needs
  Eigen::VectorXd thinned((result.size() + every - 1) / every);
  for (Eigen::Index k = 0; k < thinned.size(); ++k) thinned[k] = result[k * every];
  return thinned;
}

double noise_variance(const Case& c) {
  const double row_s = c.rig.row_s(), band = std::min(c.band_Hz, 0.5 / row_s);
  const double reading = c.rig.torque_noise * c.rig.torque_noise * 2.0 * band * row_s;
  double motion = 2.0 * row_s * std::pow(kTau, 4) * std::pow(band, 5) / 5.0 * c.rig.encoder_step *
                  c.rig.encoder_step / 12.0;
  if (!c.rig.has_position && c.rig.velocity_column == VelocityColumn::Tachometer &&
      c.rig.torque_column != TorqueColumn::Averaged)
    motion =
        2.0 * row_s * kTau * kTau * std::pow(band, 3) / 3.0 * c.rig.velocity_noise * c.rig.velocity_noise;
  const double inertia = c.plant.inertia + c.plant.payload_inertia;
  return reading + inertia * inertia * motion;
}

class LeastSquares {
 public:
  LeastSquares(const Case& c, const Data& data) : case_(c), data_(data) {
    torque_ = filtered([](const Row& row) { return row.torque; });
    add({[](const Row& row) { return row.acceleration; }, [](const Row& row) { return row.velocity; },
         [](const Row& row) { return row.direction; }});
  }

  void add(const Terms& terms) {
    for (const Term& term : terms) add_column(filtered(term));
  }

  void add_column(const Eigen::VectorXd& column) {
    const double length = column.norm();
    if (!(length > 0.0)) return;
    Eigen::VectorXd rest = column / length;
    for (int again = 0; again < 2; ++again)
      for (const Eigen::VectorXd& each : basis_) rest -= each.dot(rest) * each;
    if (rest.norm() > 1e-6) basis_.push_back(rest.normalized());
  }

  /// Adds whichever of the groups leaves least.
  void add_best(const std::vector<Terms>& groups) {
    const std::vector<Eigen::VectorXd> before = basis_;
    std::vector<Eigen::VectorXd> best = before;
    double least = rest().squaredNorm();
    for (const Terms& group : groups) {
      basis_ = before;
      add(group);
      const double left = rest().squaredNorm();
      if (left < least) least = left, best = basis_;
    }
    basis_ = best;
  }

  Eigen::VectorXd rest() const {
    Eigen::VectorXd left = torque_;
    for (int again = 0; again < 2; ++again)
      for (const Eigen::VectorXd& each : basis_) left -= each.dot(left) * each;
    return left;
  }

  Fit fit() const {
    Fit fit;
    fit.rows = data_.rows.size();
    if (fit.rows == 0) return fit;
    const double left = rest().squaredNorm() / static_cast<double>(torque_.size());
    fit.share_left = std::sqrt(left) / std::max(torque_rms(), 1e-150);
    const double independent =
        static_cast<double>(fit.rows) * std::min(1.0, 2.0 * case_.band_Hz * case_.rig.row_s());
    fit.nats = 0.5 * independent * left /
               std::max(noise_variance(case_), 1e-12 * case_.torque_scale * case_.torque_scale);
    return fit;
  }

  double torque_rms() const {
    return torque_.norm() / std::sqrt(std::max<double>(1.0, static_cast<double>(torque_.size())));
  }

  template <class Function>
  Eigen::VectorXd filtered(Function function) const {
    Eigen::VectorXd column(static_cast<Eigen::Index>(data_.rows.size()));
    for (std::size_t k = 0; k < data_.rows.size(); ++k)
      column[static_cast<Eigen::Index>(k)] = function(data_.rows[k]);
    return within_band(case_, data_, column);
  }

 private:
  const Case& case_;
  const Data& data_;
  Eigen::VectorXd torque_;
  std::vector<Eigen::VectorXd> basis_;
};

Term power(double v0, double exponent) {
  return [=](const Row& row) { return row.direction * std::pow(std::abs(row.velocity) / v0, exponent); };
}

std::vector<Terms> friction_shapes(double v0) {
  std::vector<Terms> groups;
  for (const double share : {0.02, 0.04, 0.07, 0.1, 0.15, 0.2, 0.3, 0.5})
    for (const double exponent : {1.0, 2.0}) {
      const auto shape = [=](const Row& row) {
        return std::exp(-std::pow(std::abs(row.velocity) / (share * v0), exponent));
      };
      groups.push_back({[=](const Row& row) { return row.direction * shape(row); },
                        [=](const Row& row) { return std::abs(row.direction) * shape(row); }});
    }
  return groups;
}

/// Of at least one period over the travel: what is slower is no ripple.
std::vector<Terms> ripples(const Case& c) {
  std::vector<Terms> groups;
  const double reach = detail::travel(c), slowest = std::numbers::pi / reach;
  for (int i = 1; i <= 120; ++i) {
    const double k = c.plant.linear ? slowest * std::pow(20.0, i / 120.0) : static_cast<double>(i);
    if (k < slowest) continue;
    Terms terms;
    for (const double multiple : {1.0, 2.0, 3.0}) {
      terms.push_back([=](const Row& row) { return std::sin(multiple * k * row.position); });
      terms.push_back([=](const Row& row) { return std::cos(multiple * k * row.position); });
    }
    groups.push_back(std::move(terms));
  }
  return groups;
}

std::vector<Terms> over_position(const Case& c, const std::function<Terms(double)>& of_wave_number) {
  std::vector<Terms> groups;
  for (int i = 1; i <= 16; ++i) groups.push_back(of_wave_number(kTau * 0.2 * i / (2.0 * detail::travel(c))));
  if (!c.plant.linear) groups.push_back(of_wave_number(1.0)), groups.push_back(of_wave_number(2.0));
  return groups;
}

Terms friction_position(double k) {
  return {[=](const Row& row) { return row.direction * std::sin(k * row.position); },
          [=](const Row& row) { return row.direction * std::cos(k * row.position); },
          [](const Row& row) { return row.direction * row.position; },
          [](const Row& row) { return row.direction * row.position * row.position; }};
}

Terms inertia_position(double k) {
  return {[=](const Row& r) {
            return r.acceleration * std::sin(k * r.position) +
                   0.5 * k * std::cos(k * r.position) * r.velocity * r.velocity;
          },
          [=](const Row& r) {
            return r.acceleration * std::cos(k * r.position) -
                   0.5 * k * std::sin(k * r.position) * r.velocity * r.velocity;
          }};
}

void add_presliding(LeastSquares& fit) {
  std::vector<Terms> groups;
  for (std::size_t i = 0; i < lengths().size(); ++i)
    groups.push_back({[i](const Row& row) { return static_cast<const Data::Extended&>(row).bristles[i]; }});
  fit.add_best(groups);
}

void add_drift(LeastSquares& fit, const Case& c) {
  Terms terms;
  for (int run = 1; run < c.runs; ++run)
    terms.push_back([run](const Row& row) {
      return static_cast<const Data::Extended&>(row).run == static_cast<std::size_t>(run) ? row.direction
                                                                                          : 0.0;
    });
  fit.add(terms);
  std::vector<Terms> groups;
  for (const double share : {0.1, 0.2, 0.4, 0.8, 2.0}) {
    const double time_s = share * c.motion.duration_s;
    groups.push_back({[=](const Row& row) { return row.direction * std::exp(-row.time_s / time_s); }});
  }
  fit.add_best(groups);
}

void add_effect(LeastSquares& fit, const Case& c, const std::string& name) {
  const double v0 = c.plant.speed;
  const auto one = [](const Row&) { return 1.0; };
  if (name == "torque-offset") fit.add({one});
  if (name == "friction-asymmetry")
    fit.add({[](const Row& row) { return std::abs(row.direction); },
             [](const Row& row) { return std::abs(row.velocity); }});
  if (name == "quadratic-drag")
    fit.add({[](const Row& row) { return row.velocity * std::abs(row.velocity); }});
  if (name == "friction-power") {
    std::vector<Terms> groups;
    for (double exponent = 0.1; exponent < 3.05; exponent += 0.1) groups.push_back({power(v0, exponent)});
    fit.add_best(groups);
  }
  if (name == "friction-shape") fit.add_best(friction_shapes(v0));
  if (name == "gravity" || name == "load-friction")
    fit.add({one, [](const Row& row) { return std::sin(row.position); },
             [](const Row& row) { return std::cos(row.position); }});
  if (name == "load-friction")
    fit.add({[&c](const Row& row) {
      return row.direction * std::abs(gravity_torque(c.plant, row.position) + row.load);
    }});
  if (name == "cogging") fit.add_best(ripples(c));
  if (name == "presliding") add_presliding(fit);
  if (name == "friction-drift") add_drift(fit, c);
  if (name == "load-position")
    fit.add({one, [](const Row& row) { return row.position; },
             [](const Row& row) { return row.position * row.position; },
             [](const Row& row) { return std::pow(row.position, 3); }});
  if (name == "friction-position") fit.add_best(over_position(c, friction_position));
  if (name == "inertia-position") fit.add_best(over_position(c, inertia_position));
  if (name == "torque-lag" || name == "channel-skew")
    fit.add({[](const Row& row) { return static_cast<const Data::Extended&>(row).torque_rate; }});
  if (name == "torque-saturation") fit.add({[](const Row& row) { return std::pow(row.torque, 3); }});
  if (name.rfind("column", 0) == 0) fit.add({[](const Row& row) { return row.load; }});
}

}  // namespace

Fit fit_base(const Case& c, const std::vector<Recording>& runs) {
  return fit_named(c, runs, {});
}

Fit fit_named(const Case& c, const std::vector<Recording>& runs, const std::vector<std::string>& names) {
  const Data data = gather(c, runs);
  LeastSquares fit(c, data);
  for (const std::string& name : names) add_effect(fit, c, name);
  return fit.fit();
}

double noise_share(const Case& c, const std::vector<Recording>& runs) {
  const Data data = gather(c, runs);
  return std::sqrt(noise_variance(c)) / std::max(LeastSquares(c, data).torque_rms(), 1e-300);
}

Case only(const Case& c, std::size_t effect) {
  Case alone = c;
  const auto keep = [&](std::string_view name) { return c.hidden[effect].name == name; };
  const bool gravity = keep("gravity") || keep("load-friction");  // what presses is needed
  Plant base;
  base.linear = c.plant.linear;
  base.inertia = c.plant.inertia;
  base.coulomb = c.plant.coulomb;
  base.viscous = c.plant.viscous;
  base.speed = c.plant.speed;
  if (gravity) base.gravity = c.plant.gravity, base.gravity_phase = c.plant.gravity_phase;
  if (keep("load-friction")) base.load_friction = c.plant.load_friction;
  if (keep("friction-asymmetry"))
    base.dry_asymmetry = c.plant.dry_asymmetry, base.viscous_asymmetry = c.plant.viscous_asymmetry;
  if (keep("quadratic-drag")) base.quadratic = c.plant.quadratic;
  if (keep("friction-power")) base.power = c.plant.power, base.power_exponent = c.plant.power_exponent;
  if (keep("friction-shape")) {
    base.stribeck_forward = c.plant.stribeck_forward, base.stribeck_backward = c.plant.stribeck_backward;
    base.stribeck_speed = c.plant.stribeck_speed, base.stribeck_exponent = c.plant.stribeck_exponent;
  }
  if (keep("cogging")) base.cogging = c.plant.cogging;
  if (keep("presliding")) base.bristle_length = c.plant.bristle_length;
  if (keep("friction-drift"))
    base.warm_up = c.plant.warm_up, base.warm_up_time_s = c.plant.warm_up_time_s,
    base.run_factor = c.plant.run_factor;
  if (keep("load-position"))
    base.spring = c.plant.spring, base.spring_cubic = c.plant.spring_cubic, base.centre = c.plant.centre;
  if (keep("friction-position")) base.friction_ripple = c.plant.friction_ripple;
  if (keep("inertia-position")) base.inertia_ripple = c.plant.inertia_ripple;
  if (keep("torque-saturation"))
    base.saturation = c.plant.saturation, base.torque_scale = c.plant.torque_scale;
  if (keep("torque-lag")) base.torque_lag_s = c.plant.torque_lag_s;
  if (keep("column:load")) base.measured_load = c.plant.measured_load;
  alone.plant = base;
  if (!keep("torque-offset")) alone.rig.torque_offset = 0.0;
  if (!keep("channel-skew")) alone.rig.torque_late_rows = 0;
  alone.hidden = {c.hidden[effect]};
  return alone;
}

bool is_detectable(const Case& c, const Fit& base) {
  const double good_enough = c.good_enough > 0.0 ? c.good_enough : 0.05;
  return base.share_left >= kDetectableShare * good_enough && base.nats >= kDetectable_nats;
}

}  // namespace clampd::drive_bench
