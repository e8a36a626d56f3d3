#include <wiggers/heart/walls/tissue_kind.hpp>

namespace wiggers {

TissueKind& tissue_kind() {
  static TissueKind kind;
  return kind;
}

}  // namespace wiggers
