// Numbers that a file brings, taken one by one and checked: what is missing, left over, not finite or no
// count is refused with the file and the entry.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

namespace wiggers {

class SavedNumbers {
 public:
  // `place` for messages: "r.h5: /checkpoint/run".
  SavedNumbers(std::vector<double> values, std::string place);

  double number();
  double not_negative();
  // A whole number from 0 to `most`.
  long count(long most);
  bool flag() { return count(1) == 1; }
  std::vector<double> numbers(std::size_t n);
  std::size_t left() const { return values_.size() - at_; }
  // Refuses what was not taken.
  void finish() const;

  [[noreturn]] void refuse(const std::string& why) const;

 private:
  std::vector<double> values_;
  std::string place_;
  std::size_t at_ = 0;
};

}  // namespace wiggers
