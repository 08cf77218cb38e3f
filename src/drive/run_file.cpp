#include <iterator>

#include <fmt/format.h>

#include "clampd/drive/model.hpp"

namespace clampd {
namespace {

/// "runs/a.csv" is called that, and "a.csv".
bool is_called(const std::string& path, const std::string& name) {
  return path == name || path.ends_with("/" + name);
}

const DriveFile* file_called(const std::string& path, const DriveModel& model) {
  const DriveFile* found = nullptr;  // with the most of its folders
  for (const DriveFile& file : model.files)
    if (is_called(path, file.name) && (found == nullptr || file.name.size() > found->name.size()))
      found = &file;
  return found;
}

}  // namespace

Result<LoadedRun> read_drive_run(const std::string& path, const DriveModel& model) {
  Result<LoadedRun> loaded = read_run(path, model.columns);
  std::vector<std::string> names;
  for (const DriveRegressor& regressor : model.regressors)
    if (regressor.per_file) names.push_back(regressor.name);
  if (!loaded || names.empty()) return loaded;
  const DriveFile* file = file_called(path, model);
  if (file == nullptr)
    return failure(fmt::format("{}: no values for {}: write a section [files.\"{}\"] with {} = NUMBER",
                               model.file, path, path.substr(path.rfind('/') + 1),
                               fmt::join(names, " = NUMBER and ")));
  auto value = file->values.begin();
  std::vector<RunColumn>& others = loaded->run.others;
  for (std::size_t i = 0; i < model.regressors.size(); ++i)
    if (model.regressors[i].per_file)
      others.insert(others.begin() + static_cast<std::ptrdiff_t>(i),
                    {model.regressors[i].name, std::vector<double>(loaded->run.size(), *value++)});
  return loaded;
}

}  // namespace clampd
