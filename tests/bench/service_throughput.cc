// Questions: how many tasks a second does the service get done when the tasks cost nothing, with real processes and durable commits; and
// what do idle workers cost? Prints tasks a second end to end (submit to the last commit), what share of the processors coordinator and
// workers took, and the CPU time a task at either; then the coordinator's CPU share with --idle workers that only say that they are alive.
// A first job, which is not counted, makes every worker start its compute process: what that costs (some 0.2 s, most of it the dynamic
// linker's) it costs once, however many tasks follow.
//
// Budget: on two cores, 5 000 tasks/s leave 400 us of CPU time a task for everybody: two messages and two log events at the coordinator,
// and three hops between threads and processes at the worker.
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <chrono>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <memory>
#include <string>
#include <thread>
#include <vector>
#include <zmq.hpp>

#include "coordinator/cli/client.h"
#include "mosaic/base/check.h"
#include "mosaic/base/version.h"
#include "proto/codec/envelope.h"
#include "tests/support/loopback.h"
#include "tests/support/paths.h"
#include "tests/support/subprocess.h"
#include "tests/unit/coordinator/scheduling/fake_tasks.h"

namespace trem {
namespace {

namespace fs = std::filesystem;
using Clock = std::chrono::steady_clock;
using testing::BinaryPath;
using testing::Subprocess;

std::string FirstLine(const std::string& text) { return text.substr(0, text.find('\n')); }

double Seconds(Clock::time_point since) { return std::chrono::duration<double>(Clock::now() - since).count(); }

// User and system time of a process and of its children that have ended.
double CpuSeconds(pid_t pid) {
  std::ifstream file("/proc/" + std::to_string(pid) + "/stat");
  std::string text((std::istreambuf_iterator<char>(file)), {});
  text = text.substr(text.rfind(')') + 2);
  std::istringstream fields(text);
  std::string word;
  double ticks = 0.0;
  for (int i = 3; fields >> word && i <= 17; ++i) {
    if (i >= 14) ticks += std::stod(word);
  }
  return ticks / static_cast<double>(::sysconf(_SC_CLK_TCK));
}

double ResidentMiB(pid_t pid) {
  std::ifstream file("/proc/" + std::to_string(pid) + "/statm");
  double total = 0.0, resident = 0.0;
  file >> total >> resident;
  return resident * static_cast<double>(::sysconf(_SC_PAGESIZE)) / (1 << 20);
}

struct Options {
  int workers = 8;
  int jobs = 20;
  std::uint32_t windows = 1000;
  int idle = 1000;
  double idle_s = 10.0;
  std::string folder;
};

class Service {
 public:
  explicit Service(const Options& options) : options_(options) {
    fs::create_directories(options.folder);
    const fs::path ready = fs::path(options.folder) / "ready";
    coordinator_ = std::make_unique<Subprocess>(std::vector<std::string>{
        BinaryPath("trem-coordinator").string(), "--state", options.folder + "/state", "--store", options.folder + "/store", "--bind",
        "tcp://127.0.0.1:*", "--ready-file", ready.string(), "--log-level", "warn", "--http", "127.0.0.1:0", "--die-with-parent"});
    for (int i = 0; i < 1000 && !fs::exists(ready); ++i) std::this_thread::sleep_for(std::chrono::milliseconds(10));
    const std::string text = testing::FileContents(ready);
    endpoint_ = FirstLine(text);
    url_ = FirstLine(text.substr(endpoint_.size() + 1));
  }
  void MeasureThroughput() const;
  void MeasureIdle() const;

 private:
  const Options& options_;
  std::unique_ptr<Subprocess> coordinator_;
  // Until all of them have joined; one that ends (refused, because it is of another build than the coordinator) ends the bench.
  static void AwaitWorkers(Client* client, const std::vector<std::unique_ptr<Subprocess>>& workers);
  // Submits jobs [first, end), waits until all that were ever submitted have ended, and returns how many tasks those have.
  static double RunJobs(Client* client, int first, int end);
  // The value of a metric without labels.
  double Metric(const std::string& name) const {
    const std::string text = testing::HttpGet(url_, "/metrics");
    const std::size_t at = text.find("\n" + name + " ");
    return at == std::string::npos ? 0.0 : std::stod(text.substr(at + name.size() + 2));
  }
  std::string endpoint_;
  std::string url_;
};

double Service::RunJobs(Client* client, int first, int end) {
  for (int i = first; i < end; ++i) {
    const std::string id = "job-" + std::to_string(i);
    const auto job = client->Submit(id, testing::FakeSortie(id));
    TREM_CHECK_MSG(job.ok(), job.status().ToString());
  }
  v1::Envelope question;
  question.mutable_list_jobs();
  std::uint64_t done = 0;
  for (bool running = true; running;) {
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
    const auto answer = client->Ask(question);
    TREM_CHECK_MSG(answer.ok(), answer.status().ToString());
    running = false;
    done = 0;
    for (const v1::JobStatus& job : answer->job_list().jobs()) {
      running |= job.state() == v1::JOB_RUNNING;
      TREM_CHECK_MSG(job.state() != v1::JOB_FAILED, job.error());
      for (const v1::StageStatus& stage : job.stages()) done += stage.done();
    }
  }
  return static_cast<double>(done);
}

void Service::AwaitWorkers(Client* client, const std::vector<std::unique_ptr<Subprocess>>& workers) {
  v1::Envelope question;
  question.mutable_list_workers();
  for (;;) {
    const auto answer = client->Ask(question);
    TREM_CHECK_MSG(answer.ok(), answer.status().ToString());
    if (answer->worker_list().workers_size() == static_cast<int>(workers.size())) return;
    for (const auto& worker : workers) {
      TREM_CHECK_MSG(!worker->Wait(std::chrono::milliseconds(0)),
                     "a worker ended: " + worker->Stderr() + "\nbuild no_op_worker and trem-coordinator from the same source");
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
  }
}

void Service::MeasureThroughput() const {
  Client client(endpoint_, std::chrono::seconds(30));
  std::vector<std::unique_ptr<Subprocess>> workers;
  for (int i = 0; i < options_.workers; ++i) {
    workers.push_back(std::make_unique<Subprocess>(std::vector<std::string>{BinaryPath("no_op_worker").string(), "--coordinator", endpoint_,
                                                                            "--windows", std::to_string(options_.windows)}));
  }
  AwaitWorkers(&client, workers);
  const auto workers_cpu = [&workers] {
    double seconds = 0.0;
    for (const auto& worker : workers) {
      seconds += CpuSeconds(worker->pid());
      for (const pid_t child : worker->Descendants()) seconds += CpuSeconds(child);
    }
    return seconds;
  };
  const double first_tasks = RunJobs(&client, 0, 1);
  const double commits_start = Metric("trem_store_commit_seconds_count"), events_start = Metric("trem_store_events_total");
  const double commit_seconds_start = Metric("trem_store_commit_seconds_sum");
  const auto start = Clock::now();
  const double cpu_start = CpuSeconds(coordinator_->pid()), worker_cpu_start = workers_cpu();
  const double tasks = RunJobs(&client, 1, 1 + options_.jobs) - first_tasks;
  const double seconds = Seconds(start);
  const double cpu = CpuSeconds(coordinator_->pid()) - cpu_start;
  const double worker_cpu = workers_cpu() - worker_cpu_start;
  std::printf("%.0f tasks on %d workers in %.2f s: %.0f tasks/s, each durable\n", tasks, options_.workers, seconds, tasks / seconds);
  std::printf("  CPU time a task: coordinator %.0f us, workers %.0f us; %.0f %% of one core, and %.0f %%\n", cpu / tasks * 1e6,
              worker_cpu / tasks * 1e6, cpu / seconds * 100.0, worker_cpu / seconds * 100.0);
  const double commits = Metric("trem_store_commit_seconds_count") - commits_start;
  std::printf("  %.0f commits of %.1f events, %.2f ms each on average\n", commits,
              (Metric("trem_store_events_total") - events_start) / commits,
              (Metric("trem_store_commit_seconds_sum") - commit_seconds_start) / commits * 1e3);
  std::printf("  coordinator's memory: %.0f MiB, %.1f MiB a 100 000 tasks done\n", ResidentMiB(coordinator_->pid()),
              ResidentMiB(coordinator_->pid()) / tasks * 1e5);
}

// Workers that do what the protocol asks of them, all in one thread: Hello, then a Heartbeat at the interval of the Welcome.
void Service::MeasureIdle() const {
  zmq::context_t context(1);
  context.set(zmq::ctxopt::max_sockets, options_.idle + 16);
  std::vector<zmq::socket_t> sockets;
  const auto send = [](zmq::socket_t* socket, const v1::Envelope& envelope) {
    const EnvelopeFrames frames = EncodeEnvelope(envelope);
    (void)socket->send(zmq::buffer(frames.header), zmq::send_flags::sndmore);
    (void)socket->send(zmq::buffer(frames.body), zmq::send_flags::none);
  };
  for (int i = 0; i < options_.idle; ++i) {
    sockets.emplace_back(context, zmq::socket_type::dealer);
    sockets.back().set(zmq::sockopt::linger, 0);
    sockets.back().connect(endpoint_);
    v1::Envelope hello;
    hello.mutable_hello()->set_protocol_version(kProtocolVersion);
    hello.mutable_hello()->set_engine_revision(kEngineRevision);
    hello.mutable_hello()->set_worker_id("idle-" + std::to_string(i));
    hello.mutable_hello()->set_credit(1);
    send(&sockets.back(), hello);
  }
  v1::Envelope heartbeat;
  heartbeat.mutable_heartbeat();
  std::vector<std::uint32_t> intervals_ms(sockets.size(), 500);
  std::vector<Clock::time_point> due(sockets.size(), Clock::now());
  std::uint64_t received = 0, sent = 0;
  const auto live = [&](double for_s) {
    for (const auto until = Clock::now(); Seconds(until) < for_s; std::this_thread::sleep_for(std::chrono::milliseconds(20))) {
      for (std::size_t i = 0; i < sockets.size(); ++i) {
        zmq::message_t header, body;
        while (sockets[i].recv(header, zmq::recv_flags::dontwait) && sockets[i].recv(body, zmq::recv_flags::dontwait)) {
          ++received;
          const auto envelope = DecodeEnvelope(header.to_string_view(), body.to_string_view());
          if (envelope.ok() && envelope->has_welcome()) intervals_ms[i] = envelope->welcome().heartbeat_interval_ms();
        }
        if (Clock::now() < due[i]) continue;
        due[i] = Clock::now() + std::chrono::milliseconds(intervals_ms[i]);
        send(&sockets[i], heartbeat);
        ++sent;
      }
    }
  };
  live(3.0);
  received = sent = 0;
  const auto start = Clock::now();
  const double cpu_start = CpuSeconds(coordinator_->pid());
  live(options_.idle_s);
  const double seconds = Seconds(start);
  std::printf("%d idle workers: coordinator takes %.2f %% of a core; %.0f messages/s from them, %.0f messages/s to them\n", options_.idle,
              (CpuSeconds(coordinator_->pid()) - cpu_start) / seconds * 100.0, static_cast<double>(sent) / seconds,
              static_cast<double>(received) / seconds);
}

}  // namespace
}  // namespace trem

int main(int argc, char** argv) {
  trem::Options options;
  options.folder = (std::filesystem::temp_directory_path() / ("trem-service-throughput-" + std::to_string(::getpid()))).string();
  CLI::App app("Tasks a second of the whole service, and what idle workers cost.", "service_throughput");
  app.add_option("--workers", options.workers, "Worker processes")->capture_default_str();
  app.add_option("--jobs", options.jobs, "Jobs; 0: skip")->capture_default_str();
  app.add_option("--windows", options.windows, "Windows of a job")->capture_default_str();
  app.add_option("--idle", options.idle, "Idle workers; 0: skip")->capture_default_str();
  app.add_option("--idle-s", options.idle_s, "How long they are looked at")->capture_default_str();
  app.add_option("--folder", options.folder, "Where the log is written; removed afterwards")->capture_default_str();
  CLI11_PARSE(app, argc, argv);
  {
    const trem::Service service(options);
    if (options.jobs > 0) service.MeasureThroughput();
    if (options.idle > 0) service.MeasureIdle();
  }
  std::filesystem::remove_all(options.folder);
  return 0;
}
