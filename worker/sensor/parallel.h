#pragma once

#include <functional>

namespace trem {

// Calls body(index, slot) once for every index in [0, count), on up to `threads` threads at once. No two calls that run at the same time
// have the same slot in [0, threads): scratch memory may be kept per slot. Which index runs where and when is not determined, so what a
// call writes must be its own and depend on `index` alone; then the result does not depend on `threads`. threads <= 1: in order, here.
void ForEachIndex(int threads, int count, const std::function<void(int index, int slot)>& body);

}  // namespace trem
