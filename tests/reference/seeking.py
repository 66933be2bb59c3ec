"""What paths let a lander know of the ground, look by look and node by node."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from tests.reference import divert


def told_by(eye, place, node, site, pull, left):
    """Return the share of the uncertainty about a node that one look takes away."""
    away = place - node["at"]
    distance = np.linalg.norm(away)
    ahead = (site - place) / np.linalg.norm(site - place)
    if left < node["needs"] or away[2] <= 0.0 or distance > eye["longest"]:
        return 0.0
    if np.degrees(np.arccos(np.clip(ahead @ -away / distance, -1.0, 1.0))) > eye["half_field_deg"]:
        return 0.0
    down = -pull / np.linalg.norm(pull)
    if np.degrees(np.arccos(np.clip(ahead @ down, -1.0, 1.0))) > eye["gimbal_deg"]:
        return 0.0
    azimuth = np.arctan2(away[0], away[1]) - eye["sun_azimuth"]
    at = np.array([[np.cos(azimuth), away[2] / distance]])
    if "between" not in eye:
        tables = np.dstack([eye[name] for name in ("sharp", "open", "astray")])
        eye["between"] = RegularGridInterpolator(eye["axes"], tables)
    sharp, open_, astray = eye["between"](at)[0]
    sharpness = sharp / (distance * eye["pixel"])
    told = np.interp(sharpness, np.linspace(0.0, eye["sharpest"], len(eye["told"])), eye["told"])
    return told * open_ * np.exp(-astray * distance**2)


def known_after(path, eyes, nodes, site, standing, least, max_final_tilt):
    """Return what is known of each node after a path, or None where it leans too much.

    `path`: places, thrust accelerations (n, 3) and time left (n,) at its samples.
    """
    known = [node["known"] for node in nodes]
    altitude = path["place"][:, 2] - site[2] - standing
    low = altitude < least
    lean = np.hypot(path["pull"][:, 0], path["pull"][:, 1])
    if (lean[low] > np.tan(max_final_tilt) * path["pull"][low, 2]).any():
        return None
    for eye in eyes:
        looks = []
        if eye["stations"]:
            for h in eye["stations"]:
                under = np.flatnonzero(altitude <= h)
                if h < least or len(under) == 0 or under[0] == 0:
                    continue
                s = under[0]
                part = (altitude[s - 1] - h) / (altitude[s - 1] - altitude[s])
                place = (1.0 - part) * path["place"][s - 1] + part * path["place"][s]
                looks.append((place, path["pull"][s], path["left"][s]))
        else:
            good = (altitude >= max(eye["lowest"], least)) & (altitude <= eye["highest"])
            looks = [(path["place"][s], path["pull"][s], path["left"][s])
                     for s in np.flatnonzero(good)]  # fmt: skip
        for place, pull, left in looks:
            for g, node in enumerate(nodes):
                if node["weight"] > 0.0:
                    known[g] = max(known[g], told_by(eye, place, node, site, pull, left))
    return np.array(known)


def score(r, v, target, v_f, plans, samples, vehicle, max_final_tilt, ground, nodes, eyes):
    """Return share known and increment of each plan (n, 2): time and acceleration at the end.

    `samples`: of limits and of looks. `vehicle`: gravity, mass, exhaust velocity, least and
    greatest thrust, tangents of tilt and glideslope. `ground`: site, standing height, altitude.
    """
    out = []
    gravity = vehicle[0]
    weight = np.array([node["weight"] for node in nodes])
    for total, *asked in plans:
        a_f = np.array(asked)
        taken = [np.inf]
        if np.hypot(a_f[0], a_f[1]) <= np.tan(max_final_tilt) * (a_f[2] + gravity) and total > 0.0:
            taken = divert.best(r, v, target, v_f, a_f, [total], samples[0], *vehicle)
        if not np.isfinite(taken[0]):
            out.append((0.0, np.inf))
            continue
        t = np.linspace(0.0, total, samples[1] + 1)
        place, move = divert.path(r, v, target, v_f, a_f, total, t)
        path = {"place": place, "pull": move + [0.0, 0.0, gravity], "left": total - t}
        known = known_after(path, eyes, nodes, *ground, max_final_tilt)
        if known is None:
            out.append((0.0, np.inf))
        else:
            out.append((float(known @ weight / weight.sum()), taken[0]))
    return np.array(out)
