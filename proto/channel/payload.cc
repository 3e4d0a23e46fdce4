#include "proto/channel/payload.h"

#include <cstdlib>
#include <mutex>
#include <utility>
#include <zmq.hpp>

#include "proto/channel/artefact_channel.h"

namespace trem {

Payload::Payload() : frame_(std::make_unique<zmq::message_t>()) {}
Payload::Payload(std::size_t bytes) : frame_(std::make_unique<zmq::message_t>(bytes)) {}
Payload::Payload(zmq::message_t frame) : frame_(std::make_unique<zmq::message_t>(std::move(frame))) {}
Payload::~Payload() = default;
Payload::Payload(Payload&& other) noexcept = default;
Payload& Payload::operator=(Payload&& other) noexcept = default;

char* Payload::data() { return frame_->data<char>(); }
std::size_t Payload::size() const { return frame_->size(); }
std::string_view Payload::bytes() const { return frame_->to_string_view(); }

void KeepFreedChunks() {
  static std::once_flag once;
  std::call_once(once, [] {
    // Volatile: a compiler may leave out what is allocated for nothing.
    void* volatile block = std::malloc(kChunkBytes * kCreditChunks);
    std::free(block);
  });
}

}  // namespace trem
