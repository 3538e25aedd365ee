"""The loop cut into links, each replayed alone on measured inputs, so that one link's error cannot leak into another's.

A link predicts what was measured at its output for any list of effects and gives the residual in units of the noise floor. Rows that
were not measured or that stand at a limit have weight zero.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from hiltestbed.diagnosis.chain import sense_record
from hiltestbed.diagnosis.compensated import compensated
from hiltestbed.effects.contact import DAMPING, FRAME, LEVER, REACTION, STIFFNESS, contact_parameters, replay_contact
from hiltestbed.effects.dynamics import dynamics_effects, replay_dynamics
from hiltestbed.effects.platform import DELAY, platform_parameters, replay_platform
from hiltestbed.effects.sensor import sensor_chain
from hiltestbed.frames import Array
from hiltestbed.scenario import Scenario

Effects = Sequence[tuple[str, dict[str, Any]]]
LATE = "late"  # a shift of the reading that is no effect of the vocabulary: to see what lateness does
WHOLE = 1e-6  # ticks that a delay may be off a whole number
NODES = np.linspace(-2.75, 2.75, 12)  # of a standard normal
WEIGHTS = np.exp(-0.5 * NODES**2) / np.sum(np.exp(-0.5 * NODES**2))
MOST_NOISE = 4.0  # standard deviations
FORM = "form"  # private parameter: one of several readings of an effect's equation
AHEAD = "ahead"  # private parameter [s]: a response that is integrated step by step answers to the command at the end of its step


@dataclass
class LinkRun:
    """One run as a link sees it.

    Attributes:
        scenario: as believed. measured: (N, C) at the output. sigma: (N, C) its noise, infinite where not measured.
        touching: (N,) bool, the nominal or the measured contact, with its tail through the sensor.
    """

    scenario: Scenario
    measured: Array
    sigma: Array
    touching: np.ndarray


class Link(Protocol):
    """What the fit needs of a link."""

    name: str
    channels: tuple[str, ...]
    runs: list[Any]

    def predict(self, i: int, effects: Effects) -> Array:
        """(N, C) what run i should have shown."""
        ...


def start_of(scenario: Scenario) -> tuple[Array, Array]:
    """Position [m] of A in P at t = 0 and its velocity [m/s]."""
    a = scenario.approach
    return np.array([*a.offset, -a.gap], dtype=float), np.asarray(a.velocity, dtype=float)


class PlatformLink:
    """pose_cmd to pose_act: the three translations."""

    name = "platform"
    channels: tuple[str, ...] = ("pose_act.px", "pose_act.py", "pose_act.pz")

    def __init__(self, runs: list[LinkRun], commands: list[Array], yielding: list[Array] | None = None) -> None:
        """commands: (N, 7) pose_cmd of each run. yielding: (N, 3) how the believed drives depart from it [m]; None: not at all."""
        self.runs, self.commands, self.yielding = runs, commands, yielding
        x, y, z = np.any([np.isfinite(r.sigma).any(axis=0) for r in runs], axis=0)
        self._measured = (bool(x), bool(y), bool(z))

    def predict(self, i: int, effects: Effects) -> Array:
        return self.path(i, effects, self._measured)

    def path(self, i: int, effects: Effects, wanted: tuple[bool, bool, bool] = (True, True, True)) -> Array:
        """(N, 3) positions that the platform reaches on the axes that are wanted."""
        s = self.runs[i].scenario
        position, velocity = start_of(s)
        out = np.empty((len(self.commands[i]), 3))
        divide = next((p[FORM] for kind, p in effects if kind == "platform.friction" and FORM in p), s.substeps)
        parameters = platform_parameters(effects)
        parameters[DELAY] -= min(sum(p.get(AHEAD, 0.0) for _, p in effects), s.tick)
        replay_platform(self.commands[i], position, velocity, s.tick, divide, parameters, out, wanted)
        return out if self.yielding is None else out + self.yielding[i]


class WrenchLink:
    """The pose through contact and sensor to wrench_meas.

    A reading that falls between ticks is that of the instant it left the contact; or, with ``grid`` instants a tick, it lies on a
    straight line between two of them, as a facility has it that computes its contact step by step. The rate of a contact jumps from
    one tick to the next, so that the two differ.
    """

    name = "wrench"
    channels = tuple(f"wrench_meas.{c}" for c in ("fx", "fy", "fz", "tx", "ty", "tz"))

    def __init__(self, runs: list[LinkRun], paths: list[Array], lever: float = 0.5, jumps: list[Array] | None = None) -> None:
        """paths: (N, 3) where the tip was at t_k. lever: where between tip (1) and undeformed surface (0) the force acts.
        jumps: (N,) how far the tip jumped [m] in the tick that ends at t_k, at an instant that is not known."""
        self.runs, self.paths, self.lever, self.jumps = runs, paths, lever, jumps
        self.grid: int | None = None
        self._before = []
        for run, path in zip(runs, paths, strict=True):
            _, velocity = start_of(run.scenario)
            self._before.append(path[0] - velocity * run.scenario.tick)

    def predict(self, i: int, effects: Effects) -> Array:
        s = self.runs[i].scenario
        effects = _read_late(effects)
        late = s.sensor.delay + _lateness(effects)
        sub, late = self.felt(i, effects, late)
        sensor = s.sensor
        chain = sensor_chain(
            effects, s.tick, sensor.delay, sensor.lowpass, sensor.time_constant, sensor.drift,
            (0.0, 0.0), (sensor.range, sensor.torque_range),
        )  # fmt: skip
        out = np.empty((len(sub), 6))
        sense_record(sub, late, s.tick, *chain.arrays(), out)
        skew = sum(p["delay"] for kind, p in effects if kind == "log.skew" and p.get(FORM) != "continuous")
        return advanced(out, -skew / s.tick) if skew else out

    def slope(self, i: int, effects: Effects) -> Array:
        """(N, 6) rate of the reading [N/s, N m/s]: what a late sample is worth."""
        step = self.runs[i].scenario.tick / 2.0
        if self.runs[i].scenario.sensor.delay < step:
            return np.gradient(self.predict(i, effects), 2.0 * step, axis=0)
        early, late = (self.predict(i, [*effects, (LATE, {"delay": d})]) for d in (-step, step))
        return (early - late) / (2.0 * step)

    def shaken(self, i: int, effects: Effects, sigma: float) -> tuple[Array, Array]:
        """(N, 6) mean of the reading and its spread [N, N m] where the delay varies by sigma [s] from sample to sample."""
        nominal = self.runs[i].scenario.sensor.delay + sum(p["delay"] for kind, p in effects if kind in ("sensor.delay", LATE))
        mean, square = 0.0, 0.0
        for node, weight in zip(NODES, WEIGHTS, strict=True):
            reading = self.predict(i, [*effects, (LATE, {"delay": max(sigma * node, -nominal)})])
            mean, square = mean + weight * reading, square + weight * reading**2
        return np.asarray(mean), np.sqrt(np.maximum(np.asarray(square) - np.asarray(mean) ** 2, 0.0))

    def doubt(self, i: int, effects: Effects) -> Array:
        """(N, 6) how far a reading hangs on what lies between two instants of the physics: large where a touch or a jump does."""
        s = self.runs[i].scenario
        step = s.tick / min(s.substeps, 4)
        late = s.sensor.delay + _lateness(effects)
        if late < step:
            return np.zeros((len(self.paths[i]), 6))
        early, after = (self.predict(i, [*effects, (LATE, {"delay": d})]) for d in (-step, step))
        out = np.abs(early + after - 2.0 * self.predict(i, effects))
        if self.jumps is not None and not _whole(late / s.tick):
            first = int(late / s.tick)
            jump = np.concatenate([np.zeros(first), self.jumps[i]])[: len(out)]
            touched = np.concatenate([np.zeros(first, dtype=bool), self.paths[i][:, 2] > -jump.max(initial=0.0)])[: len(out)]
            out[:, 2] += s.mechanism.contact.stiffness * np.where(touched, jump, 0.0)
        return out

    def felt(self, i: int, effects: Effects, late: float) -> tuple[Array, float]:
        """(N, m, 6) the wrench that arrives so late [s], and how much of that is still to come."""
        ticks = late / self.runs[i].scenario.tick
        if self.grid is not None and not _whole(ticks):
            return self.physical(i, effects, np.arange(1, self.grid + 1) / self.grid), late
        rows = round(ticks) if _whole(ticks) else math.floor(ticks)
        parts = np.array([1.0]) if _whole(ticks) else np.array([1.0 - (ticks - rows), 1.0])
        sub = self.physical(i, effects, parts)
        out = np.zeros((len(sub), 1, 6))
        out[rows:, 0] = sub[: max(len(sub) - rows, 0), 0]
        return out, 0.0

    def physical(self, i: int, effects: Effects, parts: Array) -> Array:
        """(N, m, 6) the wrench of the contact at the instants ``parts`` (m,) of each tick, up to t_k."""
        s = self.runs[i].scenario
        contact = s.mechanism.contact
        p = contact_parameters(contact.stiffness, contact.damping, contact.friction, s.mechanism.kind == "latched", effects)
        p[LEVER] = self.lever
        for kind, given in effects:
            _shape(p, kind, given)
        sub = np.empty((len(self.paths[i]), len(parts), 6))
        replay_contact(self.paths[i], self._before[i], s.tick, parts, p, sub)
        return sub


def _read_late(effects: Effects) -> list[tuple[str, dict[str, Any]]]:
    """The effects of a record that is read anew at the later time: a tone has come that much further in it."""
    late = sum(p["delay"] for kind, p in effects if kind == "log.skew" and p.get(FORM) == "continuous")
    return [
        (kind, p | {"phase": p["phase"] - 2.0 * math.pi * p["frequency"] * late} if late and kind == "sensor.hum" else p)
        for kind, p in effects
    ]


def _lateness(effects: Effects) -> float:
    """[s] by which the reading is later than believed."""
    return sum(p["delay"] for kind, p in effects if kind in ("sensor.delay", LATE) or p.get(FORM) == "continuous")


def _whole(ticks: float) -> bool:
    return abs(ticks - round(ticks)) < WHOLE


def _shape(p: Array, kind: str, given: dict[str, Any]) -> None:
    """Other readings of an effect's equation, where the words leave more than one."""
    form = given.get(FORM)
    if form is None:
        return
    if isinstance(form, float):  # where the force acts, between the undeformed surface (0) and the tip (1)
        p[LEVER] = form
    if kind == "contact.power_law" and form == "undamped":
        p[DAMPING] = 0.0
    if kind == "frame.mode" and form == "reaction":
        p[REACTION] = 1.0
    if kind == "frame.compliance" and form == "elastic":  # the spring alone gives, the damper feels the whole rate
        p[STIFFNESS] *= given["stiffness"] / (given["stiffness"] + p[STIFFNESS])
        p[FRAME] = 0.0
    if kind == "frame.compliance" and form == "series":
        share = given["stiffness"] / (given["stiffness"] + p[STIFFNESS])
        p[STIFFNESS] *= share
        p[DAMPING] *= share * share
        p[FRAME] = 0.0


class CompensationLink:
    """wrench_meas to wrench_comp."""

    name = "compensation"
    channels = tuple(f"wrench_comp.{c}" for c in ("fx", "fy", "fz", "tx", "ty", "tz"))

    def __init__(self, runs: list[LinkRun], wrenches: list[Array], used: list[Array] | None = None) -> None:
        """wrenches: (N, 6) wrench_meas of each run. used: the same as the loop had it, where the record is known to be stamped late."""
        self.runs, self.wrenches, self.used = runs, wrenches, used

    def predict(self, i: int, effects: Effects) -> Array:
        s, wrench = self.runs[i].scenario, self.wrenches[i]
        skew = sum(p["delay"] for kind, p in effects if kind == "log.skew")
        if skew:
            wrench = self.used[i] if self.used is not None else advanced(wrench, skew / s.tick)
        width = max((p["width"] for kind, p in effects if kind == "loop.deadzone"), default=0.0)
        form = next((p.get(FORM) for kind, p in effects if kind == "loop.deadzone"), None)
        if width and form is None:
            wrench = dead(wrench, width)
        elif width and form == "magnitude":
            wrench = np.where(np.linalg.norm(wrench[:, :3], axis=1, keepdims=True) < width, 0.0, wrench)
        wrench = compensated(s, wrench)
        return dead(wrench, width) if width and form == "after" else wrench


def dead(wrench: Array, width: float) -> Array:
    """Forces below `width` [N] read zero, axis by axis."""
    out = wrench.copy()
    out[:, :3][np.abs(out[:, :3]) < width] = 0.0
    return out


def advanced(values: Array, ticks: float) -> Array:
    """`values` (N, C) read `ticks` rows later (or earlier), linearly between rows; the first and the last row are held."""
    rows = np.clip(np.arange(len(values)) + ticks, 0.0, len(values) - 1.0)
    low = np.floor(rows).astype(int)
    part = (rows - low)[:, None]
    return values[low] + part * (values[np.minimum(low + 1, len(values) - 1)] - values[low])


def unstamped(run: LinkRun, modelled: Array, in_time: Array, ticks: int) -> Array:
    """(N, 6) what the loop read, of which the record, `run.measured`, was stamped so many ticks late.

    modelled: (N, 6) what the record should show. in_time: what the loop should have read. Only noise is shifted, the difference of record
    and model: across a touch no reading can be made up from the rows beside it, and a larger difference is the model's doubt there.
    """
    most = MOST_NOISE * np.where(np.isfinite(run.sigma), run.sigma, 0.0)
    return in_time + advanced(np.clip(np.nan_to_num(run.measured) - modelled, -most, most), float(ticks))


class DynamicsLink:
    """wrench_comp to pose_cmd: position, and attitude as a small rotation vector."""

    name = "dynamics"
    channels: tuple[str, ...] = ("pose_cmd.px", "pose_cmd.py", "pose_cmd.pz", "pose_cmd.rx", "pose_cmd.ry", "pose_cmd.rz")

    def __init__(self, runs: list[LinkRun], wrenches: list[Array]) -> None:
        """wrenches: (N, 6) wrench_comp of each run. The runs' `measured` is (N, 6), see `flat_pose`."""
        from hiltestbed.spacecraft import approach_state, inertia_matrix, port_pose

        self.runs, self.wrenches = runs, wrenches
        bodies = [(r.scenario.spacecraft.chaser, r.scenario.spacecraft.target) for r in runs]
        self._approach = [approach_state(r.scenario) for r in runs]
        self._mass = [np.array([b.mass for b in pair]) for pair in bodies]
        self._inertia = [np.array([inertia_matrix(b.inertia) for b in pair]) for pair in bodies]
        self._port = [np.array([port_pose(b) for b in pair]) for pair in bodies]

    def predict(self, i: int, effects: Effects) -> Array:
        e = dynamics_effects(effects)
        port = self._port[i].copy()
        port[:, :3] += e.port
        pose = np.empty((len(self.wrenches[i]), 7))
        replay_dynamics(
            self.wrenches[i], self._approach[i], self._mass[i] * e.mass, self._inertia[i] * e.inertia[:, None, None], port,
            self.runs[i].scenario.tick, e.appendage, e.explicit, pose,
        )  # fmt: skip
        if e.late:
            start = np.repeat(self._approach[i][None, :7], e.late, axis=0)
            velocity = self._approach[i][7:10]
            start[:, :3] += velocity * self.runs[i].scenario.tick * (np.arange(e.late)[:, None] + 1 - e.late)
            pose = np.concatenate([start, pose])[: len(pose)]
        return flat_pose(pose)


def flat_pose(pose: Array) -> Array:
    """(N, 6) position [m] and rotation vector [rad] (for small angles twice the vector part) of poses (N, 7)."""
    sign = np.where(pose[:, 6:] < 0, -1.0, 1.0)
    return np.concatenate([pose[:, :3], 2.0 * sign * pose[:, 3:6]], axis=1)
