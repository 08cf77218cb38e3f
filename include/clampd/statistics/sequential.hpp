#pragma once

#include <span>

namespace clampd::statistics {

/// The factor c of a mean that is looked at again and again while it gathers information: with no more than
/// `probability` it ever lies more than c of its standard deviations above its expectation, at any of the
/// looks (Pocock 1977: one factor for all looks). `information`: at each look, in any unit, growing. The
/// correlation of two looks is the root of the ratio of theirs, of a sum of independent shares; where they
/// correlate more, or some of them are left out, the probability is smaller (Slepian 1962). 0 < probability
/// < 1. One look: the normal quantile. To 1e-3, by numerical integration over the sum (Armitage, McPherson
/// and Rowe 1969).
double repeated_look_factor(double probability, std::span<const double> information);

/// The same of looks after `first`, first + 1, ..., `most` equal shares of information; 1 <= first <= most.
double repeated_look_factor(double probability, int first, int most);

/// What that factor becomes where a standard deviation is estimated with these degrees of freedom: Student's
/// quantile at the normal factor's level (Jennison and Turnbull 2000, section 3.8). Infinite degrees: the
/// factor itself.
double with_estimated_deviation(double factor, double degrees);

}  // namespace clampd::statistics
