#include "mosaic/publish/chain_csv.h"

#include <fmt/format.h>

#include <cerrno>

namespace trem {
namespace {

constexpr const char* kHeader =
    "frame_index,frame,time_s,window,segment,status,reason,"
    "scene_from_sensor_11,scene_from_sensor_12,scene_from_sensor_13,scene_from_sensor_21,scene_from_sensor_22,scene_from_sensor_23,"
    "scene_from_sensor_31,scene_from_sensor_32,"
    "gain,offset,residual_rms,correlation,overlap,"
    "world_from_sensor_11,world_from_sensor_12,world_from_sensor_13,world_from_sensor_21,world_from_sensor_22,world_from_sensor_23,"
    "world_from_sensor_31,world_from_sensor_32,world_from_sensor_33\n";

std::string FitColumns(const std::optional<ChainFit>& fit) {
  if (!fit) return std::string(13, ',');
  const Eigen::Matrix2d& a = fit->scene_from_sensor.linear;
  const Eigen::Vector2d& b = fit->scene_from_sensor.offset;
  const Eigen::Vector2d& p = fit->scene_from_sensor.perspective;
  return fmt::format(",{},{},{},{},{},{},{},{},{},{},{},{},{}", a(0, 0), a(0, 1), b(0), a(1, 0), a(1, 1), b(1), p(0), p(1), fit->gain, fit->offset,
                     fit->residual_rms, fit->correlation, fit->overlap);
}

std::string WorldColumns(const std::optional<Homography>& world_from_sensor) {
  std::string columns;
  for (int i = 0; i < 9; ++i) {
    columns += ',';
    if (world_from_sensor) columns += fmt::format("{}", world_from_sensor->matrix(i / 3, i % 3));
  }
  return columns;
}

}  // namespace

std::string CsvField(const std::string& text) {
  if (text.find_first_of(",\"\r\n") == std::string::npos) return text;
  std::string quoted = "\"";
  for (const char c : text) quoted += c == '"' ? std::string("\"\"") : std::string(1, c);
  return quoted + "\"";
}

Result<ChainCsvWriter> ChainCsvWriter::Create(const std::filesystem::path& path) {
  std::ofstream stream(path, std::ios::binary | std::ios::trunc);
  if (!stream) return FromErrno("cannot create " + path.string(), errno);
  stream << kHeader;
  return ChainCsvWriter(path, std::move(stream));
}

Status ChainCsvWriter::Write(const ChainRow& row) {
  stream_ << fmt::format("{},{},{},{},{},{},{}", row.frame_index, CsvField(row.frame_name), row.time_s,
                         row.window_id ? std::to_string(*row.window_id) : "", row.fit ? std::to_string(row.fit->segment_id) : "",
                         row.status, CsvField(row.reason))
          << FitColumns(row.fit) << WorldColumns(row.world_from_sensor) << '\n';
  if (!stream_) return FromErrno("cannot write " + path_.string(), errno);
  return {};
}

Status ChainCsvWriter::Close() {
  stream_.close();
  if (stream_.fail()) return FromErrno("cannot write " + path_.string(), errno);
  return {};
}

}  // namespace trem
