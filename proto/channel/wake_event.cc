#include "proto/channel/wake_event.h"

#include <sys/eventfd.h>
#include <unistd.h>

#include <cerrno>
#include <cstdint>

#include "mosaic/base/check.h"

namespace trem {

WakeEvent::WakeEvent() : fd_(::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)) { TREM_CHECK_MSG(fd_ >= 0, "eventfd: out of file descriptors"); }

WakeEvent::~WakeEvent() { ::close(fd_); }

void WakeEvent::Notify() const {
  const int saved_errno = errno;  // A signal handler must not disturb the code that it interrupts.
  const std::uint64_t one = 1;
  // Fails only when the counter is full: then a notification is pending anyway.
  [[maybe_unused]] const auto written = ::write(fd_, &one, sizeof one);
  errno = saved_errno;
}

void WakeEvent::Clear() const {
  std::uint64_t count = 0;
  [[maybe_unused]] const auto was_read = ::read(fd_, &count, sizeof count);
}

}  // namespace trem
