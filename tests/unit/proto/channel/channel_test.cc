// Goal: the channel carries envelopes both ways, survives garbage and oversize messages, reports vanished peers, reconnects, and can be
// woken. Method: real sockets over ipc in a temporary folder; raw libzmq sockets play the peers that misbehave.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <stdlib.h>

#include <atomic>
#include <csignal>
#include <filesystem>
#include <thread>
#include <zmq.hpp>

#include "proto/channel/dealer_channel.h"
#include "proto/channel/router_channel.h"

namespace trem {
namespace {

namespace fs = std::filesystem;
using std::chrono::milliseconds;
using ::testing::HasSubstr;
using ::testing::StartsWith;

constexpr milliseconds kLong{10000};  // Never waited for when all is well.
constexpr milliseconds kShort{100};

class ChannelTest : public ::testing::Test {
 protected:
  void SetUp() override {
    std::string pattern = (fs::temp_directory_path() / "trem-channel-XXXXXX").string();
    ASSERT_NE(::mkdtemp(pattern.data()), nullptr);
    folder_ = pattern;
    endpoint_ = "ipc://" + (folder_ / "socket").string();
  }
  void TearDown() override { fs::remove_all(folder_); }

  std::unique_ptr<RouterChannel> Router(const ChannelOptions& options = {}) {
    auto router = RouterChannel::Bind(endpoint_, options);
    TREM_CHECK_MSG(router.ok(), router.status().message());
    return std::move(router).value();
  }
  std::unique_ptr<DealerChannel> Dealer() {
    auto dealer = DealerChannel::Connect(endpoint_);
    TREM_CHECK_MSG(dealer.ok(), dealer.status().message());
    return std::move(dealer).value();
  }

  fs::path folder_;
  std::string endpoint_;
};

v1::Envelope Heartbeat() {
  v1::Envelope envelope;
  envelope.mutable_heartbeat();
  return envelope;
}

v1::Envelope GoodbyeOf(const std::string& reason) {
  v1::Envelope envelope;
  envelope.mutable_goodbye()->set_reason(reason);
  return envelope;
}

std::optional<RouterChannel::Incoming> Next(RouterChannel* router) { return router->Poll(kLong); }

TEST_F(ChannelTest, CarriesEnvelopesBothWays) {
  auto router = Router();
  auto dealer = Dealer();
  ASSERT_TRUE(dealer->Send(GoodbyeOf("hello"), kLong).ok());
  const auto incoming = Next(router.get());
  ASSERT_TRUE(incoming.has_value());
  ASSERT_TRUE(incoming->envelope.ok());
  EXPECT_EQ(incoming->envelope->goodbye().reason(), "hello");
  ASSERT_TRUE(router->Send(incoming->peer, Heartbeat()));
  const auto reply = dealer->Receive(kLong);
  ASSERT_TRUE(reply.ok() && reply->has_value());
  EXPECT_TRUE((*reply)->has_heartbeat());
}

TEST_F(ChannelTest, CarriesTheBytesOfChunksBesideThem) {
  auto router = Router();
  auto dealer = Dealer();
  const std::string text = std::string(100'000, 'x') + "end";
  const auto payload_of = [&text] {
    Payload payload(text.size());
    std::copy(text.begin(), text.end(), payload.data());
    return payload;
  };
  v1::Envelope put, chunk;
  put.mutable_put_chunk()->set_sha256(std::string(64, 'a'));
  put.mutable_put_chunk()->set_bytes(text.size());
  chunk.mutable_chunk()->set_sha256(std::string(64, 'a'));
  ASSERT_TRUE(dealer->Send(put, kLong, payload_of()).ok());
  const auto incoming = Next(router.get());
  ASSERT_TRUE(incoming && incoming->envelope.ok());
  EXPECT_TRUE(incoming->envelope->has_put_chunk());
  EXPECT_TRUE(incoming->payload.bytes() == text);
  ASSERT_TRUE(router->Send(incoming->peer, chunk, payload_of()));
  Payload arrived;
  const auto reply = dealer->Receive(kLong, &arrived);
  ASSERT_TRUE(reply.ok() && reply->has_value());
  EXPECT_TRUE(arrived.bytes() == text);
  EXPECT_EQ(router->counters().garbage + dealer->garbage_count(), 0U);
}

TEST_F(ChannelTest, WorksOverLoopbackTcpAndNamesTheRealPort) {
  endpoint_ = "tcp://127.0.0.1:*";
  auto router = Router();
  EXPECT_THAT(router->endpoint(), StartsWith("tcp://127.0.0.1:"));
  EXPECT_EQ(router->endpoint().find('*'), std::string::npos);
  endpoint_ = router->endpoint();
  auto dealer = Dealer();
  ASSERT_TRUE(dealer->Send(Heartbeat(), kLong).ok());
  ASSERT_TRUE(Next(router.get()).has_value());
}

TEST_F(ChannelTest, RefusesAddressesThatWouldNeedKeys) {
  for (const char* endpoint : {"tcp://0.0.0.0:5555", "tcp://*:5555", "tcp://192.168.1.5:5555", "tcp://127.0.0.1.example.com:5555",
                               "tcp://localhost:5555", "tcp://[::1]:5555", "tcp://127.0.0.300:5555", "tcp://127.1:5555"}) {
    const auto router = RouterChannel::Bind(endpoint);
    ASSERT_FALSE(router.ok()) << endpoint;
    EXPECT_EQ(router.status().code(), StatusCode::kInvalidInput);
    EXPECT_THAT(router.status().message(), HasSubstr("need keys (`trem keys`")) << endpoint;
    EXPECT_FALSE(DealerChannel::Connect(endpoint).ok()) << endpoint;
  }
  for (const char* endpoint : {"", "ipc://", "udp://127.0.0.1:1", "inproc://x", "tcp://127.0.0.1", "tcp://127.0.0.1:0",
                               "tcp://127.0.0.1:65536", "tcp://127.0.0.1:-1", "tcp://127.0.0.1:5a"}) {
    EXPECT_FALSE(RouterChannel::Bind(endpoint).ok()) << endpoint;
    EXPECT_FALSE(DealerChannel::Connect(endpoint).ok()) << endpoint;
  }
  EXPECT_FALSE(DealerChannel::Connect("tcp://127.0.0.1:*").ok());
  EXPECT_THAT(RouterChannel::Bind("ipc:///" + std::string(200, 'x')).status().message(), HasSubstr("at most 107 bytes"));
  EXPECT_THAT(RouterChannel::Bind("ipc:///nowhere/at/all/socket").status().message(), HasSubstr("cannot listen on"));
}

TEST_F(ChannelTest, SaysThatNobodyAnswers) {
  auto dealer = Dealer();
  const Status status = dealer->Send(Heartbeat(), kShort);
  EXPECT_EQ(status.code(), StatusCode::kUnavailable);
  EXPECT_THAT(status.message(), HasSubstr("no coordinator answers at " + endpoint_));
}

TEST_F(ChannelTest, CountsGarbageAndStaysUsable) {
  auto router = Router();
  zmq::context_t context;
  zmq::socket_t raw(context, zmq::socket_type::dealer);
  raw.set(zmq::sockopt::linger, 0);
  raw.connect(endpoint_);
  const std::string header("TREM\x02\0\0\0", 8);
  const std::vector<std::vector<std::string>> messages = {
      {"x"}, {"x", "y"}, {header}, {header, "garbage"}, {header, "", ""}, {header, ""}, std::vector<std::string>(50, header)};
  for (const auto& frames : messages) {
    for (std::size_t i = 0; i < frames.size(); ++i) {
      raw.send(zmq::buffer(frames[i]), i + 1 < frames.size() ? zmq::send_flags::sndmore : zmq::send_flags::none);
    }
  }
  for (std::size_t i = 0; i < messages.size(); ++i) {
    const auto incoming = Next(router.get());
    ASSERT_TRUE(incoming.has_value()) << i;
    EXPECT_FALSE(incoming->envelope.ok()) << i;
  }
  EXPECT_EQ(router->counters().garbage, messages.size());
  auto dealer = Dealer();
  ASSERT_TRUE(dealer->Send(Heartbeat(), kLong).ok());
  const auto incoming = Next(router.get());
  ASSERT_TRUE(incoming.has_value());
  EXPECT_TRUE(incoming->envelope.ok());
}

TEST_F(ChannelTest, RefusesOversizeMessagesOfOnePeerOnly) {
  ChannelOptions options;
  options.limits.body_bytes_max = 1000;
  auto router = Router(options);
  auto large = Dealer();
  ASSERT_TRUE(large->Send(GoodbyeOf(std::string(2000, 'x')), kLong).ok());
  EXPECT_FALSE(router->Poll(kShort).has_value());
  auto small = Dealer();
  ASSERT_TRUE(small->Send(GoodbyeOf("small"), kLong).ok());
  const auto incoming = Next(router.get());
  ASSERT_TRUE(incoming.has_value());
  ASSERT_TRUE(incoming->envelope.ok());
  EXPECT_EQ(incoming->envelope->goodbye().reason(), "small");
}

TEST_F(ChannelTest, ReportsAPeerThatVanished) {
  auto router = Router();
  auto dealer = Dealer();
  ASSERT_TRUE(dealer->Send(Heartbeat(), kLong).ok());
  const auto incoming = Next(router.get());
  ASSERT_TRUE(incoming.has_value());
  EXPECT_TRUE(router->Send(incoming->peer, Heartbeat()));
  dealer.reset();
  bool reported = false;
  for (int i = 0; i < 100 && !reported; ++i) {  // libzmq learns of the closed connection on its own thread.
    (void)router->Poll(milliseconds(20));
    reported = !router->Send(incoming->peer, Heartbeat());
  }
  EXPECT_TRUE(reported);
  EXPECT_FALSE(router->Send("nobody", Heartbeat()));
}

TEST_F(ChannelTest, ReconnectsAfterTheCoordinatorRestarted) {
  auto router = Router();
  auto dealer = Dealer();
  ASSERT_TRUE(dealer->Send(Heartbeat(), kLong).ok());
  ASSERT_TRUE(Next(router.get()).has_value());
  router.reset();
  router = Router();
  std::optional<RouterChannel::Incoming> incoming;
  for (int i = 0; i < 100 && !incoming; ++i) {  // What is sent while the connection breaks may be lost.
    (void)dealer->Send(GoodbyeOf("again"), kShort);
    incoming = router->Poll(kShort);
  }
  ASSERT_TRUE(incoming.has_value());
  EXPECT_TRUE(router->Send(incoming->peer, Heartbeat()));
}

TEST_F(ChannelTest, NobodyTakesOverAnothersConnectionByClaimingItsName) {
  auto router = Router();
  auto victim = Dealer();
  ASSERT_TRUE(victim->Send(GoodbyeOf("victim"), kLong).ok());
  const auto first = Next(router.get());
  ASSERT_TRUE(first.has_value());
  zmq::context_t context;
  zmq::socket_t thief(context, zmq::socket_type::dealer);
  thief.set(zmq::sockopt::linger, 0);
  thief.set(zmq::sockopt::routing_id, first->peer);
  thief.connect(endpoint_);
  thief.send(zmq::buffer(std::string("hello")), zmq::send_flags::none);
  EXPECT_FALSE(router->Poll(kShort).has_value());
  ASSERT_TRUE(router->Send(first->peer, Heartbeat()));
  const auto reply = victim->Receive(kLong);
  ASSERT_TRUE(reply.ok());
  EXPECT_TRUE(reply->has_value());
  zmq::message_t stolen;
  EXPECT_FALSE(thief.recv(stolen, zmq::recv_flags::dontwait).has_value());
}

TEST_F(ChannelTest, AWakeFromAnotherThreadEndsThePoll) {
  auto router = Router();
  auto dealer = Dealer();
  std::thread waker([&] {
    router->Wake();
    dealer->Wake();
  });
  EXPECT_FALSE(router->Poll(std::chrono::hours(24)).has_value());
  const auto received = dealer->Receive(std::chrono::hours(24));
  ASSERT_TRUE(received.ok());
  EXPECT_FALSE(received->has_value());
  waker.join();
}

std::atomic<RouterChannel*> signalled_router{nullptr};

TEST_F(ChannelTest, AWakeFromASignalHandlerEndsThePoll) {
  auto router = Router();
  signalled_router = router.get();
  struct sigaction action {};
  struct sigaction previous {};
  action.sa_handler = [](int) { signalled_router.load()->Wake(); };
  ASSERT_EQ(::sigaction(SIGUSR1, &action, &previous), 0);
  ASSERT_EQ(::raise(SIGUSR1), 0);
  EXPECT_FALSE(router->Poll(std::chrono::hours(24)).has_value());
  ASSERT_EQ(::sigaction(SIGUSR1, &previous, nullptr), 0);
}

}  // namespace
}  // namespace trem
