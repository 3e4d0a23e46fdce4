#include "mosaic/base/large_pages.h"

#include <sys/mman.h>

#include <atomic>
#include <cstdint>
#include <cstdlib>

namespace trem {
namespace {

constexpr std::size_t kPage = std::size_t{2} << 20U;
// Images of one size that are worked on together would have all their rows at the same places of a page, which compete for the same lines
// of the first cache: each block begins some lines later than the one before it.
constexpr std::size_t kShift = 5 * 64;
constexpr unsigned kShifts = 13;

}  // namespace

void* AllocateLarge(std::size_t bytes) {
  static std::atomic<unsigned> count{0};
  const std::size_t shift = kShift * (count.fetch_add(1, std::memory_order_relaxed) % kShifts);
  if (bytes > SIZE_MAX - shift - kPage) throw std::bad_alloc();
  const std::size_t whole = (bytes + shift + kPage - 1) / kPage * kPage;
  void* const block = std::aligned_alloc(kPage, whole);
  if (block == nullptr) throw std::bad_alloc();
  // The rest at the end is left to small pages, so that no more memory is used than was asked for. Not a promise: the system may refuse.
  (void)madvise(block, (bytes + shift) / kPage * kPage, MADV_HUGEPAGE);
  return static_cast<std::byte*>(block) + shift;
}

void FreeLarge(void* memory) noexcept {
  // The shift is less than a page.
  const auto address = reinterpret_cast<std::uintptr_t>(memory);
  std::free(static_cast<std::byte*>(memory) - address % kPage);
}

}  // namespace trem
