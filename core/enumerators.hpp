// Names of enumerators, as the compiler spells them: what ties an enum to the list of quantities it indexes,
// so that the two cannot drift apart.
#pragma once

#include <array>
#include <cstddef>
#include <string_view>
#include <utility>
#include <wiggers/core/quantity.hpp>

namespace wiggers {

// The name of an enumerator without its scope; no name for a value that has none.
template <auto value>
consteval std::string_view enumerator_name() {
  constexpr std::string_view text = __PRETTY_FUNCTION__;
  constexpr std::size_t start = text.find("value = ") + 8;
  constexpr std::string_view full = text.substr(start, text.find_first_of(";]", start) - start);
  return full.substr(full.rfind(':') + 1);
}

// Whether the enumerators first, first + 1, ... of E have the names of the quantities (a slash is spelt _)
// from there on.
template <class E, std::size_t first = 0, std::size_t N>
consteval bool named_as(const std::array<Quantity, N>& quantities) {
  const auto same = [](std::string_view a, std::string_view b) {
    if (a.size() != b.size()) return false;
    for (std::size_t i = 0; i < a.size(); ++i)
      if (a[i] != (b[i] == '/' ? '_' : b[i])) return false;
    return true;
  };
  return [&]<std::size_t... i>(std::index_sequence<i...>) {
    return (same(enumerator_name<static_cast<E>(first + i)>(), quantities[first + i].name) && ...);
  }
  (std::make_index_sequence<N - first>{});
}

}  // namespace wiggers
