#pragma once

#include <cstddef>
#include <mutex>
#include <string>
#include <string_view>
#include <vector>

namespace trem {

// What an attempt's process wrote to stderr, on its way to the coordinator: bounded, so that a chatty library neither fills memory nor the
// line. Thread-safe.
class AttemptLog {
 public:
  static constexpr std::size_t kLinesMax = 200;  // Of an attempt; the others are counted.
  static constexpr std::size_t kLineBytesMax = 1000;

  // A new attempt begins.
  void Begin();
  // Takes bytes as they come; lines end at line ends.
  void Add(std::string_view bytes);
  // Lines that were not taken yet, as valid UTF-8. `is_end`: also a last one that has no end, and how many were left out.
  std::vector<std::string> Take(bool is_end);

 private:
  void AddLine(std::string line);

  std::mutex mutex_;
  std::string partial_;
  std::vector<std::string> lines_;
  std::size_t count_ = 0;
};

}  // namespace trem
