#include "worker/app/input_files.h"

#include <unistd.h>

#include <cerrno>
#include <system_error>
#include <vector>

#include "mosaic/base/file.h"
#include "mosaic/raster/vsi_backing.h"
#include "proto/codec/sortie_paths.h"
#include "proto/codec/upload.h"

namespace trem {
namespace fs = std::filesystem;
namespace {

constexpr std::uint64_t kListBytesMax = std::uint64_t{256} << 20;

}  // namespace

Result<InputFiles> InputFiles::Open(const fs::path& folder) {
  TREM_RETURN_IF_ERROR(MakeDirectories(folder));
  if (::chdir(folder.c_str()) != 0) return FromErrno("cannot enter " + folder.string(), errno);
  return InputFiles(folder);
}

Result<v1::Sortie> InputFiles::Bring(const v1::Sortie& sortie, const ArtefactStore& store) {
  if (source_ != sortie.source().path()) {
    std::error_code error;
    for (const auto& entry : fs::directory_iterator(folder_, error)) fs::remove_all(entry.path(), error);
    source_ = sortie.source().path();
  }
  v1::Sortie here = sortie;
  TREM_RETURN_IF_ERROR(BringBeside(sortie.source(), sortie.telemetry()));
  for (const v1::Recording& recording : sortie.more()) TREM_RETURN_IF_ERROR(BringBeside(recording.source(), recording.telemetry()));
  for (const SortiePath& named : PathsOf(&here)) TREM_RETURN_IF_ERROR(BringPath(store, named.path).WithPrefix(named.field));
  return here;
}

// What the search for telemetry would look at beside a source that lies elsewhere, at the same place relative to it. (A folder's own
// telemetry.csv comes with the folder.)
Status InputFiles::BringBeside(const v1::Source& recording, const v1::Telemetry& telemetry) const {
  const fs::path source = recording.path();
  if (!IsVsiPath(source.string()) || telemetry.ignore() || !telemetry.path().empty()) return {};
  std::vector<fs::path> candidates = {source.parent_path() / "telemetry.csv"};
  for (const char* extension : {".srt", ".SRT", ".gpx", ".GPX"}) candidates.push_back(fs::path(source).replace_extension(extension));
  for (const fs::path& candidate : candidates) {
    const Status copied = CopyVsiTree(candidate.string(), folder_ / candidate.string().substr(1));
    if (!copied.ok() && copied.code() != StatusCode::kNotFound) return copied.WithPrefix("telemetry");
  }
  return {};
}

Status InputFiles::BringPath(const ArtefactStore& store, std::string* path) {
  if (const auto list = UploadOfPath(*path)) return BringUpload(store, UploadName(*list));
  if (!IsVsiPath(*path)) return {};
  const std::string relative = path->substr(1);
  TREM_RETURN_IF_ERROR(CopyVsiTree(*path, folder_ / relative));
  *path = relative;
  return {};
}

Status InputFiles::BringUpload(const ArtefactStore& store, const std::string& upload) {
  std::error_code error;
  if (fs::exists(folder_ / upload, error)) return {};
  const ArtefactRef ref = *UploadOfPath(upload);
  TREM_ASSIGN_OR_RETURN(const std::string bytes, store.ReadVerified(ref, kListBytesMax));
  v1::UploadList list;
  if (!list.ParseFromString(bytes)) return Corrupt(upload + " is not a list of files");
  TREM_RETURN_IF_ERROR(CheckUploadList(list));
  // Under its name only when it is complete.
  const fs::path partial = folder_ / (upload + ".part");
  fs::remove_all(partial, error);
  TREM_RETURN_IF_ERROR(MakeDirectories(partial));
  for (const v1::UploadedFile& file : list.files()) {
    const ArtefactRef content{file.name(), file.sha256(), file.bytes()};
    TREM_RETURN_IF_ERROR(store.Verify(content));
    TREM_ASSIGN_OR_RETURN(const fs::path object, store.Locate(content));
    const fs::path target = partial / file.name();
    TREM_RETURN_IF_ERROR(MakeDirectories(target.parent_path()));
    fs::create_hard_link(object, target, error);
    if (error) TREM_RETURN_IF_ERROR(CopyFileAtomically(object, target));
  }
  fs::rename(partial, folder_ / upload, error);
  return error ? FromErrno("cannot rename " + partial.string(), error.value()) : Status();
}

}  // namespace trem
