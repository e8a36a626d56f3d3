// Scenes: any text is a scene or is refused. The walls' tables, those of 3D tissue included, are read;
// nothing is run.
#include <string>
#include <wiggers/heart/scene/scene.hpp>
#include <wiggers/tissue/body/register.hpp>

#include "fuzzing.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static const bool registered = (wiggers::register_tissue(), true);
  (void)registered;
  fuzzing::must_end_in_words([&] {
    const wiggers::Scene scene =
        wiggers::read_scene_text(std::string(reinterpret_cast<const char*>(data), size), "scene.toml", {});
    fuzzing::require(scene.period_s > 0 && scene.dt_s > 0 && scene.dt_s < scene.period_s, "period and step");
    // What a result keeps of a scene is a scene.
    (void)wiggers::read_scene_text(scene.text(), "again.toml", {});
  });
  return 0;
}
