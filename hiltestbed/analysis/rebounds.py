"""Rebound of bounces along one direction, over delay and stiffness: computed from the measured
response, and simulated on request.

Computed bounces are cheap and depend on delay and stiffness like simulated ones, except for a
factor of the rebound that changes slowly with either; the factor of the last simulated bounce is
used for its neighbours. A limit that is found with computed bounces is simulated, and the search is
repeated until the limit does not change. If the first simulated bounce equals the computed one, the
rig is linear, and no further bounce is simulated.
"""

from __future__ import annotations

from collections.abc import Callable

from hiltestbed.analysis.bounce import Bounce, bounce, lag_of
from hiltestbed.analysis.rig_response import RigResponse
from hiltestbed.analysis.trial import Case, FirstContact
from hiltestbed.contact.directions import Direction

ROUNDS = 4  # searches for a limit, at most
# relative change at which a limit has converged; relative resolution of a computed rebound
SAME = 2e-3


class Rebounds:
    """Bounces of a contact ``way`` on a rig; ``simulated`` simulates them, None: only computed."""

    def __init__(
        self, response: RigResponse, way: Direction, simulated: FirstContact | None = None
    ) -> None:
        self._response, self._way, self._simulated = response, way, simulated
        self._factor = 1.0
        self.lag = lag_of(response)

    def first(self, delay: float, stiffness: float) -> Bounce:
        """The contact's own bounce; if it equals the computed one, no further one is simulated."""
        found = self.at(delay, stiffness)
        if abs(self._factor - 1.0) < SAME:
            self._simulated, self._factor = None, 1.0
        return found

    def at(self, delay: float, stiffness: float) -> Bounce:
        """The simulated bounce, or the computed one if none is simulated or the bodies do not
        separate. A negative delay (a lead) is simulated as zero delay, times the ratio of the
        computed bounces.
        """
        through = self._computed(delay, stiffness)
        found = (
            self._simulated.bounce(Case(max(delay, 0.0), stiffness / self._way.stiffness), self.lag)
            if self._simulated
            else None
        )
        if found is None:
            return through
        beside = through if delay >= 0.0 else self._computed(0.0, stiffness)
        if not (found.rebound > 0.0 and beside.rebound > 0.0):
            return found
        self._factor = found.rebound / beside.rebound
        return Bounce(through.rebound * self._factor, through.energy + found.energy - beside.energy)

    def slower(self, delay: float, stiffness: float) -> bool:
        """Whether a bounce ends slower than it began: computed, times the last one's factor."""
        return self._computed(delay, stiffness).rebound * self._factor < 1.0

    def settled(
        self, seek: Callable[[], float | None], case: Callable[[float], tuple[float, float]]
    ) -> float | None:
        """The converged limit that ``seek`` finds with :meth:`slower`; ``case`` gives (delay,
        stiffness) of the bounce at a limit.
        """
        limit = seek()
        for _ in range(ROUNDS):
            if limit is None or self._simulated is None:
                break
            before, factor = limit, self._factor
            self.at(*case(limit))
            limit = seek() if self._factor != factor else limit
            if limit is None or abs(limit - before) <= SAME * abs(limit):
                break
        return limit

    def _computed(self, delay: float, stiffness: float) -> Bounce:
        return bounce(self._response, self._way.mass, stiffness, self._way.damping, delay)
