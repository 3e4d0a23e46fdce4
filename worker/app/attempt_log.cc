#include "worker/app/attempt_log.h"

#include <algorithm>
#include <utility>

#include "worker/app/done_message.h"

namespace trem {

void AttemptLog::Begin() {
  const std::lock_guard lock(mutex_);
  partial_.clear();
  lines_.clear();
  count_ = 0;
}

void AttemptLog::AddLine(std::string line) {
  if (line.empty()) return;
  if (++count_ <= kLinesMax) lines_.push_back(ToMessageText(line.substr(0, kLineBytesMax)));
}

void AttemptLog::Add(std::string_view bytes) {
  const std::lock_guard lock(mutex_);
  for (std::size_t end = 0; (end = bytes.find('\n')) != std::string_view::npos; bytes.remove_prefix(end + 1)) {
    partial_.append(bytes.substr(0, std::min(end, kLineBytesMax - partial_.size())));
    AddLine(std::exchange(partial_, {}));
  }
  partial_.append(bytes.substr(0, kLineBytesMax - partial_.size()));
}

std::vector<std::string> AttemptLog::Take(bool is_end) {
  const std::lock_guard lock(mutex_);
  if (is_end) {
    AddLine(std::exchange(partial_, {}));
    if (count_ > kLinesMax) lines_.push_back("... and " + std::to_string(count_ - kLinesMax) + " more lines");
  }
  return std::exchange(lines_, {});
}

}  // namespace trem
