#pragma once

namespace trem {

// Wakes the thread that polls a channel from another thread or from a signal handler.
class WakeEvent {
 public:
  WakeEvent();
  ~WakeEvent();
  WakeEvent(const WakeEvent&) = delete;
  WakeEvent& operator=(const WakeEvent&) = delete;

  // Async-signal-safe, thread-safe; several calls before the poll wake it once.
  void Notify() const;
  // Takes back pending notifications.
  void Clear() const;
  int fd() const { return fd_; }

 private:
  int fd_ = -1;
};

}  // namespace trem
