"""The force of one axis along its motion, and the motion of one axis under a force.

The law, for position x, speed v, acceleration a and time t, with s the sign of v::

    F = mass a + spring (x - rest) + viscous(v) + friction(x, v) s + offset + ramp t
        + gravity_sin sin x + gravity_cos cos x + cog sin(2 pi x/pitch + phase)
        + sum of sliders + sum of Maxwell branches

One law serves both ways: a damper or the inverse model of a drive *reads* F along a recorded motion
(:func:`force_along`), a drive *moves* under a recorded force until F balances it
(:func:`motion_under`). A slider is elastic until its force reaches a level (G. M. Jenkins, J. Br.
Nucl. Energy Soc. 1, 1962), with play in series if ``PLAY`` is given, or rounds its corner (R. Bouc,
1967; Y.-K. Wen, J. Eng. Mech. 102, 1976).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hiltestbed.compiled.jit import njit
from hiltestbed.frames import Array

# numbers of the law, by their place in its array
(
    MASS,
    GAIN,
    SPRING,
    REST,
    VISCOUS,  # [N s/m] for v > 0, up to KNEE [m/s], beyond it BEYOND [N s/m]
    KNEE,
    BEYOND,
    VISCOUS_BACK,  # the same for v < 0
    KNEE_BACK,
    BEYOND_BACK,
    POWER,  # exponent of the speed in viscous friction, 1 for a linear one
    COULOMB,
    COULOMB_BACK,
    RISE,  # [N] static friction above COULOMB
    STRIBECK,  # [m/s]
    LOAD,  # friction per newton of the force that the axis transmits
    WAVE,  # share of COULOMB that varies with the position
    WAVE_PITCH,
    WAVE_PHASE,
    OFFSET,
    RAMP,  # [N/s]
    FADE,  # [1/s] relative change of all dissipative forces
    GRAVITY_SIN,
    GRAVITY_COS,
    COG,
    COG_PITCH,
    COG_PHASE,
    LAG,  # [s] time constant of the dissipative force: of an oil column
    PLAY,  # [m] in series with the sliders
    NUMBERS,
) = range(30)
STILL = 1e-30  # [m/s] stands for no speed, with a direction
MOST = 4  # sliders, and branches
# strokes to either side that are tried at once for the start of the sliders, and the share of the
# longest at which the search ends: it then costs as much as some hundred rows
STROKES, STROKE_END = 4, 1e-2
FORCE, STIFFNESS, SHAPE = range(3)  # of a slider; SHAPE 0: elastic until it slips
BRANCH, TIME = range(2)  # of a Maxwell branch: [N/m], [s]


class AxisLaw:
    """The numbers of a law; effects change them in place.

    Attributes:
        numbers: (NUMBERS,) as listed above. sliders: (MOST, 3) force [N], stiffness [N/m], shape.
            branches: (MOST, 2) stiffness [N/m], time constant [s].
    """

    def __init__(self, mass: float = 0.0, gain: float = 1.0, spring: float = 0.0) -> None:
        self.numbers = np.zeros(NUMBERS)
        self.numbers[[MASS, GAIN, SPRING, POWER, COG_PITCH, WAVE_PITCH]] = (
            mass, gain, spring, 1.0, 1.0, 1.0,
        )  # fmt: skip
        self.numbers[[KNEE, KNEE_BACK]] = np.inf
        self.numbers[STRIBECK] = 1.0
        self.sliders, self.branches = np.zeros((MOST, 3)), np.zeros((MOST, 2))

    def add(self, rows: Array, values: tuple[float, ...]) -> None:
        """Put ``values`` into the first free row of the sliders or branches ``rows``."""
        free = np.flatnonzero(rows[:, 0] == 0.0)
        if len(free):
            rows[free[0]] = values


@dataclass
class ArmNumbers:
    """The numbers of an arm; effects change them in place.

    Attributes:
        laws: of each joint, by name: what acts along it beside the rigid bodies. armature: [kg m^2]
            or [kg] of each joint's rotor, reflected by its gear, by name. bodies: (10,) inertial
            parameters of each body by name, in the frame of its joint: mass [kg], first moments
            [kg m], second moments xx, xy, yy, xz, yz, zz about its origin [kg m^2].
    """

    laws: dict[str, AxisLaw]
    armature: dict[str, float]
    bodies: dict[str, Array]


@njit(cache=True)
def viscous(p, v):
    """Viscous force [N] at the speed ``v``."""
    forward = v > 0.0
    c, knee, beyond = (
        (p[VISCOUS], p[KNEE], p[BEYOND])
        if forward
        else (p[VISCOUS_BACK], p[KNEE_BACK], p[BEYOND_BACK])
    )
    speed = abs(v)
    if p[POWER] != 1.0:
        out = c * speed ** p[POWER]
    elif speed <= knee:
        out = c * speed
    else:
        out = c * knee + beyond * (speed - knee)
    return out if forward else -out


@njit(cache=True)
def friction(p, x, v, load):
    """Level of the dry friction [N] at the position ``x`` in the direction of ``v`` while the axis
    transmits ``load`` [N]."""
    level = p[COULOMB] if v >= 0.0 else p[COULOMB_BACK]
    if p[WAVE] != 0.0:
        level *= 1.0 + p[WAVE] * math.sin(2.0 * math.pi * x / p[WAVE_PITCH] + p[WAVE_PHASE])
    if p[RISE] != 0.0:
        level += p[RISE] * math.exp(-((v / p[STRIBECK]) ** 2))
    return max(level + p[LOAD] * abs(load), 0.0)


@njit(cache=True)
def held(p, x, t):
    """Force [N] that depends on neither speed nor history."""
    out = p[SPRING] * (x - p[REST]) + p[OFFSET] + p[RAMP] * t
    if p[GRAVITY_SIN] != 0.0 or p[GRAVITY_COS] != 0.0:
        out += p[GRAVITY_SIN] * math.sin(x) + p[GRAVITY_COS] * math.cos(x)
    if p[COG] != 0.0:
        out += p[COG] * math.sin(2.0 * math.pi * x / p[COG_PITCH] + p[COG_PHASE])
    return out


@njit(cache=True)
def force_along(t, x, v, a, way, p, sliders, branches, stroke):
    """``(N,)`` force [N] along a motion: time [s], position, speed, acceleration (N,), and the mean
    sign of the speed (N,) over what each row stands for, -1 to 1. A ``stroke`` [m] has bent the
    sliders before.
    """
    out = np.empty(len(t))
    at = np.empty(sliders.shape[0])  # where each slider stands
    bent = np.zeros(sliders.shape[0])
    for i in range(sliders.shape[0]):
        most, stiff = sliders[i, FORCE], sliders[i, STIFFNESS]
        reach = most / stiff + 0.5 * p[PLAY] if most > 0.0 else 0.0
        at[i] = x[0] - min(max(stroke, -reach), reach)
        bent[i] = min(max(stiff * stroke, -most), most)
    stress = np.zeros(branches.shape[0])
    lagged = 0.0
    for k in range(len(t)):
        dt = t[k] - t[k - 1] if k > 0 else 0.0
        step = x[k] - x[k - 1] if k > 0 else 0.0
        loss = viscous(p, v[k])
        rest = p[MASS] * a[k] + held(p, x[k], t[k])
        speed = abs(v[k])
        loss += 0.5 * (1.0 + way[k]) * friction(p, x[k], speed, rest)
        loss -= 0.5 * (1.0 - way[k]) * friction(p, x[k], -speed, rest)
        for i in range(sliders.shape[0]):
            most, stiff, shape = sliders[i, FORCE], sliders[i, STIFFNESS], sliders[i, SHAPE]
            if most == 0.0:
                continue
            if shape > 0.0:
                z = bent[i]
                ahead = 1.0 if z * step > 0.0 else 0.0
                bent[i] = min(
                    max(z + stiff * step * (1.0 - ahead * abs(z / most) ** shape), -most), most
                )
                loss += bent[i]
                continue
            away, half = x[k] - at[i], 0.5 * p[PLAY]
            pull = stiff * (max(away - half, 0.0) + min(away + half, 0.0))
            if pull > most:
                at[i], pull = x[k] - half - most / stiff, most
            elif pull < -most:
                at[i], pull = x[k] + half + most / stiff, -most
            loss += pull
        for i in range(branches.shape[0]):
            if branches[i, BRANCH] > 0.0:
                decay = math.exp(-dt / branches[i, TIME])
                # exact for a constant speed over the step
                fed = branches[i, TIME] * (1.0 - decay) / dt if dt > 0.0 else 1.0
                stress[i] = stress[i] * decay + branches[i, BRANCH] * step * fed
                loss += stress[i]
        loss *= 1.0 + p[FADE] * t[k]
        if p[LAG] > 0.0 and k > 0:
            lagged += (loss - lagged) * (1.0 - math.exp(-dt / p[LAG]))
            loss = lagged
        else:
            lagged = loss
        out[k] = rest + loss
    return out


@njit(cache=True)
def stroke_before(t, x, v, a, way, p, sliders, branches, first):
    """Stroke [m] before a motion, after which its first rows are closest to the ``first`` (M,)
    forces measured [N]; 0 without rows. The motion is that of :func:`force_along`.

    What bent the sliders before a record is not on it; it is taken for one stroke.
    """
    most = 0.0  # after which all sliders slip
    for i in range(sliders.shape[0]):
        if sliders[i, FORCE] > 0.0:
            most = max(most, sliders[i, FORCE] / sliders[i, STIFFNESS] + 0.5 * p[PLAY])
    stroke, m = 0.0, len(first)
    if m == 0 or most == 0.0:
        return stroke
    reach, best = most, np.inf
    while reach > STROKE_END * most:
        centre = stroke
        for j in range(-STROKES, STROKES + 1):
            tried = min(max(centre + reach * j / STROKES, -most), most)
            force = force_along(t[:m], x[:m], v[:m], a[:m], way[:m], p, sliders, branches, tried)
            missed = np.sum((force - first) ** 2)
            if missed < best:
                stroke, best = tried, missed
        reach /= STROKES
    return stroke


@njit(cache=True)
def _pushed(v, force, drag, mass, step):
    """Speed after a ``step`` [s] under a constant ``force`` and a linear ``drag``: exact."""
    lost = step * drag / mass
    fed = (1.0 - math.exp(-lost)) / lost if lost > 1e-9 else 1.0
    return v * math.exp(-lost) + step / mass * force * fed


@njit(cache=True)
def motion_under(t, u, late, x0, v0, p, h):
    """``(N,)`` positions of an axis that a recorded force ``u`` (N,) drives from ``x0`` at ``v0``;
    each value is held from ``late`` [s] after its row until the next, as a controller holds it.

    In steps of at most ``h`` [s] of second order: the forces are those of the middle of a step (L.
    Verlet, Phys. Rev. 159, 1967), the drag is exact, and dry friction stops and holds the axis
    exactly. Sliders and branches are not part of it.
    """
    n = len(t)
    out = np.empty(n)
    out[0] = x0
    x, v, mass = x0, v0, p[MASS]
    row = 0  # whose input acts
    for k in range(1, n):
        at = t[k - 1]
        while at < t[k]:
            while row + 1 < n and t[row + 1] + late <= at:
                row += 1
            until = min(t[k], t[row + 1] + late) if row + 1 < n else t[k]
            pieces = max(1, int(math.ceil((until - at) / h - 1e-9)))
            step = (until - at) / pieces
            for i in range(pieces):
                middle = at + (i + 0.5) * step
                net = p[GAIN] * u[row] - held(p, x + 0.5 * step * v, middle)
                fade = 1.0 + p[FADE] * middle
                left = step
                if v != 0.0:
                    drag, level = viscous(p, v) / v * fade, friction(p, x, v, net) * fade
                    way = math.copysign(level, v)
                    new = _pushed(v, net - way, drag, mass, left)
                    if new * v > 0.0:
                        x += 0.5 * left * (v + new)
                        v = new
                        continue
                    part = v / (v - new)  # of the step, after which it stops
                    x += 0.5 * part * left * v
                    v, left = 0.0, (1.0 - part) * left
                level = friction(p, x, math.copysign(STILL, net), net) * fade
                if abs(net) > level:
                    trial = left / mass * (net - math.copysign(level, net))
                    drag = viscous(p, trial) / trial * fade if trial != 0.0 else 0.0
                    v = _pushed(0.0, net - math.copysign(level, net), drag, mass, left)
                    x += 0.5 * left * v
            at = until
        out[k] = x
    return out
