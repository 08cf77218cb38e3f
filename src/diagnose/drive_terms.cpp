#include "src/diagnose/drive_terms.hpp"

#include <algorithm>
#include <cmath>

namespace clampd::drive {
namespace {

/// A function of the samples, filtered like the torque.
DriveColumn filtered_column(std::function<double(const DriveMotion&, std::size_t)> value) {
  return [value = std::move(value)](const DriveRows& rows, int) {
    std::vector<double> samples(rows.motion.time_s.size());
    for (std::size_t i = 0; i < samples.size(); ++i) samples[i] = value(rows.motion, i);
    return rows.filtered(samples);
  };
}

std::vector<double> logarithmic_grid(double from, double to, int count) {
  std::vector<double> grid;
  for (int i = 0; i < count; ++i) grid.push_back(from * std::pow(to / from, i / (count - 1.0)));
  return grid;
}

}  // namespace

DriveRange range_of(const DriveData& data) {
  DriveRange range;
  std::vector<double> speeds;
  double least = std::numeric_limits<double>::infinity();
  double most = -least;
  for (const DriveRows& run : data.runs) {
    for (Eigen::Index i = 0; i < run.velocity.size(); ++i) speeds.push_back(std::abs(run.velocity[i]));
    least = std::min(least, run.position.minCoeff());
    most = std::max(most, run.position.maxCoeff());
    range.duration_s = std::max(range.duration_s, run.motion.time_s.back());
  }
  std::sort(speeds.begin(), speeds.end());
  const auto at = [&](double share) {
    return speeds[static_cast<std::size_t>(share * static_cast<double>(speeds.size() - 1))];
  };
  range.least_position = least;
  range.most_position = most;
  range.low_speed = at(0.05);
  range.slow_speed = at(0.25);
  range.high_speed = at(0.98);
  return range;
}

std::vector<DriveComponent> shapes_of(DriveTerm term, const DriveRange& range, bool constant_in_model) {
  const auto of = [&](std::vector<DriveColumn> columns, std::vector<double> shape = {}) {
    return DriveComponent{term, std::move(columns), std::move(shape)};
  };
  const auto one = filtered_column([](const DriveMotion&, std::size_t) { return 1.0; });
  const double centre = 0.5 * (range.least_position + range.most_position);
  const double half = std::max(0.5 * (range.most_position - range.least_position), 1e-12);
  const auto place = [=](const DriveMotion& m, std::size_t i) { return (m.position[i] - centre) / half; };
  std::vector<DriveComponent> shapes;
  switch (term) {
    case DriveTerm::Inertia:
      return {of({[](const DriveRows& rows, int) { return rows.acceleration; }})};
    case DriveTerm::Viscous:
      return {of({[](const DriveRows& rows, int) { return rows.velocity; }})};
    case DriveTerm::Coulomb:
      return {of({[](const DriveRows& rows, int) { return rows.sign; }})};
    case DriveTerm::TorqueOffset:
      return {of({one})};
    case DriveTerm::FrictionAsymmetry: {
      const auto speed =
          filtered_column([](const DriveMotion& m, std::size_t i) { return std::abs(m.velocity[i]); });
      if (constant_in_model) return {of({speed})};
      return {of({one, speed})};
    }
    case DriveTerm::QuadraticDrag:
      return {of({filtered_column(
          [](const DriveMotion& m, std::size_t i) { return m.velocity[i] * std::abs(m.velocity[i]); })})};
    case DriveTerm::FrictionShape:
      if (range.high_speed < 1.5 * range.low_speed) return {};
      for (const double speed :
           logarithmic_grid(std::max(range.low_speed, 0.01 * range.high_speed), 0.7 * range.high_speed, 8))
        shapes.push_back(of({filtered_column([speed](const DriveMotion& m, std::size_t i) {
                              const double u = m.velocity[i] / speed;
                              return m.sign[i] / (1.0 + u * u);
                            })},
                            {speed}));
      break;
    case DriveTerm::Presliding:
      for (const double length : logarithmic_grid(2e-4 * 2.0 * half, 0.05 * 2.0 * half, 7))
        shapes.push_back(of({filtered_column([length](const DriveMotion& m, std::size_t i) {
                              return -m.sign[i] * std::exp(-m.travel[i] / length);
                            })},
                            {length}));
      break;
    case DriveTerm::Cogging:
      break;
    case DriveTerm::FrictionPosition:
      return {of(
          {filtered_column([place](const DriveMotion& m, std::size_t i) { return m.sign[i] * place(m, i); }),
           filtered_column([place](const DriveMotion& m, std::size_t i) {
             return m.sign[i] * (1.5 * place(m, i) * place(m, i) - 0.5);
           })})};
    case DriveTerm::LoadPosition: {
      // Where a spring is slack is not known: a constant belongs to it.
      std::vector<DriveColumn> columns;
      if (!constant_in_model) columns.push_back(one);
      columns.push_back(filtered_column(place));
      columns.push_back(filtered_column(
          [place](const DriveMotion& m, std::size_t i) { return 1.5 * place(m, i) * place(m, i) - 0.5; }));
      return {of(std::move(columns))};
    }
    case DriveTerm::FrictionDrift: {
      const double duration_s = std::max(range.duration_s, 1e-12);
      return {of({[duration_s](const DriveRows& rows, int run) -> Eigen::VectorXd {
        // Runs are in chronological order; the pauses between them are not known.
        return rows.sign.array() * (run + rows.time_s.array() / duration_s);
      }})};
    }
  }
  return shapes;
}

std::vector<DriveColumn> periodic_columns(double order, bool linear, bool absolute, int runs) {
  const double factor = linear ? 2.0 * M_PI * order : order;
  std::vector<DriveColumn> columns;
  for (int owner = absolute ? -1 : 0; owner < (absolute ? 0 : runs); ++owner)
    for (const bool sine : {false, true})
      columns.push_back([=](const DriveRows& rows, int run) -> Eigen::VectorXd {
        if (owner >= 0 && owner != run) return Eigen::VectorXd::Zero(static_cast<Eigen::Index>(rows.size()));
        std::vector<double> samples(rows.motion.position.size());
        for (std::size_t i = 0; i < samples.size(); ++i) {
          const double angle = factor * rows.motion.position[i];
          samples[i] = sine ? std::sin(angle) : std::cos(angle);
        }
        return rows.filtered(samples);
      });
  return columns;
}

std::vector<double> orders_to_scan(const DriveData& data, const DriveRange& range, bool linear) {
  double longest = 0.0;
  for (const DriveRows& run : data.runs)
    longest = std::max(longest, run.position.maxCoeff() - run.position.minCoeff());
  if (!(longest > 0.0) || !(range.slow_speed > 0.0)) return {};
  const double turn = linear ? 1.0 : 2.0 * M_PI;
  const double highest = std::min(data.cut_off_Hz * turn / range.slow_speed, 400.0 * turn / longest);
  const double lowest = (linear ? 4.0 : 1.0) * turn / longest;
  std::vector<double> orders;
  // Whole orders where the position is the motor's own angle; anything where it is a length.
  const double step = linear ? 0.35 / longest : 1.0;
  for (double order = linear ? lowest : std::max(1.0, std::ceil(std::min(lowest, 1e6))); order <= highest;
       order += step)
    orders.push_back(order);
  return orders;
}

std::string_view words_of(DriveTerm term) {
  switch (term) {
    case DriveTerm::Inertia:
      return "the drive has inertia";
    case DriveTerm::Viscous:
      return "the drive has viscous friction";
    case DriveTerm::Coulomb:
      return "the drive has dry friction";
    case DriveTerm::TorqueOffset:
      return "a constant torque pulls on the drive, or its torque reading is biased";
    case DriveTerm::FrictionAsymmetry:
      return "the drive's friction differs by direction";
    case DriveTerm::QuadraticDrag:
      return "friction grows with the square of speed";
    case DriveTerm::FrictionShape:
      return "friction rises at low speed (Stribeck)";
    case DriveTerm::Presliding:
      return "friction builds up over a length after each reversal";
    case DriveTerm::Cogging:
      return "torque ripples periodically with position";
    case DriveTerm::FrictionPosition:
      return "friction depends on where the drive is";
    case DriveTerm::LoadPosition:
      return "a load depends on where the drive is, like a spring or a cable";
    case DriveTerm::FrictionDrift:
      return "friction changes as the drive goes on, as by warming up";
  }
  return "";
}

}  // namespace clampd::drive
