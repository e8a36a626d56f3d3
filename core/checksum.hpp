// CRC-64 (ECMA-182, as in XZ): tells a file that a disk or a person has changed. No protection from who means
// it.
#pragma once

#include <array>
#include <cstdint>
#include <string_view>

namespace wiggers {

class Checksum {
 public:
  void add(std::string_view bytes) {
    for (const char c : bytes)
      value_ = table()[(value_ ^ static_cast<unsigned char>(c)) & 0xFF] ^ (value_ >> 8);
  }
  std::uint64_t value() const { return ~value_; }

 private:
  static const std::array<std::uint64_t, 256>& table() {
    static const auto made = [] {
      std::array<std::uint64_t, 256> t{};
      for (std::uint64_t i = 0; i < 256; ++i) {
        std::uint64_t c = i;
        for (int bit = 0; bit < 8; ++bit) c = c & 1 ? (c >> 1) ^ 0xC96C5795D7870F42u : c >> 1;
        t[i] = c;
      }
      return t;
    }();
    return made;
  }
  std::uint64_t value_ = ~std::uint64_t{0};
};

inline std::uint64_t checksum(std::string_view bytes) {
  Checksum sum;
  sum.add(bytes);
  return sum.value();
}

}  // namespace wiggers
