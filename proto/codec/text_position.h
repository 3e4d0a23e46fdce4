#pragma once

#include <algorithm>
#include <cstddef>
#include <string_view>

namespace trem {

// A place in a text as editors show it: 1-based, columns counted in bytes.
struct TextPosition {
  std::size_t line = 1;
  std::size_t column = 1;
};

// The position of byte `offset`; one past the end when it is beyond.
inline TextPosition PositionOf(std::string_view text, std::size_t offset) {
  const std::string_view before = text.substr(0, std::min(offset, text.size()));
  const std::size_t line_begin = before.rfind('\n') == std::string_view::npos ? 0 : before.rfind('\n') + 1;
  return {1 + static_cast<std::size_t>(std::count(before.begin(), before.end(), '\n')), 1 + before.size() - line_begin};
}

}  // namespace trem
