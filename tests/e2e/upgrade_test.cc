// Goal: what docs/OPERATIONS.md says of releases that meet. A log of either older format is migrated and its jobs go on; a newer one, and
// peers of another protocol or engine, are refused in words that name both. Method: real programs; an older log is a present one without
// the tables that its version did not have; peers of another release are sockets that say what those would say.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sqlite3.h>

#include <thread>

#include "mosaic/base/version.h"
#include "proto/channel/dealer_channel.h"
#include "tests/e2e/earlier_peer.h"
#include "tests/e2e/later_coordinator.h"
#include "tests/e2e/service_fixture.h"

namespace trem::testing {
namespace {

namespace fs = std::filesystem;
using std::chrono::milliseconds;
using ::testing::AllOf;
using ::testing::HasSubstr;

class UpgradeTest : public ServiceTest {
 protected:
  fs::path Log() const { return fixture_.folder() / "state" / "events.sqlite"; }
  void Stop() {
    coordinator_->Signal(SIGTERM);
    const auto exit = coordinator_->Wait(std::chrono::seconds(30));
    ASSERT_TRUE(exit.has_value());
    ASSERT_EQ(exit->code, 0) << coordinator_->Stderr();
    fs::remove(ready_);
  }
  // Runs `statement` on the log of a coordinator that has stopped; returns what a query gave last.
  std::string Sql(const std::string& statement) const {
    sqlite3* database = nullptr;
    EXPECT_EQ(sqlite3_open(Log().c_str(), &database), SQLITE_OK);
    std::string last;
    const auto keep = [](void* text, int, char** values, char**) {
      *static_cast<std::string*>(text) = values[0] != nullptr ? values[0] : "";
      return 0;
    };
    char* message = nullptr;
    EXPECT_EQ(sqlite3_exec(database, statement.c_str(), keep, &last, &message), SQLITE_OK) << (message != nullptr ? message : "");
    sqlite3_free(message);
    sqlite3_close(database);
    return last;
  }
  std::map<std::string, std::string> Fetch(const std::string& job, const std::string& folder) const {
    const fs::path out = fixture_.NewFolder(folder);
    const Completed fetch = Trem({"fetch", job, "-o", (out / "mosaic.tif").string()});
    EXPECT_EQ(fetch.exit_code, 0) << fetch.stderr_text;
    return FilesIn(out);
  }
};

TEST_F(UpgradeTest, JobsOfALogOfEitherOlderFormatGoOn) {
  Start();
  Submit("done-before", 8);
  {
    const auto worker = Worker();
    ASSERT_EQ(Trem({"watch", "done-before", "--quiet"}).exit_code, 0);
  }
  const auto files = Fetch("done-before", "before");
  Submit("under-way-2", 8);
  Stop();
  const std::string present = Sql("PRAGMA user_version");
  Sql("DROP TABLE log_state; PRAGMA user_version = 2");
  Start();
  EXPECT_EQ(Fetch("done-before", "after-2"), files);
  {
    const auto worker = Worker();
    EXPECT_EQ(Trem({"watch", "under-way-2", "--quiet"}).exit_code, 0);
  }
  Submit("under-way-1", 10);
  Stop();
  EXPECT_EQ(Sql("PRAGMA user_version"), present);
  // The first version had no snapshots.
  ASSERT_EQ(Sql("SELECT count(*) FROM snapshot"), "0");
  Sql("DROP TABLE log_state; DROP TABLE snapshot; PRAGMA user_version = 1");
  Start();
  EXPECT_EQ(Fetch("done-before", "after-1"), files);
  const auto worker = Worker();
  EXPECT_EQ(Trem({"watch", "under-way-1", "--quiet"}).exit_code, 0);
}

TEST_F(UpgradeTest, ANewerLogIsRefusedByNumberAndLeftAlone) {
  Start();
  Submit("kept", 8);
  Stop();
  Sql("PRAGMA user_version = 99");
  // All that the log says; the file's header may change when it is opened.
  const std::string content =
      "SELECT (SELECT group_concat(sql) FROM sqlite_master) || (SELECT coalesce(group_concat(sequence || kind || hex(body)), '-') FROM "
      "events) "
      "|| (SELECT coalesce(group_concat(position || kind || hex(body)), '-') FROM snapshot)";
  const std::string before = Sql(content);
  ASSERT_THAT(before, HasSubstr("CREATE TABLE events"));
  const Completed refused = RunProgram({BinaryPath("trem-coordinator").string(), "--state", (fixture_.folder() / "state").string(),
                                        "--store", store_.string(), "--bind", "tcp://127.0.0.1:*"},
                                       std::chrono::minutes(1), fixture_.Options());
  EXPECT_EQ(refused.exit_code, 3);
  EXPECT_THAT(refused.stderr_text, AllOf(HasSubstr("schema version 99"), HasSubstr("use the trem-coordinator that wrote it")));
  EXPECT_EQ(Sql("PRAGMA user_version"), "99");
  EXPECT_EQ(Sql(content), before);
}

TEST_F(UpgradeTest, AWorkerOfAnotherEngineIsRefusedInWordsThatNameBoth) {
  Start();
  const auto channel = std::move(DealerChannel::Connect(endpoint_)).value();
  v1::Envelope envelope;
  v1::Hello* hello = envelope.mutable_hello();
  hello->set_protocol_version(kProtocolVersion);
  hello->set_engine_revision("other");
  hello->set_worker_id("w1");
  hello->set_host("node-7");
  hello->set_credit(1);
  ASSERT_TRUE(channel->Send(envelope, std::chrono::seconds(20)).ok());
  const auto answer = channel->Receive(std::chrono::seconds(20));
  ASSERT_TRUE(answer.ok() && answer->has_value() && (*answer)->has_error());
  EXPECT_THAT((*answer)->error().message(), AllOf(HasSubstr("engine revision 'other'"), HasSubstr(std::string("has '") + kEngineRevision),
                                                  HasSubstr("run the same release of both")));
}

TEST_F(UpgradeTest, ClientAndWorkerSayThatACoordinatorIsOfAnotherRelease) {
  const LaterCoordinator later;
  endpoint_ = later.endpoint();
  const std::string expected = "the peer speaks protocol version 9, this program version " + std::to_string(kProtocolVersion) +
                               "; install the same release of trem on both sides";
  const Completed list = Trem({"list"});
  EXPECT_EQ(list.exit_code, 3);
  EXPECT_THAT(list.stderr_text, HasSubstr(expected));
  const auto worker = Worker();
  const auto exit = worker->Wait(std::chrono::seconds(60));
  ASSERT_TRUE(exit.has_value()) << "it goes on trying";
  EXPECT_EQ(exit->code, 3);
  EXPECT_THAT(worker->Stderr(), HasSubstr(expected));
}

// An older program sends an older header, and reads the answer's.
TEST_F(UpgradeTest, APeerOfAnEarlierProtocolIsAnsweredWithTheVersionThatIsSpoken) {
  Start();
  const std::string header = AskInEarlierProtocol(endpoint_, "");
  ASSERT_EQ(header.size(), 8U);
  EXPECT_EQ(header.substr(0, 5), "TREM" + std::string(1, static_cast<char>(kProtocolVersion)));
  for (int i = 0; i < 500 && coordinator_->Stderr().find("protocol version 1") == std::string::npos; ++i)
    std::this_thread::sleep_for(milliseconds(20));
  EXPECT_THAT(coordinator_->Stderr(), HasSubstr("the peer speaks protocol version 1, this program version 2"));
}

}  // namespace
}  // namespace trem::testing
