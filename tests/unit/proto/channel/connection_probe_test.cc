// Goal: a probe tells apart what a silent channel hides: nobody there, a key that is not let in, another coordinator's key, keys on one
// side only. Method: real sockets on loopback, one for each case, polled on a thread as a coordinator would.
#include "proto/channel/connection_probe.h"

#include <gtest/gtest.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <filesystem>
#include <string>
#include <thread>
#include <zmq.hpp>

#include "proto/channel/router_channel.h"
#include "tests/support/paths.h"

namespace trem {
namespace {

namespace fs = std::filesystem;
using std::chrono::milliseconds;

constexpr milliseconds kPatience{2000};

// A coordinator's socket that is polled until the end.
class Listener {
 public:
  explicit Listener(const std::string& endpoint, const ChannelOptions& options = {})
      : channel_(std::move(RouterChannel::Bind(endpoint, options)).value()), thread_([this] {
          while (!stop_) (void)channel_->Poll(milliseconds(20));
        }) {}
  ~Listener() {
    stop_ = true;
    thread_.join();
  }
  const std::string& endpoint() const { return channel_->endpoint(); }

 private:
  std::unique_ptr<RouterChannel> channel_;
  std::atomic<bool> stop_{false};
  std::thread thread_;
};

// Greets whoever connects as a side with this mechanism does (ZMTP 3.0, RFC 23) and never hangs up first, so that its greeting is read.
class Greeter {
 public:
  explicit Greeter(const std::string& mechanism) : greeting_(64, '\0') {
    greeting_[0] = '\xff';
    greeting_[9] = '\x7f';
    greeting_[10] = 3;
    greeting_.replace(12, mechanism.size(), mechanism);
    socket_.set(zmq::sockopt::rcvtimeo, 20);
    socket_.bind("tcp://127.0.0.1:*");
    thread_ = std::thread([this] { Greet(); });
  }
  ~Greeter() {
    stop_ = true;
    thread_.join();
  }
  std::string endpoint() const { return socket_.get(zmq::sockopt::last_endpoint); }

 private:
  void Greet() {
    zmq::message_t peer, data;
    while (!stop_) {
      if (!socket_.recv(peer) || !socket_.recv(data) || data.size() > 0) continue;
      try {  // Nothing comes for a connection that begins, and for one that has ended, which takes no answer or would be waited for.
        if (socket_.send(peer, zmq::send_flags::sndmore | zmq::send_flags::dontwait))
          socket_.send(zmq::buffer(greeting_), zmq::send_flags::none);
      } catch (const zmq::error_t& error) {
        if (error.num() != EHOSTUNREACH) throw;
      }
    }
  }

  std::string greeting_;
  zmq::context_t context_;
  zmq::socket_t socket_{context_, zmq::socket_type::stream};
  std::atomic<bool> stop_{false};
  std::thread thread_;
};

class ConnectionProbeTest : public ::testing::Test {
 protected:
  ConnectionProbeTest() {
    const fs::path allowed = folder_ / "allowed";
    fs::create_directories(allowed);
    with_keys_.own_key = coordinator_;
    EXPECT_TRUE(WriteKeyFiles(folder_ / "keys", client_).ok());
    fs::copy_file(folder_ / "keys" / "client.pub", allowed / "client.pub");
    with_keys_.allow_list = AllowList::Open(allowed).value();
  }
  static ChannelOptions As(const v1::KeyFile& key, const v1::KeyFile& coordinator) {
    ChannelOptions options;
    options.own_key = key;
    options.coordinator_public_key = coordinator.public_key();
    return options;
  }
  Reach Probe(const std::string& endpoint, const ChannelOptions& options = {}) const {
    return ProbeConnection(endpoint, options, kPatience).value();
  }

  testing::TempDir folder_;
  v1::KeyFile coordinator_ = MakeKey("hill", v1::COORDINATOR).value();
  v1::KeyFile client_ = MakeKey("client", v1::CLIENT).value();
  v1::KeyFile stranger_ = MakeKey("stranger", v1::CLIENT).value();
  ChannelOptions with_keys_;
};

TEST_F(ConnectionProbeTest, FindsACoordinatorThatLetsItIn) {
  const Listener plain("tcp://127.0.0.1:*");
  EXPECT_EQ(Probe(plain.endpoint()), Reach::kReady);
  const Listener secure("tcp://127.0.0.1:*", with_keys_);
  EXPECT_EQ(Probe(secure.endpoint(), As(client_, coordinator_)), Reach::kReady);
  const Listener file("ipc://" + (folder_ / "socket").string());
  EXPECT_EQ(Probe(file.endpoint()), Reach::kReady);
}

TEST_F(ConnectionProbeTest, FindsThatNobodyListens) {
  EXPECT_EQ(Probe("tcp://127.0.0.1:1"), Reach::kNobodyListens);
  EXPECT_EQ(Probe("ipc://" + (folder_ / "nothing").string()), Reach::kNobodyListens);
}

// A listener whose queue of connections is full: what comes further gets no answer, as behind a firewall.
TEST_F(ConnectionProbeTest, FindsThatNothingComesBack) {
  const int listener = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  socklen_t size = sizeof address;
  ASSERT_EQ(::bind(listener, reinterpret_cast<const sockaddr*>(&address), size), 0);
  ASSERT_EQ(::listen(listener, 0), 0);
  ASSERT_EQ(::getsockname(listener, reinterpret_cast<sockaddr*>(&address), &size), 0);
  std::vector<int> waiting;
  for (int i = 0; i < 4; ++i) {
    waiting.push_back(::socket(AF_INET, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0));
    (void)::connect(waiting.back(), reinterpret_cast<const sockaddr*>(&address), size);
  }
  EXPECT_EQ(Probe("tcp://127.0.0.1:" + std::to_string(ntohs(address.sin_port))), Reach::kNoWay);
  for (const int fd : waiting) ::close(fd);
  ::close(listener);
}

TEST_F(ConnectionProbeTest, TellsAKeyThatIsNotAllowedFromAnotherCoordinators) {
  const Listener secure("tcp://127.0.0.1:*", with_keys_);
  EXPECT_EQ(Probe(secure.endpoint(), As(stranger_, coordinator_)), Reach::kKeyNotAllowed);
  const v1::KeyFile other = MakeKey("valley", v1::COORDINATOR).value();
  EXPECT_EQ(Probe(secure.endpoint(), As(client_, other)), Reach::kOtherKey);
}

TEST_F(ConnectionProbeTest, FindsThatOnlyOneSideUsesKeys) {
  const Greeter secure("CURVE");
  EXPECT_EQ(Probe(secure.endpoint()), Reach::kKeysDiffer);
  const Greeter plain("NULL");
  EXPECT_EQ(Probe(plain.endpoint(), As(client_, coordinator_)), Reach::kKeysDiffer);
}

// Of two sides whose mechanisms differ, the one that reads the other's greeting first hangs up. Where that is always the listener, its own
// is lost with the connection, and the probe knows no more than that it was hung up on; it never takes it for something else.
TEST_F(ConnectionProbeTest, IsHungUpOnByAListenerThatReadsItsGreetingFirst) {
  const auto tells = [](Reach reach) { return reach == Reach::kKeysDiffer || reach == Reach::kOtherKey; };
  const Listener secure("tcp://127.0.0.1:*", with_keys_);
  EXPECT_TRUE(tells(Probe(secure.endpoint())));
  const Listener plain("tcp://127.0.0.1:*");
  EXPECT_TRUE(tells(Probe(plain.endpoint(), As(client_, coordinator_))));
}

TEST_F(ConnectionProbeTest, RefusesAnEndpointThatIsNone) {
  EXPECT_EQ(ProbeConnection("http://127.0.0.1:1", {}, kPatience).status().code(), StatusCode::kInvalidInput);
}

}  // namespace
}  // namespace trem
