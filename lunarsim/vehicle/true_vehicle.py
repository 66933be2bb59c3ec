"""Deviations of the true lander from the lander that the onboard computer assumes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from lunarsim.errors import InputError
from lunarsim.models.jet_lander import JetLander
from lunarsim.models.lander import Lander
from lunarsim.parts.quantity import check_bounds, quantity


@dataclass(frozen=True)
class VehicleDeviations:
    """Deviations of the true lander from the table `[vehicle]`.

    The onboard computer knows only `[vehicle]`. Factors of 1 and offsets of 0 are a lander that is
    exactly as the computer assumes.

    Attributes
    ----------
    thrust_scale
        True thrust divided by the thrust of the throttle setting.
    thrust_misalignment
        Rotation of the thrust axis about body x and body y (2,), rad. Without the geometry of an
        engine (kind ``lander``) the thrust acts at the body's origin.
    thrust_lag_scale, specific_impulse_scale
        True time constant and specific impulse of the engine, divided by the nominal values.
    dry_mass_scale, propellant_mass_scale
        True masses divided by the nominal ones. The moments of inertia stay as they are.
    com_offset
        Offset of the centre of mass (3,), body axes, m.
    inertia_scale
        True moments of inertia divided by the nominal ones (3,), body axes.
    thruster_scale
        True thruster force, or control torque without thrusters, divided by the nominal value; the
        propellant flow of the thrusters stays nominal.
    """

    thrust_scale: float = quantity(
        1.0, gt=0, le=2, help="true thrust of the engine divided by its throttle setting"
    )
    thrust_misalignment: tuple[float, float] = quantity(
        (0.0, 0.0),
        "deg",
        ge=-10,
        le=10,
        help="rotation of the true thrust axis about body x and about body y",
    )
    thrust_lag_scale: float = quantity(
        1.0, ge=0, le=10, help="true time constant of the engine divided by vehicle.thrust_lag_s"
    )
    specific_impulse_scale: float = quantity(
        1.0,
        gt=0,
        le=2,
        help="true specific impulse of the engine divided by vehicle.specific_impulse_s",
    )
    dry_mass_scale: float = quantity(
        1.0, gt=0, le=2, help="true mass without propellant divided by vehicle.dry_mass_kg"
    )
    propellant_mass_scale: float = quantity(
        1.0, gt=0, le=2, help="true loaded propellant divided by vehicle.propellant_mass_kg"
    )
    com_offset: tuple[float, float, float] = quantity(
        (0.0, 0.0, 0.0),
        "m",
        ge=-1,
        le=1,
        help="true centre of mass minus the one of [vehicle] (body axes)",
    )
    inertia_scale: tuple[float, float, float] = quantity(
        (1.0, 1.0, 1.0),
        gt=0,
        le=3,
        help="true moments of inertia about body x, y and z divided by those of [vehicle]",
    )
    thruster_scale: float = quantity(
        1.0,
        gt=0,
        le=2,
        help="true force of each thruster divided by the nominal force, at the nominal propellant "
        "flow; for kind 'lander': true control torque divided by the commanded torque",
    )

    def __post_init__(self) -> None:
        check_bounds(self, "vehicle")

    def true_lander(self, nominal: Lander) -> Lander:
        """Return the true lander.

        Parameters
        ----------
        nominal
            Lander that the onboard computer assumes.

        Raises
        ------
        InputError
            If the true lander is impossible, for example if it cannot balance its engine, or if a
            custom class of lander cannot be changed.

        Examples
        --------
        >>> lander = VehicleDeviations(specific_impulse_scale=0.98).true_lander(Lander())
        >>> round(lander.specific_impulse, 2)
        304.78
        """
        if self == VehicleDeviations():
            return nominal
        scaled = {
            name: tuple(s * v for s, v in zip(self.inertia_scale, moments, strict=True))
            for name in ("inertia_dry", "inertia_full")
            if (moments := getattr(nominal, name)) is not None
        }
        x, y, z = self.com_offset
        if nominal.com_height + z <= 0.0:
            raise InputError(
                "truth.vehicle.com_offset_m[2]", z,
                f"must be above {-nominal.com_height:g} m, the height of the landing pads",
            )  # fmt: skip
        changes: dict[str, Any] = scaled | {
            "dry_mass": nominal.dry_mass * self.dry_mass_scale,
            "propellant_mass": nominal.propellant_mass * self.propellant_mass_scale,
            "specific_impulse": nominal.specific_impulse * self.specific_impulse_scale,
            "thrust_lag": nominal.thrust_lag * self.thrust_lag_scale,
            "thrust_scale": self.thrust_scale,
            "thrust_misalignment": self.thrust_misalignment,
        }
        if isinstance(nominal, JetLander):
            jets = nominal.thrusters
            for name in ("com_dry", "com_full"):
                com = getattr(nominal, name)
                changes[name] = (com[0] + x, com[1] + y, com[2] + z)
            changes["thrusters"] = replace(
                jets,
                force=jets.force * self.thruster_scale,
                specific_impulse=jets.specific_impulse * self.thruster_scale,
            )
        else:
            changes |= {"com_offset": self.com_offset, "torque_scale": self.thruster_scale}
        try:
            return replace(nominal, **changes)
        except InputError as error:
            raise InputError(
                "truth.vehicle", error.value,
                f"must give a possible lander, whose {error.field} {error.problem}",
                "Decrease the deviations.",
            ) from None  # fmt: skip
        except (TypeError, ValueError) as error:
            raise InputError(
                "truth.vehicle",
                type(nominal).__name__,
                f"must be omitted for this class of lander, because its copy fails ({error})",
            ) from None


@dataclass(frozen=True)
class Truth:
    """True values that differ from those that the onboard computer assumes.

    Attributes
    ----------
    vehicle
        Deviations of the true lander.
    initial_error_scale
        True errors of the initial estimate divided by their stated size.
    """

    vehicle: VehicleDeviations = quantity(
        VehicleDeviations(), help="deviations of the true lander from [vehicle]"
    )
    initial_error_scale: float = quantity(
        1.0,
        ge=0,
        le=100,
        help="true errors of the initial estimate of position, velocity and attitude, divided by "
        "those that [initial_uncertainty] states",
    )
