// Goal: `trem doctor` finds what is wrong with a real service and says what to do. Method: real programs, each brought into one of the
// states that it knows; where a state cannot be had on one machine (another clock, another protocol), a coordinator of the test's own plays
// it.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>

#include <atomic>
#include <fstream>
#include <nlohmann/json.hpp>
#include <thread>

#include "mosaic/base/version.h"
#include "mosaic/base/wall_clock.h"
#include "proto/channel/dealer_channel.h"
#include "proto/channel/router_channel.h"
#include "tests/e2e/earlier_peer.h"
#include "tests/e2e/later_coordinator.h"
#include "tests/e2e/service_fixture.h"

namespace trem::testing {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

class DoctorTest : public ServiceTest {
 protected:
  // What the doctor says; its exit code must say whether all is well.
  nlohmann::json Findings(std::vector<std::string> more = {}, const std::vector<std::string>& environment = {}) const {
    more.insert(more.begin(), {"doctor", "--json"});
    const Completed doctor = Trem(more, environment);
    const auto findings = nlohmann::json::parse(doctor.stdout_text, nullptr, false);
    EXPECT_TRUE(findings.is_array()) << doctor.stdout_text << doctor.stderr_text;
    bool all_good = true;
    for (const auto& finding : findings) all_good = all_good && finding["good"];
    EXPECT_EQ(doctor.exit_code, all_good ? 0 : 1);
    return findings;
  }
  // The finding about `subject`, the bad one where there are several.
  static nlohmann::json Find(const nlohmann::json& findings, const std::string& subject) {
    nlohmann::json found;
    for (const auto& finding : findings) {
      if (finding["subject"] == subject && (found.is_null() || !finding["good"])) found = finding;
    }
    return found;
  }
  static void ExpectGood(const nlohmann::json& findings, const std::string& subject, const std::string& text) {
    const nlohmann::json found = Find(findings, subject);
    ASSERT_TRUE(found.is_object()) << subject << " is not in " << findings.dump(1);
    EXPECT_EQ(found["good"], true) << found.dump();
    EXPECT_THAT(found["text"].get<std::string>(), HasSubstr(text));
  }
  static void ExpectBad(const nlohmann::json& findings, const std::string& subject, const std::string& text, const std::string& advice) {
    const nlohmann::json found = Find(findings, subject);
    ASSERT_TRUE(found.is_object()) << subject << " is not in " << findings.dump(1);
    EXPECT_EQ(found["good"], false) << found.dump();
    EXPECT_THAT(found["text"].get<std::string>(), HasSubstr(text));
    EXPECT_THAT(found["advice"].get<std::string>(), HasSubstr(advice));
  }
  // The id of the one worker, once it is there.
  std::string WorkerId() const {
    for (int i = 0; i < 300; ++i) {
      const auto workers = nlohmann::json::parse(Trem({"workers", "--json"}).stdout_text);
      if (workers.size() == 1) return workers[0]["worker_id"];
      std::this_thread::sleep_for(std::chrono::milliseconds(100));
    }
    ADD_FAILURE() << "no worker came";
    return "";
  }
};

TEST_F(DoctorTest, FindsAServiceThatIsWell) {
  Start();
  const auto worker = Worker();
  WorkerId();
  const auto findings = Findings({"--store", store_.string()});
  ExpectGood(findings, "trem-worker", TREM_VERSION);
  ExpectGood(findings, "connection", "no keys in use");
  ExpectGood(findings, "coordinator", "answers");
  ExpectGood(findings, "release", "as here");
  ExpectGood(findings, "clock", "agrees");
  ExpectGood(findings, "store quota", "none");
  ExpectGood(findings, "workers", "1 connected");
  ExpectGood(findings, "data lane", "there and back");
  ExpectGood(findings, "artefact store", "can be written to");
}

TEST_F(DoctorTest, TellsWhyThereIsNoConnection) {
  endpoint_ = "tcp://127.0.0.1:1";
  ExpectBad(Findings(), "connection", "nothing listens", "start trem-coordinator there");
  endpoint_ = "tcp://192.0.2.1:7411";  // Without keys no other machine is spoken to.
  ExpectBad(Findings(), "connection", "need keys", "correct --coordinator");
}

TEST_F(DoctorTest, TellsKeysApart) {
  const fs::path keys = fixture_.folder() / "keys";
  const auto make = [&](const char* name, const char* role) {
    ASSERT_EQ(Trem({"keys", name, "--role", role, "-o", keys.string()}).exit_code, 0);
  };
  make("hill", "coordinator");
  make("valley", "coordinator");
  make("client", "client");
  make("stranger", "client");
  fs::create_directories(fixture_.folder() / "allowed");
  fs::copy_file(keys / "client.pub", fixture_.folder() / "allowed" / "client.pub");
  Start({"--key", (keys / "hill.key").string(), "--allow", (fixture_.folder() / "allowed").string()});
  const auto as = [&](const char* key, const char* coordinator) {
    return Findings({}, {"TREM_KEY=" + (keys / key).string() + ".key", "TREM_COORDINATOR_KEY=" + (keys / coordinator).string() + ".pub"});
  };
  ExpectGood(as("client", "hill"), "connection", "key 'client' is let in");
  ExpectBad(as("stranger", "hill"), "connection", "does not let the key 'stranger' in", "copy stranger.pub into the folder");
  ExpectBad(as("client", "valley"), "connection", "does not have the key of", "get the coordinator's present .pub file");
  ExpectBad(Findings(), "connection", "wants keys", "--coordinator-key");
  fs::permissions(keys / "client.key", fs::perms::owner_read | fs::perms::owner_write | fs::perms::others_read);
  ExpectBad(as("client", "hill"), "keys", "client.key", "chmod 600");
}

TEST_F(DoctorTest, TellsOfAFleetThatIsNotThereOrTakesNothing) {
  Start({"--heartbeat-ms", "5000"});  // A worker that is stopped stays in the list for 40 s.
  Submit("town", 3);
  ExpectBad(Findings(), "workers", "none is connected, and jobs wait", "trem-worker serve");
  // Its limit holds no task, so that it takes none.
  const auto worker = Worker({"--memory-max-bytes", "100000000"});
  const std::string id = WorkerId();
  ExpectBad(Findings(), "memory limits", "the largest limit of a worker is 100.0 MB", "--memory-max-bytes");
  worker->Signal(SIGSTOP);  // Or it would leave at once.
  ASSERT_EQ(Trem({"drain", id}).exit_code, 0);
  ExpectBad(Findings(), "workers", "the only one is draining", "start new ones");
  worker->Signal(SIGKILL);
}

// Its messages are refused by their header; what it says of itself is read all the same.
TEST_F(DoctorTest, TellsOfAWorkerOfAnotherProtocol) {
  Start();
  v1::Envelope envelope;
  v1::Hello* hello = envelope.mutable_hello();
  hello->set_protocol_version(1);
  hello->set_worker_id("older-1");
  hello->set_host("node-8");
  hello->set_engine_revision("ancient");
  hello->set_credit(1);
  ASSERT_NE(AskInEarlierProtocol(endpoint_, envelope.SerializeAsString()), "");
  const std::string both = "worker older-1 speaks protocol version 1; this coordinator speaks version " + std::to_string(kProtocolVersion);
  ExpectBad(Findings(), "refused worker", "on node-8: " + both, "install the coordinator's release there");
  EXPECT_THAT(coordinator_->Stderr(), HasSubstr(both));
  // A refused worker is none.
  EXPECT_EQ(nlohmann::json::parse(Trem({"workers", "--json"}).stdout_text).size(), 0U);
}

TEST_F(DoctorTest, TellsOfWorkersOfAnotherReleaseAndOtherClocks) {
  Start();
  auto other = std::move(DealerChannel::Connect(endpoint_)).value();
  v1::Envelope envelope;
  v1::Hello* hello = envelope.mutable_hello();
  hello->set_protocol_version(kProtocolVersion);
  hello->set_worker_id("old-1");
  hello->set_host("node-9");
  hello->set_engine_revision("ancient");
  ASSERT_TRUE(other->Send(envelope, std::chrono::seconds(20)).ok());
  ASSERT_TRUE(other->Receive(std::chrono::seconds(20)).value().has_value());
  hello->set_worker_id("late-1");
  hello->set_engine_revision(kEngineRevision);
  hello->set_clock_ms(WallClockMs() - 3'600'000);
  ASSERT_TRUE(other->Send(envelope, std::chrono::seconds(20)).ok());
  ASSERT_TRUE(other->Receive(std::chrono::seconds(20)).value().has_value());
  const auto findings = Findings();
  ExpectBad(findings, "refused worker", "on node-9: worker old-1 has engine revision 'ancient'", "install the coordinator's release");
  ExpectBad(findings, "clock", "worker late-1 on node-9 is 36", "NTP");
}

TEST_F(DoctorTest, TellsOfQuotas) {
  Start({"--store-bytes-max", "10", "--user-jobs-max", "1"});
  Submit("town", 3);
  const auto findings = Findings();
  ExpectBad(findings, "data lane", "an upload to", "trem remove");
  ExpectBad(findings, "user quota", "1 job of yours running, at most 1 allowed", "--user-jobs-max");
}

TEST_F(DoctorTest, TellsOfAnObjectStoreThatDoesNotAnswer) {
  const auto findings =
      Findings({"--store", "/vsis3/bucket/prefix"}, {"AWS_S3_ENDPOINT=127.0.0.1:1", "AWS_HTTPS=NO", "AWS_VIRTUAL_HOSTING=FALSE",
                                                     "AWS_ACCESS_KEY_ID=x", "AWS_SECRET_ACCESS_KEY=not-the-secret"});
  ExpectBad(findings, "object store", "/vsis3/bucket/prefix", "AWS_SECRET_ACCESS_KEY");
  EXPECT_EQ(findings.dump().find("not-the-secret"), std::string::npos);
}

TEST_F(DoctorTest, TellsOfASharedStoreThatIsNotMounted) {
  ExpectBad(Findings({"--store", (fixture_.folder() / "nowhere").string()}), "artefact store", "is no artefact store", "is it mounted");
}

TEST_F(DoctorTest, TellsOfTheSlurmScaler) {
  const fs::path service = fixture_.NewFolder("service");
  ExpectBad(Findings({"--service", service.string()}), "Slurm scaler", "has never run", "scaler.sh");
  std::ofstream(service / "scaler") << WallClockMs() / 1000 << " 30 sbatch refused to start 3 workers\n";
  ExpectBad(Findings({"--service", service.string()}), "Slurm scaler", "sbatch refused", "by hand");
}

// Answers like a coordinator whose clock is an hour ahead and whose disk is nearly full.
TEST_F(DoctorTest, TellsOfACoordinatorsClockAndDisk) {
  auto router = std::move(RouterChannel::Bind("tcp://127.0.0.1:*")).value();
  endpoint_ = router->endpoint();
  std::atomic<bool> stop{false};
  std::thread coordinator([&] {
    while (!stop) {
      const auto incoming = router->Poll(std::chrono::milliseconds(20));
      if (!incoming || !incoming->envelope.ok()) continue;
      v1::Envelope answer;
      if (incoming->envelope->has_get_service_report()) {
        v1::ServiceReport* report = answer.mutable_service_report();
        report->set_clock_ms(WallClockMs() + 3'600'000);
        report->set_state_path("/var/lib/trem/state");
        report->set_state_bytes_free(5'000'000);
      } else {
        answer.mutable_worker_list();
      }
      router->Send(incoming->peer, answer);
    }
  });
  const auto findings = Findings();
  stop = true;
  coordinator.join();
  ExpectBad(findings, "clock", "ahead of this machine's", "NTP");
  ExpectBad(findings, "state disk", "5.0 MB free in /var/lib/trem/state", "make room there");
}

TEST_F(DoctorTest, TellsOfAnotherProtocolVersion) {
  const LaterCoordinator later;
  endpoint_ = later.endpoint();
  const auto findings = Findings();
  ExpectBad(findings, "coordinator", "speaks protocol version 9, this program version 2; install the same release of trem on both sides",
            "");
}

}  // namespace
}  // namespace trem::testing
