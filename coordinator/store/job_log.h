#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <set>
#include <string>

#include "mosaic/base/status.h"
#include "proto/trem/v1/fleet.pb.h"

namespace trem {

struct JobLogOptions {
  // A job's log keeps at least half of this of its newest lines, and never has more.
  std::uint64_t job_bytes_max = std::uint64_t{4} << 20;
  // All of them together; those that were written to longest ago go first.
  std::uint64_t bytes_max = std::uint64_t{256} << 20;
};

// What happened to each job, for people: <folder>/<job>.log and, before it, <job>.log.1, one line an event, its fields between tabs:
// number, milliseconds since 1970, "info" or "warning", task, how the task's key begins, attempt, worker, text. Bounded, and not durable:
// nothing depends on it, what cannot be written is left out. Not thread-safe.
class JobLog {
 public:
  JobLog(std::filesystem::path folder, const JobLogOptions& options = {});

  // Takes a line for the job (`number` is given here), to be written at the next Flush. Control characters and overlong texts are mended.
  // Precondition: IsJobId(job_id).
  void Append(const std::string& job_id, v1::LogLine line);
  // Writes what was appended. Cheap when nothing was.
  void Flush();

  // The lines that `get` asks for, at most about 256 KiB of them. No log, no lines.
  v1::LogPage Page(const v1::GetLog& get);

  // Lines that could not be written.
  std::uint64_t lost_count() const { return lost_count_; }

 private:
  struct Job {
    std::string unwritten;
    std::uint64_t unwritten_count = 0;
    std::uint64_t next_number = 1;
    std::uint64_t bytes = 0;  // Of the newer file.
  };
  Job& Find(const std::string& job_id);
  void Write(const std::string& job_id, Job* job);
  void RemoveOldest();
  std::filesystem::path PathOf(const std::string& job_id, bool older) const;

  std::filesystem::path folder_;
  JobLogOptions options_;
  std::map<std::string, Job> jobs_;
  std::set<std::string> unwritten_;  // Jobs that have something.
  std::uint64_t written_bytes_ = 0;  // Since the total was last looked at.
  bool is_total_known_ = false;
  std::uint64_t lost_count_ = 0;
};

}  // namespace trem
