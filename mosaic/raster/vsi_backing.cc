#include "mosaic/raster/vsi_backing.h"

#include <cpl_conv.h>
#include <cpl_string.h>
#include <cpl_vsi.h>
#include <cpl_vsi_error.h>

#include <cerrno>
#include <memory>
#include <system_error>
#include <vector>

#include "mosaic/base/file.h"
#include "mosaic/raster/gdal_env.h"

namespace trem {
namespace fs = std::filesystem;
namespace {

struct VsiCloser {
  void operator()(VSILFILE* file) const { VSIFCloseL(file); }
};
using VsiFile = std::unique_ptr<VSILFILE, VsiCloser>;

// Why the last request failed, as the store or GDAL says.
std::string Reason(const GdalErrors& errors) {
  const char* detail = VSIGetLastErrorMsg();
  if (detail != nullptr && *detail != '\0') return detail;
  return errors.Text();
}

// What the last request on `path` ended with: kInvalidInput when the store refuses (trying again will not help), else kUnavailable.
Status Failure(const std::string& what, const GdalErrors& errors) {
  const std::string text = what + ": " + Reason(errors) + "; check the store's address and credentials";
  switch (VSIGetLastErrorNo()) {
    case VSIE_AWSAccessDenied:
    case VSIE_AWSBucketNotFound:
    case VSIE_AWSInvalidCredentials:
    case VSIE_AWSSignatureDoesNotMatch:
      return InvalidInput(text);
    default:
      return errno == ENOSPC ? Exhausted(what + ": the disk is full") : Unavailable(text);
  }
}

// Kind and size; kNotFound when there is nothing, as Failure when the store does not say.
Status Stat(const std::string& path, VSIStatBufL* info) {
  // GDAL remembers what it has seen, also that there was nothing; meanwhile somebody else may have put it.
  VSICurlPartialClearCache(path.c_str());
  VSIErrorReset();
  errno = 0;
  const GdalErrors errors;
  if (VSIStatExL(path.c_str(), info, VSI_STAT_EXISTS_FLAG | VSI_STAT_NATURE_FLAG | VSI_STAT_SIZE_FLAG | VSI_STAT_SET_ERROR_FLAG) == 0)
    return {};
  // A store that refuses looks like one that has nothing; asking for the object's headers says which it is.
  if (VSIGetLastErrorNo() == VSIE_None) CSLDestroy(VSIGetFileMetadata(path.c_str(), "HEADERS", nullptr));
  const int code = VSIGetLastErrorNo();
  if (code == VSIE_None || code == VSIE_FileError || code == VSIE_AWSObjectNotFound) return NotFound(path + " does not exist");
  return Failure("cannot look at " + path, errors);
}

// Copies all bytes between two open files.
Status Pump(VSILFILE* in, VSILFILE* out, const std::string& what, const GdalErrors& errors) {
  std::vector<char> block(1 << 20);
  for (;;) {
    const std::size_t count = VSIFReadL(block.data(), 1, block.size(), in);
    if (count > 0 && VSIFWriteL(block.data(), 1, count, out) != count) return Failure(what + ": writing failed", errors);
    if (count < block.size()) break;
  }
  return errors.failed() ? Failure(what + ": reading failed", errors) : Status();
}

// From one path, virtual or not, to another.
Status CopyThrough(const std::string& from, const std::string& to) {
  VSIErrorReset();
  errno = 0;
  const GdalErrors errors;
  const std::string what = "copying " + from + " to " + to;
  const VsiFile in(VSIFOpenExL(from.c_str(), "rb", TRUE));
  if (!in) return Failure(what + ": cannot open it for reading", errors);
  VsiFile out(VSIFOpenExL(to.c_str(), "wb", TRUE));
  if (!out) return Failure(what + ": cannot open it for writing", errors);
  Status status = Pump(in.get(), out.get(), what, errors);
  // An object store takes the bytes in when the file is closed.
  if (VSIFCloseL(out.release()) != 0 && status.ok()) status = Failure(what, errors);
  return status;
}

// Credentials of a worker that was let in may have run out: the task is tried again, elsewhere perhaps.
Status Retried(const Status& status) { return status.code() == StatusCode::kInvalidInput ? Unavailable(status.message()) : status; }

}  // namespace

Result<std::string> VsiBacking::Fetch(const ArtefactRef& ref, const fs::path& path) {
  InitialiseGdal();
  const std::string object = ObjectPath(ref.sha256);
  VSIStatBufL info{};
  if (const Status found = Stat(object, &info); !found.ok()) return Retried(found).WithPrefix("artefact " + ref.name);
  TREM_RETURN_IF_ERROR(Retried(CopyThrough(object, path.string())));
  return std::string();
}

Status VsiBacking::Deliver(const ArtefactRef& ref, const fs::path& path) {
  InitialiseGdal();
  // Also what is there already, which is rare: it may be damaged, and that is why it was made again. Readers see the old or the new.
  return Retried(CopyThrough(path.string(), ObjectPath(ref.sha256)));
}

Status VsiBacking::Check() const {
  InitialiseGdal();
  VSIStatBufL info{};
  const Status found = Stat(root_ + "/objects", &info);
  return found.code() == StatusCode::kNotFound ? Status() : found.WithPrefix("artefact store " + root_);
}

Status CopyVsiTree(const std::string& source, const fs::path& target) {
  InitialiseGdal();
  VSIStatBufL info{};
  TREM_RETURN_IF_ERROR(Stat(source, &info));
  if (!VSI_ISDIR(info.st_mode)) {
    std::error_code error;
    if (fs::file_size(target, error) == static_cast<std::uint64_t>(info.st_size) && !error) return {};
    TREM_RETURN_IF_ERROR(MakeDirectories(target.parent_path()));
    const fs::path partial = target.string() + ".part";
    TREM_RETURN_IF_ERROR(CopyThrough(source, partial.string()));
    if (fs::file_size(partial, error) != static_cast<std::uint64_t>(info.st_size) || error) {
      return Unavailable(source + " has " + std::to_string(info.st_size) + " bytes, but fewer or more arrived");
    }
    return PublishFile(partial, target);
  }
  TREM_RETURN_IF_ERROR(MakeDirectories(target));
  const std::unique_ptr<char*, void (*)(char**)> names(VSIReadDir(source.c_str()), &CSLDestroy);
  for (char** name = names.get(); name != nullptr && *name != nullptr; ++name) {
    const std::string entry = *name;
    if (entry.empty() || entry.front() == '.' || entry.find('/') != std::string::npos) continue;
    const std::string path = source + "/" + entry;
    TREM_RETURN_IF_ERROR(Stat(path, &info));
    if (!VSI_ISDIR(info.st_mode)) TREM_RETURN_IF_ERROR(CopyVsiTree(path, target / entry));
  }
  return {};
}

}  // namespace trem
