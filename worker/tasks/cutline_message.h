#pragma once

#include "mosaic/raster/polygons.h"
#include "proto/trem/v1/task.pb.h"

namespace trem {

// Between PolygonRings and its message. A pair without its second number is dropped.
inline void ToProto(const PolygonRings& polygons, v1::Cutline* message) {
  message->set_crs_wkt(polygons.crs_wkt);
  for (const std::vector<Eigen::Vector2d>& ring : polygons.rings) {
    v1::CutlineRing* out = message->add_rings();
    for (const Eigen::Vector2d& point : ring) {
      out->add_x_y(point.x());
      out->add_x_y(point.y());
    }
  }
}

inline PolygonRings PolygonsFromProto(const v1::Cutline& message) {
  PolygonRings polygons;
  polygons.crs_wkt = message.crs_wkt();
  for (const v1::CutlineRing& ring : message.rings()) {
    std::vector<Eigen::Vector2d>& points = polygons.rings.emplace_back();
    for (int i = 0; i + 1 < ring.x_y_size(); i += 2) points.push_back({ring.x_y(i), ring.x_y(i + 1)});
  }
  return polygons;
}

}  // namespace trem
