#pragma once

#include <string>
#include <string_view>
#include <vector>

namespace trem {

// "; did you mean 'ratio'?" for the candidate nearest to `word` (edits and swaps of neighbours, without regard to case; at most a
// third of the word's length or 2, 1 for words of less than four letters; the first of equals), or "" when none is near.
std::string DidYouMean(std::string_view word, const std::vector<std::string>& candidates);

}  // namespace trem
