#pragma once

#include <cstddef>
#include <new>

namespace trem {

// From this size on [bytes] memory is asked for in pages of 2 MiB, where the system has them: it is walked through row by row, so that
// pages of 4 KiB would be looked up more often than the processor remembers them.
inline constexpr std::size_t kLargePagesFrom = std::size_t{4} << 20U;

// Memory for `bytes` >= kLargePagesFrom bytes, aligned to a cache line. Throws std::bad_alloc. Thread-safe.
void* AllocateLarge(std::size_t bytes);
void FreeLarge(void* memory) noexcept;

// std::allocator, but for large blocks.
template <typename T>
struct LargePageAllocator {
  using value_type = T;

  LargePageAllocator() = default;
  template <typename U>
  LargePageAllocator(const LargePageAllocator<U>&) noexcept {}

  T* allocate(std::size_t n) {
    if (n > static_cast<std::size_t>(-1) / sizeof(T)) throw std::bad_array_new_length();
    const std::size_t bytes = n * sizeof(T);
    return static_cast<T*>(bytes >= kLargePagesFrom ? AllocateLarge(bytes) : ::operator new(bytes, std::align_val_t(alignof(T))));
  }
  void deallocate(T* memory, std::size_t n) noexcept {
    if (n * sizeof(T) >= kLargePagesFrom) {
      FreeLarge(memory);
    } else {
      ::operator delete(memory, std::align_val_t(alignof(T)));
    }
  }

  friend bool operator==(const LargePageAllocator&, const LargePageAllocator&) noexcept { return true; }
};

}  // namespace trem
