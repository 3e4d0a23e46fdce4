#include "coordinator/cli/work_folder.h"

#include <fcntl.h>
#include <glob.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <system_error>
#include <thread>
#include <vector>

#include "mosaic/base/digest.h"
#include "mosaic/base/file.h"
#include "proto/codec/convert.h"

namespace trem {
namespace fs = std::filesystem;
namespace {

constexpr const char* kLockName = "lock";
// A run that was just killed may take a moment to disappear.
constexpr std::chrono::seconds kLockPatience{2};

// "<path> <bytes> <modification time>" of one file.
void AddFingerprint(const fs::path& path, Sha256* digest) {
  struct stat info {};
  if (::stat(path.c_str(), &info) != 0) return;
  digest->Update(
      path.string() + '\0' + std::to_string(S_ISDIR(info.st_mode) ? 0 : info.st_size) + ' ' +
      (S_ISDIR(info.st_mode) ? std::string() : std::to_string(info.st_mtim.tv_sec) + '.' + std::to_string(info.st_mtim.tv_nsec)) + '\n');
}

std::vector<fs::path> FilesOfGlob(const std::string& pattern) {
  std::vector<fs::path> files;
  glob_t found{};
  if (::glob(pattern.c_str(), 0, nullptr, &found) == 0) files.assign(found.gl_pathv, found.gl_pathv + found.gl_pathc);
  ::globfree(&found);
  return files;
}

Result<std::vector<fs::path>> SourceFiles(const fs::path& source) {
  std::error_code error;
  std::vector<fs::path> files;
  if (fs::is_directory(source, error)) {
    for (fs::directory_iterator it(source, error), end; !error && it != end; it.increment(error)) files.push_back(it->path());
    if (error) return FromErrno("cannot list folder " + source.string(), error.value());
  } else if (fs::exists(source, error)) {
    files.push_back(source);
  } else {
    files = FilesOfGlob(source.string());
    if (files.empty()) return NotFound("source " + source.string() + " does not exist; expected a video, a folder of images or a glob");
  }
  std::sort(files.begin(), files.end());
  return files;
}

// Everything that tells one recording's frames and telemetry.
Status AddRecording(const v1::Source& source, const v1::Telemetry& telemetry, Sha256* digest) {
  TREM_ASSIGN_OR_RETURN(const std::vector<fs::path> files, SourceFiles(source.path()));
  for (const fs::path& file : files) AddFingerprint(file, digest);
  if (!telemetry.path().empty()) {
    AddFingerprint(telemetry.path(), digest);
  } else {
    // Where ingest looks for telemetry that the spec does not name.
    const fs::path folder = fs::path(source.path()).parent_path();
    AddFingerprint(folder / "telemetry.csv", digest);
    AddFingerprint(folder.parent_path() / "telemetry.csv", digest);
    for (const char* extension : {".srt", ".SRT", ".gpx", ".GPX"}) {
      AddFingerprint(fs::path(source.path()).replace_extension(extension), digest);
    }
  }
  if (!telemetry.dem_path().empty()) AddFingerprint(telemetry.dem_path(), digest);
  return {};
}

}  // namespace

Result<WorkFolder> WorkFolder::Open(const fs::path& path) {
  std::error_code ignored;
  const bool is_new = !fs::exists(path, ignored);
  TREM_RETURN_IF_ERROR(MakeDirectories(path));
  const fs::path lock = path / kLockName;
  const int fd = ::open(lock.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0644);
  if (fd < 0) return FromErrno("cannot create " + lock.string(), errno);
  const auto deadline = std::chrono::steady_clock::now() + kLockPatience;
  while (::flock(fd, LOCK_EX | LOCK_NB) != 0) {
    if (errno != EINTR && std::chrono::steady_clock::now() >= deadline) {
      ::close(fd);
      return Failed("another 'trem run' is using work folder " + path.string() + "; wait for it, or choose another output or --work-dir");
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
  }
  return WorkFolder(path, fd, is_new);
}

WorkFolder::WorkFolder(WorkFolder&& other) noexcept : path_(std::move(other.path_)), fd_(other.fd_), is_new_(other.is_new_) {
  other.fd_ = -1;
}

WorkFolder::~WorkFolder() {
  if (fd_ >= 0) ::close(fd_);
}

void WorkFolder::Remove() {
  std::error_code ignored;
  for (const char* name : {"state", "store", "logs", "publish", "socket-folder", kLockName}) fs::remove_all(path_ / name, ignored);
  fs::remove(path_, ignored);  // Fails when somebody else's files are there: they stay.
}

Result<std::string> RunJobId(const v1::Sortie& sortie) {
  Sha256 digest;
  digest.Update(SerializeDeterministic(sortie));
  TREM_RETURN_IF_ERROR(AddRecording(sortie.source(), sortie.telemetry(), &digest));
  for (const v1::Recording& recording : sortie.more())
    TREM_RETURN_IF_ERROR(AddRecording(recording.source(), recording.telemetry(), &digest));
  if (!sortie.control().path().empty()) AddFingerprint(sortie.control().path(), &digest);
  return "run-" + digest.FinishHex().substr(0, 24);
}

}  // namespace trem
