#include "mosaic/base/status.h"

#include <cerrno>
#include <cstring>

namespace trem {

const char* ToString(StatusCode code) {
  switch (code) {
    case StatusCode::kOk: return "ok";
    case StatusCode::kInvalidInput: return "invalid input";
    case StatusCode::kNotFound: return "not found";
    case StatusCode::kUnavailable: return "unavailable";
    case StatusCode::kExhausted: return "exhausted";
    case StatusCode::kCancelled: return "cancelled";
    case StatusCode::kCorrupt: return "corrupt";
    case StatusCode::kFailed: return "failed";
  }
  return "unknown";
}

std::string Status::ToString() const { return ok() ? "ok" : std::string(trem::ToString(code_)) + ": " + message_; }

Status Status::WithPrefix(const std::string& prefix) const { return ok() ? *this : Status(code_, prefix + ": " + message_); }

Status InvalidInput(std::string message) { return {StatusCode::kInvalidInput, std::move(message)}; }
Status NotFound(std::string message) { return {StatusCode::kNotFound, std::move(message)}; }
Status Unavailable(std::string message) { return {StatusCode::kUnavailable, std::move(message)}; }
Status Exhausted(std::string message) { return {StatusCode::kExhausted, std::move(message)}; }
Status Cancelled(std::string message) { return {StatusCode::kCancelled, std::move(message)}; }
Status Corrupt(std::string message) { return {StatusCode::kCorrupt, std::move(message)}; }
Status Failed(std::string message) { return {StatusCode::kFailed, std::move(message)}; }

Status FromErrno(const std::string& what, int error_number) {
  const std::string message = what + ": " + std::strerror(error_number);
  switch (error_number) {
    case ENOENT: return NotFound(message);
    case ENOSPC:
    case EDQUOT:
    case EMFILE:
    case ENFILE:
    case ENOMEM: return Exhausted(message);
    case EACCES:
    case EPERM:
    case EROFS:
    case EISDIR:
    case ENOTDIR: return InvalidInput(message);
    default: return Failed(message);
  }
}

}  // namespace trem
