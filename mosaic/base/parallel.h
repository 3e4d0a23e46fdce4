#pragma once

#include <functional>

namespace trem {

// Calls body(index, slot) once for every index in [0, count), on up to `threads` threads at once, and on no more than ThreadsMax(). No two
// calls that run at the same time have the same slot in [0, threads): scratch memory may be kept per slot. Which index runs where and when
// is not determined, so what a call writes must be its own and depend on `index` alone; then the result does not depend on `threads`. One
// thread: in order, here, until more are allowed.
void ForEachIndex(int threads, int count, const std::function<void(int index, int slot)>& body);

// How many processors this process may run on.
int ProcessorCount();
// How many threads of this process may compute at once; may change at any time, from any thread. At first as many as there are processors.
int ThreadsMax();
// Values below 1 count as 1, and there are never more than processors.
void SetThreadsMax(int threads);

}  // namespace trem
