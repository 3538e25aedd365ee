"""How bounces along one direction end, over delay and stiffness: computed through the measured response, and played where that is asked.

Computed bounces cost little and depend on delay and stiffness as played ones do, to within a factor of the rebound that changes slowly
with either: that of the last one played is taken over to its neighbours. A limit that is sought among the computed ones is played, and
sought again, until it stays. Where the first one played is what was computed, the rig is linear, and no other is played.
"""

from __future__ import annotations

from collections.abc import Callable

from hiltestbed.bounce import Bounce, bounce, lag_of
from hiltestbed.contact.directions import Direction
from hiltestbed.rig_response import RigResponse
from hiltestbed.trial import Case, FirstContact

ROUNDS = 4  # of looking for a limit
SAME = 2e-3  # of a limit, by which it stays; of a rebound, what its computation resolves


class Rebounds:
    """Bounces of a contact ``way`` on a rig of a response; ``played``: what plays them, None: they are computed."""

    def __init__(self, response: RigResponse, way: Direction, played: FirstContact | None = None) -> None:
        self._response, self._way, self._played = response, way, played
        self._factor = 1.0
        self.lag = lag_of(response)

    def first(self, delay: float, stiffness: float) -> Bounce:
        """The contact's own bounce; where it is as computed, no other is played."""
        found = self.at(delay, stiffness)
        if abs(self._factor - 1.0) < SAME:
            self._played, self._factor = None, 1.0
        return found

    def at(self, delay: float, stiffness: float) -> Bounce:
        """Played, a force that leads as one without delay beside what is computed of both; computed where nothing is played or parts."""
        through = self._computed(delay, stiffness)
        found = self._played.played(Case(max(delay, 0.0), stiffness), self.lag) if self._played else None
        if found is None:
            return through
        beside = through if delay >= 0.0 else self._computed(0.0, stiffness)
        if not (found.rebound > 0.0 and beside.rebound > 0.0):
            return found
        self._factor = found.rebound / beside.rebound
        return Bounce(through.rebound * self._factor, through.energy + found.energy - beside.energy)

    def slower(self, delay: float, stiffness: float) -> bool:
        """Whether a bounce ends slower than it began, as far as the last one played tells."""
        return self._computed(delay, stiffness).rebound * self._factor < 1.0

    def settled(self, seek: Callable[[], float | None], case: Callable[[float], tuple[float, float]]) -> float | None:
        """The limit that ``seek`` finds with :meth:`slower`, at which a bounce is the ``case`` of (delay, stiffness)."""
        limit = seek()
        for _ in range(ROUNDS):
            if limit is None or self._played is None:
                break
            before, factor = limit, self._factor
            self.at(*case(limit))
            limit = seek() if self._factor != factor else limit
            if limit is None or abs(limit - before) <= SAME * abs(limit):
                break
        return limit

    def _computed(self, delay: float, stiffness: float) -> Bounce:
        return bounce(self._response, self._way.mass, stiffness, self._way.damping, delay)
