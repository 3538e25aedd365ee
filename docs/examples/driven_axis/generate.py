"""Two simulated records of one motor-driven axis, made by code that is independent of hiltestbed.

A mass on a ball screw under a proportional position controller around a velocity loop; the voltage
is held over each millisecond::

    M x'' = gtau u - viscous x' - coulomb sgn(x') - offset,
    u = kv (kp (x_ref - x) - x'), |u| <= 10 V

Between two samples the force is constant. The velocity is therefore an exponential between its sign
changes, and the position follows in closed form; at rest the mass holds until the force exceeds the
dry friction. There is no step size and no smoothed sign function.

    python generate.py FOLDER [--ripple N] [--seed N]

The parameters are those that A. Janot, M. Gautier and M. Brunot publish for the electro-mechanical
positioning system (EMPS, Workshop on Nonlinear System Identification Benchmarks, 2019). The records
are not theirs: course and noise are defined here.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

RATE, SECONDS = 1000, 24.8  # [Hz], [s]
KP, KV, GTAU, VOLTS = 160.0, 243.0, 35.15, 10.0  # [1/s], [V s/m], [N/V], [V]
STEP = 5e-8  # [m] resolution of the encoder


@dataclass(frozen=True)
class Axis:
    """Mass [kg], viscous [N s/m] and dry friction [N], offset [N], and a force ripple over position
    [N] that no fitted model contains.

    asymmetry: fraction by which viscous friction is lower forward and higher backward. pitch:
        wavelength of the ripple [m].
    """

    mass: float = 95.109
    viscous: float = 203.50
    coulomb: float = 20.394
    coulomb_back: float = 20.394
    offset: float = -3.165
    asymmetry: float = 0.0
    ripple: float = 0.0
    pitch: float = 0.01

    def advance(self, x: float, v: float, force: float, seconds: float) -> tuple[float, float]:
        """Position [m] and velocity [m/s] after ``seconds`` under a constant force."""
        drive = force - self.offset - self.ripple * math.sin(2.0 * math.pi * x / self.pitch)
        while seconds > 0.0:
            if v == 0.0:
                if -self.coulomb_back <= drive <= self.coulomb:
                    return x, 0.0
                direction = math.copysign(1.0, drive)
            else:
                direction = math.copysign(1.0, v)
            net = drive - (self.coulomb if direction > 0.0 else -self.coulomb_back)
            viscous = self.viscous * (1.0 - self.asymmetry * direction)
            span, stops = seconds, False
            if net * direction < 0.0:  # the mass decelerates
                end = self._stop(v, net, viscous)
                span, stops = (end, True) if end <= seconds else (seconds, False)
            x, v = self._glide(x, v, net, span, viscous)
            v = 0.0 if stops else v
            seconds -= span
        return x, v

    def _stop(self, v: float, net: float, viscous: float) -> float:
        if viscous == 0.0:
            return -self.mass * v / net
        final = net / viscous
        return self.mass / viscous * math.log((v - final) / -final)

    def _glide(
        self, x: float, v: float, net: float, t: float, viscous: float
    ) -> tuple[float, float]:
        if viscous == 0.0:
            a = net / self.mass
            return x + v * t + 0.5 * a * t * t, v + a * t
        tau, final = self.mass / viscous, net / viscous
        gone = -math.expm1(-t / tau)
        return x + final * t + (v - final) * tau * gone, v + (final - v) * gone


def trapezoids(t: np.ndarray) -> np.ndarray:
    """Position [m]: strokes of 30, 90 and 190 mm forth and back at up to 0.124 m/s, repeated."""
    place, start, out = 0.0, 0.0, np.zeros_like(t)
    moves = [
        (0.03, 0.04),
        (-0.03, 0.04),
        (0.09, 0.08),
        (-0.09, 0.08),
        (0.19, 0.124),
        (-0.19, 0.124),
    ] * 4
    for way, speed in moves:
        ramp = speed / 0.83
        rest = max(abs(way) / speed - ramp, 0.0)
        since = np.clip(t - start, 0.0, 2 * ramp + rest)
        up = np.minimum(since, ramp)
        down = np.clip(since - ramp - rest, 0.0, ramp)
        gone = (
            0.415 * up**2
            + speed * np.clip(since - ramp, 0.0, rest)
            + speed * down
            - 0.415 * down**2
        )
        out = np.where(t >= start, place + np.sign(way) * gone, out)
        place += math.copysign(speed * (ramp + rest), way)
        start += 2 * ramp + rest + 0.05
    return out


def pulses(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Another course of slow swings [m], and force pulses added to the motor force [N]."""
    place = 0.1 * (1.0 - np.cos(2 * np.pi * 0.16 * t)) + 0.02 * np.sin(2 * np.pi * 0.41 * t) ** 2
    return place, 60.0 * ((t % 2.3 > 1.0) & (t % 2.3 < 1.02)) - 60.0 * (
        (t % 2.3 > 1.7) & (t % 2.3 < 1.72)
    )


def record(
    axis: Axis, course: np.ndarray, pushes: np.ndarray, noise: float = 0.0, seed: int = 0
) -> dict[str, np.ndarray]:
    """Time, motor force and position, one row per sample: the position read at t_k and the force
    from t_k on.
    """
    rng = np.random.default_rng(seed)
    x, v, before = course[0], 0.0, course[0]
    read, force = np.zeros(len(course)), np.zeros(len(course))
    for k, wanted in enumerate(course):
        seen = round((x + noise * rng.standard_normal()) / STEP) * STEP
        volts = KV * (KP * (wanted - seen) - (seen - before) * RATE) if k else 0.0
        force[k] = GTAU * min(max(volts, -VOLTS), VOLTS) + pushes[k]
        read[k], before = seen, seen
        x, v = axis.advance(x, v, force[k], 1.0 / RATE)
    return {"t": np.arange(len(course)) / RATE, "position": read, "force": force}


def records(axis: Axis, noise: float = 0.0, seed: int = 0) -> dict[str, dict[str, np.ndarray]]:
    """Both records of an axis, by name."""
    t = np.arange(round(SECONDS * RATE)) / RATE
    swings, pushes = pulses(t)
    return {
        "trapezoids": record(axis, trapezoids(t), 0.0 * t, noise, seed),
        "pulses": record(axis, swings, pushes, noise, seed + 1),
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument(
        "--ripple",
        type=float,
        default=0.0,
        help="force ripple over position [N], which no friction law describes",
    )
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    for name, columns in records(Axis(ripple=given.ripple), seed=given.seed).items():
        pq.write_table(pa.table(columns), given.folder / f"{name}.parquet")


if __name__ == "__main__":
    main()
