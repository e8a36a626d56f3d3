// All material laws of the tissue. A material is a sum of them: myocardium a law of shape, a volumetric law,
// active stress and perhaps viscosity; a vessel NeoHookean and its volume(). law_parts.hpp says what they
// share.
#pragma once

#include <wiggers/tissue/law_active.hpp>
#include <wiggers/tissue/law_holzapfel_ogden.hpp>
#include <wiggers/tissue/law_isotropic.hpp>
#include <wiggers/tissue/law_parts.hpp>
#include <wiggers/tissue/law_usyk.hpp>
#include <wiggers/tissue/law_volume.hpp>
