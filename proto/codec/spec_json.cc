#include "proto/codec/spec_json.h"

#include <fmt/format.h>

#include <charconv>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <iterator>
#include <limits>
#include <nlohmann/json.hpp>
#include <set>
#include <vector>

#include "proto/codec/spec_fields.h"
#include "proto/codec/text_position.h"

namespace trem {
namespace {

using google::protobuf::Descriptor;
using google::protobuf::FieldDescriptor;

// Counts what nlohmann::json's lexer has consumed: its SAX events carry no position.
class CountingIterator {
 public:
  using iterator_category = std::input_iterator_tag;
  using value_type = char;
  using difference_type = std::ptrdiff_t;
  using pointer = const char*;
  using reference = const char&;

  CountingIterator(const char* at, std::size_t* count) : at_(at), count_(count) {}
  reference operator*() const { return *at_; }
  CountingIterator& operator++() {
    ++at_;
    ++*count_;
    return *this;
  }
  CountingIterator operator++(int) {
    CountingIterator old = *this;
    ++*this;
    return old;
  }
  bool operator==(const CountingIterator& other) const { return at_ == other.at_; }
  bool operator!=(const CountingIterator& other) const { return at_ != other.at_; }

 private:
  const char* at_;
  std::size_t* count_;
};

// Follows the descriptor while the JSON parser reports its tokens; stops at the first mistake.
class SpecChecker : public nlohmann::json_sax<nlohmann::json> {
 public:
  SpecChecker(std::string_view text, const std::string& file_name, const Descriptor& type, const std::size_t* consumed)
      : text_(text), file_name_(file_name), root_(&type), consumed_(consumed) {}

  const Status& status() const { return status_; }

  bool null() override { return BeginValue() && EndValue(); }
  bool boolean(bool value) override {
    if (!BeginValue()) return false;
    if (!Is(FieldDescriptor::CPPTYPE_BOOL)) return WrongType(value ? "true" : "false");
    return EndValue();
  }
  bool number_integer(number_integer_t value) override { return Number(static_cast<double>(value), value >= 0, 0, std::to_string(value)); }
  bool number_unsigned(number_unsigned_t value) override { return Number(static_cast<double>(value), true, value, std::to_string(value)); }
  bool number_float(number_float_t value, const string_t& text) override {
    constexpr double kExactMax = 9007199254740992.0;  // 2^53
    const bool whole = std::floor(value) == value && value >= 0 && value <= kExactMax;
    return Number(value, whole, whole ? static_cast<std::uint64_t>(value) : 0, text);
  }
  bool string(string_t& value) override {
    if (!BeginValue()) return false;
    if (Is(FieldDescriptor::CPPTYPE_ENUM)) {
      if (field_->enum_type()->FindValueByName(value) == nullptr) return Fail(UnknownEnumMessage(*field_, value));
    } else if (Is(FieldDescriptor::CPPTYPE_UINT64)) {
      // Writers of protobuf's JSON quote 64-bit numbers, because readers that know only doubles would round them.
      std::uint64_t number = 0;
      const auto [end, error] = std::from_chars(value.data(), value.data() + value.size(), number);
      if (error != std::errc() || end != value.data() + value.size()) return WrongType("the text " + Shown(value));
    } else if (!Is(FieldDescriptor::CPPTYPE_STRING)) {
      return WrongType("the text " + Shown(value));
    }
    return EndValue();
  }
  bool binary(binary_t&) override { return Fail("binary values do not exist in JSON"); }

  bool start_object(std::size_t) override {
    if (!BeginValue()) return false;
    if (stack_.empty()) {
      stack_.push_back({root_, {}});
    } else {
      if (!Is(FieldDescriptor::CPPTYPE_MESSAGE)) return WrongType("a group {...}");
      stack_.push_back({field_->message_type(), {}});
    }
    return EndValue();
  }
  bool key(string_t& name) override {
    FindToken();
    Level& level = stack_.back();
    field_ = level.type->FindFieldByName(name);
    if (field_ == nullptr) field_ = level.type->FindFieldByCamelcaseName(name);
    if (field_ == nullptr) return Fail(UnknownFieldMessage(*level.type, name));
    if (!level.seen.insert(field_->number()).second) return Fail(fmt::format("field '{}' is given twice", field_->name()));
    return EndValue();
  }
  bool end_object() override {
    stack_.pop_back();
    token_end_ = *consumed_;
    return true;
  }
  bool start_array(std::size_t) override { return BeginValue() && WrongType("a list [...]"); }
  bool end_array() override { return true; }

  bool parse_error(std::size_t position, const std::string&, const nlohmann::json::exception& error) override {
    // "[json.exception.parse_error.101] parse error at line 1, column 5: syntax error while parsing ...": the position is told by us.
    std::string what = error.what();
    if (const auto at = what.find("column "); at != std::string::npos) {
      if (const auto colon = what.find(": ", at); colon != std::string::npos) what = what.substr(colon + 2);
    }
    token_begin_ = position > 0 ? position - 1 : 0;
    return Fail(what);
  }

 private:
  struct Level {
    const Descriptor* type;
    std::set<int> seen;  // Field numbers.
  };

  // The token just reported starts after the previous one and its separators. (After a number the lexer has read one more character,
  // which can only be a separator or a closing bracket.)
  void FindToken() {
    token_begin_ = token_end_;
    while (token_begin_ < text_.size() && std::string_view(" \t\r\n,:}").find(text_[token_begin_]) != std::string_view::npos)
      ++token_begin_;
  }
  bool BeginValue() {
    FindToken();
    if (!stack_.empty() || text_.substr(token_begin_, 1) == "{") return true;
    return Fail(fmt::format("expected one object {{...}} of type {}", root_->full_name()));
  }
  bool EndValue() {
    token_end_ = *consumed_;
    return true;
  }
  bool Is(FieldDescriptor::CppType type) const { return field_->cpp_type() == type; }

  bool Number(double value, bool whole, std::uint64_t whole_value, const std::string& text) {
    if (!BeginValue()) return false;
    switch (field_->cpp_type()) {
      case FieldDescriptor::CPPTYPE_DOUBLE:
        if (!std::isfinite(value)) return WrongType(text);
        break;
      case FieldDescriptor::CPPTYPE_UINT32:
        if (!whole || whole_value > std::numeric_limits<std::uint32_t>::max()) return WrongType(text);
        break;
      case FieldDescriptor::CPPTYPE_UINT64:
        if (!whole) return WrongType(text);
        break;
      case FieldDescriptor::CPPTYPE_ENUM:
        if (!whole || whole_value > 1000 || field_->enum_type()->FindValueByNumber(static_cast<int>(whole_value)) == nullptr) {
          return Fail(UnknownEnumMessage(*field_, text));
        }
        break;
      default:
        return WrongType("the number " + text);
    }
    return EndValue();
  }
  bool WrongType(const std::string& found) {
    return Fail(fmt::format("field '{}': expected {}, found {}", field_->name(), Expected(*field_), found));
  }
  bool Fail(const std::string& message) {
    const TextPosition position = PositionOf(text_, token_begin_);
    status_ = InvalidInput(fmt::format("{}:{}:{}: {}", file_name_, position.line, position.column, message));
    return false;
  }

  std::string_view text_;
  const std::string& file_name_;
  const Descriptor* root_;
  const std::size_t* consumed_;
  std::vector<Level> stack_;
  const FieldDescriptor* field_ = nullptr;  // Of the last key.
  std::size_t token_begin_ = 0;
  std::size_t token_end_ = 0;
  Status status_;
};

}  // namespace

Status CheckSpecJson(std::string_view text, const std::string& file_name, const Descriptor& type) {
  std::size_t consumed = 0;
  SpecChecker checker(text, file_name, type, &consumed);
  const CountingIterator begin(text.data(), &consumed);
  const CountingIterator end(text.data() + text.size(), &consumed);
  if (nlohmann::json::sax_parse(begin, end, &checker) || !checker.status().ok()) return checker.status();
  return InvalidInput(file_name + ": not valid JSON");
}

}  // namespace trem
