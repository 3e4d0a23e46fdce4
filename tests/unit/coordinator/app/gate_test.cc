// Goal: every role may say what it should and nothing else, and floods and oversize specs stop at the gate. Method: the gate alone, with
// made-up messages and given times; the table of roles is complete: a new message has to be added here.
#include "coordinator/app/gate.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <map>

namespace trem {
namespace {

using ::testing::HasSubstr;
using Body = v1::Envelope;

RouterChannel::Incoming From(const std::string& user, v1::Role role, const v1::Envelope& envelope, const std::string& peer = "peer") {
  return {peer, envelope, user, role, envelope.ByteSizeLong()};
}

v1::Envelope Heartbeat() {
  v1::Envelope envelope;
  envelope.mutable_heartbeat();
  return envelope;
}

TEST(GateTest, EveryRoleMaySayWhatItShouldAndNothingElse) {
  // Client, worker, admin.
  const std::map<std::string, std::string> expected = {
      {"hello", "-w-"},          {"progress", "-w-"},
      {"done", "-w-"},           {"goodbye", "-w-"},
      {"heartbeat", "cwa"},      {"submit_job", "c-a"},
      {"get_job", "c-a"},        {"list_jobs", "c-a"},
      {"cancel_job", "c-a"},     {"list_workers", "c-a"},
      {"shutdown", "--a"},       {"welcome", "---"},
      {"dispatch", "---"},       {"ack", "---"},
      {"cancel_task", "---"},    {"job_status", "---"},
      {"job_list", "---"},       {"worker_list", "---"},
      {"error", "---"},          {"bye", "---"},
      {"remove_job", "c-a"},     {"retry_job", "c-a"},
      {"drain_worker", "--a"},   {"drain", "---"},
      {"get_data_lane", "cwa"},  {"data_lane", "---"},
      {"get_chunk", "cwa"},      {"chunk", "---"},
      {"put_chunk", "cwa"},      {"put_reply", "---"},
      {"task_log", "-w-"},       {"get_log", "c-a"},
      {"log_page", "---"},       {"backup", "--a"},
      {"backup_status", "---"},  {"list_artefacts", "--a"},
      {"artefact_list", "---"},  {"get_service_report", "c-a"},
      {"service_report", "---"}, {"share", "---"},
  };
  const auto* body = v1::Envelope::descriptor()->FindOneofByName("body");
  for (int i = 0; i < body->field_count(); ++i) {
    const auto kind = static_cast<Body::BodyCase>(body->field(i)->number());
    std::string may;
    may += MaySend(v1::CLIENT, kind) ? 'c' : '-';
    may += MaySend(v1::WORKER, kind) ? 'w' : '-';
    may += MaySend(v1::ADMIN, kind) ? 'a' : '-';
    const auto found = expected.find(body->field(i)->name());
    ASSERT_NE(found, expected.end()) << body->field(i)->name();
    EXPECT_EQ(may, found->second) << body->field(i)->name();
    EXPECT_FALSE(MaySend(v1::COORDINATOR, kind));
    EXPECT_TRUE(MaySend(v1::ROLE_UNSPECIFIED, kind));
  }
}

TEST(GateTest, AClientsKeyIsNoWorkersKey) {
  Gate gate;
  v1::Envelope hello;
  hello.mutable_hello()->set_worker_id("w1");
  const Status status = gate.Admit(0, From("ann", v1::CLIENT, hello));
  EXPECT_EQ(status.code(), StatusCode::kInvalidInput);
  EXPECT_THAT(status.message(), HasSubstr("key 'ann' has the role client and may not send hello"));
  EXPECT_EQ(gate.counters().wrong_role, 1U);
}

TEST(GateTest, AFloodOfOneKeyStopsWhileOthersPass) {
  Gate gate;
  int passed = 0;
  for (int i = 0; i < 5000; ++i) passed += gate.Admit(1000, From("ann", v1::CLIENT, Heartbeat(), "peer" + std::to_string(i))).ok() ? 1 : 0;
  EXPECT_EQ(passed, 800);
  EXPECT_EQ(gate.counters().too_many, 4200U);
  EXPECT_TRUE(gate.Admit(1000, From("bob", v1::CLIENT, Heartbeat())).ok());
  EXPECT_TRUE(gate.Admit(1000, From("node", v1::WORKER, Heartbeat())).ok());
  EXPECT_FALSE(gate.Admit(1001, From("ann", v1::CLIENT, Heartbeat())).ok());
  EXPECT_TRUE(gate.Admit(1006, From("ann", v1::CLIENT, Heartbeat())).ok());
}

TEST(GateTest, AnOversizeSpecStops) {
  Gate gate;
  v1::Envelope submit;
  submit.mutable_submit_job()->set_job_id("job");
  submit.mutable_submit_job()->mutable_sortie()->set_name(std::string(2'000'000, 'x'));
  EXPECT_EQ(gate.Admit(0, From("ann", v1::CLIENT, submit)).code(), StatusCode::kExhausted);
  EXPECT_EQ(gate.counters().too_large, 1U);
}

TEST(GateTest, AnswersRefusalsSparingly) {
  Gate gate;
  EXPECT_TRUE(gate.MayAnswer(0, "a"));
  EXPECT_FALSE(gate.MayAnswer(999, "a"));
  EXPECT_TRUE(gate.MayAnswer(1000, "a"));
  int answers = 0;
  for (int i = 0; i < 1000; ++i) answers += gate.MayAnswer(5000, "peer" + std::to_string(i)) ? 1 : 0;
  EXPECT_EQ(answers, 20);
}

TEST(GateTest, GarbageIsCountedAndKeepsItsReason) {
  Gate gate;
  EXPECT_EQ(gate.Admit(0, {"peer", Corrupt("garbage"), "", v1::ROLE_UNSPECIFIED, 0}).code(), StatusCode::kCorrupt);
  EXPECT_EQ(gate.counters().malformed, 1U);
}

}  // namespace
}  // namespace trem
