# The recipe of heart/indexes/further_indexes.hpp, followed: a copy with an index of one's own, built and tested
# (models/own_index.cpp). Its struct, its entry.
include(own_copy.cmake)
own_copy(heart/indexes own_index)
own_line(own_index/heart/indexes/further_indexes.hpp "using FurtherIndexes = std::tuple<" "struct FirstPressure {
  static constexpr std::string_view name = \"LV.pulse_area_mmHg_s\", unit = \"mmHg s\", meaning = \"a test's\";
  template <class Rows, class Trace, class Known>
  static auto of(const Rows& rows, const Trace& trace, const Known& known) {
    using T = std::decay_t<decltype(known.period_s)>;
    return std::optional<T>(integral(rows, trace.p[LV]));
  }
};

using FurtherIndexes = std::tuple<FirstPressure, ")
wiggers_test(own_index wiggers::circulation models/own_index.cpp ${own_index_sources})
target_include_directories(test_own_index BEFORE PRIVATE ${own_index_include})
