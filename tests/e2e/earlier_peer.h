#pragma once

#include <string>
#include <zmq.hpp>

namespace trem::testing {

// Says `body` as a program of protocol version 1 would; returns the header of the answer, empty when there is none within 20 s.
inline std::string AskInEarlierProtocol(const std::string& endpoint, const std::string& body) {
  zmq::context_t context;
  zmq::socket_t socket(context, zmq::socket_type::dealer);
  socket.set(zmq::sockopt::linger, 0);
  socket.set(zmq::sockopt::rcvtimeo, 20'000);
  socket.connect(endpoint);
  socket.send(zmq::buffer(std::string("TREM\x01\0\0\0", 8)), zmq::send_flags::sndmore);
  socket.send(zmq::buffer(body), zmq::send_flags::none);
  zmq::message_t header;
  return socket.recv(header) ? header.to_string() : std::string();
}

}  // namespace trem::testing
