"""The first contact of a scenario, played before the run on its own rig: how it ends, and how much energy the rig makes of it.

A response measured with sines holds at their amplitude and along one direction. Dry friction of seals and gears is no part of it: of drives
with feed-forward it takes f_c/k_p off the way at each reversal, as much of a slow contact as of a fast one, and holds a leg that has
stopped. And the normal of a socket turns while a tip slides in it, which changes the mass along it, and rubs. Both are in the blocks of
the loop, so that the first contact is stepped with them: the scenario's platform, surfaces and vehicles, and a sensor whose one fault is
to be as late as the force that is used; nothing else compensates. Vehicles that an FMU holds, which begins where it will, are those of
`spacecraft`. The approach begins :data:`APPROACH` before the touch, or :data:`LEAD` of time: drives that rub yield at the start, and have
forgotten it after some way (hydraulic legs at 5 mm/s: 0.5 mm before, the rebound is 1.5 % above that of the run, 5 mm before 0.4 %).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from hiltestbed.bounce import LAGS, SWINGS, Bounce
from hiltestbed.contact.directions import time_of_touch
from hiltestbed.contact.sides import sides_of
from hiltestbed.errors import InputError
from hiltestbed.frames import attitude_deg_from_quat, pose_step
from hiltestbed.loop import Loop
from hiltestbed.metrics import along_impulse
from hiltestbed.numerical_model.bodies import approach_state, effective_mass, mobility
from hiltestbed.scenario import Scenario, resolved, scenario_from

LEAD = (0.1, 1.0)  # [s] of uniform motion before the touch, at least and at most
APPROACH = 5e-3  # [m] of it
LONGEST = 20.0  # [s] of a head-on bounce that is played: of one that takes minutes the run will not see the end either
SLOWER = 2.0  # times as long as a head-on swing lasts, within which a tip that slides has parted
NEVER = 1e-12  # [m/s] at which a latch closes: no bounce is that slow
LOOKS = 10  # ticks between two looks at whether they have parted


@dataclass(frozen=True)
class Case:
    """A force that is ``delay`` [s] late, in a contact of ``stiffness`` [N/m]."""

    delay: float
    stiffness: float


class FirstContact:
    """The first contact of a scenario.

    Attributes:
        playable: it does not last so long that playing it would take longer than the run.
    """

    def __init__(self, scenario: Scenario, touch: float, ideal: bool = False) -> None:
        """``touch``: when it comes at the earliest [s]; ``ideal``: on a rig that follows exactly."""
        self._data, self._ideal = resolved(scenario), scenario.rig.platform.reference() if ideal else None
        links = ("contact",) if ideal else ("contact", "platform")
        pairs = zip(scenario.effects, self._data["effects"], strict=True)
        self._effects = [keys for effect, keys in pairs if effect.link in links]
        self._feeds, self._inverse = scenario.compensation.motion.feeds, mobility(scenario)
        speed = max(float(np.linalg.norm(scenario.approach.velocity)), APPROACH / LEAD[1])
        self._mass, self._lead = effective_mass(scenario), min(touch, max(APPROACH / speed, LEAD[0]))
        self._own = self._lasts(scenario.mechanism.contact.stiffness, scenario.sensor.delay)
        self.playable = self._own <= LONGEST
        if touch > self._lead:
            start, pose = approach_state(scenario), np.empty(7)
            pose_step(start[:7], start[7:], touch - self._lead, pose)
            x, y, z = (float(v) for v in pose[:3])
            attitude = attitude_deg_from_quat(pose[3:]).tolist()
            self._data["approach"] |= {"gap": -z, "offset": [x, y], "attitude_deg": attitude}

    def _lasts(self, stiffness: float, late: float) -> float:
        """[s] within which a head-on bounce has parted."""
        return SWINGS * math.pi * math.sqrt(self._mass / stiffness) + LAGS * late

    def played(self, case: Case, lag: float) -> Bounce | None:
        """How a case ends, on a rig with that lag [s]; None where it has not parted in time, is lost, or no scenario may be so."""
        try:
            loop = Loop([self._scenario(case, lag)])
        except InputError:  # a limit is sought among stiffnesses that the effects of the contact may not bear
            return None
        while loop.k < loop.scenarios[0].ticks and loop.alive[0]:
            try:
                loop.step()
            except ZeroDivisionError:  # numbers so far from any rig that they have no ratio
                return None
            if loop.k % LOOKS == 0 and loop.tally.rebounded[0] and loop.alive[0]:
                return self._ended(loop)
        return None

    def _ended(self, loop: Loop) -> Bounce | None:
        impulse, before, after = loop.tally.first_contact(0)
        rebound = along_impulse(impulse, before, after)
        if rebound is None:
            return None
        energy = 0.5 * float(impulse @ before) ** 2 / float(impulse @ self._inverse @ impulse)
        return Bounce(rebound, float(loop.tally.energy[0]) / energy)

    def _scenario(self, case: Case, lag: float) -> Scenario:
        data = self._data
        lasts = self._lasts(case.stiffness, max(case.delay + lag, 0.0))
        mechanism: dict[str, Any] = data["mechanism"] | {"contact": data["mechanism"]["contact"] | {"stiffness": case.stiffness}}
        if mechanism.get("latch"):
            mechanism["latch"] = mechanism["latch"] | {"speed": NEVER}
        changed = {
            "name": "first contact", "description": "", "seed": 0, "mechanism": mechanism, "sensor": {"delay": case.delay},
            "numerical_model": {"kind": "free_flyers"},
            "duration": self._lead + SLOWER * min(lasts, max(self._own, data["duration"])),
            "identification": {"kind": "none"}, "monitoring": None,
            "compensation": {"force": {"kind": "none"}, "motion": {"kind": "feedforward" if self._feeds else "none"}},
            "safety": dict.fromkeys(data["safety"]), "effects": self._effects,
        }  # fmt: skip
        if self._ideal:
            changed["rig"] = data["rig"] | {"platform": self._ideal, "upper": data["rig"]["upper"] | {"tracking": "ideal"}}
            changed["compensation"]["motion"] = {"kind": "none"}
        return scenario_from(data | changed)


def first_contact(scenario: Scenario, ideal: bool = False) -> FirstContact | None:
    """What can be played of a scenario; None where it is held from the start, nothing is met or the contact lasts for minutes, and where
    parts move or MuJoCo finds the contacts: there the first contact is part of the capture."""
    if scenario.mechanism.captured or not sides_of(scenario.mechanism).rigid:
        return None
    touch = time_of_touch(scenario)
    if touch is None:
        return None
    contact = FirstContact(scenario, touch, ideal)
    return contact if contact.playable else None
