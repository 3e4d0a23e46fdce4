// Goal: nobody without an allowed key gets a message through, and nothing that a stranger sends hurts those who may. Method: real sockets;
// the strangers are raw libzmq sockets and raw TCP connections that speak ZMTP (ZeroMQ RFC 23) by hand.
#include <arpa/inet.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

#include <atomic>
#include <cstring>
#include <filesystem>
#include <thread>
#include <zmq.hpp>

#include "mosaic/base/file.h"
#include "proto/channel/dealer_channel.h"
#include "proto/channel/router_channel.h"
#include "tests/support/paths.h"

namespace trem {
namespace {

namespace fs = std::filesystem;
using std::chrono::milliseconds;
using ::testing::HasSubstr;
using ::testing::Not;

constexpr milliseconds kLong{20000};  // Never waited for when all is well.
constexpr milliseconds kShort{300};   // Long enough for a message over loopback.

v1::Envelope Heartbeat() {
  v1::Envelope envelope;
  envelope.mutable_heartbeat();
  return envelope;
}

// A plain TCP connection to tcp://127.0.0.1:PORT.
class RawConnection {
 public:
  explicit RawConnection(const std::string& endpoint) : fd_(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0)) {
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_port = htons(static_cast<std::uint16_t>(std::stoi(endpoint.substr(endpoint.rfind(':') + 1))));
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    TREM_CHECK(::connect(fd_, reinterpret_cast<const sockaddr*>(&address), sizeof(address)) == 0);
  }
  explicit RawConnection(int fd) : fd_(fd) {}
  RawConnection(RawConnection&& other) noexcept : fd_(std::exchange(other.fd_, -1)) {}
  ~RawConnection() {
    if (fd_ >= 0) ::close(fd_);
  }
  int fd() const { return fd_; }
  void Send(const std::string& bytes) const { (void)!::send(fd_, bytes.data(), bytes.size(), MSG_NOSIGNAL); }
  // True once the other side has closed; what it sends before is dropped.
  bool IsClosedWithin(milliseconds timeout) const {
    const auto deadline = std::chrono::steady_clock::now() + timeout;
    char block[4096];
    while (std::chrono::steady_clock::now() < deadline) {
      pollfd item{fd_, POLLIN, 0};
      if (::poll(&item, 1, 20) > 0 && ::recv(fd_, block, sizeof(block), 0) <= 0) return true;
    }
    return false;
  }

 private:
  int fd_;
};

// ZMTP 3.0: greeting and READY of a DEALER without security.
std::string NullGreeting() {
  std::string greeting = std::string("\xff\0\0\0\0\0\0\0\x01\x7f\x03\0", 12) + "NULL" + std::string(16, '\0') + '\0' + std::string(31, '\0');
  const std::string ready = std::string("\x05READY\x0bSocket-Type\0\0\0\x06" "DEALER", 28);
  greeting += std::string("\x04") + static_cast<char>(ready.size()) + ready;
  return greeting;
}

class SecurityTest : public ::testing::Test {
 protected:
  SecurityTest() {
    fs::create_directories(allowed_);
    coordinator_ = Key("hill", v1::COORDINATOR, /*allow=*/false);
  }
  v1::KeyFile Key(const std::string& name, v1::Role role, bool allow = true) {
    const v1::KeyFile key = MakeKey(name, role).value();
    EXPECT_TRUE(WriteKeyFiles(folder_ / "keys", key).ok());
    if (allow) fs::copy_file(folder_ / "keys" / (name + ".pub"), allowed_ / (name + ".pub"));
    return key;
  }
  std::unique_ptr<RouterChannel> Router(ChannelOptions options = {}, const std::string& endpoint = "tcp://127.0.0.1:*") {
    options.own_key = coordinator_;
    options.allow_list = AllowList::Open(allowed_).value();
    auto router = RouterChannel::Bind(endpoint, options);
    TREM_CHECK_MSG(router.ok(), router.status().message());
    return std::move(router).value();
  }
  std::unique_ptr<DealerChannel> Dealer(const std::string& endpoint, const v1::KeyFile& key, const std::string& coordinator_key) {
    ChannelOptions options;
    options.own_key = key;
    options.coordinator_public_key = coordinator_key;
    return std::move(DealerChannel::Connect(endpoint, options)).value();
  }
  std::unique_ptr<DealerChannel> Dealer(const std::string& endpoint, const v1::KeyFile& key) {
    return Dealer(endpoint, key, coordinator_.public_key());
  }
  // Polls for a while, as a coordinator would; true when no message came through.
  static bool NothingArrives(RouterChannel* router, milliseconds time = kShort) {
    const auto deadline = std::chrono::steady_clock::now() + time;
    while (std::chrono::steady_clock::now() < deadline) {
      if (router->Poll(milliseconds(20)).has_value()) return false;
    }
    return true;
  }
  void ExpectServes(RouterChannel* router, const v1::KeyFile& key) {
    auto dealer = Dealer(router->endpoint(), key);
    std::optional<RouterChannel::Incoming> incoming;
    for (int i = 0; i < 100 && !incoming; ++i) {
      (void)dealer->Send(Heartbeat(), milliseconds(100));
      incoming = router->Poll(milliseconds(100));
    }
    ASSERT_TRUE(incoming.has_value());
    EXPECT_TRUE(incoming->envelope.ok());
    EXPECT_EQ(incoming->user, key.name());
    EXPECT_EQ(incoming->role, key.role());
  }

  trem::testing::TempDir folder_;
  fs::path allowed_ = folder_ / "allowed";
  v1::KeyFile coordinator_;
};

TEST_F(SecurityTest, LetsAllowedKeysInAndSaysWhoTheyAre) {
  const v1::KeyFile worker = Key("node-1", v1::WORKER);
  const v1::KeyFile client = Key("ann", v1::CLIENT);
  auto router = Router();
  ExpectServes(router.get(), worker);
  ExpectServes(router.get(), client);
}

TEST_F(SecurityTest, BindsBeyondLoopbackOnlyWithKeys) {
  EXPECT_THAT(RouterChannel::Bind("tcp://*:*").status().message(), HasSubstr("need keys"));
  auto router = Router({}, "tcp://*:*");
  EXPECT_THAT(router->endpoint(), HasSubstr("tcp://0.0.0.0:"));
  ChannelOptions options;
  options.own_key = coordinator_;
  EXPECT_THAT(RouterChannel::Bind("tcp://*:*", options).status().message(), HasSubstr("list of the keys"));
  EXPECT_THAT(DealerChannel::Connect("tcp://example.com:1", options).status().message(), HasSubstr("impostor"));
}

TEST_F(SecurityTest, KeepsStrangersOut) {
  const v1::KeyFile friendly = Key("node-1", v1::WORKER);
  const v1::KeyFile stranger = Key("stranger", v1::WORKER, /*allow=*/false);
  auto router = Router();
  zmq::context_t context;
  zmq::socket_t keyless(context, zmq::socket_type::dealer);
  keyless.set(zmq::sockopt::linger, 0);
  keyless.connect(router->endpoint());
  keyless.send(zmq::buffer(std::string("hello")), zmq::send_flags::dontwait);
  auto unknown = Dealer(router->endpoint(), stranger);
  (void)unknown->Send(Heartbeat(), milliseconds(0));
  // The right client, but it expects another coordinator.
  auto misled = Dealer(router->endpoint(), friendly, stranger.public_key());
  (void)misled->Send(Heartbeat(), milliseconds(0));
  EXPECT_TRUE(NothingArrives(router.get(), milliseconds(1000)));
  EXPECT_GE(router->counters().handshakes_failed, 2U);
  EXPECT_GE(router->counters().keys_refused, 1U);
  ExpectServes(router.get(), friendly);
}

TEST_F(SecurityTest, RevokesAKeyWhileItsConnectionStands) {
  const v1::KeyFile worker = Key("node-1", v1::WORKER);
  auto router = Router();
  auto dealer = Dealer(router->endpoint(), worker);
  ASSERT_TRUE(dealer->Send(Heartbeat(), kLong).ok());
  ASSERT_TRUE(router->Poll(kLong)->envelope.ok());
  fs::remove(allowed_ / "node-1.pub");
  ASSERT_TRUE(dealer->Send(Heartbeat(), kLong).ok());
  const auto incoming = router->Poll(kLong);
  ASSERT_TRUE(incoming.has_value());
  EXPECT_THAT(incoming->envelope.status().message(), HasSubstr("not in the coordinator's list"));
}

TEST_F(SecurityTest, LetsAKeyInThatIsAddedLater) {
  auto router = Router();
  const v1::KeyFile worker = Key("node-1", v1::WORKER);
  ExpectServes(router.get(), worker);
}

TEST_F(SecurityTest, RefusesARecordedConversation) {
  const v1::KeyFile worker = Key("node-1", v1::WORKER);
  auto router = Router();
  // A listener in between that keeps what the worker sends.
  RawConnection listener(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0));
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  ASSERT_EQ(::bind(listener.fd(), reinterpret_cast<const sockaddr*>(&address), sizeof(address)), 0);
  ASSERT_EQ(::listen(listener.fd(), 4), 0);
  socklen_t length = sizeof(address);
  ASSERT_EQ(::getsockname(listener.fd(), reinterpret_cast<sockaddr*>(&address), &length), 0);
  auto dealer = Dealer("tcp://127.0.0.1:" + std::to_string(ntohs(address.sin_port)), worker);
  std::string recorded;
  std::atomic<bool> stop{false};
  std::thread relay([&] {
    const RawConnection near(::accept(listener.fd(), nullptr, nullptr));
    const RawConnection far(router->endpoint());
    char block[4096];
    while (!stop) {
      pollfd items[] = {{near.fd(), POLLIN, 0}, {far.fd(), POLLIN, 0}};
      if (::poll(items, 2, 20) <= 0) continue;
      for (int i = 0; i < 2; ++i) {
        const ssize_t count = (items[i].revents & POLLIN) != 0 ? ::recv(items[i].fd, block, sizeof(block), 0) : 0;
        if (count <= 0) continue;
        (i == 0 ? far : near).Send(std::string(block, static_cast<std::size_t>(count)));
        if (i == 0) recorded.append(block, static_cast<std::size_t>(count));
      }
    }
  });
  EXPECT_TRUE(dealer->Send(Heartbeat(), kLong).ok());
  const auto first = router->Poll(kLong);
  stop = true;
  relay.join();
  ASSERT_TRUE(first.has_value());
  EXPECT_TRUE(first->envelope.ok());
  EXPECT_GT(recorded.size(), 300U);
  EXPECT_THAT(recorded, Not(HasSubstr("TREM"))) << "a message that can be read on the line";

  const RawConnection again(router->endpoint());
  again.Send(recorded);
  EXPECT_TRUE(NothingArrives(router.get()));
  EXPECT_GE(router->counters().handshakes_failed, 1U);
  ExpectServes(router.get(), worker);
}

TEST_F(SecurityTest, SurvivesGarbageOnTheLine) {
  const v1::KeyFile worker = Key("node-1", v1::WORKER);
  auto router = Router();
  std::vector<std::string> openings = {"GET / HTTP/1.1\r\n\r\n", std::string(100'000, '\xff'), std::string(100'000, '\0'), NullGreeting(),
                                       NullGreeting().substr(0, 40)};
  std::uint32_t state = 12345;
  for (int i = 0; i < 20; ++i) {
    std::string noise = i % 2 == 0 ? std::string() : NullGreeting().substr(0, 12);
    for (int k = 0; k < 500; ++k) noise += static_cast<char>((state = state * 1664525U + 1013904223U) >> 24);
    openings.push_back(noise);
  }
  for (const std::string& opening : openings) RawConnection(router->endpoint()).Send(opening);
  EXPECT_TRUE(NothingArrives(router.get()));
  ExpectServes(router.get(), worker);
}

// Peak memory of this process, bytes.
std::uint64_t PeakBytes() {
  rusage usage{};
  ::getrusage(RUSAGE_SELF, &usage);
  return static_cast<std::uint64_t>(usage.ru_maxrss) * 1024;
}

TEST_F(SecurityTest, ClosesAConnectionThatAnnouncesAGigabyte) {
  auto router = std::move(RouterChannel::Bind("tcp://127.0.0.1:*")).value();  // No keys: the frame gets past the handshake.
  const std::uint64_t before = PeakBytes();
  const RawConnection attacker(router->endpoint());
  // A long frame: flags 2, then 2^30 as eight bytes, big-endian.
  attacker.Send(NullGreeting() + std::string("\x02\0\0\0\0\x40\0\0\0", 9) + std::string(1000, 'x'));
  EXPECT_TRUE(attacker.IsClosedWithin(kLong));
  EXPECT_LT(PeakBytes() - before, std::uint64_t{256} << 20);
  EXPECT_FALSE(router->Poll(milliseconds(50)).has_value());
}

TEST_F(SecurityTest, ClosesAConnectionThatNeverShakesHands) {
  ChannelOptions options;
  options.handshake_timeout = milliseconds(200);
  auto router = Router(options);
  const RawConnection slow(router->endpoint());
  slow.Send(NullGreeting().substr(0, 5));
  EXPECT_TRUE(slow.IsClosedWithin(kLong));
}

TEST_F(SecurityTest, ClosesConnectionsBeyondTheLimitAndServesAgainWhenThereIsRoom) {
  const v1::KeyFile worker = Key("node-1", v1::WORKER);
  ChannelOptions options;
  options.connections_max = 8;
  options.handshake_timeout = milliseconds(1000);
  auto router = Router(options);
  {
    std::vector<RawConnection> crowd;
    for (int i = 0; i < 40; ++i) crowd.emplace_back(router->endpoint());
    EXPECT_TRUE(NothingArrives(router.get()));
    EXPECT_GE(router->counters().refused_full, 30U);
    EXPECT_LE(router->counters().connections, 10U);
  }
  ExpectServes(router.get(), worker);
}

TEST_F(SecurityTest, SocketFilesBelongToTheirUserAlone) {
  const std::string path = (folder_ / "socket").string();
  auto router = std::move(RouterChannel::Bind("ipc://" + path)).value();
  struct stat info {};
  ASSERT_EQ(::stat(path.c_str(), &info), 0);
  EXPECT_EQ(info.st_mode & 0777, 0600U);
}

// ---- Key files ----------------------------------------------------------------------------------------------------------------------

TEST_F(SecurityTest, KeyFilesAreSecretAndNeverOverwritten) {
  const v1::KeyFile key = Key("node-1", v1::WORKER);
  const fs::path secret = folder_ / "keys" / "node-1.key";
  struct stat info {};
  ASSERT_EQ(::stat(secret.c_str(), &info), 0);
  EXPECT_EQ(info.st_mode & 0777, 0600U);
  EXPECT_EQ(ReadSecretKey(secret).value().secret_key(), key.secret_key());
  EXPECT_THAT(WriteKeyFiles(folder_ / "keys", key).message(), HasSubstr("exists"));
  EXPECT_THAT(trem::testing::FileContents(folder_ / "keys" / "node-1.pub"), Not(HasSubstr(key.secret_key())));
  fs::permissions(secret, fs::perms::group_read, fs::perm_options::add);
  // Root's own files may be readable by a group: so are mounted secrets.
  EXPECT_EQ(ReadSecretKey(secret).ok(), ::geteuid() == 0);
  fs::permissions(secret, fs::perms::others_read, fs::perm_options::add);
  EXPECT_THAT(ReadSecretKey(secret).status().message(), HasSubstr("0600"));
}

TEST_F(SecurityTest, ErrorsOfKeyFilesNameTheFileAndKeepTheSecret) {
  const v1::KeyFile key = Key("node-1", v1::WORKER);
  const std::string good = trem::testing::FileContents(folder_ / "keys" / "node-1.key");
  const std::vector<std::string> bad = {"",
                                        "secret_key: " + key.secret_key(),
                                        "secret_key: \"" + key.secret_key(),
                                        good + "more: 1",
                                        "name: \"../x\" role: WORKER public_key: \"" + key.public_key() + "\"",
                                        "name: \"x\" public_key: \"" + key.public_key() + "\"",
                                        "name: \"x\" role: WORKER public_key: \"\xff\"",
                                        "name: \"x\" role: WORKER public_key: \"" + key.public_key() + "\"",
                                        "name: \"x\" role: WORKER public_key: \"" + coordinator_.public_key() + "\" secret_key: \"" +
                                            key.secret_key() + "\"",
                                        std::string(1'000'000, 'x')};
  for (const std::string& text : bad) {
    const fs::path path = folder_ / "bad.key";
    ASSERT_TRUE(WriteFileAtomically(path, text, 0600).ok());
    const auto read = ReadSecretKey(path);
    ASSERT_FALSE(read.ok()) << text;
    EXPECT_THAT(read.status().message(), HasSubstr("bad.key"));
    EXPECT_THAT(read.status().message(), Not(HasSubstr(key.secret_key())));
  }
  EXPECT_THAT(ReadPublicKey(folder_ / "keys" / "node-1.key").status().message(), HasSubstr("secret"));
  EXPECT_FALSE(ReadSecretKey(folder_ / "keys" / "node-1.pub").ok());
  for (const char* name : {"", "../up", "UPPER", "a b", "a/b"}) EXPECT_FALSE(MakeKey(name, v1::WORKER).ok()) << name;
  fs::copy_file(folder_ / "keys" / "node-1.key", allowed_ / "mistake.pub");
  EXPECT_THAT(AllowList::Open(allowed_).status().message(), HasSubstr("mistake.pub"));
}

}  // namespace
}  // namespace trem
