#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "mosaic/base/rng.h"
#include "tests/e2e/run_fixture.h"
#include "tests/support/network_link.h"
#include "tests/support/subprocess.h"

namespace trem::testing {

struct SoakOptions {
  std::uint64_t seed = 1;
  int frame_count = 140;
  int worker_count = 4;
  int disturbance_count = 80;
  int pause_ms_max = 800;  // Between two disturbances; the least is an eighth of it.
  // Goes on disturbing, however often, until so many processes were killed; a job that ends before that is a fault. 0: as often as
  // disturbance_count says, or until the job ends.
  int kill_count = 0;
  // Told now and then how far it is. May be empty.
  std::function<void(const std::string&)> tell;
};

// A job on real processes while they are killed, stopped, starved and lied to.
//
// The job is run once in peace, then with `worker_count` workers while a driver, from its seed, kills workers, compute processes and the
// coordinator with SIGKILL, stops and resumes workers and coordinator, damages stored artefacts and, where a small file system can be
// mounted, fills the disk that holds the log. What was killed is started again at once. When it has disturbed often enough, the job must
// end by itself.
//
// Where network namespaces can be made, every second worker lives in one, shares no store, and talks through a cable that is cut for up to
// six seconds at a time; everybody then has keys. Otherwise all talk over a local socket.
class Soak {
 public:
  explicit Soak(const SoakOptions& options);
  ~Soak();

  // Runs it. Returns what went wrong: empty means that the published files are the bytes of the undisturbed run and nothing is left behind.
  std::vector<std::string> Run();

  // How often each disturbance happened.
  const std::map<std::string, int>& counts() const { return counts_; }
  int task_count() const { return task_count_; }
  // How many processes were killed: workers, compute processes, coordinators.
  int kill_count() const;
  // From the submission to the job's end, and to its end in peace by two workers.
  std::chrono::milliseconds disturbed_time() const { return disturbed_time_; }
  std::chrono::milliseconds peaceful_time() const { return peaceful_time_; }
  bool can_fill_disk() const { return can_fill_disk_; }
  // Why no link is cut; empty: links are cut.
  const std::string& why_no_link() const { return why_no_link_; }

 private:
  void StartCoordinator();
  void StartWorker(int index);
  Completed Trem(std::vector<std::string> arguments) const;
  enum class Disturbance {
    kKillWorker,
    kKillCoordinator,
    kKillCompute,
    kStopWorker,
    kStopCoordinator,
    kDamageArtefact,
    kFillDisk,
    kCutLink
  };
  Disturbance NextDisturbance();
  bool IsEnough(int disturbances) const;
  void DisturbForLong();
  void TellProgress();
  void Disturb(Disturbance kind);
  void DamageAnArtefact();
  void FillTheDisk();
  void CutTheLink();
  void PrepareEndpoint();
  std::filesystem::path KeyPath(const std::string& name) const { return fixture_.folder() / "keys" / name; }
  std::string StateOfJob();
  bool AwaitEnd(std::chrono::seconds patience);
  bool AwaitWorkers(std::chrono::seconds patience) const;  // True once the coordinator lists every worker process that runs.
  void Count(const std::string& what) { ++counts_[what]; }

  SoakOptions options_;
  RunFixture fixture_;
  Rng rng_;
  std::filesystem::path state_ = fixture_.folder() / "state";
  std::filesystem::path store_ = fixture_.folder() / "store";
  std::string endpoint_;
  bool can_fill_disk_ = false;
  std::unique_ptr<NetworkLink> link_;  // Null: there is none.
  std::string why_no_link_;
  std::unique_ptr<Subprocess> coordinator_;
  std::vector<std::unique_ptr<Subprocess>> workers_;
  std::map<std::string, int> counts_;
  std::vector<Disturbance> deck_;  // What is left of this round; taken from the back.
  int task_count_ = 0;
  std::string progress_;  // What is done of each stage, as StateOfJob heard it last.
  std::chrono::steady_clock::time_point submitted_{};
  std::chrono::milliseconds disturbed_time_{0};
  std::chrono::milliseconds peaceful_time_{0};
  bool is_exporting_ = false;
};

}  // namespace trem::testing
