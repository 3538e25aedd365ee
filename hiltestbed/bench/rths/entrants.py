"""Methods that enter: none, the authors' adaptive compensator, and those of this package."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from scipy.signal import butter

from hiltestbed import build
from hiltestbed.bench.contacts import AXIAL, BenchContact
from hiltestbed.bench.contenders import contenders
from hiltestbed.bench.hildock.methods import UNREAD
from hiltestbed.bench.rths.problem import TICK, Material, Method, RthsRecord, late
from hiltestbed.compensation.measurement import Measurement
from hiltestbed.compensation.settings import FORCE_METHODS
from hiltestbed.frames import Array
from hiltestbed.numerical_model.model import NumericalModel
from hiltestbed.scenario import Scenario

NONE = {"kind": "none"}


def uncompensated(n: int) -> Method:
    """The command is the target."""
    return lambda target, measured: target


class Rodeac:
    """Robust decentralised adaptive compensation (Quiroz and others 2024), of ``n`` runs: the
    command is a filter of the last four targets; recursive least squares fit it as the inverse of
    the actuator, from the last four readings to the command, both low-passed.

    As in the block diagram, the readings are in mm, the initial correlation in m, and the fit reads
    the very command that it makes: an algebraic loop, linear in it and solved here.
    """

    def __init__(self, material: Material, n: int) -> None:
        filters = np.array(butter(4, 20.0, fs=1.0 / TICK))  # 20 Hz [S3_Controller.m]
        self._b0, self._b, self._a = filters[0, 0], filters[0, 1:], filters[1, 1:]
        self._theta = np.tile(material.coefficients, (n, 1, 1))
        self._p = np.tile(material.correlation, (n, 1, 1, 1))
        # newest first: targets; inputs and outputs of the filters of readings and of commands
        self._past = np.zeros((5, n, 2, 4))

    def __call__(self, target: Array, measured: Array) -> Array:
        targets, readings, smooth, commands, smooth_commands = self._past
        t = _shift(targets, target)
        x = _shift(smooth, self._b0 * measured + readings @ self._b - smooth @ self._a)
        rest = commands @ self._b - smooth_commands @ self._a
        px = (self._p @ x[..., None])[..., 0]
        gain = px / (1.0 + (x * px).sum(axis=-1, keepdims=True))
        self._p = self._p - gain[..., None] * (x[..., None, :] @ self._p)
        step, off = (gain * t).sum(axis=-1), rest - (self._theta * x).sum(axis=-1)
        command = ((self._theta * t).sum(axis=-1) + step * off) / (1.0 - self._b0 * step)
        self._theta = self._theta + gain * (self._b0 * command + off)[..., None]
        new = _shift(smooth_commands, self._b0 * command + rest)
        self._past = t, _shift(readings, measured), x, _shift(commands, command), new
        return command


def _shift(past: Array, new: Array) -> Array:
    return np.concatenate([new[..., None], past[..., :-1]], axis=-1)


class Known(NamedTuple):
    """What a test without compensation tells of the actuators: the factors (2,) that their
    displacements lack, and their delays (2,) [s].
    """

    factor: Array
    delay: Array


def known(record: RthsRecord) -> Known:
    """From the first of uncompensated runs: delays as in J1, factors by least squares at these."""
    delay, factor = np.empty(2), np.empty(2)
    for i in range(2):
        target, measured = record.target[:, 0, i], record.measured[:, 0, i]
        ticks = late(measured, target)
        delay[i], measured = ticks * TICK, measured[ticks:]
        factor[i] = target[: len(measured)] @ measured / (measured @ measured)
    return Known(factor, delay)


class ShippedMethod:
    """A method of this package on ``n`` runs, by the blocks that a scenario runs: each actuator is
    the axis of insertion of a run of its own. The force method receives the target [m] for the
    measured force; what it gives is the pose that the motion method commands.
    """

    def __init__(
        self, told: Known, force: Mapping[str, Any], motion: Callable[[float], Any], n: int
    ) -> None:
        """``motion``: its section for a delay [s]."""
        self._factor = told.factor
        rate = round(1.0 / TICK)
        settings = [
            {"rate": rate, "physics_rate": rate, "compensation.motion": motion(d)}
            for d in told.delay
        ]
        of_actuators: list[Scenario] = [
            BenchContact(1.0, d, 0.05, changes=s).scenario(dict(force))
            for d, s in zip(told.delay, settings, strict=True)
        ]
        runs = of_actuators * n
        self._drive = build.drive(runs, NumericalModel(runs))
        self._motion = build.motion_command(runs)
        self._pose, self._twist = np.tile(np.eye(7)[6], (2 * n, 1)), np.zeros((2 * n, 6))
        nothing, free = np.full((2 * n, 6), np.nan), np.zeros(2 * n, dtype=bool)
        self._read = Measurement(
            self._twist.copy(), self._pose.copy(), self._twist.copy(), nothing, nothing, free
        )

    def __call__(self, target: Array, measured: Array) -> Array:
        read = self._read
        read.wrench[:, AXIAL] = 1e-3 * target.ravel()
        _move(read.pose, read.twist, 1e-3 * measured.ravel())
        self._drive.advance(read)
        _move(self._pose, self._twist, self._drive.wrench[:, AXIAL])
        self._motion.update(self._pose, self._twist, read)
        return 1e3 * self._factor * self._motion.pose[:, AXIAL].reshape(-1, 2)


def _move(pose: Array, twist: Array, to: Array) -> None:
    twist[:, AXIAL], pose[:, AXIAL] = (to - pose[:, AXIAL]) / TICK, to


def _inverse_of_a_delay(delay: float) -> dict[str, Any]:
    """The response 1/(1 + d s + d^2 s^2/2), that of a delay d to second order."""
    bandwidth = math.sqrt(2.0) / delay / (2.0 * math.pi)
    return {"kind": "inverse_model", "bandwidth": bandwidth, "damping_ratio": math.sqrt(0.5)}


def shipped(told: Known) -> dict[str, Callable[[int], Method]]:
    """The force methods that read the wrench alone, those of plugins included, and the motion
    methods that change the command.
    """
    forces = {
        c.name: c.force(UNREAD)
        for c in contenders()
        if c.contact == "first" and c.name not in ("none", "dead_zone")
    }
    alone = {n: f for n, f in forces.items() if FORCE_METHODS[f["kind"]].reads == {"wrench"}}
    motions = {
        "inverse_model": _inverse_of_a_delay,
        "adaptive_time_series": lambda delay: {"kind": "adaptive_time_series", "delay": delay},
    }
    return {
        **{n: partial(ShippedMethod, told, force, lambda _: NONE) for n, force in alone.items()},
        **{n: partial(ShippedMethod, told, NONE, motion) for n, motion in motions.items()},
    }
