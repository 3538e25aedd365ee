"""The motion platforms that a scenario may name: each is defined by its settings class, and no
other code refers to it by name.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, ClassVar

from hiltestbed.config.validation import Problem, Strictly
from hiltestbed.plugins import Registry, kind_of

if TYPE_CHECKING:
    from hiltestbed.scenario.like import ScenarioLike as Scenario


class Platform(Strictly):
    """The motion platform of a scenario: base of every kind.

    A user's kind derives from it, gives ``kind`` as a literal and a method ``facility()``, which
    returns a :class:`hiltestbed.platform.facilities.facility.Facility` and raises InputError for a
    model that does not suit; the facilities of the shipped kinds are in
    :mod:`hiltestbed.platform.build`.

    Attributes:
        tracking: servo: moved by its drives; ideal: the pose reaches the command exactly, one tick
            later; free: nothing is commanded.
        physical: whether freely moving bodies replace the numerical model.
    """

    PARTS: ClassVar[tuple[str, ...]] = ("docstring", "facility")
    physical: ClassVar[bool] = False
    # whether its facility gives the joints' limits; else all are in the scenario's safety section
    states_limits: ClassVar[bool] = True
    # parts of a pose that this rig cannot move, and that a record may lack
    still: ClassVar[tuple[str, ...]] = ()
    carries_upper: ClassVar[bool] = False  # whether an upper platform may carry the passive side
    # whether the start is checked on the facility's model; else by its settings alone
    start_needs_model: ClassVar[bool] = True
    # fields that describe its drives, which have no effect on a prescribed platform
    drives: ClassVar[tuple[str, ...]] = ()

    kind: str
    if TYPE_CHECKING:  # a field of every kind, with choices of its own
        tracking: Any
        response: Any

    @property
    def prescribed(self) -> bool:
        """Whether the pose is prescribed, without mass; else drives or bodies are simulated."""
        return getattr(self, "tracking", "free") in ("ideal", "response")

    def idle(self, scenario: Scenario) -> Iterator[Problem]:
        tracking = getattr(self, "tracking", "free")
        if tracking == "response":
            why = (
                "tracking is response, in which rig.platform.response replaces drives and "
                "controller; put delay and bandwidth there (response.delay, response.bandwidth), "
                "or take tracking servo"
            )
            yield from (((name,), why) for name in self.drives)
        elif tracking == "ideal":
            why = (
                "tracking is ideal, in which the pose reaches the command exactly; take "
                "tracking servo or response"
            )
            yield from (((name,), why) for name in (*self.drives, "response"))
        elif tracking == "servo":
            simulated = "tracking is servo, in which the drives themselves are simulated"
            yield ("response",), f"{simulated}; take tracking response"

    def problems(self, scenario: Scenario) -> Iterator[Problem]:
        """What a scenario requires that these settings exclude. Paths: in the scenario."""
        command = getattr(self, "command", None)
        for path, message in command.problems(scenario.rate) if command else ():
            yield ("rig", "platform", "command", *path), message

    def reference(self) -> dict[str, Any]:
        """The platform of a reference run without rig errors: the same, with exact tracking."""
        return self.model_dump(mode="json") | {"tracking": "ideal"}

    def cure(self, lost: float) -> tuple[str, dict[str, Any]]:
        """The usual compensation of the lags of this kind of rig: in words, and as a scenario's
        compensation.

        Args:
            lost: damping [N s/m] that the lags of sensor and platform remove from the contact, for
                methods designed from it.
        """
        lead = {"force": {"kind": "phase_lead"}, "motion": {"kind": "feedforward"}}
        return "phase lead of the force", lead

    @classmethod
    def contest(cls) -> Mapping[str, Mapping[str, Any]]:
        """Name to `rig.platform` of each of its variants that takes part in `bench facilities`; by
        default one, with default settings.

        A kind with required settings takes part only if it overrides this method and gives them.
        """
        kind, fields = kind_of(cls), cls.model_fields.items()
        needs = any(field.is_required() and name != "kind" for name, field in fields)
        return {} if kind is None or needs else {kind: {"kind": kind}}

    # how this kind of rig distorts a contact, in two or three sentences
    distorts: ClassVar[str] = ""


PLATFORMS: Registry[Platform] = Registry(
    "platform", Platform, ("hiltestbed.platform.shipped.pss33", "hiltestbed.platform.shipped")
)
