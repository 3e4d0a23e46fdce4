#pragma once

#include <cstddef>
#include <memory>
#include <string_view>

namespace zmq {
class message_t;
}

namespace trem {

// The bytes of a chunk beside its envelope: a ZeroMQ frame of its own, which is filled where it is made, read where it arrives, and copied
// nowhere between. Empty when default-made.
class Payload {
 public:
  Payload();
  // `bytes` bytes, whatever they are.
  explicit Payload(std::size_t bytes);
  explicit Payload(zmq::message_t frame);
  ~Payload();
  Payload(Payload&& other) noexcept;
  Payload& operator=(Payload&& other) noexcept;

  char* data();
  std::size_t size() const;
  std::string_view bytes() const;
  // For the channels.
  zmq::message_t& frame() { return *frame_; }

 private:
  std::unique_ptr<zmq::message_t> frame_;  // Never null, but when moved from.
};

// glibc gives large blocks back to the system as soon as they are freed, until the first one of such a size was: each chunk would be
// received into fresh pages, which cost about as much as digesting it. This frees one of the size of all chunks on their way. Once a
// process is enough.
void KeepFreedChunks();

}  // namespace trem
