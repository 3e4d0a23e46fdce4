#include "mosaic/base/file.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <cstdio>
#include <vector>

namespace trem {
namespace fs = std::filesystem;
namespace {

// A name beside `path` that no other process or thread uses.
fs::path TemporaryBeside(const fs::path& path) {
  static std::atomic<std::uint64_t> counter{0};
  return path.parent_path() /
         ("." + path.filename().string() + ".tmp-" + std::to_string(::getpid()) + "-" + std::to_string(counter.fetch_add(1)));
}

// Owns a descriptor; closes it on destruction.
class FileDescriptor {
 public:
  explicit FileDescriptor(int fd) : fd_(fd) {}
  ~FileDescriptor() {
    if (fd_ >= 0) ::close(fd_);
  }
  FileDescriptor(const FileDescriptor&) = delete;
  FileDescriptor& operator=(const FileDescriptor&) = delete;
  int get() const { return fd_; }
  int Close() {
    const int fd = fd_;
    fd_ = -1;
    return ::close(fd);
  }

 private:
  int fd_;
};

Status WriteAll(int fd, std::string_view bytes, const fs::path& path) {
  while (!bytes.empty()) {
    const ssize_t written = ::write(fd, bytes.data(), bytes.size());
    if (written < 0) {
      if (errno == EINTR) continue;
      return FromErrno("cannot write " + path.string(), errno);
    }
    bytes.remove_prefix(static_cast<std::size_t>(written));
  }
  return {};
}

Status FsyncFolder(const fs::path& folder) {
  const fs::path name = folder.empty() ? fs::path(".") : folder;
  FileDescriptor fd(::open(name.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
  if (fd.get() < 0) return FromErrno("cannot open folder " + name.string(), errno);
  if (::fsync(fd.get()) != 0 && errno != EINVAL) return FromErrno("cannot fsync folder " + name.string(), errno);
  return {};
}

// fsync, rename to `target`, fsync of the folder; removes `temporary` on failure.
Status SyncAndRename(const fs::path& temporary, const fs::path& target) {
  Status status;
  {
    FileDescriptor fd(::open(temporary.c_str(), O_RDONLY | O_CLOEXEC));
    if (fd.get() < 0) {
      status = FromErrno("cannot open " + temporary.string(), errno);
    } else if (::fsync(fd.get()) != 0) {
      status = FromErrno("cannot fsync " + temporary.string(), errno);
    }
  }
  if (status.ok() && ::rename(temporary.c_str(), target.c_str()) != 0) {
    status = FromErrno("cannot rename to " + target.string(), errno);
  }
  if (!status.ok()) {
    ::unlink(temporary.c_str());
    return status;
  }
  return FsyncFolder(target.parent_path());
}

}  // namespace

Result<std::string> ReadFile(const fs::path& path, std::uint64_t max_bytes) {
  FileDescriptor fd(::open(path.c_str(), O_RDONLY | O_CLOEXEC));
  if (fd.get() < 0) return FromErrno("cannot read " + path.string(), errno);
  struct stat info {};
  if (::fstat(fd.get(), &info) != 0) return FromErrno("cannot stat " + path.string(), errno);
  if (S_ISDIR(info.st_mode)) return InvalidInput(path.string() + " is a folder; expected a file");
  if (static_cast<std::uint64_t>(info.st_size) > max_bytes) {
    return InvalidInput(path.string() + " has " + std::to_string(info.st_size) + " bytes; at most " + std::to_string(max_bytes) +
                        " are accepted here");
  }
  std::string bytes;
  std::vector<char> block(1 << 16);
  for (;;) {
    const ssize_t count = ::read(fd.get(), block.data(), block.size());
    if (count < 0) {
      if (errno == EINTR) continue;
      return FromErrno("cannot read " + path.string(), errno);
    }
    if (count == 0) return bytes;
    bytes.append(block.data(), static_cast<std::size_t>(count));
    if (bytes.size() > max_bytes) return InvalidInput(path.string() + " grew past " + std::to_string(max_bytes) + " bytes while read");
  }
}

Status WriteFileAtomically(const fs::path& path, std::string_view bytes, unsigned mode) {
  const fs::path temporary = TemporaryBeside(path);
  FileDescriptor fd(::open(temporary.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, mode));
  if (fd.get() < 0) return FromErrno("cannot create " + temporary.string(), errno);
  Status status = WriteAll(fd.get(), bytes, path);
  if (fd.Close() != 0 && status.ok()) status = FromErrno("cannot close " + temporary.string(), errno);
  if (!status.ok()) {
    ::unlink(temporary.c_str());
    return status;
  }
  return SyncAndRename(temporary, path);
}

Status CopyFileAtomically(const fs::path& source, const fs::path& target) {
  FileDescriptor in(::open(source.c_str(), O_RDONLY | O_CLOEXEC));
  if (in.get() < 0) return FromErrno("cannot read " + source.string(), errno);
  const fs::path temporary = TemporaryBeside(target);
  FileDescriptor out(::open(temporary.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0644));
  if (out.get() < 0) return FromErrno("cannot create " + temporary.string(), errno);
  std::vector<char> block(1 << 20);
  Status status;
  while (status.ok()) {
    const ssize_t count = ::read(in.get(), block.data(), block.size());
    if (count == 0) break;
    if (count < 0) {
      if (errno == EINTR) continue;
      status = FromErrno("cannot read " + source.string(), errno);
    } else {
      status = WriteAll(out.get(), std::string_view(block.data(), static_cast<std::size_t>(count)), target);
    }
  }
  if (out.Close() != 0 && status.ok()) status = FromErrno("cannot close " + temporary.string(), errno);
  if (!status.ok()) {
    ::unlink(temporary.c_str());
    return status;
  }
  return SyncAndRename(temporary, target);
}

Status PublishFile(const fs::path& source, const fs::path& target) {
  struct stat source_info {}, folder_info {};
  const fs::path folder = target.parent_path().empty() ? fs::path(".") : target.parent_path();
  if (::stat(source.c_str(), &source_info) != 0) return FromErrno("cannot stat " + source.string(), errno);
  if (::stat(folder.c_str(), &folder_info) != 0) return FromErrno("cannot stat " + folder.string(), errno);
  if (source_info.st_dev == folder_info.st_dev) return SyncAndRename(source, target);
  TREM_RETURN_IF_ERROR(CopyFileAtomically(source, target));
  ::unlink(source.c_str());
  return {};
}

Status MakeDirectories(const fs::path& path) {
  std::error_code error;
  fs::create_directories(path, error);
  if (error) return FromErrno("cannot create folder " + path.string(), error.value());
  if (!fs::is_directory(path, error)) return InvalidInput(path.string() + " exists and is not a folder");
  return {};
}

Status CheckWritable(const fs::path& folder) {
  const fs::path probe = TemporaryBeside(folder / "write-test");
  FileDescriptor fd(::open(probe.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0600));
  if (fd.get() < 0) return FromErrno("cannot write in folder " + (folder.empty() ? std::string(".") : folder.string()), errno);
  ::unlink(probe.c_str());
  return {};
}

}  // namespace trem
