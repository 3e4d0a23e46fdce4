#pragma once

#include <filesystem>
#include <string>

#include "mosaic/base/status.h"
#include "proto/trem/v1/job.pb.h"

namespace trem {

// The folder in which one `trem run` keeps what it needs to resume. Locked while the object lives, so that two runs cannot share it.
class WorkFolder {
 public:
  // Creates it when missing. kFailed when another run holds it.
  static Result<WorkFolder> Open(const std::filesystem::path& path);
  WorkFolder(WorkFolder&& other) noexcept;
  WorkFolder& operator=(WorkFolder&&) = delete;
  ~WorkFolder();

  const std::filesystem::path& path() const { return path_; }
  // True when this object made the folder: there is nothing to resume.
  bool is_new() const { return is_new_; }
  // Removes what a run puts there, and the folder itself when nothing else is in it.
  void Remove();

 private:
  WorkFolder(std::filesystem::path path, int fd, bool is_new) : path_(std::move(path)), fd_(fd), is_new_(is_new) {}

  std::filesystem::path path_;
  int fd_ = -1;
  bool is_new_ = false;
};

// "run-" and 24 hexadecimal digits that depend on the effective spec and on names, sizes and times of the input files: the same command
// on the same input is the same job and resumes; a changed input is another job. Errors: kNotFound for a source that does not exist.
Result<std::string> RunJobId(const v1::Sortie& sortie);

}  // namespace trem
