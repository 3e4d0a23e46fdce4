// Goal: a coordinator with keys serves those who have them, refuses all others in words or silence, and is not hurt by crowds. Method: real
// programs over TCP; the crowd is 10,000 plain connections; what was refused is read off the metrics.
#include <arpa/inet.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <signal.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <unistd.h>

#include <fstream>
#include <optional>
#include <sstream>
#include <thread>
#include <zmq.hpp>

#include "proto/channel/dealer_channel.h"
#include "tests/e2e/service_fixture.h"
#include "tests/support/loopback.h"

namespace trem::testing {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;
using ::testing::Not;

class SecureServiceTest : public ServiceTest {
 protected:
  SecureServiceTest() {
    fs::create_directories(fixture_.folder() / "allowed");
    MakeKey("hill", "coordinator");
    for (const char* role : {"worker", "client", "admin"}) {
      MakeKey(role, role);
      fs::copy_file(Key(role, ".pub"), fixture_.folder() / "allowed" / (std::string(role) + ".pub"));
    }
    MakeKey("stranger", "client");
  }
  void Start(std::vector<std::string> more = {}) {
    more.insert(more.end(), {"--key", Key("hill", ".key"), "--allow", (fixture_.folder() / "allowed").string()});
    ServiceTest::Start(more);
  }
  std::string Key(const std::string& name, const std::string& extension) const {
    return (fixture_.folder() / "keys" / (name + extension)).string();
  }
  void MakeKey(const std::string& name, const std::string& role) const {
    const Completed made =
        fixture_.Run({BinaryPath("trem").string(), "keys", name, "--role", role, "-o", (fixture_.folder() / "keys").string()});
    ASSERT_EQ(made.exit_code, 0) << made.stderr_text;
  }
  Completed Trem(const std::string& key, const std::vector<std::string>& arguments) const {
    if (key.empty()) return ServiceTest::Trem(arguments);
    return ServiceTest::Trem(arguments, {"TREM_KEY=" + Key(key, ".key"), "TREM_COORDINATOR_KEY=" + Key("hill", ".pub")});
  }
  std::unique_ptr<Subprocess> Worker(const std::string& key, std::vector<std::string> more = {}) const {
    more.insert(more.end(), {"--key", Key(key, ".key"), "--coordinator-key", Key("hill", ".pub")});
    return ServiceTest::Worker(more);
  }
  // The second lines of the secret halves of all keys.
  std::vector<std::string> Secrets() const {
    std::vector<std::string> secrets;
    for (const char* name : {"hill", "worker", "client", "admin", "stranger"}) {
      const std::string text = FileContents(Key(name, ".key"));
      const std::size_t at = text.find("secret_key: \"");
      EXPECT_NE(at, std::string::npos);
      secrets.push_back(text.substr(at + 13, 40));
    }
    return secrets;
  }
};

TEST_F(SecureServiceTest, MapsASortieWithKeysAndKeepsSecretsToItself) {
  Start();
  const fs::path sortie = fixture_.SimulateSortie("sortie", 16);
  const auto worker = Worker("worker", {"--source-root", sortie.string()});
  ASSERT_EQ(Trem("client", {"submit", (sortie / "sortie.textproto").string(), "--job-id", "town"}).exit_code, 0);
  const Completed watch = Trem("client", {"watch", "town"});
  EXPECT_EQ(watch.exit_code, 0) << watch.stderr_text;
  const fs::path out = fixture_.NewFolder("out");
  EXPECT_EQ(Trem("client", {"fetch", "town", "-o", (out / "town.tif").string()}).exit_code, 0);

  worker->Signal(SIGTERM);
  ASSERT_TRUE(worker->Wait(std::chrono::seconds(30)).has_value());
  coordinator_->Signal(SIGTERM);
  ASSERT_TRUE(coordinator_->Wait(std::chrono::seconds(30)).has_value());
  std::string everything = worker->Stderr() + worker->Stdout() + coordinator_->Stderr() + coordinator_->Stdout() + watch.stderr_text;
  for (const auto& entry : fs::recursive_directory_iterator(fixture_.folder() / "state")) {
    if (entry.is_regular_file()) everything += FileContents(entry.path());
  }
  for (const std::string& secret : Secrets()) EXPECT_EQ(everything.find(secret), std::string::npos);
}

TEST_F(SecureServiceTest, RefusesWrongKeysAndRoles) {
  Start();
  for (const char* key : {"", "stranger"}) {
    const Completed list = Trem(key, {"list"});
    EXPECT_EQ(list.exit_code, 4) << key << list.stderr_text;
  }
  const Completed as_worker = Trem("worker", {"list"});
  EXPECT_EQ(as_worker.exit_code, 3);
  EXPECT_THAT(as_worker.stderr_text, HasSubstr("has the role worker and may not send list_jobs"));
  const auto impostor = Worker("client");
  const auto exit = impostor->Wait(std::chrono::seconds(30));
  ASSERT_TRUE(exit.has_value());
  EXPECT_EQ(exit->code, 3);
  EXPECT_THAT(impostor->Stderr(), HasSubstr("may not send hello"));
  EXPECT_EQ(Trem("client", {"list"}).exit_code, 0);
}

TEST_F(SecureServiceTest, AWorkerWithAKeyReadsNothingOutsideItsFolders) {
  Start();
  const fs::path sortie = fixture_.SimulateSortie("sortie", 4);
  const auto worker = Worker("worker", {"--source-root", fixture_.NewFolder("elsewhere").string()});
  ASSERT_EQ(Trem("client", {"submit", (sortie / "sortie.textproto").string(), "--job-id", "town"}).exit_code, 0);
  const Completed watch = Trem("client", {"watch", "town"});
  EXPECT_EQ(watch.exit_code, 1);
  EXPECT_THAT(watch.stderr_text, HasSubstr("does not lie below a folder that this worker may read"));
}

TEST_F(SecureServiceTest, ServesThroughACrowdOfTenThousandConnections) {
  constexpr int kCrowd = 10'000;
  Start({"--connections-max", "500"});
  rlimit limit{};
  ASSERT_EQ(::getrlimit(RLIMIT_NOFILE, &limit), 0);
  limit.rlim_cur = std::min<rlim_t>(limit.rlim_max, kCrowd + 1000);
  ASSERT_EQ(::setrlimit(RLIMIT_NOFILE, &limit), 0);
  // As many at a time as this process may have; closed ones are made anew.
  const auto at_once = std::min<std::size_t>(limit.rlim_cur - 500, kCrowd);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(static_cast<std::uint16_t>(std::stoi(endpoint_.substr(endpoint_.rfind(':') + 1))));
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  std::vector<int> crowd;
  int made = 0;
  for (int i = 0; i < kCrowd; ++i) {
    if (crowd.size() >= at_once) {
      ::close(crowd.front());
      crowd.erase(crowd.begin());
    }
    const int fd = ::socket(AF_INET, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
    ASSERT_GE(fd, 0);
    made += ::connect(fd, reinterpret_cast<const sockaddr*>(&address), sizeof(address)) == 0 || errno == EINPROGRESS ? 1 : 0;
    crowd.push_back(fd);
  }
  EXPECT_EQ(made, kCrowd);
  // Those who hold the doors and never shake hands are out after five seconds.
  Completed list;
  for (int i = 0; i < 10; ++i) {
    list = Trem("client", {"list"});
    if (list.exit_code == 0) break;
  }
  EXPECT_EQ(list.exit_code, 0) << list.stderr_text;
  for (const int fd : crowd) ::close(fd);
  std::istringstream status(FileContents("/proc/" + std::to_string(coordinator_->pid()) + "/status"));
  for (std::string line; std::getline(status, line);) {
    if (line.starts_with("VmHWM:")) {
      EXPECT_LT(std::stol(line.substr(6)), 512 * 1024) << "kB";
    }
  }
  EXPECT_FALSE(coordinator_->Wait(std::chrono::milliseconds(0)).has_value()) << coordinator_->Stderr();
}

// What a key of this role sends until something comes back; nullopt: nothing does.
std::optional<v1::Envelope> Say(DealerChannel* channel, const v1::Envelope& envelope) {
  EXPECT_TRUE(channel->Send(envelope, std::chrono::seconds(20)).ok());
  return channel->Receive(std::chrono::seconds(20)).value();
}

// A flood is gate_test's: here it would depend on how fast the machine is.
TEST_F(SecureServiceTest, CountsWhatItRefuses) {
  Start({"--http", "127.0.0.1:0"});
  const std::string url = Lines(FileContents(ready_)).at(1);
  const auto as = [&](const std::string& name) {
    return std::move(DealerChannel::Connect(endpoint_, ChannelOptionsOf(Key(name, ".key"), Key("hill", ".pub")).value())).value();
  };
  v1::Envelope list;
  list.mutable_list_jobs();
  EXPECT_TRUE(Say(as("worker").get(), list)->has_error());  // role
  v1::Envelope large;
  large.mutable_submit_job()->set_job_id("large");
  large.mutable_submit_job()->mutable_sortie()->mutable_source()->set_path("/data");
  large.mutable_submit_job()->mutable_sortie()->set_name(std::string(2 << 20, 'x'));
  EXPECT_THAT(Say(as("client").get(), large)->error().message(), HasSubstr("at most 1048576 are accepted"));  // size
  EXPECT_EQ(Trem("stranger", {"list"}).exit_code, 4);                                                         // key
  EXPECT_EQ(Trem("", {"list"}).exit_code, 4);                                                                 // handshake
  v1::Envelope where;
  where.mutable_get_data_lane();
  const std::string data_lane = Say(as("worker").get(), where)->data_lane().endpoint();
  for (const std::string& endpoint : {endpoint_, data_lane}) {
    zmq::context_t context;
    zmq::socket_t socket(context, zmq::socket_type::dealer);
    socket.set(zmq::sockopt::linger, 0);
    const v1::KeyFile key = ReadSecretKey(Key("worker", ".key")).value();
    socket.set(zmq::sockopt::curve_publickey, key.public_key());
    socket.set(zmq::sockopt::curve_secretkey, key.secret_key());
    socket.set(zmq::sockopt::curve_serverkey, ReadPublicKey(Key("hill", ".pub")).value().public_key());
    socket.connect(endpoint);
    socket.send(zmq::buffer(std::string("TREM\x02\0\0\0", 8)), zmq::send_flags::sndmore);
    socket.send(zmq::buffer(std::string("\xff\xff no envelope")), zmq::send_flags::none);  // malformed
    zmq::message_t answer;
    EXPECT_TRUE(socket.recv(answer));
  }
  const std::vector<std::string> counters = {"trem_connections_refused_total{lane=\"control\",reason=\"key\"}",
                                             "trem_connections_refused_total{lane=\"control\",reason=\"handshake\"}",
                                             "trem_messages_refused_total{lane=\"control\",reason=\"role\"}",
                                             "trem_messages_refused_total{lane=\"control\",reason=\"size\"}",
                                             "trem_messages_refused_total{lane=\"control\",reason=\"malformed\"}",
                                             "trem_messages_refused_total{lane=\"data\",reason=\"malformed\"}",
                                             "trem_connections_closed_total{lane=\"control\"}"};
  std::string metrics;
  std::string missing = "all";
  for (int i = 0; i < 100 && !missing.empty(); ++i) {  // They follow once a second.
    metrics = HttpGet(url, "/metrics");
    missing.clear();
    for (const std::string& counter : counters) {
      const std::size_t at = metrics.find(counter + " ");
      if (at == std::string::npos || metrics.compare(at + counter.size(), 3, " 0\n") == 0) missing += counter + " ";
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(100));
  }
  EXPECT_EQ(missing, "") << metrics;
  EXPECT_EQ(Trem("client", {"list"}).exit_code, 0);
}

}  // namespace
}  // namespace trem::testing
