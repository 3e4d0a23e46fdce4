#pragma once

#include <string>
#include <string_view>
#include <vector>

namespace trem {

// The candidate that `word` was probably meant to be: the one with the least edit distance (insert, delete, replace, swap of neighbours),
// if that is at most a third of the word's length, at least 1; the first of equals. Empty when none is close.
std::string ClosestWord(std::string_view word, const std::vector<std::string>& candidates);

}  // namespace trem
