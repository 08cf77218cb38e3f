# Compiler settings shared by every target, and the functions that declare a room and a test.

add_library(clampd_options INTERFACE)
target_compile_options(clampd_options INTERFACE -Wall -Wextra -Wpedantic -Wshadow -Wnon-virtual-dtor -Woverloaded-virtual)
if(CMAKE_CXX_COMPILER_ID STREQUAL "GNU" AND CMAKE_CXX_COMPILER_VERSION VERSION_LESS 13)
  # GCC 12 takes innocent strings and vectors, once inlined, for overlaps and overflows (GCC bug 105651 and its like).
  target_compile_options(clampd_options INTERFACE -Wno-restrict -Wno-array-bounds -Wno-stringop-overflow -Wno-stringop-overread
    -Wno-free-nonheap-object -Wno-maybe-uninitialized)
  # A class of one file that holds another class of that file, seen from a unit that includes the file.
  target_compile_options(clampd_options INTERFACE -Wno-subobject-linkage)
endif()
if(CLAMPD_WERROR)
  target_compile_options(clampd_options INTERFACE -Werror)
endif()
if(CLAMPD_SANITIZE)
  target_compile_options(clampd_options INTERFACE -fsanitize=${CLAMPD_SANITIZE} -fno-omit-frame-pointer -fno-sanitize-recover=all)
  if(CLAMPD_SANITIZE MATCHES "undefined")
    # A null pointer that is followed ends the program anyway; the checks before each one take a quarter of the compiler's time.
    target_compile_options(clampd_options INTERFACE -fno-sanitize=null,vptr,object-size)
  endif()
  target_link_options(clampd_options INTERFACE -fsanitize=${CLAMPD_SANITIZE})
endif()

# Reading the libraries' headers takes longer than compiling what most files hold, so the headers that most files include are
# precompiled: once for the product, once more with nlohmann's JSON, once more with GoogleTest. Every file still includes what it
# uses: the presets tidy and fuzz compile without precompiled headers, and so does -DCLAMPD_PRECOMPILE=OFF.
option(CLAMPD_PRECOMPILE "Precompile the headers that most files include" ON)

# A precompiled header fits only where the macros that it reads are the same, so all targets have fmt's and Eigen's.
target_link_libraries(clampd_options INTERFACE fmt::fmt Eigen3::Eigen tl::expected)
if(CLAMPD_PRECOMPILE AND CMAKE_CXX_COMPILER_ID STREQUAL "GNU")
  target_compile_options(clampd_options INTERFACE -fpch-preprocess)  # so that ccache can tell what was precompiled
endif()
if(CMAKE_CXX_COMPILER_ID STREQUAL "GNU")
  # The compiler's own garbage collector takes a seventh of the time: not before a gigabyte is full.
  target_compile_options(clampd_options INTERFACE "SHELL:--param ggc-min-heapsize=1048576" "SHELL:--param ggc-min-expand=100")
endif()

# clampd_precompiled(NAME LIBRARIES target... HEADERS header... [OPTIONS option...]): what clampd_precompile() gives to a target as
# NAME, and the compiler's options that go with it.
function(clampd_precompiled NAME)
  cmake_parse_arguments(PRECOMPILED "" "" "LIBRARIES;HEADERS;OPTIONS" ${ARGN})
  file(CONFIGURE OUTPUT ${CMAKE_BINARY_DIR}/precompiled/${NAME}.cpp CONTENT "namespace {}\n")
  add_library(clampd_precompiled_${NAME} OBJECT EXCLUDE_FROM_ALL ${CMAKE_BINARY_DIR}/precompiled/${NAME}.cpp)
  target_link_libraries(clampd_precompiled_${NAME} PRIVATE clampd_options ${PRECOMPILED_LIBRARIES})
  target_compile_options(clampd_precompiled_${NAME} PRIVATE ${PRECOMPILED_OPTIONS})
  target_precompile_headers(clampd_precompiled_${NAME} PRIVATE ${PRECOMPILED_HEADERS})
endfunction()

function(clampd_precompile TARGET NAME)
  if(TARGET clampd_precompiled_${NAME})
    get_target_property(OPTIONS clampd_precompiled_${NAME} COMPILE_OPTIONS)
    if(OPTIONS)
      target_compile_options(${TARGET} PRIVATE ${OPTIONS})
    endif()
    if(CLAMPD_PRECOMPILE)
      target_precompile_headers(${TARGET} REUSE_FROM clampd_precompiled_${NAME})
    endif()
  endif()
endfunction()

set(PRECOMPILED_HEADERS <algorithm> <array> <atomic> <chrono> <cmath> <cstdint> <filesystem> <functional> <limits> <map> <memory>
  <numeric> <optional> <random> <span> <string> <string_view> <utility> <vector> <fmt/format.h> <tl/expected.hpp> <Eigen/Dense>)
clampd_precompiled(product HEADERS ${PRECOMPILED_HEADERS})
# The loop and its control law: nobody reads errno, so that a square root is one instruction.
clampd_precompiled(realtime HEADERS ${PRECOMPILED_HEADERS} OPTIONS -fno-math-errno)
# What reads, writes and shows text computes little: compiled for size, which takes a fifth less time.
clampd_precompiled(product_json LIBRARIES nlohmann_json::nlohmann_json HEADERS ${PRECOMPILED_HEADERS} <nlohmann/json.hpp>
  OPTIONS $<$<CONFIG:Release>:-Os>)

# Most of the time goes into the libraries' templates, which every file that uses them compiles anew. So the files of a target are
# compiled several at a time, each group as one unit that includes them; a name at namespace scope, also in an unnamed
# namespace, is therefore used once in a target. (CMake's own unity build names its files by absolute paths, so that ccache would
# find nothing of another clone.) Off in the presets dev, tidy and fuzz, where each file is compiled by itself.
option(CLAMPD_UNITY "Compile several files of a target as one unit" ON)
set(CLAMPD_UNITY_FILES 12)

# clampd_units(VARIABLE file...): what to compile for these files, which stand beside or below the CMakeLists.txt that calls it.
function(clampd_units VARIABLE)
  set(UNITS ${ARGN})
  if(CLAMPD_UNITY)
    set(UNITS)
    set(NUMBER 0)
    set(FILES ${ARGN})
    while(FILES)
      list(LENGTH FILES LEFT)
      math(EXPR GROUPS "(${LEFT} + ${CLAMPD_UNITY_FILES} - 1) / ${CLAMPD_UNITY_FILES}")
      math(EXPR SIZE "(${LEFT} + ${GROUPS} - 1) / ${GROUPS}")
      set(CONTENT "")
      foreach(POSITION RANGE 1 ${SIZE})
        list(POP_FRONT FILES FILE)
        cmake_path(ABSOLUTE_PATH FILE BASE_DIRECTORY ${CMAKE_CURRENT_SOURCE_DIR} NORMALIZE)
        cmake_path(RELATIVE_PATH FILE BASE_DIRECTORY ${CMAKE_SOURCE_DIR})
        string(APPEND CONTENT "#include \"${FILE}\"\n")
      endforeach()
      set(UNIT ${CMAKE_CURRENT_BINARY_DIR}/${VARIABLE}_unit_${NUMBER}.cpp)
      file(CONFIGURE OUTPUT ${UNIT} CONTENT "${CONTENT}")
      list(APPEND UNITS ${UNIT})
      math(EXPR NUMBER "${NUMBER} + 1")
    endwhile()
  endif()
  set(${VARIABLE} ${UNITS} PARENT_SCOPE)
endfunction()

# clampd_room(NAME DEPENDS target... [PRIVATE_DEPENDS target...] [ALONE file...] [PRECOMPILED name])
# One room: every .cpp beside and below the CMakeLists.txt that calls it, as clampd::NAME, with the precompiled headers `name`
# (product unless said). Files that have compiler options of
# their own, or names that mean something else in another file of the room, are compiled ALONE.
function(clampd_room NAME)
  cmake_parse_arguments(ROOM "" "PRECOMPILED" "DEPENDS;PRIVATE_DEPENDS;ALONE" ${ARGN})
  if(NOT ROOM_PRECOMPILED)
    set(ROOM_PRECOMPILED product)
  endif()
  string(REPLACE "/" "_" TARGET clampd_${NAME})
  file(GLOB_RECURSE SOURCES CONFIGURE_DEPENDS RELATIVE ${CMAKE_CURRENT_SOURCE_DIR} ${CMAKE_CURRENT_SOURCE_DIR}/*.cpp)
  if(SOURCES)
    list(REMOVE_ITEM SOURCES ${ROOM_ALONE})
    clampd_units(${TARGET} ${SOURCES})
    add_library(${TARGET} STATIC ${${TARGET}} ${ROOM_ALONE})
    set(SCOPE PUBLIC)
    target_link_libraries(${TARGET} PRIVATE ${ROOM_PRIVATE_DEPENDS})
    clampd_precompile(${TARGET} ${ROOM_PRECOMPILED})
  else()
    add_library(${TARGET} INTERFACE)
    set(SCOPE INTERFACE)
  endif()
  target_include_directories(${TARGET} ${SCOPE} ${CMAKE_SOURCE_DIR}/include ${CMAKE_SOURCE_DIR})
  target_link_libraries(${TARGET} ${SCOPE} clampd_options ${ROOM_DEPENDS})
  add_library(clampd::${NAME} ALIAS ${TARGET})
endfunction()

# What runs the tests that this build has, without whatever else there is to build.
add_custom_target(tests_to_run)

# clampd_test(NAME [ONE_BY_ONE] [THREADS pattern] [ARITHMETIC pattern] [CAMPAIGN pattern] SOURCES file... DEPENDS target...
#             [LABELS label] [TIMEOUT seconds])
# One GoogleTest program; each of its tests is a CTest test of its own. THREADS names those that run more than one thread, as
# GoogleTest's --gtest_filter does: they are what ThreadSanitizer is built for, which has nothing to find in the others.
# The other sanitizers' builds leave out the slow ones, which test figures, not memory, and, unless CLAMPD_SANITIZE_ALL is on, what
# computes for minutes there and gets nothing from outside: programs with the label arithmetic, and the tests that ARITHMETIC names.
# Programs with the label campaign, and the tests that CAMPAIGN names, are slow ones that count how often something comes out
# right: `tools/dev test` runs them, a build that has to be done soon leaves them out (.ci/run).
# ONE_BY_ONE: its files are not compiled as one unit, since several have a helper of the same name.
function(clampd_test NAME)
  cmake_parse_arguments(TEST "ONE_BY_ONE" "THREADS;ARITHMETIC;CAMPAIGN;LABELS;TIMEOUT" "SOURCES;DEPENDS" ${ARGN})
  if(NOT TEST_TIMEOUT)
    set(TEST_TIMEOUT 300)
  endif()
  if(TEST_ONE_BY_ONE)
    set(test_${NAME} ${TEST_SOURCES})
  else()
    clampd_units(test_${NAME} ${TEST_SOURCES})
  endif()
  add_executable(test_${NAME} ${test_${NAME}})
  target_include_directories(test_${NAME} PRIVATE ${CMAKE_SOURCE_DIR}/tests ${CMAKE_SOURCE_DIR})
  target_link_libraries(test_${NAME} PRIVATE clampd_options ${TEST_DEPENDS} GTest::gtest_main GTest::gmock)
  target_compile_definitions(test_${NAME} PRIVATE CLAMPD_SOURCE_DIR="${CMAKE_SOURCE_DIR}" CLAMPD_BINARY_DIR="${CMAKE_BINARY_DIR}")
  clampd_precompile(test_${NAME} tests)
  set(PATTERN "*")
  if(CLAMPD_SANITIZE STREQUAL "thread")
    set(PATTERN "${TEST_THREADS}")
  elseif(CLAMPD_SANITIZE AND
         (TEST_LABELS MATCHES "slow|campaign" OR (TEST_LABELS STREQUAL "arithmetic" AND NOT CLAMPD_SANITIZE_ALL)))
    set(PATTERN "")
  elseif(CLAMPD_SANITIZE AND TEST_ARITHMETIC AND NOT CLAMPD_SANITIZE_ALL)
    set(PATTERN "*-${TEST_ARITHMETIC}")
  endif()
  if(NOT PATTERN)
    set_target_properties(test_${NAME} PROPERTIES EXCLUDE_FROM_ALL ON)
    return()
  endif()
  add_dependencies(tests_to_run test_${NAME})
  if(TEST_CAMPAIGN AND PATTERN STREQUAL "*")
    set(PATTERN "*-${TEST_CAMPAIGN}")
    gtest_discover_tests(test_${NAME} DISCOVERY_MODE PRE_TEST DISCOVERY_TIMEOUT 60 TEST_FILTER "${TEST_CAMPAIGN}"
      PROPERTIES TIMEOUT ${TEST_TIMEOUT} LABELS campaign)
  endif()
  gtest_discover_tests(test_${NAME} DISCOVERY_MODE PRE_TEST DISCOVERY_TIMEOUT 60 TEST_FILTER "${PATTERN}"
    PROPERTIES TIMEOUT ${TEST_TIMEOUT} LABELS "${TEST_LABELS}")
endfunction()
