#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>

#include "mosaic/base/status.h"

namespace trem {

// Reads a whole file of at most `max_bytes`; a larger one is an error that names both sizes.
Result<std::string> ReadFile(const std::filesystem::path& path, std::uint64_t max_bytes);

// Publishes `bytes` at `path`: writes a temporary file beside it, fsync, rename, fsync of the folder. Readers see the old file or the
// whole new one. On failure nothing is left behind. `mode` is what the file may never exceed: 0600 for secrets.
Status WriteFileAtomically(const std::filesystem::path& path, std::string_view bytes, unsigned mode = 0644);

// Publishes an existing file at `target`: fsync, rename, fsync of the folder; copies first (same guarantees) when the two are on
// different file systems.
Status PublishFile(const std::filesystem::path& source, const std::filesystem::path& target);

// Copies `source` to `target` atomically (temporary file beside the target, fsync, rename). `source` stays.
Status CopyFileAtomically(const std::filesystem::path& source, const std::filesystem::path& target);

// Creates the folder and its parents; a clear error when a file is in the way or permission is missing.
Status MakeDirectories(const std::filesystem::path& path);

// Ok when a file can be created in `folder` (tried with a real temporary file, removed at once).
Status CheckWritable(const std::filesystem::path& folder);

}  // namespace trem
