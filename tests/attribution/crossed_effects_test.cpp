#include "clampd/attribution/crossed_effects.hpp"

#include <gtest/gtest.h>

#include <Eigen/LU>

#include "support/factory.hpp"

namespace clampd::attribution {
namespace {

using support::Factory;
using support::make_line;

Factory small_factory() {
  Factory factory;
  factory.stations = 3;
  factory.batches = 5;
  factory.brakes = 50;
  factory.checked_twice = 0.3;
  factory.deviations.wander = 0.3;
  return factory;
}

/// Minus twice the restricted log likelihood from the covariance of all readings, written out.
double dense_deviance(const LineTable& table, const Deviations& d) {
  const Layout& layout = table.layout;
  const auto n = static_cast<Eigen::Index>(table.checks());
  Eigen::MatrixXd covariance = Eigen::MatrixXd::Zero(n, n);
  Eigen::VectorXd readings(n);
  for (Eigen::Index i = 0; i < n; ++i) {
    const auto a = static_cast<std::size_t>(i);
    readings[i] = table.parameters[0].values[a];
    const double sd = table.parameters[0].deviations[a];
    covariance(i, i) = d.repeat * d.repeat + sd * sd;
    for (Eigen::Index j = 0; j < n; ++j) {
      const auto b = static_cast<std::size_t>(j);
      const bool station = layout.station[a] == layout.station[b],
                 period = layout.period[a] == layout.period[b];
      if (layout.brake[a] == layout.brake[b]) covariance(i, j) += d.brake * d.brake;
      if (layout.batch[a] == layout.batch[b]) covariance(i, j) += d.batch * d.batch;
      if (station) covariance(i, j) += d.station * d.station;
      if (period) covariance(i, j) += d.period * d.period;
      if (station && period) covariance(i, j) += d.wander * d.wander;
    }
  }
  const Eigen::MatrixXd inverse = covariance.inverse();
  const Eigen::VectorXd ones = Eigen::VectorXd::Ones(n);
  const double information = ones.dot(inverse * ones);
  const double mean = ones.dot(inverse * readings) / information;
  const Eigen::VectorXd left = readings.array() - mean;
  return std::log(covariance.determinant()) + std::log(information) + left.dot(inverse * left);
}

CrossedEffects model_of(const LineTable& table) {
  return {table.layout, table.parameters[0].values, table.parameters[0].deviations};
}

TEST(CrossedEffects, TheDevianceIsThatOfTheWholeCovariance) {
  const LineTable table = make_line(small_factory(), 1);
  ASSERT_GE(table.layout.periods, 3);
  const CrossedEffects model = model_of(table);
  const Deviations one{0.2, 1.0, 0.5, 0.4, 0.0, 0.1, 0.3}, other{0.5, 0.6, 0.9, 0.2, 0.0, 0.4, 0.1};
  EXPECT_NEAR(model.deviance(one) - model.deviance(other),
              dense_deviance(table, one) - dense_deviance(table, other), 1e-8);
}

TEST(CrossedEffects, SlopesAreThoseOfTheDeviance) {
  const LineTable table = make_line(small_factory(), 2);
  const CrossedEffects model = model_of(table);
  const Deviations at{0.3, 0.9, 0.6, 0.3, 0.0, 0.2, 0.25};
  std::vector<double> slopes;
  model.deviance(at, slopes);
  std::size_t i = 0;
  for (double Deviations::*const member :
       {&Deviations::repeat, &Deviations::brake, &Deviations::batch, &Deviations::station,
        &Deviations::fixture, &Deviations::period, &Deviations::wander}) {
    Deviations up = at, down = at;
    up.*member *= std::exp(1e-4);
    down.*member *= std::exp(-1e-4);
    EXPECT_NEAR(slopes[i], (model.deviance(up) - model.deviance(down)) / 2e-4,
                1e-4 * (1.0 + std::abs(slopes[i])))
        << i;
    ++i;
  }
}

TEST(CrossedEffects, TheFitIsAMinimum) {
  const LineTable table = make_line(small_factory(), 3);
  CrossedEffects model = model_of(table);
  ASSERT_TRUE(model.fit());
  const double least = model.deviance(model.deviations());
  for (double Deviations::*const member : {&Deviations::repeat, &Deviations::brake, &Deviations::batch,
                                           &Deviations::station, &Deviations::wander})
    for (const double factor : {0.9, 1.1}) {
      Deviations beside = model.deviations();
      beside.*member *= factor;
      EXPECT_GE(model.deviance(beside), least - 1e-2);
    }
}

/// Means of the estimated variances of many lines. A variance that is estimated from n effects scatters by
/// √(2/n); so does a line's own draw of effects from the truth.
TEST(CrossedEffects, VariancesAreThoseThatTheLineWasMadeWith) {
  Factory factory;
  factory.stations = 10;
  factory.brakes = 4000;
  factory.deviations.wander = 0.15;
  constexpr int kLines = 8;
  Deviations squares{};
  for (int line = 0; line < kLines; ++line) {
    const LineTable table = make_line(factory, 100 + static_cast<std::uint64_t>(line));
    CrossedEffects model = model_of(table);
    ASSERT_TRUE(model.fit());
    for (double Deviations::*const member : {&Deviations::repeat, &Deviations::brake, &Deviations::batch,
                                             &Deviations::station, &Deviations::period, &Deviations::wander})
      squares.*member += model.deviations().*member * (model.deviations().*member) / kLines;
  }
  const auto expect_near = [&](double Deviations::*member, double effects, const char* name) {
    const double truth = factory.deviations.*member * (factory.deviations.*member);
    EXPECT_NEAR(squares.*member / truth, 1.0, 3.0 * std::sqrt(2.0 / (effects * kLines))) << name;
  };
  expect_near(&Deviations::brake, factory.brakes, "brake");
  expect_near(&Deviations::batch, factory.batches, "batch");
  expect_near(&Deviations::station, factory.stations, "station");
  expect_near(&Deviations::wander, factory.stations * 24 / 3.0,
              "wander");  // two thirds of what a period shows are the brakes that came by
  EXPECT_NEAR(squares.repeat / 0.04, 1.0, 0.3);
}

TEST(CrossedEffects, TheUnitDoesNotMatter) {
  LineTable table = make_line(small_factory(), 5);
  CrossedEffects model = model_of(table);
  ASSERT_TRUE(model.fit());
  for (double& value : table.parameters[0].values) value = 1e6 + 1e-4 * value;
  for (double& deviation : table.parameters[0].deviations) deviation *= 1e-4;
  CrossedEffects other = model_of(table);
  ASSERT_TRUE(other.fit());
  EXPECT_NEAR(other.deviations().brake / (1e-4 * model.deviations().brake), 1.0, 1e-3);
  EXPECT_NEAR(other.deviations().station / (1e-4 * model.deviations().station), 1.0, 1e-2);
}

TEST(CrossedEffects, LevelsAreKnownAsWellAsTheySay) {
  // Of many lines, the levels' errors divided by their standard deviations are of unit variance.
  double squares = 0.0;
  int count = 0;
  for (std::uint64_t line = 0; line < 20; ++line) {
    Factory factory = small_factory();
    factory.stations = 8;
    factory.brakes = 800;
    factory.deviations.wander = 0.0;
    const LineTable table = make_line(factory, 200 + line);
    CrossedEffects model = model_of(table);
    model.set_deviations(factory.deviations);
    const Levels levels = model.levels();
    // The factory draws the batches first, then the stations.
    std::mt19937_64 random(200 + line);
    std::normal_distribution<double> normal;
    Eigen::VectorXd truth(factory.stations);
    for (int b = 0; b < factory.batches; ++b) normal(random);
    for (int s = 0; s < factory.stations; ++s) truth[s] = factory.deviations.station * normal(random);
    truth.array() -= truth.mean();
    for (int s = 0; s < factory.stations; ++s) {
      squares += (levels.station[s] - truth[s]) * (levels.station[s] - truth[s]) / levels.station_variance[s];
      ++count;
    }
  }
  EXPECT_NEAR(squares / count, 1.0, 4.0 * std::sqrt(2.0 / count));
}

}  // namespace
}  // namespace clampd::attribution
