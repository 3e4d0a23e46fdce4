// Question: how fast do artefacts travel through a coordinator's data lane over loopback, beside a plain copy of the files and a bare
// ZeroMQ push of the same bytes? Prints GB/s of each, and the CPU time a gigabyte takes.
//
// Budget: every byte is digested three times on its way (the chunk at either end, the whole at the receiver) and written once; SHA-256 runs
// at about the speed that `digest` prints. So the lane can be no faster than a third of that when both ends share a core, whatever the
// transport.
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
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

template <typename Work>
void Measure(const char* what, double gigabytes, Work work) {
  const double cpu = CpuSeconds();
  const auto start = Clock::now();
  work();
  const double seconds = std::chrono::duration<double>(Clock::now() - start).count();
  std::printf("  %-46s %6.3f GB/s; %5.2f s of CPU time a GB in this process\n", what, gigabytes / seconds,
              (CpuSeconds() - cpu) / gigabytes);
}

void Check(const Status& status) { TREM_CHECK_MSG(status.ok(), status.ToString()); }

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
  std::string folder = (fs::temp_directory_path() / ("trem-data-lane-" + std::to_string(::getpid()))).string();
  CLI::App app("Speed of the data lane beside a plain copy and a bare push.", "data_lane_speed");
  app.add_option("--artefacts", count, "How many")->capture_default_str();
  app.add_option("--mib", mebibytes, "Size of each")->capture_default_str();
  app.add_option("--folder", folder, "Working folder; removed afterwards")->capture_default_str();
  CLI11_PARSE(app, argc, argv);
  fs::create_directories(folder);
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
  const fs::path ready = base / "ready";
  const testing::Subprocess coordinator({testing::BinaryPath("trem-coordinator").string(), "--state", folder + "/state", "--store",
                                         folder + "/store", "--bind", "tcp://127.0.0.1:*", "--ready-file", ready.string(), "--log-level",
                                         "warn"});
  for (int i = 0; i < 1000 && !fs::exists(ready); ++i) std::this_thread::sleep_for(std::chrono::milliseconds(10));
  const std::string endpoint = FirstLine(testing::FileContents(ready));
  std::printf("%d artefacts of %d MiB\n", count, mebibytes);
  Measure("SHA-256 in memory", gigabytes, [&] {
    for (const std::string& block : blocks) (void)Sha256Hex(block);
  });
  Measure("plain copy of the files, each synced", gigabytes, [&] {
    for (std::size_t i = 0; i < refs.size(); ++i)
      Check(CopyFileAtomically(store->Locate(refs[i]).value(), base / ("copy-" + std::to_string(i))));
  });
  Measure("ZeroMQ PUSH to PULL, the same bytes in memory", gigabytes, [&] { PushOverZeroMq(blocks); });
  ArtefactChannel channel(endpoint, {});
  Measure("fetched from the data lane, verified, to files", gigabytes, [&] {
    for (std::size_t i = 0; i < refs.size(); ++i) Check(channel.Fetch(refs[i], base / ("fetched-" + std::to_string(i))));
  });
  for (std::size_t i = 0; i < refs.size(); ++i) fs::remove(store->Locate(refs[i]).value());
  Measure("delivered to the data lane, verified, stored", gigabytes, [&] {
    for (std::size_t i = 0; i < refs.size(); ++i) Check(channel.Deliver(refs[i], base / ("fetched-" + std::to_string(i))));
  });
  fs::remove_all(base);
  return 0;
}
