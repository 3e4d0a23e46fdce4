// Goal: the shell lets nothing leave before the log has it, recovers from its log and store, tells strangers and misfits what is wrong,
// and answers clients. Method: a shell without sockets: messages are handed in, what it sends is caught, time is given.
#include "coordinator/app/shell.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <map>
#include <string>

#include "mosaic/base/digest.h"
#include "mosaic/base/version.h"
#include "proto/codec/convert.h"
#include "tests/support/paths.h"

namespace trem {
namespace {

using ::testing::HasSubstr;
using ::testing::SizeIs;
using Sent = std::vector<std::pair<std::string, v1::Envelope>>;

class ShellTest : public ::testing::Test {
 protected:
  ShellTest() { Start(); }

  // Starts a shell, or starts it again after the old one was dropped without notice.
  void Start(const EventStoreOptions& store_options = {}, const ShellOptions& options = {}) {
    shell.reset();
    auto events = EventStore::Open(folder / "state", store_options);
    TREM_CHECK_MSG(events.ok(), events.status().ToString());
    store = events->get();
    auto artefacts = ArtefactStore::Open(folder / "store");
    TREM_CHECK_MSG(artefacts.ok(), artefacts.status().ToString());
    auto made = Shell::Create(std::move(events).value(), std::move(artefacts).value(), options,
                              [this](const std::string& peer, const v1::Envelope& e) {
                                sent.emplace_back(peer, e);
                                return true;
                              });
    TREM_CHECK_MSG(made.ok(), made.status().ToString());
    shell = std::move(made).value();
  }

  // Hands a message in and returns what leaves.
  Sent Say(const std::string& peer, const v1::Envelope& envelope) {
    sent.clear();
    shell->Receive(now_ms, peer, envelope);
    EXPECT_TRUE(sent.empty()) << "something left before Flush";
    EXPECT_TRUE(shell->Flush().ok());
    while (shell->Maintain()) {
    }
    return sent;
  }

  static v1::Envelope Hello(const std::string& worker_id) {
    v1::Envelope envelope;
    envelope.mutable_hello()->set_protocol_version(kProtocolVersion);
    envelope.mutable_hello()->set_engine_revision(kEngineRevision);
    envelope.mutable_hello()->set_worker_id(worker_id);
    envelope.mutable_hello()->set_credit(1);
    return envelope;
  }
  static v1::Envelope Submit(const std::string& job_id, std::uint64_t seed = 0) {
    v1::Envelope envelope;
    envelope.mutable_submit_job()->set_job_id(job_id);
    envelope.mutable_submit_job()->mutable_sortie()->mutable_source()->set_path("/data/leg");
    envelope.mutable_submit_job()->mutable_sortie()->set_seed(seed);
    return envelope;
  }
  static v1::Envelope GetJob(const std::string& job_id) {
    v1::Envelope envelope;
    envelope.mutable_get_job()->set_job_id(job_id);
    return envelope;
  }
  // The INGEST that was dispatched, done, with a manifest that is really in the store.
  v1::Envelope DoneIngest(const v1::Dispatch& dispatch) {
    const ArtefactStore artefacts = ArtefactStore::Open(folder / "store").value();
    v1::Envelope envelope;
    v1::Done* done = envelope.mutable_done();
    done->mutable_attempt()->set_task_key(dispatch.task().key());
    done->mutable_attempt()->set_attempt(dispatch.attempt());
    *done->mutable_result()->add_outputs() = ToProto(artefacts.PutBytes("manifest.pb", "a manifest").value());
    v1::IngestSummary* ingest = done->mutable_result()->mutable_ingest();
    ingest->set_frame_count(10);
    ingest->set_width_px(64);
    ingest->set_height_px(64);
    ingest->mutable_valid_roi()->set_x1(64);
    ingest->mutable_valid_roi()->set_y1(64);
    ingest->add_spans()->set_end(10);
    return envelope;
  }

  trem::testing::TempDir folder;
  Sent sent;
  std::unique_ptr<Shell> shell;
  EventStore* store = nullptr;  // The shell's.
  TimeMs now_ms = 1'000;
};

TEST_F(ShellTest, WelcomesAWorkerAndHandsItATask) {
  Say("client", Submit("job"));
  const Sent out = Say("peer-1", Hello("w1"));
  ASSERT_THAT(out, SizeIs(2));
  EXPECT_EQ(out[0].second.welcome().heartbeat_interval_ms(), 500U);
  EXPECT_EQ(out[0].second.welcome().store_path(), (folder / "store").string());
  EXPECT_EQ(out[1].first, "peer-1");
  EXPECT_EQ(out[1].second.dispatch().task().kind(), v1::INGEST);
  EXPECT_EQ(out[1].second.dispatch().lease_ms(), 20'000U);
}

TEST_F(ShellTest, RefusesWorkersOfAnotherReleaseInWordsAndGivesThemNothing) {
  Say("client", Submit("job"));
  v1::Envelope old_protocol = Hello("w1");
  old_protocol.mutable_hello()->set_protocol_version(kProtocolVersion + 1);
  v1::Envelope old_engine = Hello("w2");
  old_engine.mutable_hello()->set_engine_revision("ancient");
  for (const auto& [hello, words] :
       {std::pair(old_protocol, "speaks protocol version"), std::pair(old_engine, "engine revision 'ancient'")}) {
    const Sent out = Say("peer", hello);
    ASSERT_THAT(out, SizeIs(1));
    EXPECT_EQ(out[0].second.error().status_code(), static_cast<std::uint32_t>(StatusCode::kInvalidInput));
    EXPECT_THAT(out[0].second.error().message(), HasSubstr(words));
  }
}

TEST_F(ShellTest, AsksAStrangerToSayHello) {
  v1::Envelope heartbeat;
  heartbeat.mutable_heartbeat();
  const Sent out = Say("stranger", heartbeat);
  ASSERT_THAT(out, SizeIs(1));
  EXPECT_EQ(out[0].second.error().status_code(), static_cast<std::uint32_t>(StatusCode::kUnavailable));
  EXPECT_THAT(out[0].second.error().message(), HasSubstr("say Hello"));
}

TEST_F(ShellTest, TakesASilentWorkerForLostAfterEightHeartbeats) {
  Say("client", Submit("job"));
  Say("peer-1", Hello("w1"));
  now_ms += 2'000;
  Say("peer-2", Hello("w2"));
  sent.clear();
  now_ms += 2'001;
  shell->Tick(now_ms);
  ASSERT_TRUE(shell->Flush().ok());
  ASSERT_FALSE(sent.empty());
  EXPECT_EQ(sent[0].first, "peer-2");
  EXPECT_EQ(sent[0].second.dispatch().attempt(), 2U);
}

TEST_F(ShellTest, GoesOnWhereItsLogEnds) {
  Say("client", Submit("job"));
  const v1::Dispatch ingest = Say("peer", Hello("w1"))[1].second.dispatch();
  const Sent out = Say("peer", DoneIngest(ingest));
  ASSERT_THAT(out, SizeIs(2));
  EXPECT_TRUE(out[0].second.has_ack());
  const v1::Dispatch enhance = out[1].second.dispatch();
  Start();
  v1::Envelope hello = Hello("w1");
  hello.mutable_hello()->add_running()->set_task_key(enhance.task().key());
  hello.mutable_hello()->mutable_running(0)->set_attempt(enhance.attempt());
  EXPECT_THAT(Say("peer", hello), SizeIs(1)) << "a Welcome; it keeps what it runs";
  const v1::JobStatus status = Say("client", GetJob("job"))[0].second.job_status();
  EXPECT_EQ(status.stages(0).done(), 1U);
  EXPECT_EQ(status.stages(1).running(), 1U);
  EXPECT_EQ(status.store_path(), (folder / "store").string());
}

TEST_F(ShellTest, RunsATaskAgainWhenItsArtefactsAreGone) {
  Say("client", Submit("job"));
  Say("peer", DoneIngest(Say("peer", Hello("w1"))[1].second.dispatch()));
  std::filesystem::remove_all(folder / "store");
  Start();
  EXPECT_EQ(Say("client", GetJob("job"))[0].second.job_status().stages(0).done(), 0U);
  Say("peer", Hello("w1"));
  now_ms += 4'000;
  Say("peer", Hello("w1"));
  sent.clear();
  shell->Tick(now_ms);
  ASSERT_TRUE(shell->Flush().ok());
  const v1::Dispatch dispatch = [&] {
    for (const auto& [peer, envelope] : sent) {
      if (envelope.has_dispatch()) return envelope.dispatch();
    }
    return v1::Dispatch();
  }();
  EXPECT_EQ(dispatch.task().kind(), v1::INGEST);
}

TEST_F(ShellTest, TakesNothingInWhileTheDiskIsFullAndGoesOnWhenThereIsRoom) {
  Start();
  Say("peer", Hello("w1"));
  ASSERT_TRUE(store->SetBytesMax(4096).ok());  // Less than it has: not one more page.
  int accepted = 0;
  while (accepted < 200 && !shell->is_full()) {
    sent.clear();
    shell->Receive(now_ms, "client", Submit("job-" + std::to_string(accepted)));
    ASSERT_TRUE(shell->Flush().ok());
    if (!shell->is_full()) ++accepted;
  }
  ASSERT_TRUE(shell->is_full());
  EXPECT_TRUE(sent.empty()) << "a job was confirmed that the log does not hold";
  const std::string waiting = "job-" + std::to_string(accepted);

  // Clients are told, workers are kept alive, leases do not end.
  shell->Receive(now_ms, "client", Submit("another"));
  ASSERT_THAT(sent, SizeIs(1));
  EXPECT_EQ(sent[0].second.error().status_code(), static_cast<std::uint32_t>(StatusCode::kExhausted));
  EXPECT_THAT(sent[0].second.error().message(), HasSubstr("events.sqlite is full"));
  sent.clear();
  now_ms += 600'000;
  shell->Tick(now_ms);
  ASSERT_TRUE(shell->Flush().ok());
  ASSERT_THAT(sent, SizeIs(1));
  EXPECT_TRUE(sent[0].second.has_heartbeat());
  v1::Envelope heartbeat;
  heartbeat.mutable_heartbeat();
  shell->Receive(now_ms, "peer", heartbeat);

  ASSERT_TRUE(store->SetBytesMax(0).ok());
  sent.clear();
  ASSERT_TRUE(shell->Flush().ok());
  EXPECT_FALSE(shell->is_full());
  ASSERT_FALSE(sent.empty());
  EXPECT_EQ(sent.back().second.job_status().job_id(), waiting) << "what waited is answered once it is durable";
  EXPECT_EQ(Say("client", Submit("another")).back().second.job_status().state(), v1::JOB_RUNNING);
  Start();
  EXPECT_EQ(Say("client", GetJob(waiting))[0].second.job_status().state(), v1::JOB_RUNNING);
}

TEST_F(ShellTest, ALargerFleetSaysLessOftenThatItIsAliveAndIsGivenMoreTime) {
  ShellOptions options;
  options.heartbeat_fleet_step = 2;
  Start({}, options);
  EXPECT_EQ(Say("peer-1", Hello("w1")).back().second.welcome().heartbeat_interval_ms(), 500U);
  std::map<std::string, std::uint32_t> told;
  for (const auto& [peer, envelope] : Say("peer-2", Hello("w2"))) told[peer] = envelope.welcome().heartbeat_interval_ms();
  EXPECT_EQ(told, (std::map<std::string, std::uint32_t>{{"peer-1", 1'000}, {"peer-2", 1'000}})) << "all have to judge a silence alike";
  now_ms += 6'000;  // Too long for a fleet of one.
  shell->Tick(now_ms);
  v1::Envelope question;
  question.mutable_list_workers();
  EXPECT_EQ(Say("client", question).back().second.worker_list().workers_size(), 2);
  now_ms += 3'000;
  shell->Tick(now_ms);
  EXPECT_EQ(Say("client", question).back().second.worker_list().workers_size(), 0);
}

TEST_F(ShellTest, KeepsALogOfEachJobWithWhatWorkersWroteToStderr) {
  ShellOptions options;
  options.job_log_folder = folder / "logs";
  options.wall_clock_ms = [] { return std::uint64_t{5'000}; };
  Start({}, options);
  Say("client", Submit("job"));
  const v1::Dispatch dispatch = Say("peer", Hello("w1"))[1].second.dispatch();
  v1::Envelope log;
  log.mutable_task_log()->mutable_attempt()->set_task_key(dispatch.task().key());
  log.mutable_task_log()->mutable_attempt()->set_attempt(1);
  log.mutable_task_log()->add_lines("a corrupt frame\x1b[2J");
  Say("peer", log);
  Say("peer", DoneIngest(dispatch));
  v1::Envelope question;
  question.mutable_get_log()->set_job_id("job");
  const Sent out = Say("client", question);
  std::string texts;
  for (const v1::LogLine& line : out[0].second.log_page().lines()) {
    EXPECT_EQ(line.time_ms(), 5'000U);
    texts += line.task() + "#" + std::to_string(line.attempt()) + " " + line.worker_id() + " " + line.text() + "\n";
  }
  EXPECT_THAT(texts, HasSubstr("INGEST#1 w1 handed out\n"));
  EXPECT_THAT(texts, HasSubstr("INGEST#1 w1 stderr: a corrupt frame [2J\n")) << "control characters do not reach terminals";
  EXPECT_THAT(texts, HasSubstr("INGEST#1 w1 result after"));
  question.mutable_get_log()->set_job_id("other");
  EXPECT_THAT(Say("client", question)[0].second.error().message(), HasSubstr("there is no job 'other'"));
}

TEST_F(ShellTest, MakesABackupWhileItGoesOn) {
  ShellOptions options;
  options.backup_folder = folder / "backups";
  Start({}, options);
  Say("client", Submit("job"));
  v1::Envelope question;
  question.mutable_backup()->set_backup_id("nightly");
  EXPECT_LT(Say("admin", question)[0].second.backup_status().fraction(), 1.0);
  const v1::BackupStatus done = Say("admin", question)[0].second.backup_status();
  EXPECT_EQ(done.fraction(), 1.0);
  EXPECT_EQ(done.path(), (folder / "backups" / "nightly.sqlite").string());
  EXPECT_EQ(done.sha256(), Sha256HexOfFile(done.path()).value());
  Say("client", Submit("later", 1));
  shell.reset();
  ASSERT_TRUE(EventStore::Restore(done.path(), folder / "state").ok());
  Start({}, options);
  EXPECT_EQ(Say("client", GetJob("job"))[0].second.job_status().state(), v1::JOB_RUNNING);
  EXPECT_THAT(Say("client", GetJob("later"))[0].second.error().message(), HasSubstr("there is no job 'later'"));
}

TEST_F(ShellTest, ReplacesALongLogByASnapshotOfTheSameState) {
  ShellOptions options;
  options.compact_after_events = 3;
  Start({}, options);
  Say("client", Submit("job"));
  Say("peer", DoneIngest(Say("peer", Hello("w1"))[1].second.dispatch()));
  for (int i = 0; i < 4; ++i) Say("client", Submit("job-" + std::to_string(i), 1));
  EXPECT_GT(store->snapshot_count(), 0U);
  EXPECT_LE(store->event_count(), std::max<std::uint64_t>(options.compact_after_events, 2 * store->snapshot_count()));
  const std::string before = Say("client", GetJob("job"))[0].second.job_status().stages(0).DebugString();
  Start({}, options);
  EXPECT_EQ(Say("client", GetJob("job"))[0].second.job_status().stages(0).DebugString(), before);
  for (int i = 0; i < 4; ++i) {
    EXPECT_EQ(Say("client", GetJob("job-" + std::to_string(i)))[0].second.job_status().state(), v1::JOB_RUNNING);
  }
}

TEST_F(ShellTest, LimitsTheJobsOfAUserAndDrainsAndRetries) {
  ShellOptions options;
  options.user_jobs_max = 1;
  Start({}, options);
  v1::Envelope submit = Submit("one");
  submit.mutable_submit_job()->set_user("ann");
  submit.mutable_submit_job()->set_priority(3);
  const v1::JobStatus status = Say("c", submit)[0].second.job_status();
  EXPECT_EQ(status.user(), "ann");
  EXPECT_EQ(status.priority(), 3);
  submit.mutable_submit_job()->set_job_id("two");
  EXPECT_THAT(Say("c", submit)[0].second.error().message(), HasSubstr("user 'ann' has 1 jobs running"));
  submit.mutable_submit_job()->set_user("bob");
  EXPECT_TRUE(Say("c", submit)[0].second.has_job_status());

  Say("peer", Hello("w1"));
  v1::Envelope envelope;
  envelope.mutable_drain_worker()->set_worker_id("w1");
  const Sent drained = Say("c", envelope);
  ASSERT_THAT(drained, SizeIs(2));
  EXPECT_TRUE(drained[0].second.has_drain());
  EXPECT_TRUE(drained[1].second.worker_list().workers(0).draining());
  envelope.mutable_drain_worker()->set_worker_id("nobody");
  EXPECT_THAT(Say("c", envelope)[0].second.error().message(), HasSubstr("no worker 'nobody'"));
  envelope.mutable_cancel_job()->set_job_id("one");
  Say("c", envelope);
  envelope.mutable_retry_job()->set_job_id("one");
  EXPECT_EQ(Say("c", envelope).back().second.job_status().state(), v1::JOB_RUNNING);
}

TEST_F(ShellTest, AnswersClients) {
  EXPECT_EQ(Say("c", Submit("job"))[0].second.job_status().state(), v1::JOB_RUNNING);
  EXPECT_EQ(Say("c", Submit("job"))[0].second.job_status().state(), v1::JOB_RUNNING) << "the same job again";
  EXPECT_THAT(Say("c", Submit("job", 5))[0].second.error().message(), HasSubstr("exists with another sortie"));
  EXPECT_EQ(Say("c", GetJob("none"))[0].second.error().status_code(), static_cast<std::uint32_t>(StatusCode::kNotFound));
  EXPECT_THAT(Say("c", Submit("Not An Id"))[0].second.error().message(), HasSubstr("malformed"));
  v1::Envelope bad = Submit("bad");
  bad.mutable_submit_job()->mutable_sortie()->mutable_tre()->set_ratio(77);
  EXPECT_THAT(Say("c", bad)[0].second.error().message(), HasSubstr("ratio"));
  v1::Envelope envelope;
  envelope.mutable_list_jobs();
  EXPECT_THAT(Say("c", envelope)[0].second.job_list().jobs(), SizeIs(1));
  Say("peer", Hello("w1"));
  envelope.mutable_list_workers();
  EXPECT_EQ(Say("c", envelope)[0].second.worker_list().workers(0).worker_id(), "w1");
  envelope.mutable_cancel_job()->set_job_id("job");
  const Sent cancelled = Say("c", envelope);
  ASSERT_THAT(cancelled, SizeIs(2)) << "CancelTask to the worker, status to the client";
  EXPECT_TRUE(cancelled[0].second.has_cancel_task());
  EXPECT_EQ(cancelled[1].second.job_status().state(), v1::JOB_CANCELLED);
  envelope.mutable_shutdown();
  EXPECT_TRUE(Say("c", envelope)[0].second.has_bye());
  EXPECT_TRUE(shell->shutdown_requested());
}

}  // namespace
}  // namespace trem
