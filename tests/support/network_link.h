#pragma once

#include <memory>
#include <string>
#include <vector>

namespace trem::testing {

// A second "machine" as far as the network goes: a namespace of its own, joined to this one by a cable (a veth pair) that can be cut. Needs
// the right to make namespaces and the program `ip`.
class NetworkLink {
 public:
  // Null where that is not possible; `why` then says so.
  static std::unique_ptr<NetworkLink> Make(std::string* why);
  // Takes namespace and cable down. Processes in it go on without a network.
  ~NetworkLink();
  NetworkLink(const NetworkLink&) = delete;
  NetworkLink& operator=(const NetworkLink&) = delete;

  // This side's address, as the other side sees it.
  const std::string& address() const { return address_; }
  // What a command line begins with to run on the other side.
  std::vector<std::string> Prefix() const { return {"ip", "netns", "exec", name_}; }
  // While cut, packets vanish without a word to either end.
  bool Cut() const;
  bool Mend() const;

 private:
  NetworkLink(std::string name, std::string address) : name_(std::move(name)), address_(std::move(address)) {}

  std::string name_;  // Of the namespace, and of this end of the cable.
  std::string address_;
};

}  // namespace trem::testing
