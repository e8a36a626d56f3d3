"""Writes what the fuzzers start from: seeds.py WIGGERS SCENES FOLDER. A folder a fuzzer: scenes as they are shipped, a
small box of tetrahedra in every format that is read, a result, a saved state; and the words of scenes as a dictionary."""

import base64
import re
import struct
import subprocess
import sys
from pathlib import Path

import h5py

# A box of 60 x 50 x 40 mm in six cells, all facets tagged as those of a lone piece of tissue.
POINTS = [(60.0 * (i & 1), 25.0 * (i & 2), 10.0 * (i & 4)) for i in range(8)]
CELLS = [(0, 1, 3, 7), (0, 3, 2, 7), (0, 2, 6, 7), (0, 6, 4, 7), (0, 4, 5, 7), (0, 5, 1, 7)]
FACETS = [(0, 1, 3), (0, 3, 2), (4, 5, 7), (4, 7, 6), (0, 1, 5), (0, 5, 4), (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4),
          (1, 3, 7), (1, 7, 5)]
VOLUME, SURFACE = 1, 24


def rows(table):
    return "\n".join(" ".join(f"{x:g}" for x in row) for row in table)


def msh_2():
    elements = [(k + 1, 2, 2, SURFACE, SURFACE, *(p + 1 for p in f)) for k, f in enumerate(FACETS)]
    elements += [(len(FACETS) + k + 1, 4, 2, VOLUME, VOLUME, *(p + 1 for p in c)) for k, c in enumerate(CELLS)]
    nodes = [(k + 1, *p) for k, p in enumerate(POINTS)]
    return (f'$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$PhysicalNames\n2\n2 {SURFACE} "endocardium-LV"\n3 {VOLUME} "ventricles"\n'
            f"$EndPhysicalNames\n$Nodes\n{len(nodes)}\n{rows(nodes)}\n$EndNodes\n$Elements\n{len(elements)}\n{rows(elements)}\n"
            "$EndElements\n").encode()


def msh_2_binary():
    out = b"$MeshFormat\n2.2 1 8\n" + struct.pack("<i", 1) + b"\n$EndMeshFormat\n$Nodes\n%d\n" % len(POINTS)
    out += b"".join(struct.pack("<i3d", k + 1, *p) for k, p in enumerate(POINTS))
    out += b"\n$EndNodes\n$Elements\n%d\n" % (len(FACETS) + len(CELLS))
    at = 0
    for kind, tag, elements in ((2, SURFACE, FACETS), (4, VOLUME, CELLS)):
        out += struct.pack("<3i", kind, len(elements), 2)
        for e in elements:
            at += 1
            out += struct.pack(f"<{3 + len(e)}i", at, tag, tag, *(p + 1 for p in e))
    return out + b"\n$EndElements\n"


def msh_4():
    return (f'$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$PhysicalNames\n2\n2 {SURFACE} "endocardium-LV"\n3 {VOLUME} "ventricles"\n'
            f"$EndPhysicalNames\n$Entities\n0 0 1 1\n1 0 0 0 60 50 40 1 {SURFACE} 0\n1 0 0 0 60 50 40 1 {VOLUME} 1 1\n$EndEntities\n"
            f"$Nodes\n1 8 1 8\n3 1 0 8\n" + "\n".join(str(k + 1) for k in range(8)) + f"\n{rows(POINTS)}\n$EndNodes\n"
            f"$Elements\n2 {len(FACETS) + len(CELLS)} 1 {len(FACETS) + len(CELLS)}\n2 1 2 {len(FACETS)}\n" +
            rows((k + 1, *(p + 1 for p in f)) for k, f in enumerate(FACETS)) + f"\n3 1 4 {len(CELLS)}\n" +
            rows((len(FACETS) + k + 1, *(p + 1 for p in c)) for k, c in enumerate(CELLS)) + "\n$EndElements\n").encode()


ELEMENTS = FACETS + CELLS
KINDS = [5] * len(FACETS) + [10] * len(CELLS)
TAGS = [SURFACE] * len(FACETS) + [VOLUME] * len(CELLS)


def vtk():
    return (f"# vtk DataFile Version 3.0\nbox\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 8 double\n{rows(POINTS)}\n"
            f"CELLS {len(ELEMENTS)} {sum(len(e) + 1 for e in ELEMENTS)}\n{rows((len(e), *e) for e in ELEMENTS)}\n"
            f"CELL_TYPES {len(ELEMENTS)}\n" + "\n".join(map(str, KINDS)) +
            f"\nCELL_DATA {len(ELEMENTS)}\nSCALARS tag int 1\nLOOKUP_TABLE default\n" + "\n".join(map(str, TAGS)) + "\n").encode()


def vtu(how):
    """how: ascii, binary (base64 in place) or appended (raw)."""
    flat = [x for p in POINTS for x in p]
    ends = [sum(len(e) for e in ELEMENTS[: k + 1]) for k in range(len(ELEMENTS))]
    arrays = {
        "points": ("Float64", "d", flat, 'NumberOfComponents="3"'),
        "connectivity": ("Int32", "i", [p for e in ELEMENTS for p in e], ""),
        "offsets": ("Int32", "i", ends, ""),
        "types": ("UInt8", "B", KINDS, ""),
        "tag": ("Int32", "i", TAGS, ""),
    }
    heap = b""

    def array(name):
        nonlocal heap
        kind, code, values, more = arrays[name]
        data = struct.pack(f"<{len(values)}{code}", *values)
        data = struct.pack("<I", len(data)) + data
        head = f'<DataArray type="{kind}" Name="{name}" {more} format="{how}"'
        if how == "appended":
            head += f' offset="{len(heap)}"/>'
            heap += data
            return head
        body = base64.b64encode(data).decode() if how == "binary" else " ".join(map(repr, values))
        return f"{head}>{body}</DataArray>"

    text = ('<?xml version="1.0"?>\n<VTKFile type="UnstructuredGrid" version="0.1" byte_order="LittleEndian">\n<UnstructuredGrid>\n'
            f'<Piece NumberOfPoints="8" NumberOfCells="{len(ELEMENTS)}">\n<Points>{array("points")}</Points>\n'
            f'<Cells>{array("connectivity")}{array("offsets")}{array("types")}</Cells>\n<CellData>{array("tag")}</CellData>\n'
            "</Piece>\n</UnstructuredGrid>\n").encode()
    if how == "appended":
        text += b'<AppendedData encoding="raw">\n_' + heap + b"\n</AppendedData>\n"
    return text + b"</VTKFile>\n"


def carp():
    return (f"8\n{rows(POINTS)}\n%%\n{len(CELLS)}\n" + "\n".join(f"Tt {' '.join(map(str, c))} {VOLUME}" for c in CELLS) +
            "\n%%\n1\n" + "1 0 0\n" * len(CELLS)).encode()


def run(*words):
    subprocess.run([*words, "--quiet"], check=True, capture_output=True)


def main(wiggers, scenes, folder):
    for name in ("scene", "mesh", "result", "state"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    words = set()
    for path in Path(scenes).glob("*.toml"):
        text = path.read_text()
        (folder / "scene" / path.stem).write_text(text)
        words.update(re.findall(r"[A-Za-z_][A-Za-z_0-9]+", re.sub(r"#.*", "", text)))
    # What a result keeps of a scene has all keys there are, with their defaults.
    for name in ("whole_heart", "elastance_healthy", "triseg"):
        run(wiggers, "run", f"{scenes}/{name}.toml", "--set", "run.until=beats", "--set", "run.beats=1", "-o", folder / f"{name}.h5")
        with h5py.File(folder / f"{name}.h5") as file:
            text = file["provenance/scene"][()].decode()
        (folder / "scene" / f"{name}_whole").write_text(text)
        words.update(re.findall(r"[A-Za-z_][A-Za-z_0-9]+", re.sub(r"#.*", "", text)))
    (folder / "scene.dict").write_text("".join(f'"{w}"\n' for w in sorted(words)))
    for name, data in (("m2", b"m" + msh_2()), ("m2b", b"m" + msh_2_binary()), ("m4", b"m" + msh_4()), ("k", b"k" + vtk()),
                       ("ua", b"u" + vtu("ascii")), ("ub", b"u" + vtu("binary")), ("ur", b"u" + vtu("appended")),
                       ("c", b"c" + carp())):
        (folder / "mesh" / name).write_bytes(data)
    (folder / "mesh.dict").write_text("".join(f'"{w}"\n' for w in (
        "$Nodes", "$Elements", "$PhysicalNames", "$Entities", "$Periodic", "4.1 0 8", "CELLS", "CELL_TYPES", "SCALARS", "FIELD",
        "LOOKUP_TABLE", "BINARY", "OFFSETS vtktypeint64", "appended", "base64", "compressor", "UInt64", "Int64", "Float32", "Tt",
        "%%", "-1", "1e308", "nan", "2147483648", "18446744073709551615")))
    run(wiggers, "run", f"{scenes}/elastance_healthy.toml", "--set", "run.until=beats", "--set", "run.beats=1", "--set",
        "solver.inductors=implicit", "--set", "solver.dt_s=1e-2", "-o", folder / "small.h5")
    (folder / "result" / "file").write_bytes(b"b" + (folder / "small.h5").read_bytes())
    for k in range(64):
        (folder / "result" / f"edit{k}").write_bytes(b"e" + struct.pack("<HBHd", k, k, 17 * k, (-1) ** k * 10.0 ** (k % 9 - 4)))
    state = folder / "state" / "crn"
    run(wiggers, "cell", "crn", "--beats", "1", "--final-state", state)
    (folder / "state" / "odd").write_text('"a [mV]", b\n1, 2\n3,-4e5\n')


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], Path(sys.argv[3]))
