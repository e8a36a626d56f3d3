// Material laws of the tissue: energies, stresses and tangents agree with each other and with mechanics.
#include <catch2/catch.hpp>
#include <cmath>
#include <random>
#include <string>
#include <wiggers/core/dual.hpp>
#include <wiggers/core/simd.hpp>
#include <wiggers/tissue/laws/laws.hpp>
#include <wiggers/tissue/laws/material.hpp>
#include <wiggers/tissue/physics/element.hpp>

using namespace wiggers;

namespace {
using Matrix = Matrix3<double>;
using D = Dual<9>;

Matrix random_matrix(std::mt19937& random, double size) {
  std::uniform_real_distribution<double> entry(-size, size);
  Matrix a;
  for (auto& row : a.m)
    for (double& x : row) x = entry(random);
  return a;
}
// A rotation from a random quaternion.
Matrix random_rotation(std::mt19937& random) {
  std::normal_distribution<double> normal;
  double q[4], length = 0;
  for (double& x : q) length += square(x = normal(random));
  for (double& x : q) x /= std::sqrt(length);
  const double w = q[0], x = q[1], y = q[2], z = q[3];
  return {{{1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)},
           {2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)},
           {2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)}}};
}
Matrix turn_about_sheet(double angle) {
  const double c = std::cos(angle), s = std::sin(angle);
  return {{{c, 0, s}, {0, 1, 0}, {-s, 0, c}}};
}
Matrix random_deformation(std::mt19937& random) {
  Matrix F = random_matrix(random, 0.15);
  for (int i = 0; i < 3; ++i) F.m[i][i] += 1;
  return random_rotation(random) * F;
}
Matrix3<D> variables(const Matrix& F) {
  Matrix3<D> d;
  for (int p = 0; p < 9; ++p) d.m[p / 3][p % 3] = D::variable(F.m[p / 3][p % 3], p);
  return d;
}
double size_of(const Matrix& a) { return std::sqrt(contract(a, a)); }
double size_of(const double A[9][9]) {
  double sum = 0;
  for (int p = 0; p < 9; ++p)
    for (int q = 0; q < 9; ++q) sum += A[p][q] * A[p][q];
  return std::sqrt(sum);
}
double difference(const Matrix& a, const Matrix& b) {
  double sum = 0;
  for (int p = 0; p < 9; ++p) sum += square(a.m[p / 3][p % 3] - b.m[p / 3][p % 3]);
  return std::sqrt(sum);
}

// One of each law, and of each of its branches.
template <class Check>
void for_all_laws(Check check) {
  std::mt19937 random(11);
  for_each_material_kind(
      [&](auto kind) { check(std::string(kind.name), kind.law(defaults_of(kind.quantities))); });
  check("Usyk", UsykLaw3{});
  check("Guccione", UsykLaw3::guccione(2000, 8, 2, 4));
  check("penalty", VolumetricPenalty{});
  check("neo-Hookean", NeoHookean{});
  check("neo-Hookean volume", NeoHookean{}.volume());
  HolzapfelOgden ho;
  check("Holzapfel-Ogden", ho);
  ho.kappa_f = 0.12;
  check("Holzapfel-Ogden with dispersion", ho);
  ho.fibres_bear_compression = true;
  check("Holzapfel-Ogden with dispersion and compression", ho);
  ho.b = ho.b_f = ho.b_s = ho.b_fs = 0;
  check("Holzapfel-Ogden without exponents", ho);
  for (bool normalised : {true, false}) check("active", ActiveStress{3e4, 0.0, 1.0, 1, 0.2, 0.4, normalised});
  WallViscosity viscosity{40, 1e-3, green_strain(random_deformation(random))};
  check("viscosity", viscosity);
}

template <class Law>
void check_tangent(const Law& law, const Matrix& F) {
  const Matrix P = stress(law, F);
  const Matrix3<D> dual = stress(law, variables(F));
  Matrix both;
  double A[9][9] = {};
  add_stress_and_tangent(law, F, both, A);
  CHECK(difference(P, both) <= 1e-13 * size_of(P));
  double error = 0, difference_error = 0;
  const double h = 1e-5;
  for (int q = 0; q < 9; ++q) {
    Matrix up = F, down = F;
    up.m[q / 3][q % 3] += h;
    down.m[q / 3][q % 3] -= h;
    const Matrix P_up = stress(law, up), P_down = stress(law, down);
    for (int p = 0; p < 9; ++p) {
      const double a = A[p][q];
      error = std::max(error, std::abs(a - dual.m[p / 3][p % 3].derivative[q]));
      difference_error =
          std::max(difference_error, std::abs(a - (P_up.m[p / 3][p % 3] - P_down.m[p / 3][p % 3]) / (2 * h)));
    }
  }
  CHECK(error <= 1e-12 * size_of(A));
  CHECK(difference_error <= 1e-6 * size_of(A));
}
double asymmetry(const double A[9][9]) {
  double largest = 0;
  for (int p = 0; p < 9; ++p)
    for (int q = 0; q < p; ++q) largest = std::max(largest, std::abs(A[p][q] - A[q][p]));
  return largest / size_of(A);
}
}  // namespace

TEST_CASE("the stress of every law is the derivative of its energy") {
  std::mt19937 random(1);
  for (int trial = 0; trial < 30; ++trial) {
    const Matrix F = random_deformation(random);
    for_all_laws([&](const std::string& name, const auto& law) {
      INFO(name << " trial " << trial);
      const Matrix P = stress(law, F);
      const D W = energy(law, variables(F));
      Matrix slope;
      for (int p = 0; p < 9; ++p) slope.m[p / 3][p % 3] = W.derivative[p];
      CHECK(difference(P, slope) <= 1e-12 * size_of(P));
      CHECK(W.value == Approx(energy(law, F)).epsilon(1e-12));
      for (int p = 0; p < 9; ++p) {
        const double h = 1e-5;
        Matrix up = F, down = F;
        up.m[p / 3][p % 3] += h;
        down.m[p / 3][p % 3] -= h;
        const double central = (energy(law, up) - energy(law, down)) / (2 * h);
        CHECK(P.m[p / 3][p % 3] == Approx(central).epsilon(1e-6).margin(1e-6 * size_of(P)));
      }
    });
  }
}

TEST_CASE("the tangent of every law is the derivative of its stress and symmetric") {
  std::mt19937 random(2);
  for (int trial = 0; trial < 30; ++trial) {
    const Matrix F = random_deformation(random);
    for_all_laws([&](const std::string& name, const auto& law) {
      INFO(name << " trial " << trial);
      check_tangent(law, F);
      Matrix P;
      double A[9][9] = {};
      add_stress_and_tangent(law, F, P, A);
      CHECK(asymmetry(A) < 1e-14);
    });
  }
}

TEST_CASE("laws add to what is there") {
  std::mt19937 random(3);
  const Matrix F = random_deformation(random);
  for_all_laws([&](const std::string& name, const auto& law) {
    INFO(name);
    Matrix P, P_more = random_matrix(random, 1e3);
    const Matrix P_before = P_more;
    double A[9][9] = {}, A_more[9][9];
    for (int p = 0; p < 9; ++p)
      for (int q = 0; q < 9; ++q) A_more[p][q] = 1000.0 * p - 300.0 * q;
    add_stress_and_tangent(law, F, P, A);
    add_stress_and_tangent(law, F, P_more, A_more);
    for (int p = 0; p < 9; ++p) {
      CHECK(P_more.m[p / 3][p % 3] - P_before.m[p / 3][p % 3] ==
            Approx(P.m[p / 3][p % 3]).margin(1e-12 * (size_of(P) + 1e3)));
      for (int q = 0; q < 9; ++q)
        CHECK(A_more[p][q] - (1000.0 * p - 300.0 * q) == Approx(A[p][q]).margin(1e-12 * (size_of(A) + 1e4)));
    }
  });
}

TEST_CASE("unloaded tissue is free of passive stress") {
  const Matrix I = Matrix::identity();
  const auto check = [&](const auto& law) {
    CHECK(size_of(stress(law, I)) == 0);
    CHECK(energy(law, I) == 0);
  };
  check(UsykLaw3{});
  check(VolumetricPenalty{});
  check(NeoHookean{});
  check(NeoHookean{}.volume());
  check(HolzapfelOgden{});
  check(WallViscosity{40, 1e-3, {}});
  HolzapfelOgden dispersed;
  dispersed.kappa_f = 0.2;
  CHECK(size_of(stress(dispersed, I)) < 1e-11);
  // The bulk modulus is the curvature there.
  CHECK(volume_derivatives(VolumetricPenalty{7e4}, 1.0).curvature == Approx(7e4));
  CHECK(volume_derivatives(NeoHookeanVolume{3e6}, 1.0).curvature == Approx(3e6));
}

TEST_CASE("a turned body carries turned stress") {
  std::mt19937 random(4);
  for (int trial = 0; trial < 30; ++trial) {
    const Matrix F = random_deformation(random), R = random_rotation(random);
    for_all_laws([&](const std::string& name, const auto& law) {
      INFO(name << " trial " << trial);
      const Matrix P = stress(law, F);
      CHECK(difference(stress(law, R * F), R * P) <= 1e-12 * size_of(P));
      CHECK(energy(law, R * F) == Approx(energy(law, F)).epsilon(1e-12));
    });
  }
}

TEST_CASE("isotropic laws do not see the frame and laws of shape not the volume") {
  std::mt19937 random(5);
  for (int trial = 0; trial < 10; ++trial) {
    const Matrix F = random_deformation(random), R = random_rotation(random);
    const auto check = [&](const auto& law) {
      const Matrix P = stress(law, F);
      CHECK(difference(stress(law, F * R), P * R) <= 1e-12 * size_of(P));
    };
    check(NeoHookean{});
    check(NeoHookean{}.volume());
    check(VolumetricPenalty{});
    check(UsykLaw3::guccione(1e4, 1, 1, 1));
    // P : F is the work of a change of volume.
    const Matrix P = stress(NeoHookean{}, F);
    CHECK(std::abs(contract(P, F)) < 1e-12 * size_of(P));
  }
}

TEST_CASE("Guccione is the transversely isotropic case of Usyk") {
  std::mt19937 random(6);
  const double C = 2000, bf = 8, bt = 2, bfs = 4;
  const UsykLaw3 law = UsykLaw3::guccione(C, bf, bt, bfs);
  for (int trial = 0; trial < 10; ++trial) {
    const Matrix F = random_deformation(random), E = green_strain(F);
    const auto e2 = [&](int a, int b) { return E.m[a][b] * E.m[a][b]; };
    const double Q = bf * e2(0, 0) + bt * (e2(1, 1) + e2(2, 2) + e2(1, 2) + e2(2, 1)) +
                     bfs * (e2(0, 1) + e2(1, 0) + e2(0, 2) + e2(2, 0));
    CHECK(energy(law, F) == Approx(C / 2 * (std::exp(Q) - 1)).epsilon(1e-13));
    // Turning sheet and normal about the fibre changes nothing.
    const double c = std::cos(0.7), s = std::sin(0.7);
    const Matrix R = {{{1, 0, 0}, {0, c, -s}, {0, s, c}}};
    const Matrix P = stress(law, F);
    CHECK(difference(stress(law, F * R), P * R) <= 1e-12 * size_of(P));
  }
}

TEST_CASE("coefficients of the thick sphere make Usyk independent of the helix angle") {
  std::mt19937 random(7);
  const UsykLaw3 law = UsykLaw3::from(880, 5.5, 6, 5.5, 7.5, 5.5, 7.5);
  const UsykLaw3 unequal;
  for (double angle : {0.3, 1.0, -1.2}) {
    const Matrix F = random_deformation(random), R = turn_about_sheet(angle);
    const Matrix P = stress(law, F);
    CHECK(energy(law, F * R) == Approx(energy(law, F)).epsilon(1e-13));
    CHECK(difference(stress(law, F * R), P * R) <= 1e-12 * size_of(P));
    // The tangent: turn its second and fourth index.
    Matrix unused;
    double A[9][9] = {}, turned[9][9] = {};
    add_stress_and_tangent(law, F, unused, A);
    add_stress_and_tangent(law, F * R, unused, turned);
    double error = 0;
    for (int i = 0; i < 3; ++i)
      for (int a = 0; a < 3; ++a)
        for (int j = 0; j < 3; ++j)
          for (int b = 0; b < 3; ++b) {
            double expected = 0;
            for (int c = 0; c < 3; ++c)
              for (int d = 0; d < 3; ++d) expected += R.m[c][a] * R.m[d][b] * A[3 * i + c][3 * j + d];
            error = std::max(error, std::abs(expected - turned[3 * i + a][3 * j + b]));
          }
    CHECK(error <= 1e-12 * size_of(A));
    const Matrix P_unequal = stress(unequal, F);
    CHECK(difference(stress(unequal, F * R), P_unequal * R) > 1e-3 * size_of(P_unequal));
  }
}

TEST_CASE("Usyk stress has the values of its formula in simple states") {
  // Stretch along the fibre: S_ff = C e^Q b_ff E_ff.
  Matrix F = Matrix::identity();
  F.m[0][0] = 1.2;
  const double E = (1.44 - 1) / 2;
  CHECK(stress(UsykLaw3{}, F).m[0][0] == Approx(1.2 * 880 * std::exp(8 * E * E) * 8 * E).epsilon(1e-14));
  // The penalty: P = (B/2)(J ln J + J - 1) F^-T.
  const double J = 1.2;
  CHECK(stress(VolumetricPenalty{}, F).m[0][0] ==
        Approx(25e3 * (J * std::log(J) + J - 1) / 1.2).epsilon(1e-14));
  CHECK(stress(VolumetricPenalty{}, F).m[1][1] == Approx(25e3 * (J * std::log(J) + J - 1)).epsilon(1e-14));
}

TEST_CASE("volumetric stress takes its slope from anywhere") {
  std::mt19937 random(8);
  const Matrix F = random_deformation(random);
  const VolumetricPenalty law;
  const auto U = volume_derivatives(law, determinant(F));
  Matrix P, Q;
  double A[9][9] = {}, B[9][9] = {};
  add_stress_and_tangent(law, F, P, A);
  add_volumetric_stress_and_tangent(U.slope, 0.0, F, Q, B);
  const Matrix cof = cofactors(F);
  add_outer(U.curvature, cof, cof, B);
  CHECK(difference(P, Q) == 0);
  for (int p = 0; p < 9; ++p)
    for (int q = 0; q < 9; ++q) CHECK(A[p][q] == Approx(B[p][q]).margin(1e-12 * size_of(A)));
  for (double J : {0.6, 0.9, 1.0, 1.3})
    for (int which : {0, 1}) {
      const auto derivatives = [&](const Dual<1>& x) {
        return which ? volume_derivatives(NeoHookeanVolume{}, x) : volume_derivatives(law, x);
      };
      const auto d = derivatives(Dual<1>::variable(J, 0));
      CHECK(d.energy.derivative[0] == Approx(d.slope.value).epsilon(1e-12).margin(1e-9));
      CHECK(d.slope.derivative[0] == Approx(d.curvature.value).epsilon(1e-12));
    }
}

TEST_CASE("Holzapfel-Ogden fibres bear no compression and dispersion starts from zero") {
  std::mt19937 random(9);
  HolzapfelOgden without, with;
  with.kappa_f = 1e-13;
  for (int trial = 0; trial < 20; ++trial) {
    const Matrix F = random_deformation(random);
    Matrix P, Q;
    double A[9][9] = {}, B[9][9] = {};
    add_stress_and_tangent(without, F, P, A);
    add_stress_and_tangent(with, F, Q, B);
    CHECK(difference(P, Q) < 1e-10 * size_of(P));
    double error = 0;
    for (int p = 0; p < 9; ++p)
      for (int q = 0; q < 9; ++q) error = std::max(error, std::abs(A[p][q] - B[p][q]));
    CHECK(error < 1e-10 * size_of(A));
  }
  // Shortened fibre and sheet: the isotropic term alone.
  Matrix F = Matrix::identity();
  F.m[0][0] = 0.9;
  F.m[1][1] = 0.95;
  F.m[2][2] = 1.15;
  HolzapfelOgden matrix_only;
  matrix_only.a_f_Pa = matrix_only.a_s_Pa = 0;
  CHECK(difference(stress(HolzapfelOgden{}, F), stress(matrix_only, F)) == 0);
  HolzapfelOgden bearing;
  bearing.fibres_bear_compression = true;
  CHECK(stress(bearing, F).m[0][0] < stress(matrix_only, F).m[0][0] - 1000);
  // All directions alike at kappa_f = 1/3: no fibre direction is left.
  HolzapfelOgden isotropic;
  isotropic.kappa_f = 1.0 / 3.0;
  isotropic.a_s_Pa = isotropic.a_fs_Pa = 0;
  const Matrix G = random_deformation(random), R = random_rotation(random);
  const Matrix P = stress(isotropic, G);
  CHECK(difference(stress(isotropic, G * R), P * R) <= 1e-12 * size_of(P));
}

TEST_CASE("active stress pulls by its tension and stiffens with stretch of the fibre") {
  std::mt19937 random(10);
  // Without stretch of the other directions: tension by column.
  Matrix F = Matrix::identity();
  F.m[0][0] = 1.1;
  const ActiveStress plain{3e4, 0.0, 1.0};
  CHECK(stress(plain, F).m[0][0] == Approx(3e4));
  CHECK(stress(plain, F).m[1][1] == 0);
  CHECK(stress(plain, F).m[2][2] == Approx(1.2e4));
  const ActiveStress stiff{3e4, 2e5, 1.04};
  CHECK(stress(stiff, F).m[0][0] == Approx(3e4 + 2e5 * 0.06));
  const ActiveStress second{3e4, 0.0, 1.0, 1, 0, 0.4, false};
  CHECK(stress(second, F).m[0][0] == Approx(3.3e4));
  for (int trial = 0; trial < 20; ++trial) {
    const Matrix G = random_deformation(random);
    for (bool normalised : {true, false})
      for (double stiffness : {0.0, 2e5})
        for (double across : {0.0, 0.4}) {
          INFO(normalised << " " << stiffness << " " << across << " trial " << trial);
          const ActiveStress law{3e4, stiffness, 0.97, 1, 0.5 * across, across, normalised};
          check_tangent(law, G);
          Matrix P;
          double A[9][9] = {};
          add_stress_and_tangent(law, G, P, A);
          if (stiffness == 0 || across == 0)
            CHECK(asymmetry(A) < 1e-14);
          else
            CHECK(asymmetry(A) > 1e-3);
        }
  }
}

TEST_CASE("viscosity vanishes at rest and dissipates") {
  std::mt19937 random(12);
  for (int trial = 0; trial < 10; ++trial) {
    const Matrix F = random_deformation(random), G = random_deformation(random);
    const WallViscosity law{40, 1e-3, green_strain(F)};
    CHECK(size_of(stress(law, F)) == 0);
    const Matrix turned = stress(law, random_rotation(random) * F);
    CHECK(size_of(turned) < 1e-9);
    const Matrix E = green_strain(G), before = green_strain(F);
    const Matrix S = wall_viscosity_terms::second_stress(law, G);
    CHECK(contract(S, E) - contract(S, before) > 0);
    CHECK(S.m[0][1] == Approx(40 / 1e-3 * (E.m[0][1] - before.m[0][1])));
  }
}

TEST_CASE("laws in lanes are the laws one by one") {
  using Batch = Vec<double, 4, isa::Baseline>;
  constexpr int lanes = Batch::lanes;
  std::mt19937 random(13);
  Matrix F[lanes];
  Matrix3<Batch> batch;
  double entries[9][lanes];
  for (int lane = 0; lane < lanes; ++lane) {
    F[lane] = random_deformation(random);
    for (int p = 0; p < 9; ++p) entries[p][lane] = F[lane].m[p / 3][p % 3];
  }
  for (int p = 0; p < 9; ++p) batch.m[p / 3][p % 3] = Batch::load(entries[p]);
  const auto check = [&](const auto& batch_law, const auto& law) {
    Matrix3<Batch> P;
    Batch A[9][9];
    for (auto& row : A)
      for (Batch& x : row) x = Batch(0.0);
    add_stress_and_tangent(batch_law, batch, P, A);
    const Matrix3<Batch> alone = stress(batch_law, batch);
    for (int lane = 0; lane < lanes; ++lane) {
      Matrix P1;
      double A1[9][9] = {};
      add_stress_and_tangent(law, F[lane], P1, A1);
      for (int p = 0; p < 9; ++p) {
        CHECK(P.m[p / 3][p % 3][lane] == Approx(P1.m[p / 3][p % 3]).margin(1e-12 * size_of(P1)));
        CHECK(alone.m[p / 3][p % 3][lane] == Approx(P1.m[p / 3][p % 3]).margin(1e-12 * size_of(P1)));
        for (int q = 0; q < 9; ++q) CHECK(A[p][q][lane] == Approx(A1[p][q]).margin(1e-12 * size_of(A1)));
      }
    }
  };
  check(UsykLaw3{}, UsykLaw3{});
  check(VolumetricPenalty{}, VolumetricPenalty{});
  check(NeoHookean{}, NeoHookean{});
  check(HolzapfelOgden{}, HolzapfelOgden{});
  check(ActiveStressOf<Batch>{3e4, 2e5, 0.97}, ActiveStress{3e4, 2e5, 0.97});
  check(WallViscosityOf<Batch>{40, 1e-3, {}}, WallViscosity{40, 1e-3, {}});
}

TEST_CASE("scenes make the laws from their defaults") {
  const auto read = [](const std::string& text, Tissue tissue) {
    SettingsReader reader(parse_settings_text(text, "law.toml"), "law.toml");
    Material material = read_material(reader, tissue);
    reader.finish();
    return material;
  };
  const Material muscle = read("", Tissue::ventricle);
  const UsykLaw3 usyk = std::get<UsykLaw3>(muscle.law);
  CHECK(usyk.C_Pa == 880);
  for (int a = 0; a < 3; ++a)
    for (int b = 0; b < 3; ++b) CHECK(usyk.b[a][b] == UsykLaw3{}.b[a][b]);
  CHECK(muscle.bulk_Pa == 50e3);
  CHECK(muscle.stiffness_Pa == 880 * 8);
  CHECK(std::get<UsykLaw3>(read("", Tissue::left_atrium).law).C_Pa == 1760);
  CHECK(std::get<UsykLaw3>(read("", Tissue::right_atrium).law).C_Pa == 1470);
  const Material beam = read("law = \"guccione\"\nbulk_Pa = 7e4", Tissue::ventricle);
  const UsykLaw3 guccione = std::get<UsykLaw3>(beam.law);
  CHECK(guccione.b[0][0] == 8);
  CHECK(guccione.b[1][2] == 2);
  CHECK(guccione.b[2][0] == 4);
  CHECK(beam.bulk_Pa == 7e4);
  const Material valve = read("", Tissue::other);
  CHECK(std::get<NeoHookean>(valve.law).mu_Pa == 1e6);
  CHECK(std::get<NeoHookean>(valve.law).volume().kappa_Pa == 5e6);
  CHECK(valve.bulk_Pa == Approx(5e6));
  CHECK(std::get<NeoHookean>(read("", Tissue::artery).law).mu_Pa == 5.25e5);
  const Material layered = read("law = \"holzapfel-ogden\"", Tissue::ventricle);
  std::mt19937 random(14);
  const Matrix F = random_deformation(random);
  CHECK(difference(stress(std::get<HolzapfelOgden>(layered.law), F), stress(HolzapfelOgden{}, F)) == 0);
  CHECK_THROWS_WITH(read("law = \"neo-hookean\"\nbulk_Pa = 1", Tissue::artery), Catch::Contains("bulk_Pa"));
  CHECK_THROWS_WITH(read("law = \"usik\"", Tissue::ventricle), Catch::Contains("usyk"));
}

namespace {
struct Tetrahedron {
  double at_rest[4][3], deformed[4][3], g[4][3], volume;
};
Tetrahedron random_tetrahedron(std::mt19937& random) {
  const double size = 2e-3;
  std::uniform_real_distribution<double> shift(-0.1 * size, 0.1 * size);
  Tetrahedron t{};
  const Matrix R = random_rotation(random);
  for (int n = 0; n < 4; ++n) {
    double corner[3] = {};
    if (n > 0) corner[n - 1] = size;
    for (double& x : corner) x += shift(random);
    for (int i = 0; i < 3; ++i) {
      t.at_rest[n][i] = corner[i];
      for (int j = 0; j < 3; ++j) t.deformed[n][i] += R.m[i][j] * corner[j];
    }
    for (double& x : t.deformed[n]) x += shift(random) + 0.05;
  }
  t.volume = shape_gradients<double>(t.at_rest, t.g);
  return t;
}
// A law of everything together.
void all_of(const Matrix& F, Matrix& P, double A[9][9]) {
  add_stress_and_tangent(UsykLaw3{}, F, P, A);
  add_stress_and_tangent(VolumetricPenalty{}, F, P, A);
  add_stress_and_tangent(ActiveStress{3e4, 2e5, 0.97}, F, P, A);
}
void force_of(const double x[4][3], const Tetrahedron& t, double f[4][3]) {
  const Matrix F = deformation_gradient(x, t.g);
  Matrix P;
  add_stress(UsykLaw3{}, F, P);
  add_stress(VolumetricPenalty{}, F, P);
  add_stress(ActiveStress{3e4, 2e5, 0.97}, F, P);
  element_force(t.g, P, t.volume, f);
}
}  // namespace

TEST_CASE("shape gradients reproduce linear fields") {
  std::mt19937 random(15);
  const Tetrahedron t = random_tetrahedron(random);
  CHECK(difference(deformation_gradient(t.at_rest, t.g), Matrix::identity()) < 1e-14);
  const Matrix G = random_deformation(random);
  double x[4][3];
  for (int n = 0; n < 4; ++n)
    for (int i = 0; i < 3; ++i) {
      x[n][i] = 0.3 * i;
      for (int j = 0; j < 3; ++j) x[n][i] += G.m[i][j] * t.at_rest[n][j];
    }
  CHECK(difference(deformation_gradient(x, t.g), G) < 1e-12);
  const double unit[4][3] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
  double g[4][3];
  CHECK(shape_gradients<double>(unit, g) == Approx(1.0 / 6));
  CHECK(g[0][1] == -1);
  CHECK(g[2][1] == 1);
}

TEST_CASE("stiffness of an element is the contraction of its tangent") {
  std::mt19937 random(16);
  for (int trial = 0; trial < 10; ++trial) {
    const Tetrahedron t = random_tetrahedron(random);
    const Matrix F = deformation_gradient(t.deformed, t.g);
    Matrix P;
    double A[9][9] = {}, f[4][3], K[4][3][4][3];
    all_of(F, P, A);
    element_force_and_stiffness(t.g, P, A, t.volume, f, K);
    double largest = 0, error = 0, force_error = 0;
    for (int n = 0; n < 4; ++n)
      for (int i = 0; i < 3; ++i) {
        double force = 0;
        for (int a = 0; a < 3; ++a) force += t.volume * P.m[i][a] * t.g[n][a];
        force_error = std::max(force_error, std::abs(force - f[n][i]));
        for (int m = 0; m < 4; ++m)
          for (int j = 0; j < 3; ++j) {
            double sum = 0;
            for (int a = 0; a < 3; ++a)
              for (int b = 0; b < 3; ++b) sum += t.g[n][a] * A[3 * i + a][3 * j + b] * t.g[m][b];
            sum *= t.volume;
            largest = std::max(largest, std::abs(sum));
            error = std::max(error, std::abs(sum - K[n][i][m][j]));
          }
      }
    CHECK(error < 1e-13 * largest);
    CHECK(force_error < 1e-13 * t.volume * size_of(P) * 1e3);
  }
}

TEST_CASE("stiffness of an element is the derivative of its forces") {
  std::mt19937 random(17);
  for (int trial = 0; trial < 10; ++trial) {
    const Tetrahedron t = random_tetrahedron(random);
    const Matrix F = deformation_gradient(t.deformed, t.g);
    Matrix P;
    double A[9][9] = {}, f[4][3], alone[4][3], K[4][3][4][3];
    all_of(F, P, A);
    element_force_and_stiffness(t.g, P, A, t.volume, f, K);
    force_of(t.deformed, t, alone);
    double largest = 0, error = 0;
    const double h = 1e-8;
    for (int m = 0; m < 4; ++m)
      for (int j = 0; j < 3; ++j) {
        double up[4][3], down[4][3], x[4][3];
        for (int n = 0; n < 4; ++n)
          for (int i = 0; i < 3; ++i) x[n][i] = t.deformed[n][i];
        x[m][j] += h;
        force_of(x, t, up);
        x[m][j] -= 2 * h;
        force_of(x, t, down);
        for (int n = 0; n < 4; ++n)
          for (int i = 0; i < 3; ++i) {
            largest = std::max(largest, std::abs(K[n][i][m][j]));
            error = std::max(error, std::abs(K[n][i][m][j] - (up[n][i] - down[n][i]) / (2 * h)));
          }
      }
    CHECK(error < 1e-6 * largest);
    for (int i = 0; i < 3; ++i) {
      for (int n = 0; n < 4; ++n) CHECK(f[n][i] == Approx(alone[n][i]).epsilon(1e-12).margin(1e-16));
      CHECK(std::abs(f[0][i] + f[1][i] + f[2][i] + f[3][i]) <=
            1e-15 * (std::abs(f[1][i]) + std::abs(f[2][i]) + std::abs(f[3][i])));
    }
  }
}
