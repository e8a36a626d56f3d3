// All material laws of the tissue. A material is a sum of them: myocardium a law of shape, a volumetric law,
// active stress and perhaps viscosity; a vessel NeoHookean and its volume(). parts.hpp says what they
// share.
#pragma once

#include <wiggers/tissue/laws/active.hpp>
#include <wiggers/tissue/laws/holzapfel_ogden.hpp>
#include <wiggers/tissue/laws/isotropic.hpp>
#include <wiggers/tissue/laws/material.hpp>
#include <wiggers/tissue/laws/parts.hpp>
#include <wiggers/tissue/laws/usyk.hpp>
#include <wiggers/tissue/laws/volume.hpp>
