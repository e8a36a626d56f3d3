#include <wiggers/heart/tissue_kind.hpp>
#include <wiggers/tissue/register.hpp>

namespace wiggers {

void register_tissue() {}

}  // namespace wiggers
