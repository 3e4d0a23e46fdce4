#include "proto/codec/convert.h"

#include <google/protobuf/io/coded_stream.h>
#include <google/protobuf/io/zero_copy_stream_impl_lite.h>

#include <algorithm>
#include <cmath>

namespace trem {
namespace {

constexpr std::uint64_t kProtoArtefactBytesMax = 512ULL << 20;
constexpr int kMosaicSideMax = 1 << 24;
constexpr std::uint32_t kCellGridSideMax = 4096;

Status CheckNumbers(const google::protobuf::RepeatedField<double>& numbers, int expected, const char* field) {
  if (numbers.size() != expected) {
    return Corrupt(std::string(field) + " has " + std::to_string(numbers.size()) + " numbers; expected " + std::to_string(expected));
  }
  for (const double number : numbers) {
    if (!std::isfinite(number)) return Corrupt(std::string(field) + " holds a number that is not finite");
  }
  return {};
}

template <typename Value>
void PlaceToProto(const CellGrid<Value>& grid, v1::CellGrid* message) {
  message->set_first_x(grid.first.x());
  message->set_first_y(grid.first.y());
  message->set_step(grid.step);
  message->set_columns(static_cast<std::uint32_t>(grid.columns));
  message->set_rows(static_cast<std::uint32_t>(grid.rows));
}

// The grid without its values, after all of the message has been checked.
template <typename Value>
Result<CellGrid<Value>> PlaceFromProto(const v1::CellGrid& message, int values_per_node, const char* field) {
  const bool sized = message.columns() >= 2 && message.rows() >= 2 && message.columns() <= kCellGridSideMax &&
                     message.rows() <= kCellGridSideMax &&
                     static_cast<std::uint64_t>(message.values_size()) ==
                         std::uint64_t{message.columns()} * message.rows() * static_cast<std::uint64_t>(values_per_node);
  const bool placed =
      std::isfinite(message.first_x()) && std::isfinite(message.first_y()) && std::isfinite(message.step()) && message.step() > 0.0;
  if (!sized || !placed || !std::all_of(message.values().begin(), message.values().end(), [](float v) { return std::isfinite(v); })) {
    return Corrupt(std::string(field) + " is no grid: " + std::to_string(message.values_size()) + " values for " +
                   std::to_string(message.columns()) + " x " + std::to_string(message.rows()) + " nodes " + std::to_string(message.step()) +
                   " apart; expected " + std::to_string(values_per_node) + " finite ones a node");
  }
  CellGrid<Value> grid;
  grid.first = {message.first_x(), message.first_y()};
  grid.step = message.step();
  grid.columns = static_cast<int>(message.columns());
  grid.rows = static_cast<int>(message.rows());
  return grid;
}

}  // namespace

v1::RoiMessage ToProto(const Roi& roi) {
  v1::RoiMessage message;
  message.set_x0(roi.x0);
  message.set_y0(roi.y0);
  message.set_x1(roi.x1);
  message.set_y1(roi.y1);
  return message;
}

Roi FromProto(const v1::RoiMessage& message) { return {message.x0(), message.y0(), message.x1(), message.y1()}; }

std::string NoteText(const v1::Note& note) { return note.subject().empty() ? note.message() : note.subject() + ": " + note.message(); }

v1::ArtefactRef ToProto(const ArtefactRef& ref) {
  v1::ArtefactRef message;
  message.set_name(ref.name);
  message.set_sha256(ref.sha256);
  message.set_bytes(ref.bytes);
  return message;
}

ArtefactRef FromProto(const v1::ArtefactRef& message) { return {message.name(), message.sha256(), message.bytes()}; }

v1::MosaicGridMessage ToProto(const MosaicGrid& grid) {
  v1::MosaicGridMessage message;
  message.set_crs_wkt(grid.crs_wkt);
  message.set_origin_x(grid.origin_x);
  message.set_origin_y(grid.origin_y);
  message.set_gsd(grid.gsd);
  message.set_width(static_cast<std::uint32_t>(grid.width));
  message.set_height(static_cast<std::uint32_t>(grid.height));
  message.set_tile_size(static_cast<std::uint32_t>(grid.tile_size));
  return message;
}

Result<MosaicGrid> FromProto(const v1::MosaicGridMessage& message) {
  if (!std::isfinite(message.origin_x()) || !std::isfinite(message.origin_y())) return Corrupt("grid.origin is not finite");
  if (!(message.gsd() > 0.0) || !std::isfinite(message.gsd())) {
    return Corrupt("grid.gsd is " + std::to_string(message.gsd()) + "; expected > 0");
  }
  if (message.width() < 1 || message.height() < 1 || message.width() > kMosaicSideMax || message.height() > kMosaicSideMax) {
    return Corrupt("grid is " + std::to_string(message.width()) + " x " + std::to_string(message.height()) + " pixels; expected 1.." +
                   std::to_string(kMosaicSideMax) + " a side");
  }
  if (message.tile_size() < 16 || message.tile_size() > 8192) {
    return Corrupt("grid.tile_size is " + std::to_string(message.tile_size()) + "; expected 16..8192");
  }
  MosaicGrid grid;
  grid.crs_wkt = message.crs_wkt();
  grid.origin_x = message.origin_x();
  grid.origin_y = message.origin_y();
  grid.gsd = message.gsd();
  grid.width = static_cast<int>(message.width());
  grid.height = static_cast<int>(message.height());
  grid.tile_size = static_cast<int>(message.tile_size());
  return grid;
}

void ToProto(const Affine& affine, google::protobuf::RepeatedField<double>* numbers) {
  numbers->Clear();
  for (int row = 0; row < 2; ++row) {
    numbers->Add(affine.linear(row, 0));
    numbers->Add(affine.linear(row, 1));
    numbers->Add(affine.offset(row));
  }
}

void ToProto(const Homography& homography, google::protobuf::RepeatedField<double>* numbers) {
  numbers->Clear();
  for (int row = 0; row < 3; ++row) {
    for (int column = 0; column < 3; ++column) numbers->Add(homography.matrix(row, column));
  }
}

Result<Affine> AffineFromProto(const google::protobuf::RepeatedField<double>& numbers, const char* field) {
  TREM_RETURN_IF_ERROR(CheckNumbers(numbers, 6, field));
  Affine affine;
  affine.linear << numbers[0], numbers[1], numbers[3], numbers[4];
  affine.offset << numbers[2], numbers[5];
  if (std::abs(affine.linear.determinant()) < 1e-12) return Corrupt(std::string(field) + " is singular");
  return affine;
}

void ToProto(const PlanarMap& map, google::protobuf::RepeatedField<double>* numbers) {
  if (map.IsAffine()) return ToProto(Affine{map.linear, map.offset}, numbers);
  ToProto(map.ToHomography(), numbers);
}

Result<PlanarMap> PlanarMapFromProto(const google::protobuf::RepeatedField<double>& numbers, const char* field) {
  if (numbers.size() != 9) {
    TREM_ASSIGN_OR_RETURN(const Affine affine, AffineFromProto(numbers, field));
    return PlanarMap(affine);
  }
  TREM_ASSIGN_OR_RETURN(const Homography h, HomographyFromProto(numbers, field));
  if (h.matrix(2, 2) != 1.0) return Corrupt(std::string(field) + " has 9 numbers and the last one is not 1");
  if (std::abs(h.matrix.determinant()) < 1e-12) return Corrupt(std::string(field) + " is singular");
  return PlanarMap::FromHomography(h);
}

Result<Homography> HomographyFromProto(const google::protobuf::RepeatedField<double>& numbers, const char* field) {
  TREM_RETURN_IF_ERROR(CheckNumbers(numbers, 9, field));
  Homography homography;
  for (int i = 0; i < 9; ++i) homography.matrix(i / 3, i % 3) = numbers[i];
  return homography;
}

void ToProto(const CellShifts& shifts, v1::CellGrid* message) {
  PlaceToProto(shifts, message);
  for (const Eigen::Vector2d& shift : shifts.values) {
    message->add_values(static_cast<float>(shift.x()));
    message->add_values(static_cast<float>(shift.y()));
  }
}

void ToProto(const CellGrid<double>& grid, v1::CellGrid* message) {
  PlaceToProto(grid, message);
  for (const double value : grid.values) message->add_values(static_cast<float>(value));
}

Result<CellShifts> CellShiftsFromProto(const v1::CellGrid& message, const char* field) {
  if (message.values().empty() && message.columns() == 0) return CellShifts();
  TREM_ASSIGN_OR_RETURN(CellShifts shifts, PlaceFromProto<Eigen::Vector2d>(message, 2, field));
  for (int i = 0; i + 1 < message.values_size(); i += 2) shifts.values.emplace_back(message.values(i), message.values(i + 1));
  return shifts;
}

Result<CellGrid<double>> CellGridFromProto(const v1::CellGrid& message, const char* field) {
  if (message.values().empty() && message.columns() == 0) return CellGrid<double>();
  TREM_ASSIGN_OR_RETURN(CellGrid<double> grid, PlaceFromProto<double>(message, 1, field));
  grid.values.assign(message.values().begin(), message.values().end());
  return grid;
}

std::string SerializeDeterministic(const google::protobuf::Message& message) {
  std::string bytes;
  google::protobuf::io::StringOutputStream stream(&bytes);
  google::protobuf::io::CodedOutputStream coded(&stream);
  coded.SetSerializationDeterministic(true);
  TREM_CHECK(message.SerializeToCodedStream(&coded));
  coded.Trim();
  return bytes;
}

Status ReadProtoArtefact(const ArtefactStore& store, const v1::ArtefactRef& ref, google::protobuf::Message* message) {
  TREM_ASSIGN_OR_RETURN(const std::string bytes, store.ReadVerified(FromProto(ref), kProtoArtefactBytesMax));
  if (!message->ParseFromString(bytes)) {
    return Corrupt("artefact " + ref.name() + " (" + ref.sha256() + ") is not a " + message->GetDescriptor()->full_name());
  }
  return {};
}

Result<v1::ArtefactRef> PutProtoArtefact(const ArtefactStore& store, const std::string& name, const google::protobuf::Message& message) {
  TREM_ASSIGN_OR_RETURN(const ArtefactRef ref, store.PutBytes(name, SerializeDeterministic(message)));
  return ToProto(ref);
}

}  // namespace trem
