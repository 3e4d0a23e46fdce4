#pragma once

#include <filesystem>
#include <functional>
#include <map>
#include <string>
#include <vector>

#include "mosaic/base/artefact_store.h"
#include "mosaic/base/status.h"
#include "mosaic/geometry/homography.h"
#include "mosaic/publish/chain_csv.h"
#include "mosaic/publish/report.h"
#include "mosaic/publish/windows_geojson.h"
#include "proto/trem/v1/task.pb.h"
#include "worker/tasks/aligned_scenes.h"

namespace trem {

// What became of the sortie's frames and scenes, gathered from the windows one by one (a window is dropped before the next is read), while
// mosaic_chain.csv is written. Rows: windows in the order they come, frames in order within a window; at the end the frames that no
// window took.
class FrameLedger {
 public:
  // Both must outlive the ledger.
  FrameLedger(const v1::SortieManifest& manifest, const v1::Alignment& alignment) : manifest_(manifest), alignment_(alignment) {}

  // Writes the CSV to `path`. `progress` gets the fraction of windows done.
  Status Gather(const ArtefactStore& store, const std::vector<v1::ArtefactRef>& windows, const std::filesystem::path& path,
                const std::function<bool(double)>& progress);

  // Fills the report's counts and its list of missing frames.
  void Summarise(ReportData* report) const;
  // Footprints of the aligned scenes, in the alignment's order.
  Result<std::vector<SceneFootprint>> Footprints() const;

 private:
  // Best fate of a frame over its windows, from worst to best.
  enum class Fate { kNotUsed = 0, kSkipped, kLost, kRegistered };
  struct FrameRecord {
    Fate fate = Fate::kNotUsed;
    std::string reason;  // Of the first window that gave this fate.
  };
  struct SceneRecord {
    Roi roi_in_sensor;
    std::uint32_t frame_begin = 0;
    std::uint32_t frame_end = 0;
  };

  Status AddWindow(const v1::WindowResult& window, ChainCsvWriter* csv);
  Status WriteUnusedFrames(ChainCsvWriter* csv);
  Result<ChainRow> StartRow(std::uint32_t frame_index) const;
  Status IndexAlignedFrames();

  const v1::SortieManifest& manifest_;
  const v1::Alignment& alignment_;
  std::map<std::uint32_t, Homography> world_from_sensor_;
  std::vector<FrameRecord> frames_;
  EmittedScenes emitted_;
  std::map<SceneKey, SceneRecord> scenes_;
  std::uint32_t window_count_ = 0;
};

}  // namespace trem
