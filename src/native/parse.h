// Numbers out of text, in bulk.
#pragma once
#include <cstddef>
#include <string>
#include <vector>

namespace vt {

struct BadToken {
    size_t offset = 0;  // of the first byte of the token
    std::string text;   // empty: no bad token
};

// Appends every number of text[0, size) to `out`; separators are white space and commas. Stops at the first token that
// is not a finite decimal number.
BadToken parse_floats(const char* text, size_t size, std::vector<double>& out);

}  // namespace vt
