#include "coordinator/cli/interrupt.h"

#include <signal.h>

#include <atomic>

namespace trem {
namespace {

std::atomic<int> first_signal{0};
std::atomic<int> signal_count{0};
static_assert(std::atomic<int>::is_always_lock_free, "only lock-free atomics may be used in a signal handler");

void HandleInterrupt(int signal_number) {
  int none = 0;
  first_signal.compare_exchange_strong(none, signal_number);
  signal_count.fetch_add(1);
}

}  // namespace

void CountInterrupts() {
  struct sigaction action {};
  action.sa_handler = HandleInterrupt;
  ::sigemptyset(&action.sa_mask);  // Without SA_RESTART: polls and sleeps return at once.
  for (const int signal_number : {SIGINT, SIGTERM, SIGHUP}) ::sigaction(signal_number, &action, nullptr);
  struct sigaction ignore {};
  ignore.sa_handler = SIG_IGN;
  ::sigaction(SIGPIPE, &ignore, nullptr);
}

int InterruptSignal() { return first_signal.load(); }
int InterruptCount() { return signal_count.load(); }

}  // namespace trem
