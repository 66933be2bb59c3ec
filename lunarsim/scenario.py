"""The scenario: everything that a study fixes, as typed sections of one TOML file.

Fields carry their unit in their name: ``_m``, ``_s``, ``_kg``, ``_n``, ``_deg``, ``_m_s``. Unknown
keys, wrong types and impossible values are refused with the field, the value and what is right.
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal

import tomli_w
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from lunarsim.errors import InputError, suggestion

Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Vector2 = tuple[Finite, Finite]
Vector3 = tuple[Finite, Finite, Finite]


class Section(BaseModel):
    """A table of the file: strict about keys and types, immutable."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=False)


# Median Hurst exponents of maria and highlands, and their slopes carried to 1 m by them, from
# Rosenburg et al. (2011), J. Geophys. Res. 116, E02001. The south pole is highland.
_PRESETS: dict[str, dict[str, float]] = {
    "mare": {"hurst": 0.76, "rms_slope_deg": 3.9, "crater_density": 0.079},
    "highland": {"hurst": 0.95, "rms_slope_deg": 8.6, "crater_density": 0.079},
    "polar": {"hurst": 0.95, "rms_slope_deg": 8.6, "crater_density": 0.079},
}


class TerrainSection(Section):
    """The relief."""

    kind: Literal["dtm", "fractal", "hazard-field"] = Field(
        "fractal", description="measured, procedural, or boulders and craters on level grass"
    )
    path: Path | None = Field(None, description="raster, relative to the scenario file (dtm)")
    dtm_posting_m: Positive | None = Field(None, description="for a raster without metric frame")
    dtm_window: tuple[int, int, int, int] | None = Field(
        None, description="first and last row from the top, first and last column (dtm)"
    )
    height_step_m: Positive | None = Field(
        None, description="for a raster whose elevations come in steps: smooth within them (dtm)"
    )
    relief_scale: NonNegative = Field(1.0, description="c of Eq. 20 of the Gaussian DEM paper")
    posting_m: Positive = Field(0.25, description="working posting of the relief")
    size_m: Positive = Field(160.0, description="side of the square (fractal, hazard-field)")
    field_m: Positive = Field(100.0, description="side of the hazard field in it (hazard-field)")
    field_turn_deg: Finite = Field(20.0, description="of the field in the frame (hazard-field)")
    boulders: int = Field(300, ge=0, description="0.4 to 1 m across (hazard-field)")
    craters: int = Field(24, ge=0, description="2 to 5 m across (hazard-field)")
    preset: Literal["none", "mare", "highland", "polar"] = Field(
        "none", description="roughness and craters that keys below may override"
    )
    hurst: float = Field(0.85, gt=0.0, lt=1.0, description="Hurst exponent (fractal, detail)")
    rms_slope_deg: float = Field(
        2.5, ge=0.0, lt=45.0, description="at 1 m baseline (fractal, detail)"
    )
    crater_density: float = Field(
        0.0, ge=0.0, le=0.3, description="craters of 1 m or more on 1 m^2 in equilibrium; 0: none"
    )
    crater_saturation_m: Positive = Field(200.0, description="diameter where equilibrium ends")
    crater_min_diameter_m: Positive = Field(2.0, description="least diameter drawn")
    detail: bool = Field(
        False, description="add roughness and craters between the posts of a DTM (dtm)"
    )

    @model_validator(mode="before")
    @classmethod
    def _fill_from_preset(cls, data: Any) -> Any:
        if isinstance(data, dict) and data.get("preset") in _PRESETS:
            return _PRESETS[data["preset"]] | data
        return data

    @model_validator(mode="after")
    def _path_with_dtm(self) -> TerrainSection:
        if (self.kind == "dtm") != (self.path is not None):
            raise ValueError("terrain.path: give it for kind = 'dtm', leave it out otherwise")
        return self


class RocksSection(Section):
    """Rocks by the Golombek law, drawn anew for every flight."""

    cover: float = Field(0.05, ge=0.0, le=0.2, description="fraction k of ground under rocks")
    min_diameter_m: Positive = 0.15
    max_diameter_m: Positive = 3.0
    shape: Literal["hemisphere", "ellipsoid", "cube", "irregular", "mixed"] = "hemisphere"
    height_ratio: Vector2 = Field((0.5, 0.1), description="height over diameter, mean and sigma")
    burial: Vector2 = Field((0.0, 0.5), description="buried fraction of the height, least and most")
    axis_ratio: Vector2 = Field((0.6, 1.0), description="of the horizontal axes, least and most")

    @model_validator(mode="after")
    def _ordered(self) -> RocksSection:
        if self.min_diameter_m >= self.max_diameter_m:
            raise ValueError("rocks.min_diameter_m: must be less than rocks.max_diameter_m")
        return self


class SunSection(Section):
    """Sunlight, and how the ground reflects it; only cameras look at it."""

    azimuth_deg: Finite = Field(270.0, description="clockwise from north")
    elevation_deg: float = Field(20.0, ge=-90.0, le=90.0)
    albedo: float = Field(0.12, gt=0.0, le=1.0, description="normal albedo")
    ambient: float = Field(0.0, ge=0.0, le=1.0, description="I/F of shadows over the albedo")
    photometry: Literal["lambert", "lunar-lambert"] = "lunar-lambert"


class CameraSection(Section):
    """Camera fixed to the lander, looking along body -z."""

    pixels: tuple[int, int] = Field((480, 640), description="rows and columns")
    field_of_view_deg: float = Field(60.0, gt=0.0, lt=170.0, description="of the width")
    distortion: tuple[Finite, Finite, Finite, Finite, Finite] = Field(
        (0.0, 0.0, 0.0, 0.0, 0.0), description="Brown-Conrady k1, k2, p1, p2, k3"
    )
    exposure_s: Positive = 2e-3
    sensitivity: Positive = Field(5e7, description="electrons a second for I/F = 1")
    blur_sigma_px: NonNegative = 0.6
    motion_blur: bool = True
    shot_noise: bool = True
    read_noise_electrons: NonNegative = 12.0
    full_well_electrons: Positive = 20_000.0
    bits: int = Field(8, ge=1, le=16)
    rate_hz: Positive = Field(10.0, description="pictures a second, for the shadow mapper")
    first_altitude_m: Positive = Field(400.0, description="of the first picture above the site")
    gimbal_limit_deg: float = Field(
        180.0, gt=0.0, le=180.0, description="farthest that it points from straight down"
    )


class LanderSection(Section):
    """The vehicle; defaults are those of `lunarsim.vehicle.Lander`."""

    dry_mass_kg: Positive = 1100.0
    propellant_kg: Positive = 400.0
    inertia_dry_kg_m2: tuple[Positive, Positive, Positive] = (1100.0, 1100.0, 1300.0)
    inertia_full_kg_m2: tuple[Positive, Positive, Positive] = (1400.0, 1400.0, 1600.0)
    thrust_min_n: NonNegative = 600.0
    thrust_max_n: Positive = 6000.0
    specific_impulse_s: Positive = 311.0
    thrust_lag_s: NonNegative = 0.1
    torque_max_n_m: tuple[Positive, Positive, Positive] = (600.0, 600.0, 300.0)
    legs: Literal[3, 4] = 4
    leg_radius_m: Positive = 2.35
    pad_diameter_m: Positive = 0.3
    com_height_m: Positive = 1.6
    belly_clearance_m: Positive = 0.25
    slope_limit_deg: float = Field(10.0, gt=0.0, lt=45.0)
    roughness_limit_m: Positive = 0.25
    vertical_speed_limit_m_s: Positive = 3.0
    horizontal_speed_limit_m_s: Positive = 1.0
    tilt_limit_deg: float = Field(6.0, gt=0.0, lt=90.0)
    rate_limit_deg_s: Positive = 6.0


class StartSection(Section):
    """Where a flight begins, relative to the ground at its target."""

    position_m: Vector3 = (-600.0, 0.0, 500.0)
    velocity_m_s: Vector3 = (28.0, 0.0, -18.0)
    heading_deg: Finite = Field(90.0, description="azimuth of body x, held through the flight")
    position_sigma_m: NonNegative = 10.0
    velocity_sigma_m_s: NonNegative = 0.5


class TargetSection(Section):
    """The landing site before any divert."""

    position_m: Vector2 = (0.0, 0.0)
    scatter_m: Vector2 = Field((0.0, 0.0), description="half sides of a uniform scatter, E and N")


class GuidanceSection(Section):
    """Approach by the Apollo law, then straight down."""

    attitude: Literal["pd", "slerp"] = "pd"
    slew_limit_deg_s: Positive = 15.0
    max_tilt_deg: float = Field(40.0, gt=0.0, lt=85.0)
    glideslope_deg: float = Field(8.0, ge=0.0, lt=80.0)
    reserve_kg: NonNegative = 15.0
    time_to_go_s: Positive | None = Field(None, description="left out: the cheapest admissible")
    arrival_acceleration_m_s2: Vector3 = Field(
        (0.0, 0.0, 0.0), description="at the end of the approach; shapes the path before it"
    )
    vertical_altitude_m: Positive = 10.0
    vertical_speed_m_s: Positive = 2.0


class LidarSection(Section):
    """Flash LiDAR on a gimbal that points at the site."""

    pixels: tuple[int, int] = Field((256, 256), description="rows and columns")
    half_width: float = Field(0.1, gt=0.0, lt=2.0, description="tangent of half the field of view")
    noise_3sigma_m: NonNegative = Field(
        0.05, description="along the ray at 500 m; grows with range"
    )
    max_range_m: Positive = 2000.0
    spacing: Literal["tangent", "angle"] = Field("tangent", description="pixels even in this")
    max_incidence_deg: float = Field(90.0, gt=0.0, le=90.0, description="no return beyond")
    photons: Positive | None = Field(
        None, description="mean of a return from 500 m head-on; left out: no return is lost"
    )
    boresight: Literal["site", "nadir"] = "site"
    gimbal_limit_deg: float = Field(
        180.0, gt=0.0, le=180.0, description="greatest angle of the boresight from body -z"
    )
    divergence_mrad: float = Field(0.0, ge=0.0, lt=100.0, description="half angle at 1/e^2")
    scan_altitudes_m: tuple[Positive, ...] = (350.0, 160.0)


class MapperSection(Section):
    """The hazard mapper."""

    kind: Literal["gaussian-dem", "shadow", "quadtree"] = Field(
        "gaussian-dem",
        description="LiDAR flashes, rocks by their shadows, or a LiDAR sweep tied to a map",
    )
    posting_m: Positive = 0.2
    size_m: Positive = 100.0
    safety: Literal["level", "planes"] = Field(
        "level", description="Eqs. 15 to 17 of the paper, or through the real support planes"
    )
    sigma_f_m: Positive = 0.5
    length_scale_m: Positive = 30.0
    expected_shape: Literal["hemisphere", "ellipsoid", "cube", "irregular", "mixed"] = Field(
        "hemisphere", description="of rocks, to read shadows by (shadow)"
    )
    expected_cover: float = Field(0.05, gt=0.0, le=0.2, description="of rocks, beforehand (shadow)")
    hazard_diameter_m: Positive = Field(0.5, description="least diameter of a hazard (shadow)")
    refresh_s: Positive = Field(1.0, description="between two evaluations of the map (shadow)")


class SweepSection(Section):
    """How a gimballed LiDAR sweeps the ground (quadtree)."""

    duration_s: Positive = Field(20.0, description="then it dwells on the site")
    rate_hz: Positive = Field(20.0, description="flashes a second while it sweeps")
    dwell_rate_hz: Positive = Field(5.0, description="flashes a second on the site")
    size_m: Positive = Field(90.0, description="side of the square swept")
    last_altitude_m: NonNegative = Field(15.0, description="below it the LiDAR is turned away")
    update_s: Positive = Field(1.0, description="between two selections of sites")


class PriorSection(Section):
    """The map that a lander brings along to find its place on (quadtree)."""

    size_m: Positive = Field(300.0, description="side of the square about the target")
    posting_m: Positive = 0.5
    sigma_m: Positive = Field(0.1, description="noise of each post")
    offset_m: Vector3 = Field((0.0, 0.0, 0.0), description="by which the whole map is wrong")
    stale_share: float = Field(0.0, ge=0.0, lt=1.0, description="of the map out of date")
    stale_side_m: Positive = Field(12.0, description="of the patches out of date")
    stale_sigma_m: NonNegative = Field(0.4, description="of what they show besides the ground")


class SitesSection(Section):
    """What a landing site must be like (quadtree); defaults are Table 1 of the paper."""

    slope_limit_deg: float = Field(5.0, gt=0.0, lt=45.0)
    roughness_limit_m: Positive = 0.3
    density_m2: NonNegative = Field(5.0, description="least points on a square metre")
    exception_limit: float = Field(0.015, ge=0.0, lt=1.0)
    zone_m: Positive = Field(2.5, description="half side of the landing zone")
    weight_interest: NonNegative = 1.0
    weight_slope: NonNegative = 1000.0
    weight_roughness: NonNegative = 100.0
    roughness: Literal["rms", "printed"] = "rms"
    interest_path: Path | None = Field(
        None, description="NumPy archive of value, x0, y0, posting, relative to the scenario file"
    )
    count: int = Field(5, ge=1, description="sites on the scoreboard")
    separation_m: NonNegative = 5.0
    mesh_band_m: tuple[Positive, Positive] = Field((6.4, 12.8), description="cells of the mesh")
    hazard_band_m: tuple[Positive, Positive] = (1.6, 1.6)
    site_band_m: tuple[Positive, Positive] = (0.8, 1.6)
    least_m: Positive = Field(0.1, description="least cells of the quadtree")
    split_count: int = Field(8, ge=2, description="points at which a cell divides")
    hold_sigma_m: Positive = Field(
        0.5, description="scans whose ground is less certain than this wait until it is"
    )
    jerk_m_s3: Positive = Field(0.25, description="limit that sets the time-to-go for fuel")
    snap_m_s4: Positive = Field(0.05, description="likewise")


class NavigationSection(Section):
    """Error budget of navigation, 1 sigma an axis."""

    position_bias_m: NonNegative = 5.0
    position_drift_m: NonNegative = 0.1
    drift_time_s: Positive = 60.0
    velocity_m_s: NonNegative = 0.02
    attitude_deg: NonNegative = 0.03


class DecisionsSection(Section):
    """When the policy is asked, and what it chooses from."""

    first_altitude_m: Positive = 400.0
    last_altitude_m: Positive = 50.0
    interval_s: Positive = 1.0
    candidates: int = Field(16, ge=1, le=256)
    separation_m: Positive = 3.0
    touchdown_sigma_m: NonNegative = Field(0.3, description="expected miss on the map, an axis")

    @model_validator(mode="after")
    def _ordered(self) -> DecisionsSection:
        if self.last_altitude_m >= self.first_altitude_m:
            raise ValueError("decisions.last_altitude_m: must be less than first_altitude_m")
        return self


class SimulationSection(Section):
    """The clock."""

    step_s: Positive = 0.01
    cycle_s: Positive = 0.1
    max_time_s: Positive = 300.0

    @model_validator(mode="after")
    def _whole_steps(self) -> SimulationSection:
        steps = self.cycle_s / self.step_s
        if steps < 1.0 or abs(steps - round(steps)) > 1e-6:
            raise ValueError("simulation.cycle_s: must be a whole number of simulation.step_s")
        return self


class Scenario(Section):
    """One study: world, vehicle, sensors, guidance, decisions."""

    name: str = Field("unnamed", min_length=1)
    description: str = ""
    gravity_m_s2: Positive = 1.622
    terrain: TerrainSection = TerrainSection()
    rocks: RocksSection = RocksSection()
    sun: SunSection = SunSection()
    lander: LanderSection = LanderSection()
    start: StartSection = StartSection()
    target: TargetSection = TargetSection()
    guidance: GuidanceSection = GuidanceSection()
    lidar: LidarSection = LidarSection()
    camera: CameraSection = CameraSection()
    mapper: MapperSection = MapperSection()
    sweep: SweepSection = SweepSection()
    prior: PriorSection = PriorSection()
    sites: SitesSection = SitesSection()
    navigation: NavigationSection = NavigationSection()
    decisions: DecisionsSection = DecisionsSection()
    simulation: SimulationSection = SimulationSection()

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> Scenario:
        """Build a scenario from plain tables.

        Raises
        ------
        InputError
            Naming the first field that is wrong.
        """
        try:
            return cls.model_validate(data)
        except ValidationError as error:
            raise _input_error(cls, error) from None

    @classmethod
    def load(cls, path: str | Path) -> Scenario:
        """Read a TOML file; relative paths in it start from its folder.

        Raises
        ------
        InputError
            If the file is missing, is no TOML, or a field is wrong.
        """
        path = Path(path)
        if not path.is_file():
            raise InputError("scenario", str(path), "an existing TOML file")
        try:
            data = tomllib.loads(path.read_text(encoding="utf-8"))
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise InputError("scenario", str(path), f"a TOML file ({error})") from None
        scenario = cls.from_dict(data)
        for table, key in (("terrain", "path"), ("sites", "interest_path")):
            section = getattr(scenario, table)
            relative = getattr(section, key)
            if relative is not None:
                section = section.model_copy(update={key: (path.parent / relative).resolve()})
                scenario = scenario.model_copy(update={table: section})
        return scenario

    def to_toml(self) -> str:
        """Return the scenario as TOML, defaults included."""
        return tomli_w.dumps(self.model_dump(mode="json", exclude_none=True))

    def save(self, path: str | Path) -> None:
        """Write the scenario as TOML, defaults included."""
        Path(path).write_text(self.to_toml(), encoding="utf-8")


def _known_keys(model: type[BaseModel], location: tuple[Any, ...]) -> list[str]:
    """Return the keys allowed in the table at `location`."""
    for step in location:
        annotation = model.model_fields[step].annotation if step in model.model_fields else None
        if not (isinstance(annotation, type) and issubclass(annotation, BaseModel)):
            return []
        model = annotation
    return list(model.model_fields)


def _input_error(model: type[BaseModel], error: ValidationError) -> InputError:
    """Return the first validation error as an `InputError`."""
    first = error.errors(include_url=False)[0]
    location = tuple(first["loc"])
    field = ".".join(str(part) for part in location) or "scenario"
    if first["type"] == "extra_forbidden":
        keys = _known_keys(model, location[:-1])
        return InputError(
            field, first["input"], "unknown key; " + suggestion(str(location[-1]), keys)
        )
    message = str(first["msg"]).removeprefix("Value error, ")
    if first["type"] == "value_error" and ": " in message:
        name, expected = message.split(": ", 1)
        key = name.rpartition(".")[2]
        given = first["input"]
        value = given.get(key) if isinstance(given, dict) else getattr(given, key, None)
        return InputError(name, value, expected)
    expected = message[0].lower() + message[1:]
    unit = _unit_of(field)
    if unit and first["type"].endswith(("_type", "_parsing")):
        expected += f", a plain number in {unit}"
    return InputError(field, first["input"], expected)


_UNITS = {
    "_kg_m2": "kg m^2",
    "_m_s2": "m/s^2",
    "_m_s": "m/s",
    "_deg_s": "deg/s",
    "_n_m": "N m",
    "_m2": "m^2",
    "_kg": "kg",
    "_deg": "degrees",
    "_n": "newtons",
    "_m": "metres",
    "_s": "seconds",
}


def _unit_of(field: str) -> str | None:
    name = next((p for p in reversed(field.split(".")) if not p.isdigit()), field)
    return next((unit for suffix, unit in _UNITS.items() if name.endswith(suffix)), None)
