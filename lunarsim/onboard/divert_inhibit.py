"""Inhibit diverts while the navigation solution or the map is unreliable."""

from __future__ import annotations


class DivertInhibit:
    """Inhibits diverts while navigation is lost, and for good if it mapped meanwhile.

    With lost navigation a new site is no more certain than the last one, but the divert costs
    propellant and time. A scan that was mapped while navigation was lost is placed wrongly in the
    map, so the map stays unreliable.

    Attributes
    ----------
    inhibited
        Whether diverts are inhibited.
    """

    def __init__(self) -> None:
        self.inhibited = False
        self._mapped_lost = False

    def update(self, lost: bool, mapped: bool) -> bool:
        """Update the state for one cycle; return whether the inhibit changed.

        Parameters
        ----------
        lost
            Whether navigation is lost.
        mapped
            Whether a mapper received a measurement in the cycle.
        """
        self._mapped_lost |= lost and mapped
        before, self.inhibited = self.inhibited, lost or self._mapped_lost
        return self.inhibited != before
