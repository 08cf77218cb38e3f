#pragma once

#include <span>
#include <string>

#include <nlohmann/json_fwd.hpp>

#include "clampd/base/result.hpp"
#include "clampd/record/prediction.hpp"

namespace clampd {

/// `model` is the name of the model's file.
nlohmann::ordered_json prediction_json(std::span<const PredictedRun> runs,
                                       const std::string& model);  ///< clampd.prediction/1
std::string prediction_text(std::span<const PredictedRun> runs);
/// Errors are those of drawing.
Result<std::string> prediction_html(std::span<const PredictedRun> runs, const std::string& model);

}  // namespace clampd
