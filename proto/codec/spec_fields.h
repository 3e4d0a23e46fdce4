#pragma once

#include <google/protobuf/descriptor.h>
#include <google/protobuf/message.h>

#include <string>
#include <string_view>

#include "mosaic/base/status.h"

namespace trem {

// What the readers of sortie specs (text proto, JSON, --set) have in common: words for what was expected, and one setter.

// "unknown field 'ratoi' in trem.v1.Tre; did you mean 'ratio'?", or the list of fields when none is near.
std::string UnknownFieldMessage(const google::protobuf::Descriptor& type, std::string_view name);
// "unknown value 'FOO' of registration; expected one of REGISTRATION_AUTO, GAUSS_NEWTON, ...".
std::string UnknownEnumMessage(const google::protobuf::FieldDescriptor& field, std::string_view value);
// "a whole number from 0 to 4294967295", "a number", "true or false", "a text", "one of A, B", "a group of fields (a, b)".
std::string Expected(const google::protobuf::FieldDescriptor& field);
// Quoted and cut to a length that suits an error message.
std::string Shown(std::string_view found);

// Sets the non-repeated, non-message `field` of `message` from text; an empty text clears it (the default applies). Enumerations by name
// without regard to case, with or without their prefix ("always" for DEINTERLACE_ALWAYS). Errors say what was expected.
Status SetFieldFromText(const google::protobuf::FieldDescriptor& field, std::string_view text, google::protobuf::Message* message);

}  // namespace trem
