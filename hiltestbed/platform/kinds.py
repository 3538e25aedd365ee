"""The motion platforms that a scenario may name: each describes itself in its settings, and nothing else knows it by name."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

from hiltestbed.plugins import Registry, kind_of, placeholder
from hiltestbed.validation import Problem, Strictly

if TYPE_CHECKING:
    from hiltestbed.contact.composition import Structure
    from hiltestbed.platform.facilities.drawing import DrawnFacility
    from hiltestbed.platform.facilities.facility import Facility
    from hiltestbed.platform.facilities.rig import FacilityFollower, FacilityRig
    from hiltestbed.platform.pss33.rig import Pss33Follower, Pss33Rig
    from hiltestbed.scenario import Scenario


class Platform(Strictly):
    """The motion platform of a scenario: base of every kind.

    A kind of one's own derives from it, gives ``kind`` as a literal, and a ``facility`` (:class:`hiltestbed.platform.facilities.facility.
    Facility`); how it is stepped, recorded, watched and measured follows from that.

    Attributes:
        tracking: servo: under its drives; ideal: the pose reaches the command exactly, one tick later; free: nothing is commanded.
        physical: bodies that move by themselves stand in place of the numerical model.
    """

    PARTS: ClassVar[tuple[str, ...]] = ("docstring", "facility")
    physical: ClassVar[bool] = False
    states_limits: ClassVar[bool] = True  # of its joints, in its facility; else the scenario's safety section has them all
    carries_upper: ClassVar[bool] = False  # an upper platform may carry the passive side
    drives: ClassVar[tuple[str, ...]] = ()  # fields that say how it is driven, on which a platform that is prescribed does not hang

    kind: str
    if TYPE_CHECKING:  # a field of every kind, with choices of its own
        tracking: Any
        response: Any

    @property
    def prescribed(self) -> bool:
        """Whether the pose is put where it is to be, without mass, and its rate held over a tick; else drives or bodies are simulated."""
        return getattr(self, "tracking", "free") in ("ideal", "response")

    def idle(self, scenario: Scenario) -> Iterator[Problem]:
        tracking = getattr(self, "tracking", "free")
        if tracking == "response":
            why = "tracking is response, in which rig.platform.response stands for drives and controller together"
            do = "put delay and bandwidth there (response.delay, response.bandwidth), or take tracking servo"
            yield from (((name,), f"{why}; {do}") for name in self.drives)
        elif tracking == "ideal":
            why = "tracking is ideal, in which the pose reaches the command exactly; take tracking servo or response"
            yield from (((name,), why) for name in (*self.drives, "response"))
        elif tracking == "servo":
            yield ("response",), "tracking is servo, in which the drives themselves are simulated; take tracking response"

    @placeholder
    def facility(self) -> Facility:
        """Model, kinematics, drives and limits. Raises InputError for a model of the user's own that does not do."""
        raise NotImplementedError

    def driven(self, scenarios: Sequence[Scenario], structure: Structure, dt: float) -> FacilityRig | Pss33Rig:
        """The rigs of runs on this platform under their drives, for steps of ``dt`` [s]."""
        from hiltestbed.platform.facilities.rig import FacilityRig

        return FacilityRig(scenarios, structure, dt)

    def follower(self, scenarios: Sequence[Scenario], structure: Structure, dt: float) -> FacilityFollower | Pss33Follower:
        """The joints of runs on this platform where it follows exactly."""
        from hiltestbed.platform.facilities.rig import FacilityFollower

        return FacilityFollower(scenarios, structure, dt)

    def drawn(self, scenario: Scenario) -> DrawnFacility | None:
        """The rig of a scenario as it is drawn; None for the one that the viewer draws by itself."""
        from hiltestbed.platform.facilities.drawing import DrawnFacility

        return DrawnFacility(scenario)

    def alike(self, scenario: Scenario) -> Hashable:
        """What must be equal in the runs of one batch: all that the model depends on."""
        return self.facility().alike()

    def problems(self, scenario: Scenario) -> Iterator[Problem]:
        """What of the scenario cannot be on this platform: a start out of reach, rates that do not divide. Paths are the scenario's."""
        from hiltestbed.platform.facilities.checks import facility_problems

        return facility_problems(scenario)

    def reference(self) -> dict[str, Any]:
        """The platform of a run without faults: the same, followed exactly."""
        return self.model_dump(mode="json") | {"tracking": "ideal"}

    def cure(self, lost: float) -> tuple[str, dict[str, Any]]:
        """What the field does on this kind of rig about its lags: in words, and as a scenario's compensation.

        lost: damping [N s/m] that sensor and platform take out of the contact, for methods that are designed by it.
        """
        return "phase lead of the force", {"force": {"kind": "phase_lead"}, "motion": {"kind": "feedforward"}}

    @classmethod
    def contest(cls) -> Mapping[str, Mapping[str, Any]]:
        """Name to `rig.platform` of each of its forms that takes part in `bench facilities`; by default one, with its defaults.

        A kind that has to be told more than that takes no part unless it says what here.
        """
        kind = kind_of(cls)
        needs = [name for name, field in cls.model_fields.items() if field.is_required() and name != "kind"]
        return {} if kind is None or needs else {kind: {"kind": kind}}

    distorts: ClassVar[str] = ""  # what this kind of rig makes of a contact, in two or three sentences

    def nearest_bandwidth(self, scenario: Scenario) -> float:
        """Bandwidth [Hz] of the second order that is nearest to the way the platform follows, along the insertion."""
        given = getattr(self, "response", None)
        if given is not None and getattr(self, "tracking", "free") == "response":
            band = given.bandwidth
            return band if isinstance(band, float) else band[2]
        return self.facility().response(scenario.rate, scenario.compensation.motion.feeds).bandwidth[2]


PLATFORMS: Registry[Platform] = Registry("platform", Platform, ("hiltestbed.platform.pss33.settings", "hiltestbed.platform.shipped"))
