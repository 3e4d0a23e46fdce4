# Build options and the one interface target, trem_flags, that carries every compiler flag.
option(TREM_BUILD_TESTS "Build tests and benchmarks" ON)
option(TREM_BUILD_FUZZERS "Build libFuzzer targets (clang only)" OFF)
set(TREM_SANITIZE "" CACHE STRING "Sanitizers for -fsanitize=, for example address,undefined or thread")

set(CMAKE_CXX_STANDARD 20)
set(CMAKE_CXX_STANDARD_REQUIRED ON)
set(CMAKE_CXX_EXTENSIONS OFF)
set(CMAKE_EXPORT_COMPILE_COMMANDS ON)
set(CMAKE_RUNTIME_OUTPUT_DIRECTORY "${CMAKE_BINARY_DIR}/bin")
if(NOT CMAKE_BUILD_TYPE)
  set(CMAKE_BUILD_TYPE Release CACHE STRING "" FORCE)
endif()

find_program(TREM_CCACHE ccache)
if(TREM_CCACHE AND NOT CMAKE_CXX_COMPILER_LAUNCHER)
  set(CMAKE_CXX_COMPILER_LAUNCHER "${TREM_CCACHE}")
endif()
find_program(TREM_MOLD mold)

add_library(trem_flags INTERFACE)
target_include_directories(trem_flags INTERFACE "${CMAKE_SOURCE_DIR}")
# -ffp-contract=off and no -ffast-math: the same input gives the same bytes whatever the compiler decides to fuse, and NaN checks stay.
target_compile_options(trem_flags INTERFACE -Wall -Wextra -Wpedantic -Wshadow -Wnon-virtual-dtor -Werror=return-type
  -Werror=unused-result -fno-omit-frame-pointer -ffp-contract=off "$<$<CONFIG:Release>:-O3>")
target_compile_definitions(trem_flags INTERFACE SPDLOG_COMPILED_LIB SPDLOG_FMT_EXTERNAL SPDLOG_SHARED_LIB
  TREM_VERSION="${PROJECT_VERSION}")
if(CMAKE_CXX_COMPILER_ID STREQUAL "GNU")
  # g++ 12 reports false positives on std::variant<std::string> and std::optional, and on "text" + std::string (GCC bug 105651).
  target_compile_options(trem_flags INTERFACE -Wno-maybe-uninitialized -Wno-restrict)
endif()
if(TREM_MOLD)
  target_link_options(trem_flags INTERFACE -fuse-ld=mold)
endif()
if(TREM_SANITIZE)
  target_compile_options(trem_flags INTERFACE -fsanitize=${TREM_SANITIZE} -fno-sanitize-recover=undefined)
  target_link_options(trem_flags INTERFACE -fsanitize=${TREM_SANITIZE})
endif()
if(TREM_BUILD_FUZZERS)
  # Coverage feedback from the code under test too, not only from the fuzz target's own file.
  target_compile_options(trem_flags INTERFACE -fsanitize=fuzzer-no-link)
endif()
