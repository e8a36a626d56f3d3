#include <wiggers/heart/scene/tissue_services.hpp>

namespace wiggers {

TissueServices& tissue_services() {
  static TissueServices services;
  return services;
}

}  // namespace wiggers
