// Tables that bring states and traces (CSV).
#include <wiggers/core/table.hpp>

#include "fuzzing.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  fuzzing::must_end_in_words([&] {
    const wiggers::Table table =
        wiggers::read_csv(fuzzing::file("state.csv", {reinterpret_cast<const char*>(data), size}));
    fuzzing::require(!table.columns.empty(), "no column");
    for (const wiggers::Column& column : table.columns)
      fuzzing::require(column.values.size() == table.n_rows(), "ragged rows");
  });
  return 0;
}
