#include "parse.h"

#include <charconv>
#include <cmath>
#include <cstdint>
#if !defined(__cpp_lib_to_chars)
#include <locale>
#include <sstream>
#endif

namespace vt {
namespace {

// Exact in double, so that mantissa / 10^k is correctly rounded when the mantissa is below 2^53 (Clinger 1990).
const double kTens[] = {1e0,  1e1,  1e2,  1e3,  1e4,  1e5,  1e6,  1e7,  1e8,  1e9,  1e10, 1e11,
                        1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18, 1e19, 1e20, 1e21, 1e22};

inline bool separates(char c) { return c == ' ' || c == ',' || (c >= '\t' && c <= '\r'); }
inline bool digit(char c) { return c >= '0' && c <= '9'; }

// Any decimal number in [first, last), already known to have only digits, one point and an exponent at the right places.
bool slow(const char* first, const char* last, double& value) {
#if defined(__cpp_lib_to_chars)
    auto [end, error] = std::from_chars(first, last, value);
    if (error == std::errc::result_out_of_range) {
        const char* e = first;
        while (e != last && *e != 'e' && *e != 'E') ++e;
        if (e == last || e + 1 == last || e[1] != '-') return false;  // too large
        value = *first == '-' ? -0.0 : 0.0;                           // too small: zero, as every reader does
        return end == last;
    }
    return error == std::errc() && end == last;
#else
    std::istringstream stream(std::string(first, last));
    stream.imbue(std::locale::classic());
    return bool(stream >> value) && stream.peek() == std::istringstream::traits_type::eof() && std::isfinite(value);
#endif
}

// One token; true when it is a number.
bool number(const char* first, const char* last, double& value) {
    const char* p = first;
    bool negative = false;
    if (*p == '+' || *p == '-') negative = *p++ == '-';
    const char* unsigned_first = p;
    uint64_t mantissa = 0;
    int digits = 0, decimals = 0;
    for (; p != last && digit(*p); ++p, ++digits) mantissa = mantissa * 10 + uint64_t(*p - '0');
    if (p != last && *p == '.') {
        ++p;
        for (; p != last && digit(*p); ++p, ++digits, ++decimals) mantissa = mantissa * 10 + uint64_t(*p - '0');
    }
    if (digits == 0) return false;
    if (p == last && digits <= 15) {
        value = double(mantissa) / kTens[decimals];
        if (negative) value = -value;
        return true;
    }
    if (p != last) {
        if (*p != 'e' && *p != 'E') return false;
        ++p;
        if (p != last && (*p == '+' || *p == '-')) ++p;
        if (p == last) return false;
        for (; p != last; ++p)
            if (!digit(*p)) return false;
    }
    if (!slow(unsigned_first, last, value)) return false;
    if (negative) value = -value;
    return true;
}

}  // namespace

BadToken parse_floats(const char* text, size_t size, std::vector<double>& out) {
    const char* p = text;
    const char* const stop = text + size;
    while (true) {
        while (p != stop && separates(*p)) ++p;
        if (p == stop) return {};
        const char* last = p;
        while (last != stop && !separates(*last)) ++last;
        double value;
        if (!number(p, last, value)) {
            const size_t shown = size_t(last - p) < 40 ? size_t(last - p) : 40;
            return {size_t(p - text), std::string(p, shown)};
        }
        out.push_back(value);
        p = last;
    }
}

}  // namespace vt
