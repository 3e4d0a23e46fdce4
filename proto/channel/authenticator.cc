#include "proto/channel/authenticator.h"

#include <array>
#include <chrono>
#include <string>
#include <utility>
#include <vector>

#include "proto/channel/socket.h"

namespace trem {
namespace {

constexpr std::size_t kKeyBytes = 32;

// The key of a CURVE request in Z85; empty for a request of any other kind.
std::string KeyOf(const std::vector<std::string>& request) {
  // Version, request id, domain, address, identity, mechanism, credentials.
  if (request.size() != 7 || request[0] != "1.0" || request[5] != "CURVE" || request[6].size() != kKeyBytes) return {};
  std::array<char, kKeyBytes * 5 / 4 + 1> text{};
  if (zmq_z85_encode(text.data(), reinterpret_cast<const std::uint8_t*>(request[6].data()), kKeyBytes) == nullptr) return {};
  return text.data();
}

}  // namespace

Authenticator::Authenticator(zmq::context_t* context, std::shared_ptr<const AllowList> allow_list)
    : allow_list_(std::move(allow_list)), socket_(*context, zmq::socket_type::rep) {
  socket_.set(zmq::sockopt::linger, 0);
  socket_.bind("inproc://zeromq.zap.01");
  thread_ = std::thread([this] { Serve(); });
}

Authenticator::~Authenticator() {
  stop_ = true;
  wake_.Notify();
  thread_.join();
}

void Authenticator::Serve() {
  constexpr std::size_t kFramesMax = 7;
  while (!stop_) {
    RawMessage request;
    if (!WaitFor(&socket_, wake_, ZMQ_POLLIN, std::chrono::hours(1)) || !ReceiveNow(&socket_, kFramesMax, &request)) continue;
    const std::string key = request.is_complete ? KeyOf(request.frames) : std::string();
    const bool allowed = !key.empty() && allow_list_->Find(key).has_value();
    if (!allowed) ++refused_count_;
    // Version, request id, status code, text, user id, metadata.
    const std::array<std::string, 6> reply = {"1.0",
                                              request.frames.size() > 1 ? request.frames[1] : "",
                                              allowed ? "200" : "400",
                                              allowed ? "OK" : "unknown key",
                                              allowed ? key : "",
                                              ""};
    try {
      for (std::size_t i = 0; i < reply.size(); ++i) {
        socket_.send(zmq::buffer(reply[i]), i + 1 < reply.size() ? zmq::send_flags::sndmore : zmq::send_flags::none);
      }
    } catch (const zmq::error_t&) {  // The socket that asked is gone.
    }
  }
}

}  // namespace trem
