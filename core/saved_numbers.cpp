#include <fmt/format.h>

#include <cmath>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/saved_numbers.hpp>

namespace wiggers {

SavedNumbers::SavedNumbers(std::vector<double> values, std::string place)
    : values_(std::move(values)), place_(std::move(place)) {}

void SavedNumbers::refuse(const std::string& why) const {
  throw InputError(fmt::format("{} is damaged: {}", place_, why));
}

double SavedNumbers::number() {
  if (at_ == values_.size()) refuse(fmt::format("it ends after {} numbers", values_.size()));
  const double value = values_[at_++];
  if (!std::isfinite(value)) refuse(fmt::format("number {} is {}", at_, value));
  return value;
}

double SavedNumbers::not_negative() {
  const double value = number();
  if (value < 0) refuse(fmt::format("number {}, {}, is negative", at_, to_text(value)));
  return value;
}

long SavedNumbers::count(long most) {
  const double value = number();
  if (!(value >= 0 && value <= static_cast<double>(most) && value == std::floor(value)))
    refuse(fmt::format("number {}, {}, is no whole number from 0 to {}", at_, to_text(value), most));
  return static_cast<long>(value);
}

std::vector<double> SavedNumbers::numbers(std::size_t n) {
  if (n > left()) refuse(fmt::format("it ends after {} numbers", values_.size()));
  std::vector<double> taken;
  taken.reserve(n);
  for (std::size_t k = 0; k < n; ++k) taken.push_back(number());
  return taken;
}

void SavedNumbers::finish() const {
  if (left() > 0)
    refuse(fmt::format("it holds {} numbers, {} more than belong there", values_.size(), left()));
}

}  // namespace wiggers
