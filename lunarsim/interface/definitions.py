"""Define the messages between lunarsim and external flight software.

C header, Protobuf schema, interface control document and encoders follow from this file. A change
that another program could misread increases `VERSION`.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

# Version of the interface. Software of another version is refused.
VERSION = 1
ENU = "local frame"
BODY = "body axes"


class SensorKind(IntEnum):
    """Kind of a sensor, which states the list of `Measurements` with its measurements."""

    OTHER = 0
    INERTIAL_UNIT = 1
    ALTIMETER = 2
    VELOCIMETER = 3
    STAR_TRACKER = 4
    NAVIGATION_FIX = 5
    LIDAR = 6
    CAMERA = 7


class GuidancePhase(IntEnum):
    """Phase of the descent for which a guidance law is called."""

    APPROACH = 0
    TERMINAL_DESCENT = 1


class PolicyAction(IntEnum):
    """Decision of a policy."""

    KEEP = 0
    DIVERT = 1
    ABORT = 2


@dataclass(frozen=True)
class Field:
    """Field of a message.

    Attributes
    ----------
    name
        Name in C, Protobuf and Python.
    type
        "double", "float", "int32", "uint32", "uint16", "uint8", "text", or the name of a message.
    doc
        Meaning, a noun phrase.
    unit
        Unit; empty if dimensionless.
    frame
        Frame of a vector; empty if it has none.
    shape
        Shape of an array of fixed size; of a text, the maximum number of bytes with the final zero.
    count
        Size of an array of variable size, as a C expression of other fields; empty for one value.
        A list of messages has the field `NAME_count` before it.
    written
        Whether the software writes the array.
    """

    name: str
    type: str
    doc: str
    unit: str = ""
    frame: str = ""
    shape: tuple[int, ...] = ()
    count: str = ""
    written: bool = False

    @property
    def is_message(self) -> bool:
        """Whether the field is a message or a list of messages."""
        return self.type[0].isupper()

    @property
    def is_list(self) -> bool:
        """Whether the field is a list of messages."""
        return self.is_message and bool(self.count)

    @property
    def is_block(self) -> bool:
        """Whether the field is an array of numbers of variable size."""
        return not self.is_message and bool(self.count)


@dataclass(frozen=True)
class Message:
    """Message with a name, its meaning, and its fields in order."""

    name: str
    doc: str
    fields: tuple[Field, ...]


def _number(name: str, doc: str, unit: str = "") -> Field:
    return Field(name, "double", doc, unit)


def _vector(name: str, doc: str, unit: str, frame: str = ENU) -> Field:
    return Field(name, "double", doc, unit, frame, (3,))


def _quaternion(name: str, doc: str) -> Field:
    return Field(name, "double", f"{doc}: quaternion, body to {ENU}, scalar last", "", "", (4,))


def _count(name: str, doc: str) -> Field:
    return Field(name, "uint32", doc)


def _flag(name: str, doc: str) -> Field:
    return Field(name, "uint32", f"1 if {doc}, otherwise 0")


def _list(message: str, doc: str) -> tuple[Field, Field]:
    name = "".join(f"_{c.lower()}" if c.isupper() else c for c in message).lstrip("_")
    return (
        _count(f"{name}_count", f"number of elements of `{name}`"),
        Field(name, message, doc, count=f"{name}_count"),
    )


def _block(name: str, of: str, count: str, doc: str, unit: str = "", frame: str = "") -> Field:
    return Field(name, of, doc, unit, frame, count=count)


_SENSOR = _count("sensor", "index of the sensor in `Briefing.sensor`")
_TIME = _number("time", "time of the measurement since the start of the flight", "s")

_GEOMETRY = (
    Message("Grid", "Raster of square cells; row 0 is the southernmost, col 0 the westernmost.", (
        _number("x0", "east coordinate of the centre of cell (0, 0)", "m"),
        _number("y0", "north coordinate of the centre of cell (0, 0)", "m"),
        _number("posting", "side of a cell", "m"),
        _count("rows", "number of cells to the north"),
        _count("cols", "number of cells to the east"),
    )),
    Message("Estimate", "Estimated state of the lander.", (
        _number("time", "time of the estimate", "s"),
        _vector("position", "position of the centre of mass", "m"),
        _vector("velocity", "velocity", "m/s"),
        _quaternion("attitude", "attitude"),
        _vector("rate", "angular rate", "rad/s", BODY),
        _number("mass", "mass", "kg"),
        Field("covariance", "double", "covariance of position, velocity and small rotation, row by "
              "row", "m, m/s, rad", ENU, (9, 9)),
        _flag("lost", "the measurements contradict the estimate"),
    )),
    Message("PhaseEnd", "State that guidance must reach.", (
        _vector("position", "position of the centre of mass", "m"),
        _vector("velocity", "velocity", "m/s"),
        _vector("acceleration", "acceleration of the lander, without gravity compensation",
                "m/s^2"),
    )),
)  # fmt: skip
_BEFORE_FLIGHT = (
    Message("Vehicle", "Nominal parameters of the lander.", (
        _number("dry_mass", "mass without propellant", "kg"),
        _number("propellant_mass", "propellant in full tanks", "kg"),
        _vector("inertia_dry", "principal moments of inertia with empty tanks", "kg m^2", BODY),
        _vector("inertia_full", "principal moments of inertia with full tanks", "kg m^2", BODY),
        _number("thrust_min", "minimum thrust of the running engine", "N"),
        _number("thrust_max", "maximum thrust", "N"),
        _number("exhaust_velocity", "effective exhaust velocity", "m/s"),
        _number("thrust_lag", "time constant of the engine", "s"),
        _vector("torque_max", "maximum control torque about each axis", "N m", BODY),
        _number("leg_radius", "radius of the circle of pad centres", "m"),
        _number("pad_diameter", "diameter of a pad", "m"),
        _number("com_height", "height of the centre of mass above the pads", "m"),
        _number("belly_clearance", "height of the underside above the pads", "m"),
        _number("slope_limit", "maximum terrain slope of a safe site", "rad"),
        _number("roughness_limit", "maximum terrain roughness of a safe site", "m"),
        _number("vertical_speed_limit", "maximum vertical speed at touchdown", "m/s"),
        _number("horizontal_speed_limit", "maximum horizontal speed at touchdown", "m/s"),
        _number("tilt_limit", "maximum tilt at touchdown", "rad"),
        _number("rate_limit", "maximum angular rate at touchdown", "rad/s"),
    )),
    Message("Sensor", "Sensor on the lander.", (
        Field("name", "text", "name in the scenario", shape=(64,)),
        _count("kind", "`SensorKind`"),
        _flag("is_tasked", "the sensor measures only when it is commanded"),
        _vector("boresight", "direction of an altimeter's beam; zero for other sensors", "", BODY),
        _count("beam_count", "number of beams of a velocimeter"),
        _block("beam", "double", "3 * beam_count", "directions of the beams of a velocimeter", "",
               BODY),
    )),
    Message("PriorMap", "Terrain elevations known before the flight.", (
        Field("grid", "Grid", "cells of the map, site frame"),
        _block("elevation", "double", "grid.rows * grid.cols",
               "mean elevations of the cells, row by row; NaN without data", "m"),
        _number("sigma", "standard deviation of the elevation error", "m"),
    )),
    Message("Briefing", "Data that the software gets before the flight.", (
        _count("interface_version", "`LUNARSIM_INTERFACE_VERSION` of lunarsim"),
        Field("configuration", "text", "text of the scenario key `configuration`", shape=(1024,)),
        Field("vehicle", "Vehicle", "nominal lander"),
        _number("gravity", "downward acceleration at the target", "m/s^2"),
        _vector("target", "landing target, height of the terrain", "m"),
        _number("heading", "azimuth of body x, clockwise from north", "rad"),
        _vector("start_position", "estimated position at the start", "m"),
        _vector("start_velocity", "estimated velocity at the start", "m/s"),
        _quaternion("start_attitude", "estimated attitude at the start"),
        _number("start_position_sigma", "its standard deviation per axis", "m"),
        _number("start_velocity_sigma", "its standard deviation per axis", "m/s"),
        _number("start_attitude_sigma", "its standard deviation per axis", "rad"),
        _number("time_to_go", "planned duration of the approach", "s"),
        _number("lag", "response time of attitude control and engine", "s"),
        _vector("sun", "unit vector towards the Sun", ""),
        _number("step", "period of inertial samples and attitude control", "s"),
        _number("cycle", "period of the control cycle", "s"),
        *_list("Sensor", "sensors; other messages have their indices"),
        *_list("PriorMap", "prior map: one element, or none"),
    )),
)  # fmt: skip
_MEASUREMENTS = (
    Message("InertialSamples", "Increments of an inertial unit over one control cycle.", (
        _SENSOR,
        _number("time", "time of the last sample", "s"),
        _count("sample_count", "number of samples"),
        _block("angle", "double", "3 * sample_count", "angle increments, sample by sample; NaN for "
               "a lost sample", "rad", BODY),
        _block("velocity", "double", "3 * sample_count", "velocity increments, sample by sample; "
               "NaN for a lost sample", "m/s", BODY),
    )),
    Message("AltimeterReading", "Slant range of an altimeter.", (
        _SENSOR,
        _TIME,
        _number("range", "slant range; NaN without a return", "m"),
        _number("sigma", "standard deviation", "m"),
    )),
    Message("DopplerReading", "Speeds and ranges along the beams of a velocimeter.", (
        _SENSOR,
        _TIME,
        _count("beam_count", "number of beams"),
        _block("speed", "double", "beam_count", "speed along each beam, positive towards the "
               "terrain; NaN without a return", "m/s"),
        _block("range", "double", "beam_count", "slant ranges; NaN without a return", "m"),
        _block("speed_sigma", "double", "beam_count", "standard deviations of the speeds", "m/s"),
        _block("range_sigma", "double", "beam_count", "standard deviations of the ranges", "m"),
    )),
    Message("AttitudeReading", "Attitude from a star tracker.", (
        _SENSOR,
        _TIME,
        _quaternion("attitude", "measured attitude, NaN if no stars are visible"),
        Field("covariance", "double", "covariance of the noise as a small rotation", "rad^2", BODY,
              (3, 3)),
    )),
    Message("NavigationFix", "State from an external navigation system.", (
        _SENSOR,
        _TIME,
        _vector("position", "position of the centre of mass", "m"),
        _vector("velocity", "velocity", "m/s"),
        _quaternion("attitude", "attitude"),
        Field("covariance", "double", "covariance of position, velocity and small rotation",
              "m, m/s, rad", ENU, (9, 9)),
    )),
    Message("LidarScan", "One flash of a LiDAR.", (
        _SENSOR,
        _TIME,
        _count("rows", "rows of the detector"),
        _count("cols", "columns of the detector"),
        Field("mount", "double", "rotation, sensor to body, row by row", "", "", (3, 3)),
        _block("range", "double", "rows * cols", "range of each pixel; NaN without a return", "m"),
        _block("direction", "double", "3 * rows * cols", "unit vector of each pixel", "",
               "sensor axes"),
        _block("sigma", "double", "rows * cols", "standard deviation of each range", "m"),
    )),
    Message("CameraImage", "Image of a camera.", (
        _SENSOR,
        _number("time", "middle of the exposure", "s"),
        _count("width", "width of the image"),
        _count("height", "height of the image"),
        _count("bytes_per_pixel", "1 or 2"),
        _block("pixels", "uint8", "width * height * bytes_per_pixel", "pixel values row by row, "
               "little-endian"),
        _number("fx", "focal length along the width", "px"),
        _number("fy", "focal length along the height", "px"),
        _number("cx", "principal point from the centre of the first pixel", "px"),
        _number("cy", "principal point from the centre of the first pixel", "px"),
        Field("distortion", "double", "Brown-Conrady coefficients k1, k2, p1, p2, k3 as in OpenCV",
              "", "", (5,)),
        _vector("offset", "position of the camera", "m", BODY),
        Field("mount", "double", "rotation, camera to body, row by row; camera x is right in the "
              "image, y down, z along the boresight", "", "", (3, 3)),
        _number("exposure", "exposure time; NaN if the camera does not report it", "s"),
    )),
)  # fmt: skip
_HAZARDS = (
    Message("HazardMap", "Probability of a safe touchdown at each cell.", (
        Field("grid", "Grid", "cells of the map"),
        _block("p_safe", "float", "grid.rows * grid.cols",
               "probability of a safe touchdown; 0 where not observed"),
        _block("observed", "uint8", "grid.rows * grid.cols",
               "1 where the footprint of the lander has been observed"),
        _count("elevation_count", "number of elements of `elevation`: those of the map, or 0"),
        _block("elevation", "float", "elevation_count", "mean elevation; NaN where unknown", "m"),
    )),
    Message("Candidates", "Candidate landing sites, safest first.", (
        _count("site_count", "number of sites"),
        _block("position", "double", "3 * site_count", "positions, site by site", "m", ENU),
        _block("p_safe", "double", "site_count", "probability of a safe touchdown"),
        _block("distance", "double", "site_count", "horizontal distance from the current site",
               "m"),
        _block("propellant", "double", "site_count", "propellant to reach the site; infinite if it "
               "is out of reach", "kg"),
        _block("value", "double", "site_count", "value for the mission, 0 to 1"),
    )),
)  # fmt: skip
_ROLES = (
    Message("Measurements", "Input of the role `computer`: all measurements of one control cycle.",
        (
            _number("time", "current time", "s"),
            *_list("InertialSamples", "samples of inertial units"),
            *_list("AltimeterReading", "readings of altimeters"),
            *_list("DopplerReading", "readings of velocimeters"),
            *_list("AttitudeReading", "readings of star trackers"),
            *_list("NavigationFix", "fixes of external navigation"),
            *_list("LidarScan", "scans of LiDARs"),
            *_list("CameraImage", "images of cameras"),
        )),
    Message("SensorTask", "Measurement to make at the end of the next cycle.", (
        _SENSOR,
        Field("mount", "double", "rotation, sensor to body, row by row, that the gimbal must hold",
              "", "", (3, 3)),
    )),
    Message("Command", "Output of the role `computer`: commands for the next control cycle, and "
        "the estimate behind them.", (
            _number("thrust", "thrust; 0 shuts the engine down", "N"),
            _quaternion("attitude", "commanded attitude"),
            _flag("abort", "the lander aborts and climbs away with these commands"),
            _count("task_count", "number of valid elements of `task`, at most 8, one per sensor"),
            Field("task", "SensorTask", "measurement tasks", shape=(8,)),
            Field("estimate", "Estimate", "estimated state; attitude control starts from its "
                  "attitude and mass, all else is recorded; time and covariance are optional"),
            _vector("site", "landing site that the lander flies to, for the record; optional", "m"),
            _number("time_to_go", "time until the end of the approach, for the record; optional",
                    "s"),
        )),
    Message("GuidanceInput", "Input of the role `guidance`.", (
        _count("phase", "`GuidancePhase`"),
        _number("time", "current time", "s"),
        _number("time_to_go", "time until the end of the phase; 0 in the terminal descent", "s"),
        Field("estimate", "Estimate", "estimated state"),
        Field("end", "PhaseEnd", "state to reach"),
    )),
    Message("GuidanceOutput", "Output of the role `guidance`.", (
        _vector("acceleration", "thrust over mass, compensation of gravity included", "m/s^2"),
    )),
    Message("PolicyInput", "Input of the role `policy`, at each decision.", (
        _number("time", "current time", "s"),
        Field("estimate", "Estimate", "estimated state"),
        Field("map", "HazardMap", "current hazard map"),
        Field("candidates", "Candidates", "candidate sites"),
        _vector("site", "current landing site", "m"),
        _number("site_p_safe", "probability of a safe touchdown there; NaN if not observed"),
        _number("site_propellant", "propellant to reach the current site", "kg"),
        _number("time_to_go", "time until the end of the approach", "s"),
        _number("propellant", "remaining propellant", "kg"),
        _flag("site_eligible", "the mission permits a landing at the current site"),
        _number("site_value", "value of the current site for the mission, 0 to 1"),
        _number("expected_miss", "expected touchdown error on the map, 1 sigma per axis", "m"),
    )),
    Message("PolicyOutput", "Output of the role `policy`.", (
        _count("action", "`PolicyAction`"),
        _vector("site", "new site if `action` is DIVERT", "m"),
        Field("reason", "text", "short text for the record", shape=(64,)),
    )),
    Message("MapperInput", "Input of the role `mapper`, for each measurement. The arrays keep "
        "their contents between calls.", (
            Field("estimate", "Estimate", "estimated state at the measurement"),
            *_list("LidarScan", "scan: one element, or none"),
            *_list("CameraImage", "image: one element, or none"),
            Field("grid", "Grid", "cells of the map"),
            Field("p_safe", "float", "probability of a safe touchdown", count=
                  "grid.rows * grid.cols", written=True),
            Field("observed", "uint8", "1 where the footprint of the lander has been observed",
                  count="grid.rows * grid.cols", written=True),
            Field("elevation", "float", "mean elevation; NaN where unknown", "m", count=
                  "grid.rows * grid.cols", written=True),
        )),
    Message("MapperOutput", "Output of the role `mapper`.", (
        _flag("changed", "the map has changed"),
    )),
    Message("ControlInput", "Input of the role `control`, at each step of the attitude loop.", (
        _vector("error", "rotation vector from the estimated to the commanded attitude", "rad",
                BODY),
        _vector("rate", "angular rate from the gyroscopes", "rad/s", BODY),
        _vector("inertia", "principal moments at the estimated mass", "kg m^2", BODY),
    )),
    Message("ControlOutput", "Output of the role `control`.", (
        _vector("torque", "commanded torque; lunarsim applies the limits", "N m", BODY),
    )),
)  # fmt: skip
MESSAGES: dict[str, Message] = {
    message.name: message
    for message in (*_GEOMETRY, *_BEFORE_FLIGHT, *_MEASUREMENTS, *_HAZARDS, *_ROLES)
}
ENUMS: tuple[type[IntEnum], ...] = (SensorKind, GuidancePhase, PolicyAction)


@dataclass(frozen=True)
class Role:
    """Part of the flight software that external software replaces.

    Attributes
    ----------
    name
        Name, which is also the prefix of its functions in C.
    table
        Scenario table that selects the software.
    input, output
        Names of the messages of one call.
    rate
        When it is called.
    """

    name: str
    table: str
    input: str
    output: str
    rate: str


ROLES: dict[str, Role] = {
    role.name: role
    for role in (
        Role("computer", "[computer]", "Measurements", "Command", "once per control cycle"),
        Role("guidance", "[guidance] or [terminal_descent]", "GuidanceInput", "GuidanceOutput",
             "once per control cycle of the approach or of the terminal descent"),
        Role("policy", "[policy]", "PolicyInput", "PolicyOutput", "at each decision"),
        Role("mapper", "[mappers.NAME]", "MapperInput", "MapperOutput", "for each measurement"),
        Role("control", "[control]", "ControlInput", "ControlOutput",
             "once per step of the attitude loop, 100 Hz by default"),
    )
}  # fmt: skip
