// A material law that was added by its recipe alone (own_law.cmake): in scenes, in the element's choice of
// law, with stress and tangent of its energy.
#include <catch2/catch.hpp>
#include <cmath>
#include <string>
#include <wiggers/core/dual.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/tissue/laws/laws.hpp>

using namespace wiggers;

namespace {
Material read(const std::string& text) {
  SettingsReader reader(parse_settings_text(text, "own.toml"), "own.toml");
  const Material material = read_material(reader, Tissue::ventricle);
  reader.finish();
  return material;
}
}  // namespace

TEST_CASE("a law of one's own is read by its name, with its ranges") {
  const Material material = read("law = \"demiray\"\na_Pa = 3000\nbulk_Pa = 6e4\n");
  CHECK(std::get<Demiray>(material.law).a_Pa == 3000);
  CHECK(std::get<Demiray>(material.law).b == 6);
  CHECK(material.stiffness_Pa == 3000);
  CHECK(material.bulk_Pa == 6e4);
  CHECK_THROWS_WITH(read("law = \"demiray\"\nb = -1\n"), Catch::Contains("0.001 to 1000"));
  CHECK_THROWS_WITH(read("law = \"demirai\"\n"), Catch::Contains("did you mean 'demiray'"));
}

TEST_CASE("what a material adds up to is the derivative of its energies") {
  using D = Dual<9>;
  int seen = 0;
  for (const char* name : {"demiray", "usyk"}) {
    const Material material = read("law = \"" + std::string(name) + "\"\n");
    visit_material(material, [&](const auto& shape, const auto& volumetric) {
      const Matrix3<double> F = {{{1.1, 0.2, -0.1}, {0.05, 0.9, 0.1}, {0, -0.15, 1.05}}};
      Matrix3<D> variable;
      for (int p = 0; p < 9; ++p) variable.m[p / 3][p % 3] = D::variable(F.m[p / 3][p % 3], p);
      const D W = energy(shape, variable) + energy(volumetric, variable);
      Matrix3<D> slope;
      add_stress(shape, variable, slope);
      add_stress(volumetric, variable, slope);
      Matrix3<double> P;
      double A[9][9] = {};
      add_stress_and_tangent(shape, F, P, A);
      add_stress_and_tangent(volumetric, F, P, A);
      for (int p = 0; p < 9; ++p) {
        CHECK(P.m[p / 3][p % 3] == Approx(W.derivative[p]).epsilon(1e-10).margin(1e-8));
        for (int q = 0; q < 9; ++q)
          CHECK(A[p][q] == Approx(slope.m[p / 3][p % 3].derivative[q]).epsilon(1e-10).margin(1e-6));
        seen += W.derivative[p] != 0;
      }
    });
  }
  CHECK(seen == 18);
}
