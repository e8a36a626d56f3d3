// gmsh's own format, versions 2.2 and 4.1, text and binary.
#include <fmt/format.h>

#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <unordered_map>
#include <wiggers/tissue/mesh/raw.hpp>

namespace wiggers {

namespace {

struct Kind {
  int type;
  int nodes;
  int dimension;
  std::string_view name;
};
// The types that may stand in a file: kept are 2 and 4, skipped those of dimension 0 and 1.
constexpr Kind kinds[] = {{1, 2, 1, "line"},
                          {2, 3, 2, "triangle"},
                          {3, 4, 2, "quadrangle"},
                          {4, 4, 3, "tetrahedron"},
                          {5, 8, 3, "hexahedron"},
                          {6, 6, 3, "prism"},
                          {7, 5, 3, "pyramid"},
                          {8, 3, 1, "line of order 2"},
                          {9, 6, 2, "triangle of order 2"},
                          {11, 10, 3, "tetrahedron of order 2"},
                          {15, 1, 0, "point"}};

class Gmsh {
 public:
  Gmsh(std::string_view text, const std::string& file) : in_(text, file) {}

  RawMesh parse() {
    format();
    while (!in_.at_end()) {
      const std::string section(in_.word("a section"));
      if (section.size() < 2 || section[0] != '$')
        in_.fail(fmt::format("'{}' where a section should begin", section));
      const std::string name = section.substr(1);
      if (name == "Entities" && new_)
        entities();
      else if (name == "Nodes")
        new_ ? nodes_4() : nodes_2();
      else if (name == "Elements")
        new_ ? elements_4() : elements_2();
      else if (name == "PartitionedEntities")
        in_.fail(
            "the mesh is cut into partitions; save it from gmsh without (Mesh.SaveParametric 0, "
            "PartitionMesh 0)");
      else if (name == "Comments")
        comments();
      if (!in_.skip_past("$End" + name))
        in_.fail(fmt::format("${} without $End{}; is the file whole?", name, name));
    }
    return finish();
  }

 private:
  void format() {
    if (in_.word("$MeshFormat") != "$MeshFormat") in_.fail("no gmsh file: it must begin with $MeshFormat");
    const double version = in_.real("version");
    if (version != 2.2 && version != 4.1)
      in_.fail(fmt::format("gmsh format {}; known: 2.2, 4.1 (gmsh -save -format msh41)", version));
    new_ = version == 4.1;
    binary_ = in_.integer("file type") == 1;
    const long long size = in_.integer("data size");
    if (binary_) {
      in_.line();
      if (size != 8 || in_.binary<std::int32_t>("byte order") != 1)
        in_.fail("binary data of another machine (byte order or size of numbers); save the mesh as text");
    }
    if (!in_.skip_past("$EndMeshFormat")) in_.fail("$MeshFormat without $EndMeshFormat; is the file whole?");
  }

  // Binary data begin right after the line that names the section, or holds the count.
  void start_binary() {
    if (binary_) in_.line();
  }
  long long whole(std::string_view what) {
    return binary_ ? in_.binary<std::int32_t>(what) : in_.integer(what);
  }
  std::size_t big(std::string_view what) {
    if (!binary_) return in_.count(what);
    const auto value = in_.binary<std::uint64_t>(what);
    if (value > in_.rest().size())
      in_.fail(fmt::format("{} is {}, more than this file can hold", what, value));
    return value;
  }
  // Numbers of nodes and elements may be sparse, hence larger than the file.
  long long number(std::string_view what) {
    return binary_ ? static_cast<long long>(in_.binary<std::uint64_t>(what)) : in_.integer(what);
  }
  double real(std::string_view what) { return binary_ ? in_.binary<double>(what) : in_.real(what); }

  void comments() {
    const std::string_view rest = in_.rest();
    if (rest.substr(0, rest.find("$End")).find("unit: mm") != std::string_view::npos)
      raw_.stated = MeshUnit::millimetre;
  }

  void entities() {
    start_binary();
    std::size_t n[4];
    for (std::size_t& k : n) k = big("number of entities");
    for (int dimension = 0; dimension < 4; ++dimension)
      for (std::size_t k = 0; k < n[dimension]; ++k) {
        const auto tag = static_cast<int>(whole("number of an entity"));
        for (int i = 0; i < (dimension == 0 ? 3 : 6); ++i) real("bounding box of an entity");
        const std::size_t groups = big("number of physical groups");
        for (std::size_t i = 0; i < groups; ++i) {
          const auto group = static_cast<int>(std::llabs(whole("physical group")));
          if (i == 0) group_[{dimension, tag}] = group;
        }
        if (groups > 1 && dimension > 1) ++several_groups_;
        if (dimension > 0) {
          const std::size_t sides = big("number of sides");
          for (std::size_t i = 0; i < sides; ++i) whole("side of an entity");
        }
      }
  }

  void add_node(long long tag, const Point3& x) {
    if (!row_.emplace(tag, static_cast<int>(raw_.mesh.points.size())).second)
      in_.fail(fmt::format("node {} stands twice", tag));
    raw_.mesh.points.push_back(x);
  }

  void nodes_2() {
    const std::size_t n = in_.count("number of nodes");
    start_binary();
    for (std::size_t i = 0; i < n; ++i) {
      const long long tag = whole("number of a node");
      Point3 x;
      for (double& c : x) c = real("coordinate");
      add_node(tag, x);
    }
  }

  void nodes_4() {
    start_binary();
    const std::size_t blocks = big("number of node blocks");
    for (int i = 0; i < 3; ++i) number("node statistics");
    for (std::size_t b = 0; b < blocks; ++b) {
      const long long dimension = whole("dimension of a node block");
      whole("entity of a node block");
      const bool parametric = whole("parametric") != 0;
      const std::size_t n = big("number of nodes");
      std::vector<long long> tags(n);
      for (long long& tag : tags) tag = number("number of a node");
      for (const long long tag : tags) {
        Point3 x;
        for (double& c : x) c = real("coordinate");
        if (parametric)
          for (long long i = 0; i < dimension; ++i) real("parameter");
        add_node(tag, x);
      }
    }
  }

  const Kind& kind(long long type) {
    for (const Kind& k : kinds)
      if (k.type == type) {
        if (k.dimension > 1 && type != 2 && type != 4) refuse_element(in_, k.name);
        return k;
      }
    refuse_element(in_, fmt::format("number {} of gmsh", type));
  }

  int node(long long tag) {
    const auto found = row_.find(tag);
    if (found == row_.end()) in_.fail(fmt::format("an element uses node {}, which does not exist", tag));
    return found->second;
  }

  void add_element(const Kind& k, int group, int entity, const long long* nodes) {
    if (k.type == 4) {
      raw_.mesh.cells.push_back({node(nodes[0]), node(nodes[1]), node(nodes[2]), node(nodes[3])});
      raw_.mesh.cell_tags.push_back(group);
      entities_.push_back(entity);
    } else if (k.type == 2 && group != 0) {
      raw_.mesh.facets.push_back({node(nodes[0]), node(nodes[1]), node(nodes[2])});
      raw_.mesh.facet_tags.push_back(group);
    }
  }

  void elements_2() {
    const std::size_t n = in_.count("number of elements");
    start_binary();
    long long nodes[10], tags[16];
    for (std::size_t i = 0; i < n;) {
      long long type, in_block = 1, tag_count;
      if (binary_) {
        type = whole("element type"), in_block = whole("number of elements"),
        tag_count = whole("number of tags");
      } else {
        in_.integer("number of an element");
        type = in_.integer("element type"), tag_count = in_.integer("number of tags");
      }
      const Kind& k = kind(type);
      if (tag_count < 0 || tag_count > 16 || in_block < 1)
        in_.fail("an element with an absurd number of tags");
      for (long long b = 0; b < in_block; ++b, ++i) {
        if (binary_) whole("number of an element");
        tags[0] = tags[1] = 0;
        for (long long t = 0; t < tag_count; ++t) tags[t] = whole("tag of an element");
        for (int j = 0; j < k.nodes; ++j) nodes[j] = whole("node of an element");
        add_element(k, static_cast<int>(std::llabs(tags[0])), static_cast<int>(tags[1]), nodes);
      }
    }
  }

  void elements_4() {
    start_binary();
    const std::size_t blocks = big("number of element blocks");
    for (int i = 0; i < 3; ++i) number("element statistics");
    long long nodes[10];
    for (std::size_t b = 0; b < blocks; ++b) {
      const auto dimension = static_cast<int>(whole("dimension of an element block"));
      const auto entity = static_cast<int>(whole("entity of an element block"));
      const Kind& k = kind(whole("element type"));
      const std::size_t n = big("number of elements");
      const auto found = group_.find({dimension, entity});
      const int group = found == group_.end() ? 0 : found->second;
      for (std::size_t i = 0; i < n; ++i) {
        number("number of an element");
        for (int j = 0; j < k.nodes; ++j) nodes[j] = number("node of an element");
        add_element(k, group, entity, nodes);
      }
    }
  }

  RawMesh finish() {
    auto& tags = raw_.mesh.cell_tags;
    if (!tags.empty() && std::all_of(tags.begin(), tags.end(), [](int t) { return t == 0; })) {
      tags = entities_;
      raw_.notes.push_back("no physical volumes: cells have the number of their geometric volume as tag");
    }
    if (several_groups_ > 0)
      raw_.notes.push_back(
          fmt::format("{} entities belong to several physical groups; the first counts", several_groups_));
    return std::move(raw_);
  }

  MeshScanner in_;
  RawMesh raw_;
  bool new_ = false, binary_ = false;
  std::map<std::pair<int, int>, int> group_;  // (dimension, entity) to physical group
  std::unordered_map<long long, int> row_;
  std::vector<int> entities_;
  int several_groups_ = 0;
};

}  // namespace

RawMesh parse_gmsh(std::string_view text, const std::string& file) { return Gmsh(text, file).parse(); }

}  // namespace wiggers
