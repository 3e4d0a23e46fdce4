#pragma once

#include <optional>
#include <string>
#include <utility>
#include <variant>

#include "mosaic/base/check.h"

namespace trem {

// The class of an operating failure. The code IS the retry class and decides the exit code of a command.
enum class StatusCode {
  kOk = 0,
  kInvalidInput,  // The user's file, spec or option is wrong; a retry cannot help. Exit code 3.
  kNotFound,      // A path, artefact or job does not exist. Exit code 3.
  kUnavailable,   // A peer, a mount or a lock is not reachable now; a retry may help. Exit code 4.
  kExhausted,     // Disk, memory or a limit is used up; a retry may help after somebody made room. Exit code 1.
  kCancelled,     // The user or the coordinator asked to stop. Exit code 1.
  kCorrupt,       // Stored bytes do not match their digest or format. Exit code 1.
  kFailed,        // The computation could not be completed for the reason given. Exit code 1.
};

// Lower-case name, for logs and messages.
const char* ToString(StatusCode code);

// The outcome of an operation that can fail for reasons outside the program. The message names the thing (file, line, frame,
// field), what was found, what was expected and what to do.
class [[nodiscard]] Status {
 public:
  Status() = default;  // Ok.
  Status(StatusCode code, std::string message) : code_(code), message_(std::move(message)) {}

  bool ok() const { return code_ == StatusCode::kOk; }
  StatusCode code() const { return code_; }
  const std::string& message() const { return message_; }
  // "invalid input: <message>".
  std::string ToString() const;
  // The same code, with "<prefix>: " put before the message.
  Status WithPrefix(const std::string& prefix) const;

 private:
  StatusCode code_ = StatusCode::kOk;
  std::string message_;
};

Status InvalidInput(std::string message);
Status NotFound(std::string message);
Status Unavailable(std::string message);
Status Exhausted(std::string message);
Status Cancelled(std::string message);
Status Corrupt(std::string message);
Status Failed(std::string message);
// Maps errno to a code (ENOENT -> kNotFound, ENOSPC/EDQUOT/EMFILE -> kExhausted, EACCES/EROFS/ENOTDIR -> kInvalidInput, others ->
// kFailed); the message is "<what>: <strerror>".
Status FromErrno(const std::string& what, int error_number);

// A value or the Status that explains why there is none.
template <typename T>
class [[nodiscard]] Result {
 public:
  Result(T value) : value_(std::move(value)) {}           // NOLINT: implicit on purpose.
  Result(Status status) : status_(std::move(status)) {    // NOLINT: implicit on purpose.
    TREM_CHECK(!status_.ok());
  }

  bool ok() const { return value_.has_value(); }
  const Status& status() const { return status_; }
  // Precondition: ok().
  const T& value() const& {
    TREM_CHECK_MSG(ok(), status_.message());
    return *value_;
  }
  T& value() & {
    TREM_CHECK_MSG(ok(), status_.message());
    return *value_;
  }
  T&& value() && {
    TREM_CHECK_MSG(ok(), status_.message());
    return std::move(*value_);
  }
  const T& operator*() const& { return value(); }
  T& operator*() & { return value(); }
  T&& operator*() && { return std::move(*this).value(); }
  const T* operator->() const { return &value(); }
  T* operator->() { return &value(); }

 private:
  std::optional<T> value_;
  Status status_;
};

}  // namespace trem

#define TREM_CONCAT_INNER_(a, b) a##b
#define TREM_CONCAT_(a, b) TREM_CONCAT_INNER_(a, b)

// Returns the Status of `expr` from the enclosing function when it is not Ok.
#define TREM_RETURN_IF_ERROR(expr)                          \
  do {                                                      \
    if (::trem::Status trem_status_ = (expr); !trem_status_.ok()) return trem_status_; \
  } while (false)

// TREM_ASSIGN_OR_RETURN(const auto x, Compute()): unwraps a Result or returns its Status.
#define TREM_ASSIGN_OR_RETURN(lhs, expr) TREM_ASSIGN_OR_RETURN_IMPL_(TREM_CONCAT_(trem_result_, __LINE__), lhs, expr)
#define TREM_ASSIGN_OR_RETURN_IMPL_(result, lhs, expr) \
  auto result = (expr);                                \
  if (!result.ok()) return result.status();            \
  lhs = std::move(result).value()
