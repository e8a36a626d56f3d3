// The ionic models. A new one is its header and its line here; ionic_model.hpp says what the header has.
#pragma once

#include <wiggers/cellmodels/models/aliev_panfilov.hpp>
#include <wiggers/cellmodels/models/crn.hpp>
#include <wiggers/cellmodels/models/ionic_model.hpp>
#include <wiggers/cellmodels/models/ttp06.hpp>

namespace wiggers {

using IonicModels = IonicModelList<  //
    Crn,                             //
    Ttp06<Ttp06Type::endo>,          //
    Ttp06<Ttp06Type::mid>,           //
    Ttp06<Ttp06Type::epi>,           //
    AlievPanfilov>;

}  // namespace wiggers
