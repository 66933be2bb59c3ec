"""Read units and special values that GDAL omits from planetary labels.

GDAL provides scale and offset of every format (including SCALING_FACTOR and OFFSET of PDS3, Base
and Multiplier of ISIS3, scaling_factor and value_offset of PDS4), and the unit of all formats but
PDS3, ISIS3 and AAIGrid. GDAL provides only one of the values that mark missing heights.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from rasterio.crs import CRS
from rasterio.io import DatasetReader

# Keywords of PDS3 labels whose value means "no height".
_MISSING_KEYWORDS = re.compile(
    r"((MISSING|INVALID|UNKNOWN|NOT_APPLICABLE|NULL)(_CONSTANT)?"
    r"|CORE_(NULL|(LOW|HIGH)_(INSTR|REPR)_SATURATION))"
)
# Special pixels of ISIS3: null and four kinds of saturation. Those of 32-bit cubes are below -1e30
# and need no list.
_ISIS_SPECIAL = {
    "uint8": (0, 255),
    "int16": (-32768, -32767, -32766, -32765, -32764),
    "uint16": (0, 1, 2, 65534, 65535),
}


def declared_units(source: DatasetReader) -> list[str]:
    """Return the names of all height units that an open raster file states.

    They are read from its band, its label and its vertical reference system.
    """
    found = [source.units[0]] + [unit for _, unit in _label_units(source)]
    if source.crs is not None:
        vertical = re.search(r'VERTCRS\[.*?LENGTHUNIT\["([^"]*)"', wkt2(source.crs))
        found.append(vertical.group(1) if vertical else None)
    return [unit.strip() for unit in found if unit and unit.strip()]


def has_downward_heights(source: DatasetReader) -> bool:
    """Return whether an open raster file states depths (positive down)."""
    if source.driver == "netCDF" and str(source.tags(1).get("positive", "")).lower() == "down":
        return True
    crs = source.crs
    return crs is not None and bool(re.search(r'VERTCRS\[.*?AXIS\["[^"]*",down', wkt2(crs)))


def special_values(source: DatasetReader) -> list[float]:
    """Return the raw values that a planetary label reserves for missing heights.

    GDAL's no-data value of the open file is not included. The result is empty for other formats
    than ISIS3, PDS3 and PDS4.
    """
    dtype = np.dtype(source.dtypes[0])
    if source.driver == "ISIS3":
        return [float(v) for v in _ISIS_SPECIAL.get(dtype.name, ())]
    texts: list[Any] = []
    if source.driver == "PDS":
        image = _image_object(_json_label(source, "json:PDS"))
        texts = [value for key, value in image.items() if _MISSING_KEYWORDS.fullmatch(key)]
    elif source.driver == "PDS4":
        texts = [e.text for e in _pds4_constants(source.tags(ns="xml:PDS4").get("xml:PDS4", ""))]
    values = (_number(text, dtype) for text in texts)
    return [value for value in values if value is not None]


def has_hexadecimal_no_data(source: DatasetReader) -> bool:
    """Return whether a PDS3 label has a hexadecimal no-data value (16#FF7FFFFB#)."""
    if source.driver != "PDS":
        return False
    image = _image_object(_json_label(source, "json:PDS"))
    return any(_MISSING_KEYWORDS.fullmatch(k) and "16#" in str(v) for k, v in image.items())


def _label_units(source: DatasetReader) -> Iterator[tuple[str, str]]:
    """Yield label keywords and height units of files whose unit GDAL does not provide."""
    if source.driver == "PDS":
        image = _image_object(_json_label(source, "json:PDS"))
        for key in ("UNIT", "UNITS", "CORE_UNIT"):
            if isinstance(image.get(key), str):
                yield key, image[key]
        for key in ("SCALING_FACTOR", "OFFSET"):  # SCALING_FACTOR = 0.5 <METER>
            if isinstance(image.get(key), dict) and "unit" in image[key]:
                yield key, re.sub(r"/(DN|PIXEL)$", "", str(image[key]["unit"]), flags=re.I)
    elif source.driver == "ISIS3":
        cube = _json_label(source, "json:ISIS3").get("IsisCube", {})
        for name, group in cube.items():  # BandBin; GDAL 3.12 and later append its Name
            for key in ("Unit", "Units"):
                if name.startswith("BandBin") and isinstance(group.get(key), str):
                    yield key, group[key]
    elif source.driver == "AAIGrid":
        projection = Path(source.name).with_suffix(".prj")
        text = projection.read_text(errors="replace") if projection.is_file() else ""
        found = re.search(r"^\s*Zunits\s+(\S+)", text, re.IGNORECASE | re.MULTILINE)
        if found and found.group(1).upper() != "NO":
            yield "Zunits", found.group(1)


def _json_label(source: DatasetReader, domain: str) -> dict[str, Any]:
    """Return a label as GDAL parsed it; {} without a label.

    `domain` is GDAL's name of the metadata.
    """
    # rasterio splits the text at the first colon.
    text = ":".join(next(iter(source.tags(ns=domain).items()), ("", "")))
    try:
        label = json.loads(text)
    except ValueError:
        return {}
    return label if isinstance(label, dict) else {}


def _image_object(label: dict[str, Any]) -> dict[str, Any]:
    """Return the part of a PDS3 label that describes the samples; {} if there is none."""
    if "SAMPLE_BITS" in label or "CORE_ITEM_BYTES" in label:
        return label
    nested = [_image_object(value) for value in label.values() if isinstance(value, dict)]
    return next((found for found in nested if found), {})


def _pds4_constants(text: str) -> list[ElementTree.Element]:
    if not text or "<!" in re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL):
        return []  # refuse labels with entity declarations
    try:
        root = ElementTree.fromstring(text.encode())
    except ElementTree.ParseError:
        return []
    return [e for c in root.iter() if c.tag.endswith("}Special_Constants") for e in c
            if not e.tag.rpartition("}")[2].startswith("valid_")]  # fmt: skip


def _number(text: Any, dtype: np.dtype[Any]) -> float | None:
    """Parse a special value of a label, given as a number or as hexadecimal bits.

    `dtype` is the number type of the raster. Text that is neither gives None.
    """
    if isinstance(text, dict):
        text = text.get("value")
    bits = re.fullmatch(r"\s*(?:16#([0-9A-Fa-f]+)#|0x([0-9A-Fa-f]+))\s*", str(text))
    try:
        if bits:
            pattern = int(bits.group(1) or bits.group(2), 16)
            sample = pattern.to_bytes(dtype.itemsize, "big")
            return float(np.frombuffer(sample, dtype.newbyteorder(">"))[0])
        return float(text)
    except (TypeError, ValueError, OverflowError):
        return None


def wkt2(crs: CRS) -> str:
    """Return a coordinate reference system as text (WKT 2, version of 2019)."""
    return str(crs.to_wkt(version="WKT2_2019"))
