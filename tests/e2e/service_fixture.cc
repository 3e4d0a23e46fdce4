#include "tests/e2e/service_fixture.h"

#include <thread>

namespace trem::testing {
namespace fs = std::filesystem;

void ServiceTest::Start(const std::vector<std::string>& more) {
  std::vector<std::string> argv = {BinaryPath("trem-coordinator").string(),
                                   "--state",
                                   (fixture_.folder() / "state").string(),
                                   "--store",
                                   store_.string(),
                                   "--bind",
                                   bind_,
                                   "--ready-file",
                                   ready_.string()};
  argv.insert(argv.end(), more.begin(), more.end());
  coordinator_ = std::make_unique<Subprocess>(argv, fixture_.Options());
  for (int i = 0; i < 3000 && !fs::exists(ready_); ++i) std::this_thread::sleep_for(std::chrono::milliseconds(10));
  ASSERT_TRUE(fs::exists(ready_)) << coordinator_->Stderr();
  endpoint_ = Lines(FileContents(ready_)).at(0);
}

Completed ServiceTest::Trem(std::vector<std::string> arguments, const std::vector<std::string>& environment) const {
  arguments.insert(arguments.begin(), BinaryPath("trem").string());
  SubprocessOptions options = fixture_.Options();
  options.environment.push_back("TREM_COORDINATOR=" + endpoint_);
  options.environment.insert(options.environment.end(), environment.begin(), environment.end());
  return RunProgram(arguments, std::chrono::minutes(10), options);
}

std::unique_ptr<Subprocess> ServiceTest::Worker(const std::vector<std::string>& more) const {
  std::vector<std::string> argv = {BinaryPath("trem-worker").string(), "serve", "--coordinator", endpoint_, "--store", store_.string()};
  argv.insert(argv.end(), more.begin(), more.end());
  return std::make_unique<Subprocess>(argv, fixture_.Options());
}

void ServiceTest::Submit(const std::string& job_id, int frame_count) {
  const fs::path sortie = fixture_.SimulateSortie("sortie-" + job_id, frame_count);
  const Completed submit = Trem({"submit", (sortie / "sortie.textproto").string(), "--job-id", job_id});
  ASSERT_EQ(submit.exit_code, 0) << submit.stderr_text;
}

}  // namespace trem::testing
