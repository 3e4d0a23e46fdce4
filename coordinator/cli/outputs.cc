#include "coordinator/cli/outputs.h"

#include <sys/stat.h>

#include <algorithm>
#include <cctype>
#include <cerrno>
#include <cstdlib>
#include <system_error>

#include "coordinator/cli/published_text.h"
#include "mosaic/base/digest.h"
#include "mosaic/base/file.h"
#include "proto/codec/convert.h"

namespace trem {
namespace fs = std::filesystem;
namespace {

constexpr const char* kMosaicName = "mosaic.tif";
constexpr std::string_view kNamePrefix = "mosaic";
constexpr std::uint64_t kTextBytesMax = std::uint64_t{256} << 20;

fs::path FolderOf(const fs::path& path) { return path.has_parent_path() ? path.parent_path() : fs::path("."); }

bool OnSameFileSystem(const fs::path& a, const fs::path& b) {
  struct stat info_a {
  }, info_b{};
  return ::stat(a.c_str(), &info_a) == 0 && ::stat(b.c_str(), &info_b) == 0 && info_a.st_dev == info_b.st_dev;
}

// Removed with its contents on destruction.
class StagingFolder {
 public:
  static Result<StagingFolder> Make(const fs::path& work_folder, const fs::path& output) {
    const fs::path folder = FolderOf(output);
    if (!work_folder.empty() && OnSameFileSystem(work_folder, folder)) {
      const fs::path path = work_folder / "publish";
      std::error_code ignored;
      fs::remove_all(path, ignored);  // Of a run that was killed; this run holds the folder's lock.
      TREM_RETURN_IF_ERROR(MakeDirectories(path));
      return StagingFolder(path);
    }
    std::string name = (folder / ("." + output.stem().string() + ".publish-XXXXXX")).string();
    if (::mkdtemp(name.data()) == nullptr) return FromErrno("cannot create a folder in " + folder.string(), errno);
    return StagingFolder(name);
  }
  StagingFolder(StagingFolder&& other) noexcept : path_(std::move(other.path_)) { other.path_.clear(); }
  StagingFolder& operator=(StagingFolder&&) = delete;
  ~StagingFolder() {
    std::error_code ignored;
    if (!path_.empty()) fs::remove_all(path_, ignored);
  }
  const fs::path& path() const { return path_; }

 private:
  explicit StagingFolder(fs::path path) : path_(std::move(path)) {}
  fs::path path_;
};

}  // namespace

Result<fs::path> OutputPath(const fs::path& output, const std::string& name) {
  if (name == kMosaicName) return output;
  if (name.empty() || name.front() == '.' || name.find('/') != std::string::npos || name.find('\0') != std::string::npos) {
    return Corrupt("the job has an output named '" + name + "'; expected a plain file name");
  }
  const std::string rest = name.compare(0, kNamePrefix.size(), kNamePrefix) == 0 ? name.substr(kNamePrefix.size()) : "_" + name;
  return output.parent_path() / (output.stem().string() + rest);
}

Status CheckOutput(const fs::path& output) {
  std::string extension = output.extension().string();
  std::transform(extension.begin(), extension.end(), extension.begin(), [](unsigned char c) { return std::tolower(c); });
  std::error_code error;
  if (fs::is_directory(output, error)) {
    return InvalidInput("output " + output.string() + " is a folder; expected the name of a file, for example " +
                        (output / kMosaicName).string());
  }
  if (extension != ".tif" && extension != ".tiff") {
    return InvalidInput("output " + output.string() + " does not end in .tif; the mosaic is a GeoTIFF: name it like mosaic.tif");
  }
  const fs::path folder = FolderOf(output);
  if (!fs::is_directory(folder, error)) {
    return NotFound("output folder " + folder.string() + " does not exist or is not a folder; create it first, or choose another -o");
  }
  return CheckWritable(folder).WithPrefix("output " + output.string());
}

Result<std::vector<PublishedFile>> PublishOutputs(const v1::JobStatus& job, const ArtefactStore& store, const fs::path& output,
                                                  const fs::path& work_folder) {
  TREM_ASSIGN_OR_RETURN(const StagingFolder staging, StagingFolder::Make(work_folder, output));
  std::vector<PublishedFile> files;
  for (const v1::ArtefactRef& message : job.outputs()) {
    const ArtefactRef ref = FromProto(message);
    TREM_ASSIGN_OR_RETURN(const fs::path path, OutputPath(output, ref.name));
    TREM_ASSIGN_OR_RETURN(const fs::path object, store.Locate(ref));
    const fs::path staged = staging.path() / path.filename();
    TREM_RETURN_IF_ERROR(CopyFileAtomically(object, staged).WithPrefix("output " + path.string()));
    TREM_ASSIGN_OR_RETURN(const std::string sha256, Sha256HexOfFile(staged));
    if (sha256 != ref.sha256) {
      return Corrupt("result " + ref.name + " has digest " + sha256 + " in " + object.string() + "; expected " + ref.sha256 +
                     "; check the disk and run the same command again");
    }
    files.push_back({ref.name, path, ref.sha256, ref.bytes});
    if (IsFinishedWhenPublished(ref.name)) {
      TREM_ASSIGN_OR_RETURN(const std::string text, ReadFile(staged, kTextBytesMax));
      TREM_ASSIGN_OR_RETURN(const std::string finished, FinishedText(ref.name, text, output, job));
      TREM_RETURN_IF_ERROR(WriteFileAtomically(staged, finished));
      files.back().sha256 = Sha256Hex(finished);
      files.back().bytes = finished.size();
    }
  }
  const auto is_mosaic = [](const PublishedFile& file) { return file.name == kMosaicName; };
  if (std::none_of(files.begin(), files.end(), is_mosaic)) return Failed("the job is done but has no output named mosaic.tif");
  std::stable_partition(files.begin(), files.end(), [&](const PublishedFile& file) { return !is_mosaic(file); });
  for (const PublishedFile& file : files) TREM_RETURN_IF_ERROR(PublishFile(staging.path() / file.path.filename(), file.path));
  std::stable_partition(files.begin(), files.end(), is_mosaic);
  return files;
}

}  // namespace trem
