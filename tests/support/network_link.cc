#include "tests/support/network_link.h"

#include <unistd.h>

#include <chrono>

#include "tests/support/subprocess.h"

namespace trem::testing {
namespace {

bool Ip(std::vector<std::string> arguments, std::string* why = nullptr) {
  arguments.insert(arguments.begin(), "ip");
  const Completed done = RunProgram(arguments, std::chrono::seconds(20));
  if (done.exit_code != 0 && why != nullptr) *why = "'" + arguments[1] + " " + arguments[2] + "' failed: " + done.stderr_text;
  return done.exit_code == 0;
}

}  // namespace

std::unique_ptr<NetworkLink> NetworkLink::Make(std::string* why) {
  // Names of interfaces have at most 15 characters. Two that run at once differ in name and in subnet.
  const auto pid = static_cast<unsigned>(::getpid());
  const std::string name = "trem" + std::to_string(pid % 10'000'000);
  const std::string subnet = "10." + std::to_string(200 + pid / 16'384 % 50) + "." + std::to_string(pid / 64 % 256) + ".";
  const unsigned base = pid % 64 * 4;
  if (!Ip({"netns", "add", name}, why)) return nullptr;
  std::unique_ptr<NetworkLink> link(new NetworkLink(name, subnet + std::to_string(base + 1)));
  const std::string far = name + "f";
  const bool made = Ip({"link", "add", name, "type", "veth", "peer", "name", far}, why) && Ip({"link", "set", far, "netns", name}, why) &&
                    Ip({"addr", "add", link->address_ + "/30", "dev", name}, why) && Ip({"link", "set", name, "up"}, why) &&
                    Ip({"-n", name, "addr", "add", subnet + std::to_string(base + 2) + "/30", "dev", far}, why) &&
                    Ip({"-n", name, "link", "set", far, "up"}, why) && Ip({"-n", name, "link", "set", "lo", "up"}, why);
  if (!made) return nullptr;
  return link;
}

NetworkLink::~NetworkLink() {
  (void)Ip({"link", "del", name_});
  (void)Ip({"netns", "del", name_});
}

bool NetworkLink::Cut() const { return Ip({"-n", name_, "link", "set", name_ + "f", "down"}); }
bool NetworkLink::Mend() const { return Ip({"-n", name_, "link", "set", name_ + "f", "up"}); }

}  // namespace trem::testing
