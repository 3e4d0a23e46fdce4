// A compute process that does to itself what native code does to a real one: the spec's key says what.
#include <sys/resource.h>

#include <algorithm>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <string>
#include <thread>
#include <vector>

#include "mosaic/base/parallel.h"
#include "worker/app/compute_protocol.h"

namespace {

using trem::TaskOutcome;
namespace v1 = trem::v1;

TaskOutcome Misbehave(const v1::TaskSpec& spec, const std::function<bool(double)>& progress) {
  const std::string& what = spec.key();
  if (what == "crash") std::raise(SIGSEGV);
  if (what == "abort") std::abort();
  if (what == "exit") std::_Exit(7);
  if (what == "out-of-memory") std::raise(SIGKILL);
  if (what == "hang") {
    for (;;) std::this_thread::sleep_for(std::chrono::seconds(1));
  }
  if (what == "deaf") {
    for (;; std::this_thread::sleep_for(std::chrono::milliseconds(20))) progress(0.5);
  }
  if (what == "obedient") {
    while (progress(0.25)) std::this_thread::sleep_for(std::chrono::milliseconds(5));
    return trem::Cancelled("as asked");
  }
  if (what == "mutter" || what == "last-words") {
    std::fputs("a corrupt frame\nhalf a line", stderr);
    if (what == "last-words") std::abort();
  }
  if (what == "two") {  // Works until it may use two processors.
    while (trem::ThreadsMax() < std::min(2, trem::ProcessorCount())) progress(0.5);
  }
  if (what == "one" && trem::ThreadsMax() != 1) return trem::Failed("may use " + std::to_string(trem::ThreadsMax()) + " processors");
  if (what == "fail") {
    TaskOutcome outcome = trem::Corrupt("window.pb is damaged");
    outcome.bad_artefacts = {std::string(64, 'a')};
    return outcome;
  }
  if (what == "allocate") {
    const rlimit limit{256U << 20, 256U << 20};
    ::setrlimit(RLIMIT_DATA, &limit);
    try {
      std::vector<char> much(1ULL << 30, 1);
    } catch (const std::bad_alloc&) {
      return trem::Exhausted("out of memory");
    }
  }
  progress(0.5);
  v1::TaskResult result;
  result.add_outputs()->set_name(what);
  return result;
}

}  // namespace

int main(int argc, char** argv) {
  std::signal(SIGTERM, SIG_IGN);
  trem::ServeCompute(std::atoi(argv[argc - 1]), Misbehave);
}
