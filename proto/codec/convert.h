#pragma once

#include "mosaic/base/artefact_store.h"
#include "mosaic/base/status.h"
#include "mosaic/geometry/affine.h"
#include "mosaic/geometry/cell_grid.h"
#include "mosaic/geometry/homography.h"
#include "mosaic/geometry/mosaic_grid.h"
#include "mosaic/geometry/planar_map.h"
#include "mosaic/geometry/roi.h"
#include "proto/trem/v1/task.pb.h"

namespace trem {

// Between messages and domain types. Conversions from messages validate: they are fed from files and sockets. Every error is
// kCorrupt and names the field.

v1::RoiMessage ToProto(const Roi& roi);
Roi FromProto(const v1::RoiMessage& message);

// What a note says to people: its subject, when it has one, and its message.
std::string NoteText(const v1::Note& note);

v1::ArtefactRef ToProto(const ArtefactRef& ref);
ArtefactRef FromProto(const v1::ArtefactRef& message);

v1::MosaicGridMessage ToProto(const MosaicGrid& grid);
Result<MosaicGrid> FromProto(const v1::MosaicGridMessage& message);

// Row-major 2x3 and 3x3.
void ToProto(const Affine& affine, google::protobuf::RepeatedField<double>* numbers);
void ToProto(const Homography& homography, google::protobuf::RepeatedField<double>* numbers);
void ToProto(const PlanarMap& map, google::protobuf::RepeatedField<double>* numbers);
Result<Affine> AffineFromProto(const google::protobuf::RepeatedField<double>& numbers, const char* field);
// 6 numbers (2x3) or 9 (3x3, the last one 1), row-major.
Result<PlanarMap> PlanarMapFromProto(const google::protobuf::RepeatedField<double>& numbers, const char* field);
Result<Homography> HomographyFromProto(const google::protobuf::RepeatedField<double>& numbers, const char* field);

// Two values a node; a grid of one value a node. `field` names the message in errors; an absent message is an empty grid.
void ToProto(const CellShifts& shifts, v1::CellGrid* message);
void ToProto(const CellGrid<double>& grid, v1::CellGrid* message);
Result<CellShifts> CellShiftsFromProto(const v1::CellGrid& message, const char* field);
Result<CellGrid<double>> CellGridFromProto(const v1::CellGrid& message, const char* field);

// Deterministic bytes of a message (map-free schemas, fixed field order): what artefacts are made of.
std::string SerializeDeterministic(const google::protobuf::Message& message);

// Reads artefact `ref` of `store`, verifies its digest, parses it into `message` (at most 512 MiB).
Status ReadProtoArtefact(const ArtefactStore& store, const v1::ArtefactRef& ref, google::protobuf::Message* message);
Result<v1::ArtefactRef> PutProtoArtefact(const ArtefactStore& store, const std::string& name, const google::protobuf::Message& message);

}  // namespace trem
