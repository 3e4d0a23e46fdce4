#include "coordinator/cli/upload.h"

#include <glob.h>
#include <stdlib.h>

#include <algorithm>
#include <cerrno>
#include <filesystem>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <system_error>
#include <utility>
#include <vector>

#include "mosaic/base/digest.h"
#include "proto/codec/convert.h"
#include "proto/codec/sortie_paths.h"
#include "proto/codec/upload.h"

namespace trem {
namespace fs = std::filesystem;
namespace {

using FileMap = std::map<std::string, fs::path>;  // Name in the upload -> here. Sorted, so that the same files make the same list.

bool IsElsewhere(const std::string& path) { return path.starts_with("/vsi"); }

// The files of one recording, all below `folder` (empty, or ending in a slash), so that those of several do not get in each other's way.
class RecordingFiles {
 public:
  RecordingFiles(std::string folder, FileMap* files) : folder_(std::move(folder)), files_(files) {}

  // A video under its name, frames below "frames/"; returns what the source is called in the upload.
  Result<std::string> Add(const fs::path& source) {
    std::error_code error;
    if (fs::is_regular_file(source, error)) {
      files_->emplace(folder_ + source.filename().string(), source);
      AddBeside(source);
      return folder_ + source.filename().string();
    }
    if (fs::is_directory(source, error)) {
      for (fs::directory_iterator it(source, error), end; !error && it != end; it.increment(error))
        TREM_RETURN_IF_ERROR(AddFrame(it->path()));
      if (error) return FromErrno("cannot list " + source.string(), error.value());
      AddBeside(source);
      return folder_ + "frames";
    }
    glob_t matches{};
    const std::unique_ptr<glob_t, void (*)(glob_t*)> free_matches(&matches, &::globfree);
    if (::glob(source.c_str(), 0, nullptr, &matches) != 0) return NotFound("nothing matches " + source.string());
    for (std::size_t i = 0; i < matches.gl_pathc; ++i) TREM_RETURN_IF_ERROR(AddFrame(matches.gl_pathv[i]));
    const fs::path folder = fs::path(matches.gl_pathv[0]).parent_path();
    AddIfThere("frames/telemetry.csv", folder / "telemetry.csv");
    AddBeside(folder);
    return folder_ + "frames";
  }

 private:
  void AddIfThere(const std::string& name, const fs::path& path) {
    std::error_code error;
    if (fs::is_regular_file(path, error)) files_->emplace(folder_ + name, path);
  }

  Status AddFrame(const fs::path& path) {
    std::error_code error;
    if (!fs::is_regular_file(path, error)) return {};
    if (files_->emplace(folder_ + "frames/" + path.filename().string(), path).second) return {};
    return InvalidInput("two frames are called " + path.filename().string() + ": a glob over several folders cannot be uploaded");
  }

  // What the search for telemetry looks at beside a source comes along, at the same place relative to it: the search then finds on a worker
  // what it would find here.
  void AddBeside(const fs::path& source) {
    std::error_code error;
    AddIfThere("telemetry.csv", source.parent_path() / "telemetry.csv");
    if (!fs::is_regular_file(source, error)) return;
    for (const char* extension : {".srt", ".SRT", ".gpx", ".GPX"}) {
      const fs::path track = fs::path(source).replace_extension(extension);
      AddIfThere(track.filename().string(), track);
    }
  }

  std::string folder_;
  FileMap* files_;
};

// Which of the sortie's recordings `path` is the source of: 0 is its own; nothing: it is no source.
std::optional<int> SourceIndex(const v1::Sortie& sortie, const std::string* path) {
  if (path == &sortie.source().path()) return 0;
  for (int k = 0; k < sortie.more_size(); ++k) {
    if (path == &sortie.more(k).source().path()) return k + 1;
  }
  return std::nullopt;
}

Result<ArtefactRef> Send(const std::string& name, const fs::path& path, ArtefactBacking* backing) {
  std::error_code error;
  TREM_ASSIGN_OR_RETURN(const std::string sha256, Sha256HexOfFile(path));
  const ArtefactRef ref{name, sha256, fs::file_size(path, error)};
  if (error) return FromErrno("cannot stat " + path.string(), error.value());
  TREM_RETURN_IF_ERROR(backing->Deliver(ref, path).WithPrefix(path.string()));
  return ref;
}

// The list itself, as an artefact.
Result<ArtefactRef> SendList(const v1::UploadList& list, const std::shared_ptr<ArtefactBacking>& backing) {
  std::error_code error;
  std::string folder = (fs::temp_directory_path(error) / "trem-upload-XXXXXX").string();
  if (::mkdtemp(folder.data()) == nullptr) return FromErrno("cannot make a folder like " + folder, errno);
  Result<ArtefactRef> ref = Failed("nothing was sent");
  if (const auto store = ArtefactStore::OpenCache(folder, backing); store.ok()) {
    ref = store->PutBytes("upload.pb", SerializeDeterministic(list));
  } else {
    ref = store.status();
  }
  fs::remove_all(folder, error);
  return ref;
}

}  // namespace

Result<v1::Sortie> UploadSortie(const v1::Sortie& sortie, const std::shared_ptr<ArtefactBacking>& backing) {
  v1::Sortie uploaded = sortie;
  if (uploaded.telemetry().ignore()) uploaded.mutable_telemetry()->clear_path();
  for (v1::Recording& recording : *uploaded.mutable_more()) {
    if (recording.telemetry().ignore()) recording.mutable_telemetry()->clear_path();
  }
  FileMap files;
  std::vector<std::string*> moved;
  for (const SortiePath& named : PathsOf(&uploaded)) {
    if (IsElsewhere(*named.path)) continue;
    moved.push_back(named.path);
    if (const std::optional<int> recording = SourceIndex(uploaded, named.path)) {
      RecordingFiles of_recording(*recording == 0 ? "" : "more-" + std::to_string(*recording) + "/", &files);
      TREM_ASSIGN_OR_RETURN(*named.path, of_recording.Add(std::string(*named.path)));
    } else {
      const std::string name = "named/" + std::to_string(moved.size()) + "/" + fs::path(*named.path).filename().string();
      files.emplace(name, *named.path);
      *named.path = name;
    }
  }
  if (moved.empty()) return uploaded;
  v1::UploadList list;
  for (const auto& [name, path] : files) {
    TREM_ASSIGN_OR_RETURN(const ArtefactRef ref, Send(name, path, backing.get()));
    v1::UploadedFile* file = list.add_files();
    file->set_name(name);
    file->set_sha256(ref.sha256);
    file->set_bytes(ref.bytes);
  }
  TREM_RETURN_IF_ERROR(CheckUploadList(list));
  TREM_ASSIGN_OR_RETURN(const ArtefactRef ref, SendList(list, backing));
  const std::string prefix = UploadName(ref) + "/";
  for (std::string* path : moved) *path = prefix + *path;
  return uploaded;
}

}  // namespace trem
