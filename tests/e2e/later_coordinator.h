#pragma once

#include <atomic>
#include <string>
#include <thread>
#include <zmq.hpp>

namespace trem::testing {

// A coordinator of a later protocol (version 9): whatever it is asked, it answers in that.
class LaterCoordinator {
 public:
  LaterCoordinator() {
    router_.set(zmq::sockopt::rcvtimeo, 20);
    router_.set(zmq::sockopt::linger, 0);
    router_.bind("tcp://127.0.0.1:*");
    endpoint_ = router_.get(zmq::sockopt::last_endpoint);
    thread_ = std::thread([this] { Serve(); });
  }
  ~LaterCoordinator() {
    stop_ = true;
    thread_.join();
  }
  const std::string& endpoint() const { return endpoint_; }

 private:
  void Serve() {
    while (!stop_) {
      zmq::message_t peer, frame;
      if (!router_.recv(peer)) continue;
      do {
        (void)!router_.recv(frame);
      } while (frame.more());
      router_.send(peer, zmq::send_flags::sndmore);
      router_.send(zmq::buffer(std::string("TREM\x09\0\0\0", 8)), zmq::send_flags::sndmore);
      router_.send(zmq::message_t(), zmq::send_flags::none);
    }
  }

  zmq::context_t context_;
  zmq::socket_t router_{context_, zmq::socket_type::router};
  std::string endpoint_;
  std::atomic<bool> stop_{false};
  std::thread thread_;
};

}  // namespace trem::testing
