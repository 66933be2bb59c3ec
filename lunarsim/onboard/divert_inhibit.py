"""Inhibit diverts while the navigation solution or the map is unreliable."""

from __future__ import annotations


class DivertInhibit:
    """Inhibits diverts while navigation is lost or the map is corrupted.

    With lost navigation, a new site is no more certain than the last one, but the divert costs
    propellant and time. A scan that is mapped while navigation is lost is placed wrongly in the
    map. Diverts are then inhibited until touchdown.

    Attributes
    ----------
    inhibited
        Whether diverts are inhibited.
    """

    def __init__(self) -> None:
        self.inhibited = False
        self._mapped_lost = False

    def update(self, is_lost: bool, has_mapped: bool) -> bool:
        """Update the inhibit for one control cycle.

        The return value states whether `inhibited` changed in this cycle.

        Parameters
        ----------
        is_lost
            Whether navigation is lost.
        has_mapped
            Whether a mapper received a measurement in the cycle.
        """
        self._mapped_lost |= is_lost and has_mapped
        before, self.inhibited = self.inhibited, is_lost or self._mapped_lost
        return self.inhibited != before
