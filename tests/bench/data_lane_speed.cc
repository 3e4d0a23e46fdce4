// Question: how fast do artefacts travel through a coordinator's data lane over loopback, beside a plain copy of the files and a bare
// ZeroMQ push of the same bytes, and what does encryption (CURVE, which every address beyond this machine takes) add? Prints GB/s of each,
// and the CPU time that a gigabyte takes: the best of some rounds.
//
// Budget: every byte is digested once, at the receiver, copied into and out of a socket, and written once, as the plain copy does. The
// checksums of the chunks cost a tenth of the digest. So fetching costs about what digest, push and copy cost together. With CURVE every
// byte is encrypted and authenticated at one end and that undone at the other (XSalsa20-Poly1305, in libsodium): about a gigabyte a
// second and core each.
#include <sys/resource.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <memory>
#include <string>
#include <thread>
#include <vector>
#include <zmq.hpp>

#include "mosaic/base/artefact_store.h"
#include "mosaic/base/check.h"
#include "mosaic/base/digest.h"
#include "mosaic/base/file.h"
#include "mosaic/base/rng.h"
#include "proto/channel/artefact_channel.h"
#include "tests/support/paths.h"
#include "tests/support/subprocess.h"

namespace trem {
namespace {

namespace fs = std::filesystem;
using Clock = std::chrono::steady_clock;

std::string FirstLine(const std::string& text) { return text.substr(0, text.find('\n')); }

double CpuSeconds() {
  double seconds = 0.0;
  for (const int who : {RUSAGE_SELF, RUSAGE_CHILDREN}) {
    rusage usage{};
    ::getrusage(who, &usage);
    seconds += static_cast<double>(usage.ru_utime.tv_sec + usage.ru_stime.tv_sec) +
               static_cast<double>(usage.ru_utime.tv_usec + usage.ru_stime.tv_usec) * 1e-6;
  }
  return seconds;
}

// User and system time of another process.
double CpuSecondsOf(pid_t pid) {
  timespec time{};
  clockid_t clock{};
  TREM_CHECK(::clock_getcpuclockid(pid, &clock) == 0 && ::clock_gettime(clock, &time) == 0);
  return static_cast<double>(time.tv_sec) + static_cast<double>(time.tv_nsec) * 1e-9;
}

// The least that any of several rounds took, of wall time and of CPU time here and at the coordinator.
struct Cost {
  double seconds = 1e9, cpu = 1e9, served = 1e9;
};

// A coordinator on the store in `base`, with keys or without.
class Lane {
 public:
  Lane(const fs::path& base, bool with_keys) : name_(with_keys ? "curve" : "plain"), store_((base / "store").string()) {
    const fs::path ready = base / ("ready-" + name_), keys = base / "keys";
    std::vector<std::string> argv = {testing::BinaryPath("trem-coordinator").string(),
                                     "--state",
                                     (base / name_).string(),
                                     "--store",
                                     store_,
                                     "--bind",
                                     "tcp://127.0.0.1:*",
                                     "--ready-file",
                                     ready.string(),
                                     "--log-level",
                                     "error"};
    if (with_keys) {
      for (const char* role : {"coordinator", "worker"}) {
        const auto made = testing::RunProgram({testing::BinaryPath("trem").string(), "keys", role, "--role", role, "-o", keys.string()},
                                              std::chrono::minutes(1));
        TREM_CHECK_MSG(made.exit_code == 0, made.stderr_text);
      }
      argv.insert(argv.end(), {"--key", (keys / "coordinator.key").string(), "--allow", keys.string()});
      auto options = ChannelOptionsOf((keys / "worker.key").string(), (keys / "coordinator.pub").string());
      TREM_CHECK_MSG(options.ok(), options.status().ToString());
      options_ = *std::move(options);
    }
    process_ = std::make_unique<testing::Subprocess>(argv);
    for (int i = 0; i < 1000 && !fs::exists(ready); ++i) std::this_thread::sleep_for(std::chrono::milliseconds(10));
    endpoint_ = FirstLine(testing::FileContents(ready));
  }
  void MeasureBothWays(const std::vector<ArtefactRef>& refs, const ArtefactStore& store, const fs::path& cache_folder);
  void Print(double gigabytes) const;

 private:
  std::string name_, store_, endpoint_;
  ChannelOptions options_;
  std::unique_ptr<testing::Subprocess> process_;
  Cost fetch_, deliver_;
};

template <typename Work>
void Measure(Cost* least, pid_t coordinator, Work work) {
  const double cpu = CpuSeconds(), served = CpuSecondsOf(coordinator);
  const auto start = Clock::now();
  work();
  least->seconds = std::min(least->seconds, std::chrono::duration<double>(Clock::now() - start).count());
  least->cpu = std::min(least->cpu, CpuSeconds() - cpu);
  least->served = std::min(least->served, CpuSecondsOf(coordinator) - served);
}

void Print(const char* what, const Cost& cost, double gigabytes, bool is_served) {
  std::printf("  %-46s %6.3f GB/s; CPU time a GB: %5.2f s", what, gigabytes / cost.seconds, cost.cpu / gigabytes);
  if (is_served) std::printf(", and %5.2f s at the coordinator", cost.served / gigabytes);
  std::printf("\n");
}

void Check(const Status& status) { TREM_CHECK_MSG(status.ok(), status.ToString()); }

// Fetches all of them into a new cache, and delivers them from there to a store that has lost them.
void Lane::MeasureBothWays(const std::vector<ArtefactRef>& refs, const ArtefactStore& store, const fs::path& cache_folder) {
  const auto channel = std::make_shared<ArtefactChannel>(endpoint_, options_);
  const auto cache = ArtefactStore::OpenCache(cache_folder, channel);
  Check(cache.status());
  std::vector<fs::path> fetched;
  Measure(&fetch_, process_->pid(), [&] {
    for (const ArtefactRef& ref : refs) fetched.push_back(cache->Locate(ref).value());
  });
  for (const ArtefactRef& ref : refs) fs::remove(store.Locate(ref).value());
  Measure(&deliver_, process_->pid(), [&] {
    for (std::size_t i = 0; i < refs.size(); ++i) Check(channel->Deliver(refs[i], fetched[i]));
  });
  fs::remove_all(cache_folder);
}

void Lane::Print(double gigabytes) const {
  const bool with_keys = options_.own_key.has_value();
  ::trem::Print(with_keys ? "fetched, verified, synced; over CURVE" : "fetched from the data lane, verified, synced", fetch_, gigabytes,
                true);
  ::trem::Print(with_keys ? "delivered, verified, synced; over CURVE" : "delivered to the data lane, verified, synced", deliver_, gigabytes,
                true);
}

void PushOverZeroMq(const std::vector<std::string>& blocks) {
  zmq::context_t context(1);
  zmq::socket_t pull(context, zmq::socket_type::pull);
  pull.bind("tcp://127.0.0.1:*");
  const std::string endpoint = pull.get(zmq::sockopt::last_endpoint);
  std::thread pusher([&] {
    zmq::socket_t push(context, zmq::socket_type::push);
    push.connect(endpoint);
    for (const std::string& block : blocks) {
      for (std::size_t at = 0; at < block.size(); at += 1 << 20) {
        push.send(zmq::buffer(block.data() + at, std::min<std::size_t>(1 << 20, block.size() - at)), zmq::send_flags::none);
      }
    }
  });
  std::size_t total = 0, received = 0;
  for (const std::string& block : blocks) total += block.size();
  while (received < total) {
    zmq::message_t message;
    (void)pull.recv(message);
    received += message.size();
  }
  pusher.join();
}

}  // namespace
}  // namespace trem

int main(int argc, char** argv) {
  using namespace trem;
  int count = 8;
  int mebibytes = 64;
  int rounds = 3;
  std::string folder = (fs::temp_directory_path() / ("trem-data-lane-" + std::to_string(::getpid()))).string();
  CLI::App app("Speed of the data lane beside a plain copy and a bare push.", "data_lane_speed");
  app.add_option("--artefacts", count, "How many")->capture_default_str();
  app.add_option("--mib", mebibytes, "Size of each")->capture_default_str();
  app.add_option("--rounds", rounds, "The best of so many counts")->check(CLI::Range(1, 1000))->capture_default_str();
  app.add_option("--folder", folder, "Working folder; removed afterwards")->capture_default_str();
  CLI11_PARSE(app, argc, argv);
  fs::create_directories(folder + "/copies");
  const fs::path base = folder;
  const auto store = ArtefactStore::Open(base / "store");
  Check(store.status());
  std::vector<std::string> blocks;
  std::vector<ArtefactRef> refs;
  for (int i = 0; i < count; ++i) {
    Rng rng({7, static_cast<std::uint64_t>(i)});
    std::string block(static_cast<std::size_t>(mebibytes) << 20, '\0');
    for (std::size_t at = 0; at + 8 <= block.size(); at += 8) {
      const std::uint64_t bits = rng();
      std::copy_n(reinterpret_cast<const char*>(&bits), 8, block.data() + at);
    }
    auto ref = store->PutBytes("block", block);
    Check(ref.status());
    refs.push_back(*ref);
    blocks.push_back(std::move(block));
  }
  const double gigabytes = static_cast<double>(count) * mebibytes * (1 << 20) / 1e9;
  Lane plain(base, false), curve(base, true);
  std::printf("%d artefacts of %d MiB\n", count, mebibytes);
  Cost digest, copy, push;
  for (int round = 0; round < rounds; ++round) {
    Measure(&digest, ::getpid(), [&] {
      for (const std::string& block : blocks) (void)Sha256Hex(block);
    });
    Measure(&copy, ::getpid(), [&] {
      for (const ArtefactRef& ref : refs) Check(CopyFileAtomically(store->Locate(ref).value(), base / "copies" / ref.sha256));
    });
    // Removed before others write: pages that the system has at hand are cheaper than those that it has to find.
    for (const fs::directory_entry& file : fs::directory_iterator(base / "copies")) fs::remove(file.path());
    Measure(&push, ::getpid(), [&] { PushOverZeroMq(blocks); });
    plain.MeasureBothWays(refs, *store, base / "cache");
    curve.MeasureBothWays(refs, *store, base / "cache");
  }
  Print("SHA-256 in memory", digest, gigabytes, false);
  Print("plain copy of the files, each synced", copy, gigabytes, false);
  Print("ZeroMQ PUSH to PULL, the same bytes in memory", push, gigabytes, false);
  plain.Print(gigabytes);
  curve.Print(gigabytes);
  fs::remove_all(base);
  return 0;
}
