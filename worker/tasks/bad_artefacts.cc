#include "worker/tasks/bad_artefacts.h"

#include <set>

#include "proto/codec/convert.h"

namespace trem {

std::vector<std::string> FindBadArtefacts(const v1::TaskSpec& spec, const Status& failure, const ArtefactStore& store) {
  if (failure.code() != StatusCode::kCorrupt && failure.code() != StatusCode::kNotFound) return {};
  std::set<std::string> bad;
  const auto check = [&](const v1::ArtefactRef& ref) {
    if (!store.Verify(FromProto(ref)).ok()) bad.insert(ref.sha256());
  };
  for (const v1::ArtefactRef& input : spec.inputs()) {
    check(input);
    v1::WindowResult window;
    if (input.name() != "window.pb" || !ReadProtoArtefact(store, input, &window).ok()) continue;
    for (const v1::Segment& segment : window.segments()) {
      for (const v1::EmittedScene& scene : segment.scenes()) check(scene.raster());
    }
  }
  return {bad.begin(), bad.end()};
}

}  // namespace trem
