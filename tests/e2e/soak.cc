#include "tests/e2e/soak.h"

#include <signal.h>
#include <sys/mount.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <fstream>
#include <nlohmann/json.hpp>
#include <thread>
#include <utility>

#include "tests/support/loopback.h"

namespace trem::testing {
namespace {

namespace fs = std::filesystem;
using std::chrono::milliseconds;
using std::chrono::seconds;

constexpr const char* kJob = "soak";
constexpr int kStateBytes = 24 << 20;
constexpr std::uint64_t kStream = 0x736f616b;

void Sleep(int ms) { std::this_thread::sleep_for(milliseconds(ms)); }

}  // namespace

Soak::Soak(const SoakOptions& options) : options_(options), rng_({options.seed, kStream}) {
  PrepareEndpoint();
  fs::create_directories(state_);
  const std::string size = "size=" + std::to_string(kStateBytes);
  can_fill_disk_ = ::mount("tmpfs", state_.c_str(), "tmpfs", 0, size.c_str()) == 0;
}

Soak::~Soak() {
  workers_.clear();
  coordinator_.reset();
  if (can_fill_disk_) ::umount2(state_.c_str(), MNT_DETACH);
}

// A local socket; or, with a link, an address that its other side reaches, and the keys that this takes.
void Soak::PrepareEndpoint() {
  link_ = NetworkLink::Make(&why_no_link_);
  endpoint_ = "ipc://" + (fixture_.folder() / "socket").string();
  if (!link_) return;
  endpoint_ = "tcp://" + link_->address() + ":" + std::to_string(FreeLoopbackPort());
  fs::create_directories(KeyPath("allowed"));
  for (const auto& [name, role] : {std::pair("hill", "coordinator"), std::pair("fleet", "worker"), std::pair("ann", "client")}) {
    (void)fixture_.Run({BinaryPath("trem").string(), "keys", name, "--role", role, "-o", KeyPath("").string()});
    if (std::string(role) != "coordinator")
      fs::copy_file(KeyPath(std::string(name) + ".pub"), KeyPath("allowed") / (std::string(name) + ".pub"));
  }
}

void Soak::StartCoordinator() {
  std::vector<std::string> argv = {BinaryPath("trem-coordinator").string(),
                                   "--state",
                                   state_.string(),
                                   "--store",
                                   store_.string(),
                                   "--bind",
                                   endpoint_,
                                   "--lease-ms",
                                   "8000",
                                   "--log-level",
                                   "error"};
  if (link_) argv.insert(argv.end(), {"--key", KeyPath("hill.key").string(), "--allow", KeyPath("allowed").string()});
  coordinator_ = std::make_unique<Subprocess>(argv, fixture_.Options());
}

void Soak::StartWorker(int index) {
  const bool is_far = link_ && index % 2 == 1;
  std::vector<std::string> argv = is_far ? link_->Prefix() : std::vector<std::string>();
  argv.insert(argv.end(), {BinaryPath("trem-worker").string(), "serve", "--coordinator", endpoint_, "--log-level", "error"});
  if (!is_far) argv.insert(argv.end(), {"--store", store_.string()});
  if (link_) {
    argv.insert(argv.end(), {"--key", KeyPath("fleet.key").string(), "--coordinator-key", KeyPath("hill.pub").string(), "--source-root",
                             fixture_.folder().path().string()});
  }
  workers_[static_cast<std::size_t>(index)] = std::make_unique<Subprocess>(argv, fixture_.Options());
}

Completed Soak::Trem(std::vector<std::string> arguments) const {
  arguments.insert(arguments.begin(), BinaryPath("trem").string());
  SubprocessOptions options = fixture_.Options();
  options.environment.push_back("TREM_COORDINATOR=" + endpoint_);
  if (link_) {
    options.environment.push_back("TREM_KEY=" + KeyPath("ann.key").string());
    options.environment.push_back("TREM_COORDINATOR_KEY=" + KeyPath("hill.pub").string());
  }
  return RunProgram(arguments, std::chrono::minutes(2), options);
}

// Flips a byte in the middle of some object; not of what EXPORT has made, for which nobody would ask again.
void Soak::DamageAnArtefact() {
  if (StateOfJob() != "running" || is_exporting_) return;
  std::vector<fs::path> objects;
  std::error_code error;
  for (fs::recursive_directory_iterator it(store_ / "objects", error), end; !error && it != end; it.increment(error)) {
    std::error_code ignored;
    if (it->is_regular_file(ignored)) objects.push_back(it->path());
  }
  if (objects.empty()) return;
  std::sort(objects.begin(), objects.end());
  std::fstream file(objects[rng_.UniformIndex(static_cast<std::uint32_t>(objects.size()))],
                    std::ios::in | std::ios::out | std::ios::binary);
  file.seekg(0, std::ios::end);
  const auto middle = file.tellg() / 2;
  file.seekg(middle);
  const int byte = file.get();
  file.seekp(middle);
  file.put(static_cast<char>(byte ^ 0x40));
  Count("artefact damaged");
}

void Soak::FillTheDisk() {
  const fs::path ballast = state_ / "ballast";
  {
    std::ofstream file(ballast, std::ios::binary);
    const std::string block(1 << 14, 'x');
    while (file.write(block.data(), static_cast<std::streamsize>(block.size())).flush()) {
    }
  }
  Sleep(1'500);
  fs::remove(ballast);
  Count("disk filled");
}

// Shorter than a lease, about as long as a worker may be silent, or longer than both.
void Soak::CutTheLink() {
  const int ms = static_cast<int>(300 + rng_.UniformIndex(5'700));
  if (!link_->Cut()) return;
  Sleep(ms);
  if (link_->Mend()) Count("link cut");
}

void Soak::Disturb(Disturbance kind) {
  const auto index = static_cast<int>(rng_.UniformIndex(static_cast<std::uint32_t>(options_.worker_count)));
  Subprocess& worker = *workers_[static_cast<std::size_t>(index)];
  switch (kind) {
    case Disturbance::kKillWorker:
      worker.Signal(SIGKILL);
      (void)worker.Wait(seconds(10));
      StartWorker(index);
      return Count("worker killed");
    case Disturbance::kKillCoordinator:
      coordinator_->Signal(SIGKILL);
      (void)coordinator_->Wait(seconds(10));
      StartCoordinator();
      return Count("coordinator killed");
    case Disturbance::kKillCompute: {
      const std::vector<pid_t> children = worker.Descendants();
      if (children.empty()) return;
      ::kill(children[0], SIGKILL);
      return Count("compute process killed");
    }
    case Disturbance::kStopWorker:
      worker.Signal(SIGSTOP);
      Sleep(static_cast<int>(200 + rng_.UniformIndex(2'500)));
      worker.Signal(SIGCONT);
      return Count("worker stopped for a while");
    case Disturbance::kStopCoordinator:
      coordinator_->Signal(SIGSTOP);
      Sleep(static_cast<int>(200 + rng_.UniformIndex(5'800)));
      coordinator_->Signal(SIGCONT);
      return Count("coordinator stopped for a while");
    case Disturbance::kDamageArtefact:
      return DamageAnArtefact();
    case Disturbance::kFillDisk:
      if (can_fill_disk_) FillTheDisk();
      return;
    case Disturbance::kCutLink:
      if (link_) CutTheLink();
      return;
  }
}

Soak::Disturbance Soak::NextDisturbance() {
  if (deck_.empty()) {
    // How often each comes in a round; a round holds every kind, so that a job that ends early has met all of them.
    constexpr std::array<std::pair<Disturbance, int>, 8> kRound = {{{Disturbance::kKillWorker, 6},
                                                                    {Disturbance::kKillCoordinator, 3},
                                                                    {Disturbance::kKillCompute, 2},
                                                                    {Disturbance::kStopWorker, 2},
                                                                    {Disturbance::kStopCoordinator, 1},
                                                                    {Disturbance::kDamageArtefact, 2},
                                                                    {Disturbance::kFillDisk, 1},
                                                                    {Disturbance::kCutLink, 2}}};
    // The first round is one of each.
    const bool is_first = counts_.empty();
    for (const auto& [kind, times] : kRound) deck_.insert(deck_.end(), is_first ? 1 : static_cast<std::size_t>(times), kind);
    for (std::size_t left = deck_.size(); left > 1; --left) {
      std::swap(deck_[left - 1], deck_[rng_.UniformIndex(static_cast<std::uint32_t>(left))]);
    }
  }
  const Disturbance next = deck_.back();
  deck_.pop_back();
  return next;
}

// "running", "done", ...; empty when nobody answers.
std::string Soak::StateOfJob() {
  const Completed status = Trem({"status", kJob, "--json"});
  if (status.exit_code != 0) return "";
  const auto json = nlohmann::json::parse(status.stdout_text, nullptr, false);
  if (json.is_discarded()) return "";
  task_count_ = 0;
  progress_.clear();
  for (const auto& stage : json["stages"]) {
    const int total = stage["total"].get<int>();
    task_count_ += total;
    progress_ += ", " + stage["kind"].get<std::string>() + " " + std::to_string(stage["done"].get<int>()) + "/" + std::to_string(total);
    is_exporting_ = stage["kind"] == "export" && stage["running"].get<int>() + stage["done"].get<int>() > 0;
  }
  return json["state"];
}

bool Soak::AwaitEnd(std::chrono::seconds patience) {
  const auto deadline = std::chrono::steady_clock::now() + patience;
  while (std::chrono::steady_clock::now() < deadline) {
    const std::string state = StateOfJob();
    if (!state.empty() && state != "running") return true;
    Sleep(300);
  }
  return false;
}

bool Soak::AwaitWorkers(std::chrono::seconds patience) const {
  const auto deadline = std::chrono::steady_clock::now() + patience;
  while (std::chrono::steady_clock::now() < deadline) {
    const auto json = nlohmann::json::parse(Trem({"workers", "--json"}).stdout_text, nullptr, false);
    const auto is_there = [&](const auto& worker) {
      const std::string pid = "-" + std::to_string(worker->pid()) + "-";
      return std::any_of(json.begin(), json.end(), [&](const auto& listed) {
        return listed["worker_id"].template get<std::string>().find(pid) != std::string::npos;
      });
    };
    if (json.is_array() && std::all_of(workers_.begin(), workers_.end(), is_there)) return true;
    Sleep(200);
  }
  return false;
}

int Soak::kill_count() const {
  int kills = 0;
  for (const auto& [what, count] : counts_) kills += what.ends_with(" killed") ? count : 0;
  return kills;
}

bool Soak::IsEnough(int disturbances) const {
  return options_.kill_count > 0 ? kill_count() >= options_.kill_count : disturbances >= options_.disturbance_count;
}

void Soak::TellProgress() {
  if (!options_.tell) return;
  const auto elapsed = std::chrono::duration_cast<seconds>(std::chrono::steady_clock::now() - submitted_);
  options_.tell(std::to_string(elapsed.count()) + " s, " + std::to_string(kill_count()) + " kills" + progress_);
}

void Soak::DisturbForLong() {
  for (int disturbances = 0; !IsEnough(disturbances); ++disturbances) {
    if (disturbances % 8 == 7) {
      const std::string state = StateOfJob();
      TellProgress();
      if (!state.empty() && state != "running") break;
    }
    Sleep(options_.pause_ms_max / 8 + static_cast<int>(rng_.UniformIndex(static_cast<std::uint32_t>(options_.pause_ms_max))));
    Disturb(NextDisturbance());
  }
}

std::vector<std::string> Soak::Run() {
  // The truth has room for a path of 150 px: many frames go slower.
  const std::string speed = std::to_string(std::min(1.0, 140.0 / options_.frame_count));
  const fs::path sortie = fixture_.SimulateSortie("sortie", options_.frame_count, {"--speed-px", speed}) / "sortie.textproto";
  const fs::path peace = fixture_.NewFolder("peace");
  const auto begun = std::chrono::steady_clock::now();
  const Completed reference = fixture_.Run(RunFixture::RunArguments(sortie, peace / "town.tif", {"--workers", "2", "--quiet"}));
  peaceful_time_ = std::chrono::duration_cast<milliseconds>(std::chrono::steady_clock::now() - begun);
  if (reference.exit_code != 0) return {"the undisturbed run failed: " + reference.stderr_text};

  StartCoordinator();
  workers_.resize(static_cast<std::size_t>(options_.worker_count));
  for (int i = 0; i < options_.worker_count; ++i) StartWorker(i);
  std::vector<std::string> submit = {"submit", sortie.string(), "--job-id", kJob};
  const std::vector<std::string> run = RunFixture::RunArguments(sortie, "");
  for (std::size_t i = 0; i + 1 < run.size(); ++i) {
    if (run[i] == "--set") submit.insert(submit.end(), {run[i], run[i + 1]});
  }
  if (const Completed submitted = Trem(submit); submitted.exit_code != 0) return {"submit failed: " + submitted.stderr_text};

  submitted_ = std::chrono::steady_clock::now();
  DisturbForLong();
  std::vector<std::string> faults;
  if (kill_count() < options_.kill_count) {
    faults.push_back("the job ended after " + std::to_string(kill_count()) + " kills of " + std::to_string(options_.kill_count) +
                     ": give it more frames, or shorter pauses");
  }
  if (!AwaitEnd(seconds(600))) faults.push_back("the job does not end although nothing disturbs it any more");
  disturbed_time_ = std::chrono::duration_cast<milliseconds>(std::chrono::steady_clock::now() - submitted_);
  if (const std::string state = StateOfJob(); state != "done") {
    faults.push_back("the job is " + state + ": " + Trem({"status", kJob}).stdout_text);
  }
  const fs::path out = fixture_.NewFolder("out");
  Completed fetched = Trem({"fetch", kJob, "-o", (out / "town.tif").string()});
  if (fetched.exit_code != 0) faults.push_back("fetch failed: " + fetched.stderr_text);
  if (FilesIn(out) != FilesIn(peace)) faults.push_back("the published files are not those of the undisturbed run");

  // One that was started a moment ago has no handler yet: the signal would end it as if it had failed.
  if (!AwaitWorkers(seconds(30))) faults.push_back("not every worker has found back: " + Trem({"workers"}).stdout_text);
  for (const auto& worker : workers_) worker->Signal(SIGTERM);
  for (const auto& worker : workers_) {
    const auto exit = worker->Wait(seconds(30));
    if (!exit) faults.push_back("a worker did not leave within 30 s: " + worker->Stderr());
    if (exit && exit->code != 0) faults.push_back("a worker left with exit code " + std::to_string(exit->code) + ": " + worker->Stderr());
    if (!worker->DescendantsAfter(seconds(5)).empty()) faults.push_back("a worker left a compute process behind");
  }
  coordinator_->Signal(SIGTERM);
  if (const auto exit = coordinator_->Wait(seconds(30)); !exit || exit->code != 0) faults.push_back("the coordinator did not end");
  return faults;
}

}  // namespace trem::testing
