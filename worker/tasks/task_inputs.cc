#include "worker/tasks/task_inputs.h"

namespace trem {

Result<v1::ArtefactRef> SingleInput(const v1::TaskSpec& spec, const std::string& name) {
  const std::vector<v1::ArtefactRef> found = InputsNamed(spec, name);
  if (found.size() != 1) {
    return InvalidInput(v1::TaskKind_Name(spec.kind()) + " task " + spec.key() + " has " + std::to_string(found.size()) + " inputs named " +
                        name + "; expected one");
  }
  return found[0];
}

std::vector<v1::ArtefactRef> InputsNamed(const v1::TaskSpec& spec, const std::string& name) {
  std::vector<v1::ArtefactRef> found;
  for (const v1::ArtefactRef& input : spec.inputs()) {
    if (input.name() == name) found.push_back(input);
  }
  return found;
}

}  // namespace trem
