"""Disturbance torques of engine and sloshing propellant against control torque."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from lunarsim.evaluation.vehicle_check.attitude import agility, control_torque, tilt_torque
from lunarsim.evaluation.vehicle_check.mission import Mission
from lunarsim.evaluation.vehicle_check.rows import CheckRow
from lunarsim.models.jet_lander import JetLander

# Wanted control torque over disturbance torque, minus 1: the rest rotates the lander.
_WANTED_MARGIN = 1.0
# Fill fractions at which slosh is examined.
_FILLS = (1.0, 0.75, 0.5, 0.25, 0.1)


def offset_torques(lander: JetLander, mass: float, thrust: float) -> tuple[float, float]:
    """Return the engine's torque about body x and y that the gimbal leaves, N m.

    With the offset c of the centre of mass from the engine's axis, the arm a from the gimbal's
    pivot to the centre of mass and the gimbal angle d, the torque is ``F (c cos d - a sin d)``. The
    gimbal removes it up to ``tan d = c / a``; beyond its limit the rest remains. `mass` is in kg,
    `thrust` F in N.
    """
    com = lander.com(mass)
    arm, limit = lander.engine.pivot_depth + float(com[2]), lander.engine.gimbal_limit
    rest = [
        thrust * max(abs(float(c)) * np.cos(limit) - max(arm, 0.0) * np.sin(limit), 0.0)
        for c in (com[1], com[0])
    ]
    return rest[0], rest[1]


def trim_angles(lander: JetLander, mass: float) -> tuple[float, float]:
    """Return the gimbal angles about body x and y that remove the offset torque, rad.

    They are ``atan(c / a)`` with the offset c and the arm a of `offset_torques`; `mass` is in kg.
    """
    com = lander.com(mass)
    arm = max(lander.engine.pivot_depth + float(com[2]), 1e-6)
    return float(np.arctan2(-com[1], arm)), float(np.arctan2(com[0], arm))


def disturbance_rows(mission: Mission) -> Iterator[CheckRow]:
    """Yield the checks of disturbance torques; only landers with thrusters have any."""
    lander = mission.lander
    if not isinstance(lander, JetLander):
        return
    torque = control_torque(lander)
    path = mission.approach.path
    cases = (
        ("full", mission.start_mass, float(path.thrust[: len(path.thrust) // 2].max())),
        ("empty", lander.dry_mass, float(mission.terminal.thrust.max())),
    )
    for name, mass, thrust in cases:
        rest = offset_torques(lander, mass, thrust)
        axis = int(np.argmax(np.asarray(rest) / torque[:2]))
        yield CheckRow(
            f"offset-torque-{name}", "disturbance",
            f"control torque against the engine's offset torque, tanks {name}",
            rest[axis], float(torque[axis]), "N m",
            "Otherwise the engine rotates the lander faster than the thrusters can stop it: move "
            f"vehicle.com_{'full' if name == 'full' else 'dry'}_m to the engine's axis, or raise "
            "vehicle.engine.gimbal_limit_deg or vehicle.thrusters.force_n.",
            wanted_margin=_WANTED_MARGIN,
        )  # fmt: skip
    yield from _gimbal_rows(mission, lander)
    if lander.slosh.tanks:
        yield _slosh_row(mission, lander, tilt_torque(lander))


def _gimbal_rows(mission: Mission, lander: JetLander) -> Iterator[CheckRow]:
    """Yield the rows of the gimbal's angle and of its rate.

    The angle must reach the trim angles at the start and with empty tanks. The rate must follow
    the change of the trim angle from the start to touchdown.
    """
    masses = (mission.start_mass, mission.touchdown_mass, lander.dry_mass)
    angles = np.array([trim_angles(lander, m) for m in masses])
    if lander.engine.gimbal_limit == 0.0 or not angles.any():
        return
    yield CheckRow(
        "gimbal-angle", "disturbance", "gimbal limit against the trim angle",
        float(np.rad2deg(np.abs(angles).max())), float(np.rad2deg(lander.engine.gimbal_limit)),
        "deg", "Otherwise the thrusters fire without pause to hold the attitude: raise "
        "vehicle.engine.gimbal_limit_deg, or move vehicle.com_full_m and vehicle.com_dry_m to the "
        "engine's axis.", wanted_margin=0.2,
    )  # fmt: skip
    time = mission.approach.path.duration + mission.terminal.duration
    rate = float(np.abs(angles[1] - angles[0]).max()) / time
    if rate > 0.0:
        yield CheckRow(
            "gimbal-rate", "disturbance", "gimbal rate against the drift of the trim angle",
            float(np.rad2deg(rate)), float(np.rad2deg(lander.engine.gimbal_rate)), "deg/s",
            "Otherwise the gimbal lags behind the moving centre of mass and the thrusters carry "
            "the rest: raise vehicle.engine.gimbal_rate_deg_s.", wanted_margin=_WANTED_MARGIN,
        )  # fmt: skip


def slosh_torque(
    lander: JetLander, fill: float, acceleration: float, angle: float, turn_time: float
) -> float:
    """Return the torque of sloshing propellant after a rotation of the lander, N m.

    A pendulum of mass m hangs under the thrust acceleration a at the height z of its hinge above
    the centre of mass. At the swing angle s it pulls with ``m a sin s`` across the body, and the
    torque is ``m a |z| sin s``. A rotation by an angle in the time t leaves at most the swing
    ``angle min(1, T / (pi t))``, with the pendulum's period ``T = 2 pi sqrt(L / a)`` (response of
    an undamped oscillator to a ramp).

    Parameters
    ----------
    lander
        Lander with tanks.
    fill
        Remaining fraction of the propellant.
    acceleration
        Thrust acceleration, m/s^2.
    angle, turn_time
        Angle, rad, and duration, s, of the rotation.
    """
    masses, lengths, bobs = lander.slosh.pendulums(fill, lander.propellant_mass)
    com = lander.com(lander.dry_mass + fill * lander.propellant_mass)
    period = 2.0 * np.pi * np.sqrt(lengths / acceleration)
    swing = angle * np.minimum(1.0, period / (np.pi * max(turn_time, 1e-6)))
    side = masses * acceleration * np.sin(np.minimum(swing, 0.5 * np.pi))
    return float((side * np.abs(bobs[:, 2] + lengths - com[2])).sum())


def _slosh_row(mission: Mission, lander: JetLander, torque: float) -> CheckRow:
    """Return the row of the maximum slosh torque after the largest rotation."""
    path, able = mission.approach.path, agility(mission)
    u = path.direction
    angle = max(
        [d.rotation for d in mission.diverts],
        default=float(np.arccos(np.clip(u @ u[0], -1.0, 1.0)).max()),
    )
    acceleration = float(np.linalg.norm(path.acceleration, axis=1).max())
    most = max(slosh_torque(lander, fill, acceleration, angle, able.time(angle)) for fill in _FILLS)
    return CheckRow(
        "slosh-torque", "disturbance", "control torque against the torque of sloshing propellant",
        most, torque, "N m",
        "Otherwise slosh rotates the lander after each divert: add tanks or baffles "
        "(vehicle.slosh.tanks_m, vehicle.slosh.damping), lower vehicle.slosh.radius_m, or raise "
        "vehicle.thrusters.force_n.", wanted_margin=_WANTED_MARGIN,
    )  # fmt: skip
