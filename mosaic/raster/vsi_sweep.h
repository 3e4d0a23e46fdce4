#pragma once

#include <string>

#include "mosaic/base/sweep.h"

namespace trem {

// Whose an artefact store is: the object <root>/owner says so, and the first one who asks writes it. kInvalidInput when it is another's.
Status ClaimVsiStore(const std::string& root, const std::string& owner);

// Removes the objects of an artefact store at one of GDAL's virtual paths that may go by `rule`. What else lies there stays. Errors as
// VsiBacking's; what was removed until then is gone.
Result<SweepReport> SweepVsiStore(const std::string& root, const SweepRule& rule);

}  // namespace trem
