#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <thread>
#include <zmq.hpp>

#include "proto/channel/keys.h"
#include "proto/channel/wake_event.h"

namespace trem {

// Answers libzmq's question whether a CURVE key may come in (ZAP, ZeroMQ RFC 27), on a thread of its own, until destroyed. One per context.
class Authenticator {
 public:
  // Throws zmq::error_t.
  Authenticator(zmq::context_t* context, std::shared_ptr<const AllowList> allow_list);
  ~Authenticator();
  Authenticator(const Authenticator&) = delete;
  Authenticator& operator=(const Authenticator&) = delete;

  // Connections whose key was not in the list.
  std::uint64_t refused_count() const { return refused_count_; }

 private:
  void Serve();

  std::shared_ptr<const AllowList> allow_list_;
  zmq::socket_t socket_;
  WakeEvent wake_;
  std::atomic<bool> stop_{false};
  std::atomic<std::uint64_t> refused_count_{0};
  std::thread thread_;
};

}  // namespace trem
