"""Whether diverts are to be trusted to navigation and map."""

from __future__ import annotations


class DivertBar:
    """Keeps a lander to its site while navigation is lost, and for good once it mapped then.

    The site decided on last is then as far off as any other, and a divert costs propellant and time
    besides. Where something was mapped while navigation was lost, part of the map lies where nobody
    knows.

    Attributes
    ----------
    barred
        Whether diverts are.
    """

    def __init__(self) -> None:
        self.barred = False
        self._mapped_lost = False

    def changes(self, lost: bool, mapped: bool) -> bool:
        """Tell whether diverts are barred, or allowed again, by a cycle.

        Parameters
        ----------
        lost, mapped
            Whether navigation is lost, and whether something was mapped in the cycle.
        """
        self._mapped_lost |= lost and mapped
        before, self.barred = self.barred, lost or self._mapped_lost
        return self.barred != before
