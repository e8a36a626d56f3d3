// The force models. A new one is its header and its line here; force_model.hpp says what the header has.
#pragma once

#include <wiggers/cellmodels/models/force_model.hpp>
#include <wiggers/cellmodels/models/land2017.hpp>
#include <wiggers/cellmodels/models/rdq20.hpp>

namespace wiggers {

using ForceModels = ForceModelList<  //
    Rdq20,                           //
    Land2017>;

}  // namespace wiggers
