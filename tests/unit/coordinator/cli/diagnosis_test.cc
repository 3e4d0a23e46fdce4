// Goal: `trem doctor` names every cause that it knows of, with what was found and what to do, and is quiet when nothing is wrong. Method:
// what a coordinator would say, cause by cause; real programs are in tests/e2e/doctor_test.cc.
#include "coordinator/cli/diagnosis.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>

#include "mosaic/base/version.h"

namespace trem {
namespace {

using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::StartsWith;

constexpr std::uint64_t kNowMs = 1'800'000'000'000;

v1::ServiceReport WellReport() {
  v1::ServiceReport report;
  report.set_version(TREM_VERSION);
  report.set_engine_revision(kEngineRevision);
  report.set_clock_ms(kNowMs + 900);
  report.set_state_path("/var/lib/trem/state");
  report.set_state_bytes_free(50'000'000'000);
  report.set_store_path("/srv/store");
  report.set_store_bytes_free(50'000'000'000);
  return report;
}

v1::WorkerList Workers(int count) {
  v1::WorkerList list;
  for (int i = 0; i < count; ++i) {
    v1::WorkerStatus* worker = list.add_workers();
    worker->set_worker_id("w" + std::to_string(i));
    worker->set_host("node");
    worker->set_memory_bytes_max(1'000'000'000);
  }
  return list;
}

std::vector<Finding> Bad(std::vector<Finding> findings) {
  std::erase_if(findings, [](const Finding& finding) { return finding.is_good; });
  return findings;
}

// Exactly one finding is bad; it is about `subject`, says `text` and advises `advice`.
void ExpectBad(const std::vector<Finding>& findings, const std::string& subject, const std::string& text, const std::string& advice) {
  const std::vector<Finding> bad = Bad(findings);
  ASSERT_EQ(bad.size(), 1U) << subject;
  EXPECT_EQ(bad[0].subject, subject);
  EXPECT_THAT(bad[0].text, HasSubstr(text));
  EXPECT_THAT(bad[0].advice, HasSubstr(advice));
}

TEST(Diagnosis, IsQuietWhenAllIsWell) {
  EXPECT_THAT(Bad(JudgeReport(WellReport(), kNowMs)), IsEmpty());
  EXPECT_THAT(Bad(JudgeWorkers(Workers(2), true)), IsEmpty());
  EXPECT_THAT(Bad(JudgeJob(v1::JobStatus(), Workers(2))), IsEmpty());
  EXPECT_TRUE(JudgeReach(Reach::kReady, "tcp://h:1", "", "").is_good);
  EXPECT_TRUE(JudgeScaler("1799999990 30 ok: 3 tasks wait", kNowMs).is_good);
}

TEST(Diagnosis, TellsWhyThereIsNoConnection) {
  const auto expect = [](Reach reach, const char* key, const char* text, const char* advice) {
    ExpectBad({JudgeReach(reach, "tcp://h:1", key, "hill.pub")}, "connection", text, advice);
  };
  expect(Reach::kNobodyListens, "", "nothing listens at tcp://h:1", "start trem-coordinator there");
  expect(Reach::kNoWay, "", "nothing comes back", "firewalls");
  expect(Reach::kKeyNotAllowed, "ann", "does not let the key 'ann' in", "copy ann.pub into the folder");
  expect(Reach::kOtherKey, "ann", "does not have the key of hill.pub", "get the coordinator's present .pub");
  expect(Reach::kOtherKey, "", "no coordinator", "check the port");
  expect(Reach::kKeysDiffer, "", "wants keys", "--coordinator-key");
  expect(Reach::kKeysDiffer, "ann", "uses no keys", "leave --key");
}

TEST(Diagnosis, TellsOfAFullDiskAndOfSilence) {
  ExpectBad({JudgeRefusal(Exhausted("the disk that holds /s is full"))}, "coordinator", "is full", "make room");
  ExpectBad({JudgeRefusal(Unavailable("no coordinator answers"))}, "coordinator", "no coordinator", "/healthz");
  ExpectBad({JudgeRefusal(InvalidInput("the peer speaks protocol version 2; install the same release"))}, "coordinator",
            "install the same release", "");
}

TEST(Diagnosis, TellsOfDisksThatAreNearlyFull) {
  v1::ServiceReport report = WellReport();
  report.set_state_bytes_free(10'000'000);
  ExpectBad(JudgeReport(report, kNowMs), "state disk", "10.0 MB free in /var/lib/trem/state", "make room there");
  report = WellReport();
  report.set_store_bytes_free(10'000'000);
  ExpectBad(JudgeReport(report, kNowMs), "store disk", "/srv/store", "make room there");
  report.set_store_path("/vsis3/bucket/prefix");  // Has no disk that could be looked at.
  EXPECT_THAT(Bad(JudgeReport(report, kNowMs)), IsEmpty());
}

TEST(Diagnosis, TellsOfQuotas) {
  v1::ServiceReport report = WellReport();
  report.set_store_bytes(95);
  report.set_store_bytes_max(100);
  ExpectBad(JudgeReport(report, kNowMs), "store quota", "95 B of 100 B used", "trem remove");
  report.set_refuses_jobs("the artefact store holds 120 of at most 100 bytes");
  ExpectBad(JudgeReport(report, kNowMs), "store quota", "new jobs and uploads are refused: the artefact store holds 120",
            "--store-bytes-max");
  report = WellReport();
  report.set_user_jobs(3);
  report.set_user_jobs_max(3);
  ExpectBad(JudgeReport(report, kNowMs), "user quota", "3 jobs of yours running, at most 3 allowed", "--user-jobs-max");
}

TEST(Diagnosis, TellsOfClocks) {
  v1::ServiceReport report = WellReport();
  report.set_clock_ms(kNowMs + 312'000);
  ExpectBad(JudgeReport(report, kNowMs), "clock", "312 s ahead of this machine's", "NTP");
  report.set_clock_ms(kNowMs - 312'000);
  ExpectBad(JudgeReport(report, kNowMs), "clock", "312 s behind this machine's", "NTP");
  v1::WorkerList workers = Workers(2);
  workers.mutable_workers(1)->set_clock_ahead_ms(-90'000);
  ExpectBad(JudgeWorkers(workers, false), "clock", "worker w1 on node is 90 s behind the coordinator", "NTP");
}

TEST(Diagnosis, TellsOfWorkersThatWereRefused) {
  v1::ServiceReport report = WellReport();
  v1::RefusedWorker* refused = report.add_refused_workers();
  refused->set_worker_id("w9");
  refused->set_host("node-9");
  refused->set_reason("worker w9 has engine revision '3'; this coordinator has '4'");
  refused->set_ms_ago(5'000);
  ExpectBad(JudgeReport(report, kNowMs), "refused worker", "5 s ago, on node-9: worker w9 has engine revision '3'",
            "install the coordinator's");
}

TEST(Diagnosis, TellsOfAFleetThatTakesNothing) {
  ExpectBad(JudgeWorkers(Workers(0), true), "workers", "none is connected, and jobs wait", "trem-worker serve");
  v1::WorkerList workers = Workers(2);
  for (auto& worker : *workers.mutable_workers()) worker.set_draining(true);
  ExpectBad(JudgeWorkers(workers, true), "workers", "all 2 are draining", "start new ones");
  workers.mutable_workers(0)->set_draining(false);
  EXPECT_THAT(Bad(JudgeWorkers(workers, true)), IsEmpty());
  workers.mutable_workers(0)->set_last_seen_ms_ago(12'000);
  ExpectBad(JudgeWorkers(workers, true), "worker", "nothing was heard of w0 on node for 12 s", "look at its log");
}

TEST(Diagnosis, TellsOfMemoryLimitsThatHoldNoTask) {
  v1::JobStatus job;
  job.set_job_id("town");
  v1::Note* note = job.add_notes();
  note->set_code("waiting_for_memory");
  note->set_message("at least 3000000000 bytes are needed");
  ExpectBad(JudgeJob(job, Workers(2)), "memory limits",
            "job town: at least 3000000000 bytes are needed; the largest limit of a worker is 1.0 GB", "--memory-max-bytes");
}

TEST(Diagnosis, TellsOfASlurmScalerThatDoesNotScale) {
  ExpectBad({JudgeScaler("", kNowMs)}, "Slurm scaler", "has never run", "scaler.sh");
  ExpectBad({JudgeScaler("1799999000 30 ok: 3 tasks wait", kNowMs)}, "Slurm scaler", "its last step was 1000 s ago", "start deploy/slurm");
  ExpectBad({JudgeScaler("1799999990 30 sbatch refused: invalid partition", kNowMs)}, "Slurm scaler", "sbatch refused: invalid partition",
            "by hand");
  // Not a note of the scaler's: too old, whatever it says.
  ExpectBad({JudgeScaler("\x1b[31m nonsense", kNowMs)}, "Slurm scaler", "its last step was", "start");
}

}  // namespace
}  // namespace trem
