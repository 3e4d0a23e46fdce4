#include "coordinator/cli/local_fleet.h"

#include <signal.h>
#include <sys/statvfs.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <cstdlib>
#include <system_error>
#include <thread>

#include "coordinator/cli/child_process.h"
#include "mosaic/base/file.h"

namespace trem {
namespace fs = std::filesystem;
namespace {

constexpr int kRestartsMax = 3;
constexpr std::chrono::minutes kRestartPeriod{1};
constexpr std::chrono::seconds kPatience{5};
constexpr std::size_t kSocketPathBytesMax = 107;  // sizeof(sockaddr_un::sun_path) - 1.
constexpr const char* kSocketName = "/coordinator.sock";
constexpr const char* kSocketFolderPrefix = "trem-run-";
constexpr const char* kSocketFolderNote = "socket-folder";
constexpr int kQuotedLines = 5;

// Whether the file system of `folder` has less than 1 MiB left.
bool DiskIsFull(const fs::path& folder) {
  struct statvfs info {};
  return ::statvfs(folder.c_str(), &info) == 0 && static_cast<std::uint64_t>(info.f_bavail) * info.f_frsize < (1U << 20);
}

// Removes the socket folder of a run that was killed, as noted in its work folder.
void RemoveNotedSocketFolder(const fs::path& note) {
  const auto text = ReadFile(note, 4096);
  if (!text.ok()) return;
  const fs::path folder = *text;
  std::error_code ignored;
  if (folder.filename().string().rfind(kSocketFolderPrefix, 0) == 0) fs::remove_all(folder, ignored);
  fs::remove(note, ignored);
}

}  // namespace

bool RestartBudget::Take(Clock::time_point now) {
  while (!taken_.empty() && now - taken_.front() >= period_) taken_.pop_front();
  if (static_cast<int>(taken_.size()) >= count_max_) return false;
  taken_.push_back(now);
  return true;
}

Result<std::unique_ptr<LocalFleet>> LocalFleet::Start(const LocalFleetOptions& options) {
  std::unique_ptr<LocalFleet> fleet(new LocalFleet(options));
  const fs::path& work = options.work_folder;
  for (const char* folder : {"state", "store", "logs"}) TREM_RETURN_IF_ERROR(MakeDirectories(work / folder));
  TREM_RETURN_IF_ERROR(fleet->MakeSocketFolder());
  fleet->AddSlot("coordinator",
                 {(options.program_folder / "trem-coordinator").string(), "--state", (work / "state").string(), "--store",
                  (work / "store").string(), "--bind", fleet->endpoint_, "--data-bind", "none",
                  // Someone waits before the terminal and resumes with the same command: a full disk is told within a minute.
                  "--outages-max", "3"});
  for (int i = 1; i <= options.worker_count; ++i) {
    fleet->AddSlot("worker-" + std::to_string(i), {(options.program_folder / "trem-worker").string(), "serve", "--coordinator",
                                                   fleet->endpoint_, "--store", (work / "store").string(),
                                                   // This coordinator asks for no keys, whatever TREM_KEY says for another one.
                                                   "--key", "", "--coordinator-key", ""});
  }
  for (Slot& slot : fleet->slots_) {
    TREM_ASSIGN_OR_RETURN(slot.pid, StartChild(slot.argv, slot.log_path));
  }
  return fleet;
}

LocalFleet::~LocalFleet() {
  for (const Slot& slot : slots_) {
    if (slot.pid <= 0) continue;
    ::kill(slot.pid, SIGKILL);
    while (::waitpid(slot.pid, nullptr, 0) < 0 && errno == EINTR) {
    }
  }
  std::error_code ignored;
  if (!socket_folder_.empty()) {
    fs::remove_all(socket_folder_, ignored);
    fs::remove(options_.work_folder / kSocketFolderNote, ignored);
  }
}

Status LocalFleet::MakeSocketFolder() {
  const fs::path note = options_.work_folder / kSocketFolderNote;
  RemoveNotedSocketFolder(note);
  const char* runtime = std::getenv("XDG_RUNTIME_DIR");
  for (const std::string& base : {std::string(runtime == nullptr ? "" : runtime), std::string("/tmp")}) {
    std::string name = base + "/" + kSocketFolderPrefix + "XXXXXX";
    if (base.empty() || name.size() + std::string(kSocketName).size() > kSocketPathBytesMax) continue;
    if (::mkdtemp(name.data()) == nullptr) continue;
    socket_folder_ = name;
    endpoint_ = "ipc://" + name + kSocketName;
    return WriteFileAtomically(note, name);
  }
  return FromErrno("cannot make a folder for the coordinator's socket in $XDG_RUNTIME_DIR or /tmp", errno);
}

void LocalFleet::AddSlot(const std::string& name, std::vector<std::string> argv) {
  slots_.push_back(
      {name, std::move(argv), options_.work_folder / "logs" / (name + ".log"), RestartBudget(kRestartsMax, kRestartPeriod), -1});
}

Status LocalFleet::GiveUp(const Slot& slot, int wait_status) const {
  if (DiskIsFull(options_.work_folder)) {
    return Exhausted("the disk that holds " + options_.work_folder.string() +
                     " is full; make room, or choose another disk with --work-dir");
  }
  const std::string lines = LastLines(slot.log_path, kQuotedLines);
  return Failed(slot.name + " " + DescribeExit(wait_status) + " again after " + std::to_string(kRestartsMax) +
                " restarts within a minute; " +
                (lines.empty() ? "its log " + slot.log_path.string() + " is empty"
                               : "the last lines of its log " + slot.log_path.string() + ":\n" + lines));
}

Status LocalFleet::Supervise() {
  for (Slot& slot : slots_) {
    if (slot.pid <= 0) continue;
    const std::optional<int> wait_status = ReapChild(slot.pid);
    if (!wait_status) continue;
    slot.pid = -1;
    if (!slot.budget.Take(RestartBudget::Clock::now())) return GiveUp(slot, *wait_status);
    TREM_ASSIGN_OR_RETURN(slot.pid, StartChild(slot.argv, slot.log_path));
  }
  return {};
}

void LocalFleet::AwaitEnd(const std::vector<Slot*>& slots, std::chrono::milliseconds patience, const std::function<bool()>& in_a_hurry) {
  const auto deadline = std::chrono::steady_clock::now() + patience;
  bool killed = false;
  for (;;) {
    bool any_left = false;
    for (Slot* slot : slots) {
      if (slot->pid > 0 && ReapChild(slot->pid)) slot->pid = -1;
      any_left |= slot->pid > 0;
    }
    if (!any_left) return;
    if (!killed && (std::chrono::steady_clock::now() >= deadline || in_a_hurry())) {
      killed = true;
      for (const Slot* slot : slots) {
        if (slot->pid > 0) ::kill(slot->pid, SIGKILL);
      }
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
}

void LocalFleet::Stop(const std::function<void()>& ask_coordinator, const std::function<bool()>& in_a_hurry) {
  std::vector<Slot*> workers, coordinator;
  for (Slot& slot : slots_) (&slot == &slots_.front() ? coordinator : workers).push_back(&slot);
  for (const Slot* slot : workers) {
    if (slot->pid > 0) ::kill(slot->pid, SIGTERM);
  }
  AwaitEnd(workers, kPatience, in_a_hurry);
  if (coordinator.empty() || coordinator[0]->pid <= 0) return;
  ask_coordinator();
  ::kill(coordinator[0]->pid, SIGTERM);
  AwaitEnd(coordinator, kPatience, in_a_hurry);
}

}  // namespace trem
