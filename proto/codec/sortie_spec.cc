#include "proto/codec/sortie_spec.h"

#include <fmt/format.h>
#include <google/protobuf/io/tokenizer.h>
#include <google/protobuf/text_format.h>
#include <google/protobuf/util/json_util.h>

#include <optional>

#include "proto/codec/spec_fields.h"
#include "proto/codec/spec_json.h"
#include "proto/codec/text_position.h"

namespace trem {
namespace {

using google::protobuf::Descriptor;
using google::protobuf::FieldDescriptor;

constexpr std::size_t kSpecBytesMax = std::size_t{1} << 20;
constexpr int kSpecDepthMax = 32;

// The byte at 0-based `line` and `column` as protobuf's tokenizer counts them: a tab goes to the next multiple of 8.
std::size_t OffsetOf(std::string_view text, int line, int column) {
  constexpr int kTabWidth = 8;
  std::size_t offset = 0;
  for (int i = 0; i < line; ++i) {
    const std::size_t newline = text.find('\n', offset);
    if (newline == std::string_view::npos) return text.size();
    offset = newline + 1;
  }
  for (int at = 0; at < column && offset < text.size() && text[offset] != '\n'; ++offset) {
    at = text[offset] == '\t' ? at + kTabWidth - at % kTabWidth : at + 1;
  }
  return offset;
}

// The `index`-th text in double quotes of a protobuf error message.
std::optional<std::string> Quoted(const std::string& message, int index) {
  std::size_t begin = 0;
  for (int i = 0; i <= index; ++i) {
    begin = message.find('"', begin);
    if (begin == std::string::npos) return std::nullopt;
    const std::size_t end = message.find('"', begin + 1);
    if (end == std::string::npos) return std::nullopt;
    if (i == index) return message.substr(begin + 1, end - begin - 1);
    begin = end + 1;
  }
  return std::nullopt;
}

// The enumeration field `name` anywhere below `type`; names of enumeration fields are unique in a Sortie.
const FieldDescriptor* FindEnumField(const Descriptor& type, const std::string& name) {
  for (int i = 0; i < type.field_count(); ++i) {
    const FieldDescriptor* field = type.field(i);
    if (field->cpp_type() == FieldDescriptor::CPPTYPE_ENUM && field->name() == name) return field;
    if (field->cpp_type() == FieldDescriptor::CPPTYPE_MESSAGE) {
      if (const FieldDescriptor* found = FindEnumField(*field->message_type(), name)) return found;
    }
  }
  return nullptr;
}

// Turns the first error of protobuf's text parser into one of ours.
class SpecErrorCollector : public google::protobuf::io::ErrorCollector {
 public:
  SpecErrorCollector(std::string_view text, const std::string& file_name) : text_(text), file_name_(file_name) {}

  void AddError(int line, google::protobuf::io::ColumnNumber column, const std::string& message) override {
    if (!status_.ok()) return;
    if (line < 0) {
      status_ = InvalidInput(fmt::format("{}: {}", file_name_, message));
      return;
    }
    std::size_t offset = OffsetOf(text_, line, column);
    const std::string words = InOurWords(message, &offset);
    const TextPosition position = PositionOf(text_, offset);
    status_ = InvalidInput(fmt::format("{}:{}:{}: {}", file_name_, position.line, position.column, words));
  }

  const Status& status() const { return status_; }

 private:
  // protobuf reports names that it does not know after having read them: `offset` goes back to where they stand.
  std::string InOurWords(const std::string& message, std::size_t* offset) const {
    if (message.starts_with("Message type ") && message.find(" has no field named ") != std::string::npos) {
      const auto type_name = Quoted(message, 0);
      const auto field_name = Quoted(message, 1);
      const Descriptor* type = type_name ? v1::Sortie::descriptor()->file()->pool()->FindMessageTypeByName(*type_name) : nullptr;
      if (type != nullptr && field_name) {
        MoveBackTo(*field_name, offset);
        return UnknownFieldMessage(*type, *field_name);
      }
    }
    if (message.starts_with("Unknown enumeration value of ")) {
      const auto value = Quoted(message, 0);
      const auto field_name = Quoted(message, 1);
      const FieldDescriptor* field = field_name ? FindEnumField(*v1::Sortie::descriptor(), *field_name) : nullptr;
      if (field != nullptr && value) {
        MoveBackTo(*value, offset);
        return UnknownEnumMessage(*field, *value);
      }
    }
    return message;
  }
  void MoveBackTo(const std::string& name, std::size_t* offset) const {
    if (const auto at = text_.rfind(name, *offset); !name.empty() && at != std::string_view::npos) *offset = at;
  }

  std::string_view text_;
  const std::string& file_name_;
  Status status_;
};

Result<v1::Sortie> ParseTextSpec(std::string_view text, const std::string& file_name) {
  v1::Sortie sortie;
  SpecErrorCollector errors(text, file_name);
  google::protobuf::TextFormat::Parser parser;
  parser.RecordErrorsTo(&errors);
  parser.SetRecursionLimit(kSpecDepthMax);
  const bool parsed = parser.ParseFromString(std::string(text), &sortie);
  if (!errors.status().ok()) return errors.status();
  if (!parsed) return InvalidInput(file_name + ": not a valid text proto of trem.v1.Sortie");
  return sortie;
}

Result<v1::Sortie> ParseJsonSpec(std::string_view text, const std::string& file_name) {
  TREM_RETURN_IF_ERROR(CheckSpecJson(text, file_name, *v1::Sortie::descriptor()));
  v1::Sortie sortie;
  const auto converted = google::protobuf::util::JsonStringToMessage(std::string(text), &sortie);
  if (!converted.ok()) return InvalidInput(file_name + ": " + converted.ToString());
  return sortie;
}

Status ApplyPath(std::string_view path, std::string_view value, google::protobuf::Message* message) {
  const std::size_t dot = path.find('.');
  const std::string name(path.substr(0, dot));
  const FieldDescriptor* field = message->GetDescriptor()->FindFieldByName(name);
  if (field == nullptr) return InvalidInput(UnknownFieldMessage(*message->GetDescriptor(), name));
  const bool is_group = field->cpp_type() == FieldDescriptor::CPPTYPE_MESSAGE;
  if (dot == std::string_view::npos) {
    if (is_group)
      return InvalidInput(fmt::format("'{}' is {}; set one of them, for example {}.{}=...", name, Expected(*field), name,
                                      field->message_type()->field(0)->name()));
    return SetFieldFromText(*field, value, message);
  }
  if (!is_group) return InvalidInput(fmt::format("'{}' is {} and has no field '{}'", name, Expected(*field), path.substr(dot + 1)));
  return ApplyPath(path.substr(dot + 1), value, message->GetReflection()->MutableMessage(message, field));
}

}  // namespace

Result<v1::Sortie> ParseSortieSpec(std::string_view text, const std::string& file_name) {
  if (text.size() > kSpecBytesMax) {
    return InvalidInput(fmt::format("{}: {} bytes; a sortie spec has at most {}", file_name, text.size(), kSpecBytesMax));
  }
  return file_name.ends_with(".json") ? ParseJsonSpec(text, file_name) : ParseTextSpec(text, file_name);
}

Status ApplyOverride(const std::string& assignment, v1::Sortie* sortie) {
  const std::size_t equals = assignment.find('=');
  if (equals == std::string::npos || equals == 0) {
    return InvalidInput(fmt::format("--set {}: expected FIELD=VALUE, for example tre.ratio=3", assignment));
  }
  const std::string_view all = assignment;
  return ApplyPath(all.substr(0, equals), all.substr(equals + 1), sortie).WithPrefix("--set " + assignment);
}

}  // namespace trem
