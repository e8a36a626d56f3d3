// Settings: types, ranges, unknown keys, overrides, and the listing with all defaults.
#include <catch2/catch.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/settings.hpp>

using namespace wiggers;

namespace {
constexpr Quantity speed{"speed_m_per_s", "m/s", 1.5, 0, 10, "speed"};
SettingsReader reader_of(const std::string& text) {
  return SettingsReader(parse_settings_text(text, "f.toml"), "f.toml");
}
}  // namespace

TEST_CASE("numbers are checked for type and range, and default where absent") {
  auto good = reader_of("speed_m_per_s = 3");
  CHECK(good.number(speed) == 3);
  auto absent = reader_of("");
  CHECK(absent.number(speed) == 1.5);
  auto text = reader_of("speed_m_per_s = \"fast\"");
  CHECK_THROWS_WITH(text.number(speed), Catch::Contains("must be a number") && Catch::Contains("f.toml"));
  auto outside = reader_of("speed_m_per_s = 11.0");
  CHECK_THROWS_WITH(outside.number(speed), Catch::Contains("0 to 10"));
  auto infinite = reader_of("speed_m_per_s = nan");
  CHECK_THROWS_AS(infinite.number(speed), InputError);
}

TEST_CASE("unknown keys are refused with place and nearest name, in any table") {
  auto flat = reader_of("sped_m_per_s = 3");
  flat.number(speed);
  CHECK_THROWS_WITH(flat.finish(),
                    Catch::Contains("sped_m_per_s") && Catch::Contains("did you mean 'speed_m_per_s'"));
  auto nested = reader_of("[car]\nspeed_m_per_s = 3\nwheel = 4");
  nested.table("car").number(speed);
  CHECK_THROWS_WITH(nested.finish(), Catch::Contains("car.wheel"));
}

TEST_CASE("invalid TOML is refused with its line") {
  CHECK_THROWS_WITH(parse_settings_text("a = 1\nb = = 2\n", "f.toml"), Catch::Contains("f.toml"));
  CHECK_THROWS_AS(parse_settings_text("a = [1, 2]", "f.toml"), InputError);
}

TEST_CASE("text that is no UTF-8 is refused with its line and byte, other languages are read") {
  // The parser would read beyond its text.
  for (const std::string quotes : {"'", "\"", "'''", "\"\"\""})
    for (const char* wrong :
         {"\x9b", "\xc3(", "\xed\xa0\x80", "\xf4\x90\x80\x80", "\xc0\xaf", "\xe2\x82", "\xff"}) {
      INFO(quotes << wrong);
      CHECK_THROWS_WITH(parse_settings_text("a = 1\nb = " + quotes + "x" + wrong + quotes + "\n", "s.toml"),
                        Catch::Contains("s.toml: line 2: not valid TOML: byte 0x"));
    }
  CHECK_NOTHROW(parse_settings_text("# \xc3\xa9\xe5\xbf\x83\nb = '\xf0\x9f\xab\x80'\n", "s.toml"));
}

TEST_CASE("overrides reach nested tables - a bare word is text") {
  auto table = parse_settings_text("[a.b]\nx = 1\n", "f.toml");
  override_setting(*table, "a.b.x=2.5");
  override_setting(*table, "a.b.kind=reduced");
  override_setting(*table, "a.on=true");
  SettingsReader reader(table, "f.toml");
  SettingsReader& b = reader.table("a").table("b");
  CHECK(b.number({"x", "1", 0, 0, 10, "x"}) == 2.5);
  CHECK(b.text("kind", "") == "reduced");
  CHECK(reader.table("a").flag("on", false));
  CHECK_THROWS_AS(override_setting(*table, "nonsense"), InputError);
}

TEST_CASE("the full listing reads back to the same settings") {
  auto reader = reader_of("title = \"a \\\"b\\\"\"\n[car]\nspeed_m_per_s = 3.25\n");
  const std::string title = reader.text("title", "");
  reader.table("car").number(speed);
  reader.table("car").flag("abs", true);
  auto again = reader_of(reader.full());
  CHECK(again.text("title", "") == title);
  CHECK(again.table("car").number(speed) == 3.25);
  CHECK(again.table("car").flag("abs", false));
  again.finish();
}
