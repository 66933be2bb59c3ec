"""Rasters of many formats, orientations, units, scales, projections, no-data and types."""

from __future__ import annotations

import numpy as np

from tests.world.terrain.rasters import (
    ORIENTATIONS,
    Case,
    degrees,
    equirectangular,
    mercator,
    plane,
    south_polar,
)

METRES = equirectangular(0.0)
FOOT, SURVEY = 0.3048, 1200 / 3937
LOCAL = 'LOCAL_CS["Site",UNIT["metre",1]]'
LOCAL_FEET = 'LOCAL_CS["Site",UNIT["US survey foot",0.304800609601219]]'

CASES = {
    **{f"metres {name}": Case(map=METRES, orientation=name) for name in ORIENTATIONS},
    **{f"site {name}": Case(map=plane(LOCAL, 2.0), orientation=name, dtype="float32")
       for name in ORIENTATIONS},
    **{f"60 deg {name}": Case(map=equirectangular(60.0), orientation=name, unit="km", metres=1e3)
       for name in ("north-up", "south-up", "quarter-turn", "turned")},
    **{f"no frame {name}": Case(map=plane(None, 2.0), orientation=name,
                                options=(("posting", 2.0),))
       for name in ("north-up", "south-up", "transposed")},
    "no frame turned": Case(map=plane(None, 2.0), orientation="unequal",
                            options=(("posting", 2.0),), refused="unequal steps"),
    "no frame, no posting": Case(map=plane(None, 2.0), refused="dtm_posting_m"),
    # Projections.
    "standard parallel": Case(map=equirectangular(60.0, lat_ts=60.0, step=1.0)),
    "Mercator": Case(map=mercator(60.0, step=2.0)),
    "wide Mercator": Case(map=mercator(60.0, step=600.0)),
    "polar": Case(map=south_polar(60.0, -88.0)),
    "pole": Case(map=south_polar(0.0, -89.99)),
    "polar int16": Case(map=south_polar(200.0, -85.0), dtype="int16", scale=0.005, offset=50.0),
    "degrees": Case(map=degrees(30.0, -60.0)),
    "degrees east of 180": Case(map=degrees(330.0, 10.0), orientation="south-up"),
    "degrees about 180": Case(map=degrees(180.0, 40.0)),
    "high latitude": Case(map=degrees(-75.0, 80.0)),
    "map in km": Case(map=equirectangular(0.0, units="km", metres=1e3, step=0.01)),
    "map in feet": Case(map=equirectangular(0.0, units="us-ft", metres=SURVEY, step=30.0)),
    "site in feet": Case(map=plane(LOCAL_FEET, 5.0, SURVEY), orientation="south-up"),
    # Units, scale and offset.
    "feet": Case(map=METRES, unit="foot", metres=FOOT),
    "survey feet": Case(map=METRES, unit="US survey foot", metres=SURVEY, dtype="float32"),
    "kilometres, int16": Case(map=METRES, unit="km", metres=1e3, dtype="int16", scale=1e-6,
                              offset=-1.9),
    "centimetres, uint16": Case(map=METRES, unit="cm", metres=0.01, dtype="uint16", scale=0.2,
                                offset=-2500.0, no_data=65535),
    "fathoms": Case(map=METRES, unit="fathom", refused="dtm_unit"),
    "fathoms, unit given": Case(map=METRES, unit="fathom", options=(("unit", "m"),)),
    "wrong unit": Case(map=METRES, unit="m", metres=FOOT, options=(("unit", "ft"),)),
    "from the centre": Case(map=METRES, offset=-1_737_400.0),
    # Formats.
    **{f"{driver}": Case(driver, METRES, dtype=dtype, scale=0.5e-3, offset=1737.4, unit="km",
                         metres=1e3)
       for driver, dtype in (("PDS4", "float64"), ("netCDF", "float64"), ("ENVI", "float64"),
                             ("PDS", "float64"))},
    **{f"{driver} int16": Case(driver, METRES, dtype="int16", scale=0.002, offset=1_737_400.0,
                               no_data=-32768)
       for driver in ("GTiff", "PDS4", "netCDF", "ENVI", "PDS", "ISIS3")},
    **{f"{driver} at 60 deg": Case(driver, equirectangular(60.0), dtype="float32", no_data=-9999)
       for driver in ("PDS4", "netCDF", "ENVI", "AAIGrid")},
    "netCDF south-up": Case("netCDF", METRES, "south-up", no_data=-9999.0),
    "PDS in feet": Case("PDS", METRES, dtype="float32", unit="FEET", metres=FOOT),
    "PDS in parsecs": Case("PDS", METRES, dtype="float32", unit="PARSEC", refused="dtm_unit"),
    "ISIS3 in km": Case("ISIS3", METRES, dtype="float32", unit="km", metres=1e3),
    "AAIGrid": Case("AAIGrid", METRES, no_data=-9999.0),
    "AAIGrid from the centre": Case("AAIGrid", METRES, offset=-1_737_400.0),
    # No-data.
    "no-data": Case(map=METRES, no_data=-9999.0, dtype="float32"),
    "no-data nan": Case(map=METRES, no_data=np.nan, orientation="transposed"),
    "no-data at 60 deg": Case(map=equirectangular(60.0), no_data=-3.4028226550889045e38,
                              dtype="float32"),
}  # fmt: skip
