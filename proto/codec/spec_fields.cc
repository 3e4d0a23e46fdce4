#include "proto/codec/spec_fields.h"

#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <charconv>
#include <cmath>
#include <cstdint>
#include <limits>
#include <optional>
#include <vector>

#include "mosaic/base/suggest.h"

namespace trem {
namespace {

using google::protobuf::Descriptor;
using google::protobuf::EnumDescriptor;
using google::protobuf::EnumValueDescriptor;
using google::protobuf::FieldDescriptor;
using google::protobuf::Message;

std::string Join(const std::vector<std::string>& words) {
  std::string joined;
  for (const std::string& word : words) joined += (joined.empty() ? "" : ", ") + word;
  return joined;
}

std::vector<std::string> FieldNames(const Descriptor& type) {
  std::vector<std::string> names;
  for (int i = 0; i < type.field_count(); ++i) names.push_back(type.field(i)->name());
  return names;
}

std::vector<std::string> ValueNames(const EnumDescriptor& type) {
  std::vector<std::string> names;
  for (int i = 0; i < type.value_count(); ++i) names.push_back(type.value(i)->name());
  return names;
}

std::string Upper(std::string_view text) {
  std::string upper(text);
  std::transform(upper.begin(), upper.end(), upper.begin(), [](unsigned char c) { return static_cast<char>(std::toupper(c)); });
  return upper;
}

// Every enumeration of job.proto starts with <PREFIX>AUTO.
const EnumValueDescriptor* FindEnumValue(const EnumDescriptor& type, std::string_view text) {
  const std::string upper = Upper(text);
  if (const EnumValueDescriptor* value = type.FindValueByName(upper)) return value;
  std::string prefix = type.value(0)->name();
  const std::string suffix = "AUTO";
  if (!prefix.ends_with(suffix)) return nullptr;
  prefix.resize(prefix.size() - suffix.size());
  return type.FindValueByName(prefix + upper);
}

template <typename T>
std::optional<T> ParseNumber(std::string_view text) {
  T value{};
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size()) return std::nullopt;
  return value;
}

std::optional<bool> ParseBool(std::string_view text) {
  const std::string upper = Upper(text);
  if (upper == "TRUE" || upper == "1" || upper == "YES" || upper == "ON") return true;
  if (upper == "FALSE" || upper == "0" || upper == "NO" || upper == "OFF") return false;
  return std::nullopt;
}

// False when `text` is not a value of the field's type.
bool TrySet(const FieldDescriptor& field, std::string_view text, Message* message) {
  const auto* reflection = message->GetReflection();
  switch (field.cpp_type()) {
    case FieldDescriptor::CPPTYPE_UINT32:
      if (const auto value = ParseNumber<std::uint32_t>(text)) return reflection->SetUInt32(message, &field, *value), true;
      return false;
    case FieldDescriptor::CPPTYPE_UINT64:
      if (const auto value = ParseNumber<std::uint64_t>(text)) return reflection->SetUInt64(message, &field, *value), true;
      return false;
    case FieldDescriptor::CPPTYPE_DOUBLE:
      if (const auto value = ParseNumber<double>(text); value && std::isfinite(*value)) {
        return reflection->SetDouble(message, &field, *value), true;
      }
      return false;
    case FieldDescriptor::CPPTYPE_BOOL:
      if (const auto value = ParseBool(text)) return reflection->SetBool(message, &field, *value), true;
      return false;
    case FieldDescriptor::CPPTYPE_STRING:
      return reflection->SetString(message, &field, std::string(text)), true;
    case FieldDescriptor::CPPTYPE_ENUM:
      if (const auto* value = FindEnumValue(*field.enum_type(), text)) return reflection->SetEnum(message, &field, value), true;
      return false;
    default:
      return false;
  }
}

}  // namespace

std::string Shown(std::string_view found) {
  constexpr std::size_t kLengthMax = 60;
  return found.size() <= kLengthMax ? fmt::format("'{}'", found) : fmt::format("'{}...'", found.substr(0, kLengthMax));
}

std::string UnknownFieldMessage(const Descriptor& type, std::string_view name) {
  const std::vector<std::string> names = FieldNames(type);
  std::string hint = DidYouMean(name, names);
  if (hint.empty()) hint = "; it has " + Join(names);
  return fmt::format("unknown field {} in {}{}", Shown(name), type.full_name(), hint);
}

std::string UnknownEnumMessage(const FieldDescriptor& field, std::string_view value) {
  const std::vector<std::string> names = ValueNames(*field.enum_type());
  return fmt::format("unknown value {} of {}; expected one of {}{}", Shown(value), field.name(), Join(names), DidYouMean(value, names));
}

std::string Expected(const FieldDescriptor& field) {
  switch (field.cpp_type()) {
    case FieldDescriptor::CPPTYPE_UINT32:
      return fmt::format("a whole number from 0 to {}", std::numeric_limits<std::uint32_t>::max());
    case FieldDescriptor::CPPTYPE_UINT64:
      return fmt::format("a whole number from 0 to {}", std::numeric_limits<std::uint64_t>::max());
    case FieldDescriptor::CPPTYPE_DOUBLE:
      return "a finite number";
    case FieldDescriptor::CPPTYPE_BOOL:
      return "true or false";
    case FieldDescriptor::CPPTYPE_STRING:
      return "a text";
    case FieldDescriptor::CPPTYPE_ENUM:
      return "one of " + Join(ValueNames(*field.enum_type()));
    case FieldDescriptor::CPPTYPE_MESSAGE:
      return "a group of fields (" + Join(FieldNames(*field.message_type())) + ")";
    default:
      return field.cpp_type_name();
  }
}

Status SetFieldFromText(const FieldDescriptor& field, std::string_view text, Message* message) {
  if (text.empty()) {
    message->GetReflection()->ClearField(message, &field);
    return {};
  }
  if (TrySet(field, text, message)) return {};
  if (field.cpp_type() == FieldDescriptor::CPPTYPE_ENUM) return InvalidInput(UnknownEnumMessage(field, text));
  return InvalidInput(fmt::format("expected {}, found {}", Expected(field), Shown(text)));
}

}  // namespace trem
