#include <algorithm>
#include <iterator>

#include <fmt/format.h>

#include "clampd/drive/model.hpp"
#include "clampd/drive/simulation.hpp"
#include "clampd/record/file.hpp"

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

/// What is asked of a drive, not what it did: its load's place, and whether it was on.
ColumnMap asked_columns(const DriveModel& model) {
  ColumnMap columns = model.columns;
  columns.drive_enabled.reset();
  if (model.load_position) columns.others.pop_back();
  return columns;
}

/// The regressors that are one number a file, beside those that are columns.
Result<LoadedRun> with_values_of_file(Result<LoadedRun> loaded, const std::string& path,
                                      const DriveModel& model) {
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

}  // namespace

Result<LoadedRun> read_drive_run(const std::string& path, const DriveModel& model) {
  return with_values_of_file(read_run(path, model.columns), path, model);
}

Result<LoadedRun> read_drive_torque(const std::string& path, const DriveModel& model) {
  ColumnMap columns = asked_columns(model);
  columns.position.reset();
  columns.velocity.reset();
  return with_values_of_file(read_run(path, columns), path, model);
}

Result<LoadedRun> read_drive_motion(const std::string& path, const DriveModel& model) {
  const Result<std::string> text = read_file(path);
  if (!text) return tl::unexpected(text.error());
  ColumnMap columns = asked_columns(model);
  columns.torque.reset();
  if (columns.position && columns.velocity)
    if (const Result<TableHeader> header = find_header(*text, path); header) {
      const auto lacks = [&](const ColumnSource& source) {
        return std::ranges::find(header->names, source.column) == header->names.end();
      };
      if (lacks(*columns.velocity))
        columns.velocity.reset();
      else if (lacks(*columns.position))
        columns.position.reset();
    }
  return with_values_of_file(parse_run(*text, path, columns), path, model);
}

}  // namespace clampd
