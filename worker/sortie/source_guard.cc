#include "worker/sortie/source_guard.h"

#include <glob.h>

#include <algorithm>
#include <memory>
#include <system_error>

#include "proto/codec/sortie_paths.h"
#include "proto/codec/upload.h"
#include "worker/sortie/image_sequence_reader.h"
#include "worker/sortie/telemetry_match.h"
#include "worker/sortie/telemetry_sources.h"

namespace trem {
namespace fs = std::filesystem;
namespace {

constexpr const char* kVirtualPrefix = "/vsi";

bool IsVirtual(const std::string& path) { return path.starts_with(kVirtualPrefix); }

bool IsWithin(const fs::path& path, const fs::path& folder) {
  return std::mismatch(folder.begin(), folder.end(), path.begin(), path.end()).first == folder.end();
}

}  // namespace

Result<SourceGuard> SourceGuard::Make(const std::vector<std::string>& roots, bool closed) {
  SourceGuard guard;
  guard.open_ = roots.empty() && !closed;
  for (const std::string& root : roots) {
    if (IsVirtual(root)) {
      guard.virtual_roots_.push_back(root.ends_with('/') ? root : root + "/");
      continue;
    }
    std::error_code error;
    const fs::path canonical = fs::canonical(root, error);
    if (error || !fs::is_directory(canonical, error)) return NotFound("--source-root " + root + " is not a folder");
    guard.roots_.push_back(canonical);
  }
  return guard;
}

bool SourceGuard::Allows(const fs::path& path) const {
  const std::string text = path.string();
  if (UploadOfPath(text)) return true;  // What a client gave, in a folder that holds nothing else.
  if (IsVirtual(text)) {
    // Nested ones, such as /vsizip//vsicurl/..., begin with something that no root names.
    return text.find("..") == std::string::npos &&
           std::any_of(virtual_roots_.begin(), virtual_roots_.end(), [&](const std::string& root) { return text.starts_with(root); });
  }
  std::error_code error;
  const fs::path canonical = fs::weakly_canonical(path, error);
  return !error && std::any_of(roots_.begin(), roots_.end(), [&](const fs::path& root) { return IsWithin(canonical, root); });
}

Status SourceGuard::CheckPath(const std::string& field, const fs::path& path) const {
  if (path.empty() || Allows(path)) return {};
  const bool nothing = roots_.empty() && virtual_roots_.empty();
  return InvalidInput(field + " " + path.string() + " does not lie below a folder that this worker may read" +
                      (nothing ? " (it was started with --key and without --source-root: it reads none)" : "") +
                      "; put the sortie there, or start the workers with another --source-root");
}

Status SourceGuard::CheckEntries(const fs::path& source) const {
  std::error_code error;
  for (fs::directory_iterator it(source, error), end; !error && it != end; it.increment(error)) {
    if (it->is_symlink(error)) TREM_RETURN_IF_ERROR(CheckPath("the source's folder holds a link:", it->path()));
  }
  if (fs::exists(source, error)) return {};
  glob_t matches{};
  const std::unique_ptr<glob_t, void (*)(glob_t*)> free_matches(&matches, &::globfree);
  if (::glob(source.c_str(), GLOB_NOSORT, nullptr, &matches) != 0) return {};
  for (std::size_t i = 0; i < matches.gl_pathc; ++i) TREM_RETURN_IF_ERROR(CheckPath("a match of source.path:", matches.gl_pathv[i]));
  return {};
}

Status SourceGuard::CheckNamed(const v1::Sortie& sortie) const {
  v1::Sortie named = sortie;
  for (const SortiePath& entry : PathsOf(&named)) {
    if (entry.path != &named.source().path()) TREM_RETURN_IF_ERROR(CheckPath(entry.field, *entry.path));
  }
  return {};
}

Status SourceGuard::Check(const v1::Sortie& sortie) const {
  if (open_) return {};
  for (const v1::Recording& recording : sortie.more()) {
    v1::Sortie alone;
    *alone.mutable_source() = recording.source();
    *alone.mutable_telemetry() = recording.telemetry();
    TREM_RETURN_IF_ERROR(Check(alone).WithPrefix("more"));
  }
  const fs::path source = sortie.source().path();
  if (UploadOfPath(source.string())) return CheckNamed(sortie);
  if (!source.is_absolute()) return InvalidInput("source.path " + source.string() + " is relative; expected an absolute path");
  std::error_code error;
  // Of a glob (which does not exist as it stands) the folder above the first wildcard counts, then every match.
  const bool is_there = IsVirtual(source.string()) || fs::exists(source, error);
  TREM_RETURN_IF_ERROR(CheckPath("source.path", is_there ? source : ImageFolder(source.string())));
  TREM_RETURN_IF_ERROR(CheckNamed(sortie));
  if (IsVirtual(source.string())) return {};
  TREM_RETURN_IF_ERROR(CheckEntries(source));
  // Tracks beside a video may be links, too; a telemetry.csv may lie above the source, and be a link.
  for (const fs::path& track : TrackFilesBeside(sortie)) TREM_RETURN_IF_ERROR(CheckPath("telemetry", track));
  return CheckPath("telemetry", FindTelemetryCsv(sortie).value_or(""));
}

}  // namespace trem
