"""The source of a module from a stranger, which leaves a mark when it is imported."""

SOURCE = """
from dataclasses import dataclass
from pathlib import Path
from lunarsim.onboard.policies.library import NoDivert
Path({mark!r}).write_text("imported")
@dataclass(frozen=True)
class Mine(NoDivert):
    name: str = "mine"
"""
