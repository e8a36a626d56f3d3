"""Frames of a field series (tissue/body/field_file.hpp): one VTU file a moment, a PVD index of all.

Reads what this project writes, nothing more: tetrahedra, arrays appended as raw bytes, each with its number of
bytes in front.
"""

import re
from xml.etree import ElementTree

import numpy as np

TYPES = {"Float32": "f4", "Float64": "f8", "Int32": "i4", "UInt8": "u1"}


class BrokenFields(Exception):
    """The fields cannot be read; the text says which file and why."""


class Frame:
    """One moment: points (m), cells (four points each), tag of each cell, point fields by name."""

    def __init__(self, path):
        try:
            data = path.read_bytes()
        except OSError as error:
            raise BrokenFields(f"{path.name}: {error.strerror}") from error
        begin = data.find(b"<AppendedData")
        if begin < 0:
            raise BrokenFields(f"{path.name} has no appended arrays")
        # The header is XML by itself once its open elements are closed.
        try:
            header = ElementTree.fromstring(data[:begin].decode() + "</VTKFile>")
        except (ElementTree.ParseError, UnicodeDecodeError) as error:
            raise BrokenFields(f"{path.name}: {error}") from error
        first = data.index(b"_", begin) + 1
        order = "<" if header.get("byte_order") == "LittleEndian" else ">"

        def array(item):
            try:
                type_ = np.dtype(order + TYPES[item.get("Type", item.get("type"))])
                place = first + int(item.get("offset"))
                n_bytes = int(np.frombuffer(data, order + "u8", 1, place)[0])
                values = np.frombuffer(data, type_, n_bytes // type_.itemsize, place + 8)
            except (KeyError, TypeError, ValueError) as error:
                raise BrokenFields(f"{path.name}, array {item.get('Name')}: {error}") from error
            n = int(item.get("NumberOfComponents", "1"))
            return values.reshape(-1, n) if n > 1 else values

        def arrays(place):
            return {item.get("Name"): array(item) for item in header.iterfind(f".//{place}/DataArray")}

        try:
            self.points = arrays("Points")["Points"].astype(float)
            self.cells = arrays("Cells")["connectivity"].reshape(-1, 4).astype(np.int64)
            self.tag = arrays("CellData")["tag"]
        except KeyError as error:
            raise BrokenFields(f"{path.name} has no array {error}") from error
        self.fields = {name: values.astype(float) for name, values in arrays("PointData").items()}

    def field(self, name):
        if name not in self.fields:
            raise BrokenFields(f"the frames have no field {name}")
        return self.fields[name]


def read_index(folder):
    """(time in s, path) of each frame that the index lists, in order of time."""
    index = folder / "index.pvd"
    try:
        text = index.read_text()
    except OSError as error:
        raise BrokenFields(f"{index.name}: {error.strerror}") from error
    frames = [
        (float(time_s), folder / file)
        for time_s, file in re.findall(r'<DataSet timestep="([^"]+)"[^>]* file="([^"]+)"', text)
    ]
    return sorted(frames)
