#include "mosaic/raster/vsi_sweep.h"

#include <cpl_string.h>
#include <cpl_vsi.h>

#include <ctime>
#include <memory>
#include <vector>

#include "mosaic/base/digest.h"
#include "mosaic/raster/gdal_env.h"
#include "mosaic/raster/vsi_backing.h"

namespace trem {
namespace {

// What one request of S3 may name.
constexpr std::size_t kBatchMax = 1000;

struct Doomed {
  std::string path;
  std::uint64_t bytes = 0;
};

struct DirCloser {
  void operator()(VSIDIR* dir) const { VSICloseDir(dir); }
};

// Removes them all at once; those that are still there afterwards count as left.
void RemoveBatch(const std::vector<Doomed>& batch, SweepReport* report) {
  if (batch.empty()) return;
  CPLStringList paths;
  for (const Doomed& object : batch) paths.AddString(object.path.c_str());
  const GdalErrors errors;
  const std::unique_ptr<int, void (*)(void*)> gone(VSIUnlinkBatch(paths.List()), &VSIFree);
  for (std::size_t i = 0; i < batch.size(); ++i) {
    if (gone == nullptr || gone.get()[i] == 0) {
      report->bytes += batch[i].bytes;
      continue;
    }
    ++report->removed_objects;
    report->removed_bytes += batch[i].bytes;
  }
}

}  // namespace

Status ClaimVsiStore(const std::string& root, const std::string& owner) {
  constexpr vsi_l_offset kOwnerBytesMax = 256;
  TREM_RETURN_IF_ERROR(VsiBacking(root).Check());
  const std::string path = root + "/owner";
  const GdalErrors errors;
  GByte* bytes = nullptr;
  vsi_l_offset size = 0;
  if (VSIIngestFile(nullptr, path.c_str(), &bytes, &size, kOwnerBytesMax) != 0) {
    const std::unique_ptr<GByte, void (*)(void*)> held(bytes, &VSIFree);
    const std::string found(reinterpret_cast<const char*>(bytes), size);
    if (found == owner) return {};
    return InvalidInput("the artefact store " + root + " belongs to the coordinator '" + found + "', not to '" + owner + "', says " + path +
                        "; give every coordinator a prefix of its own, or remove that object if its coordinator is no more");
  }
  VSILFILE* file = VSIFOpenL(path.c_str(), "wb");
  const bool is_written = file != nullptr && VSIFWriteL(owner.data(), 1, owner.size(), file) == owner.size();
  const bool is_closed = file != nullptr && VSIFCloseL(file) == 0;
  return is_written && is_closed ? Status() : Unavailable("cannot write " + path + ": " + errors.Text());
}

Result<SweepReport> SweepVsiStore(const std::string& root, const SweepRule& rule) {
  TREM_RETURN_IF_ERROR(VsiBacking(root).Check());
  const std::string objects = root + "/objects";
  const std::time_t now = std::time(nullptr);
  SweepReport report;
  std::vector<Doomed> batch;
  const GdalErrors errors;
  const std::unique_ptr<VSIDIR, DirCloser> dir(VSIOpenDir(objects.c_str(), -1, nullptr));
  if (!dir) return report;  // Check has seen that the store answers: nothing was ever put.
  while (const VSIDIREntry* entry = VSIGetNextDirEntry(dir.get())) {
    const std::string name = entry->pszName;
    const std::string digest = name.substr(name.rfind('/') + 1);
    if (VSI_ISDIR(entry->nMode) || !IsSha256Hex(digest)) continue;  // None of ours.
    const std::uint64_t bytes = entry->bSizeKnown ? entry->nSize : 0;
    // One whose age is not known may be young.
    if (!entry->bMTimeKnown || !rule.MayGo(digest, std::chrono::seconds(now - static_cast<std::time_t>(entry->nMTime)))) {
      report.bytes += bytes;
      continue;
    }
    batch.push_back({objects + "/" + name, bytes});
    if (batch.size() < kBatchMax) continue;
    RemoveBatch(batch, &report);
    batch.clear();
  }
  if (errors.failed()) return Unavailable("listing " + objects + " broke off: " + errors.Text());
  RemoveBatch(batch, &report);
  return report;
}

}  // namespace trem
